//! A point that asks for light.

use super::rays::ShadowRays;
use super::shadows::{OpticalDepth, Shadows};
use crate::trace::{self, Tracer};
use glam::Vec3;

/// A point that asks for light, and what its shadow rays pass.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint<'a, S, R> {
    /// Surfaces, and the scene's own media.
    pub tracer: &'a Tracer<'a>,
    /// How media stop light.
    pub shadows: S,
    /// Where rays begin, in scene space: off the surface that asks, if one does.
    pub origin: Vec3,
    /// Shadow rays to each light with an extent: which of its samples, and how many.
    pub rays: ShadowRays,
    /// What light falls on there.
    pub receiver: R,
}

impl<S: Shadows, R> ShadingPoint<'_, S, R> {
    /// Share of light that gets here from `t_max` away along a unit direction; `depth` tells that of the media, if not the
    /// scene's own do.
    pub fn through(&self, direction: Vec3, t_max: f32, depth: Option<&dyn OpticalDepth>) -> f32 {
        self.shadows
            .transmittance(self.tracer, self.origin, direction, t_max, depth)
    }

    /// Share of the light that gets here from a point of an emissive triangle, `distance` along a unit direction.
    pub fn through_from_triangle(&self, direction: Vec3, distance: f32) -> f32 {
        let end = trace::short_of(self.origin + direction * distance, distance);
        self.through(direction, end, self.shadows.before_triangles())
    }
}
