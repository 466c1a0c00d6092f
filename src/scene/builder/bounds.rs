//! The box around a scene in the making, and the exposure that fits it.

use super::copies::Copies;
use super::{DEFAULT_FILM, SceneBuilder};
use crate::scene::Light;
use glam::DVec3;

/// A box in world space.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub low: DVec3,
    pub high: DVec3,
}

impl Bounds {
    const EMPTY: Self = Self {
        low: DVec3::INFINITY,
        high: DVec3::NEG_INFINITY,
    };

    fn add(&mut self, p: DVec3) {
        self.low = self.low.min(p);
        self.high = self.high.max(p);
    }

    pub fn centre(&self) -> DVec3 {
        0.5 * (self.low + self.high)
    }

    pub fn radius(&self) -> f64 {
        0.5 * (self.high - self.low).length()
    }
}

impl SceneBuilder {
    pub(super) fn bounds(&self) -> Bounds {
        let mut bounds = Bounds::EMPTY;
        for mesh in &self.meshes {
            // Vertices that no triangle uses are not part of the picture.
            for v in mesh.triangles.iter().flatten() {
                bounds.add(mesh.positions[*v as usize]);
            }
            for [low, high] in mesh.copies.iter().map(Copies::bounds) {
                bounds.add(low);
                bounds.add(high);
            }
        }
        for volume in self.all_volumes() {
            for corner in volume.corners() {
                bounds.add(corner);
            }
        }
        bounds
    }

    /// For a file that says nothing of film: the exposure at which a white surface in the middle of
    /// the scene that faces all its lights is just white, so that lights in lux and in watts make
    /// the same picture.
    pub(super) fn default_exposure(&self, bounds: &Bounds) -> f32 {
        let distance2 = (bounds.radius() * bounds.radius()) as f32;
        let brightest: f32 = self
            .lights
            .iter()
            .map(|l| match l.light {
                Light::Directional { irradiance, .. } => irradiance,
                Light::Point { intensity, .. } | Light::Spot { intensity, .. } => {
                    intensity.map(|v| v / distance2)
                }
                Light::Environment { radiance } => radiance.map(|v| v * std::f32::consts::PI),
            })
            .chain(
                self.environment_image
                    .iter()
                    .map(|i| (i.image.mean() * std::f32::consts::PI).0),
            )
            .map(|irradiance| irradiance.into_iter().fold(0.0, f32::max) / std::f32::consts::PI)
            .sum();
        if brightest.is_finite() && brightest > 0.0 {
            1.0 / brightest
        } else {
            DEFAULT_FILM.exposure
        }
    }
}
