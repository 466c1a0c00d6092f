//! What makes a camera more than a pinhole: a lens, and a shutter that is open while it moves.

use super::Film;
use crate::math::sampling;
use glam::{Affine3A, Vec3};

/// A thin lens: sharp is what lies in the plane at its focus distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Radius of its opening, scene units.
    pub aperture: f32,
    /// Distance along the camera's axis of what is sharp, scene units.
    pub focus_distance: f32,
}

impl Lens {
    /// Apertures and focus distances that are taken for no mistake, scene units.
    pub(super) const LENGTHS: std::ops::RangeInclusive<f32> = 1e-15..=1e15;

    /// A lens of these lengths; `None`, a pinhole, if its aperture is 0.
    #[must_use]
    pub fn new(aperture: f32, focus_distance: f32) -> Option<Self> {
        (aperture != 0.0).then_some(Self {
            aperture,
            focus_distance,
        })
    }

    /// What is in between two lenses; a pinhole counts as one of no aperture.
    pub(super) fn between(a: Option<Self>, b: Option<Self>, share: f32) -> Option<Self> {
        let like = a.or(b)?;
        let [a, b] = [a, b].map(|lens| {
            lens.unwrap_or(Self {
                aperture: 0.0,
                ..like
            })
        });
        let mix = |a: f32, b: f32| a + (b - a) * share;
        let aperture = mix(a.aperture, b.aperture);
        Self::new(aperture, mix(a.focus_distance, b.focus_distance))
    }

    /// Radius of the circle of confusion of a point at a depth, as a tangent: in the plane one unit
    /// ahead of the camera.
    #[must_use]
    pub fn confusion(&self, depth: f32) -> f32 {
        self.aperture * (1.0 / self.focus_distance - 1.0 / depth).abs()
    }
}

/// A camera at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation and position; no scale.
    pub scene_from_camera: Affine3A,
    /// Tangent of half the horizontal field of view.
    pub half_width: f32,
    /// Its lens; `None` for a pinhole.
    pub lens: Option<Lens>,
}

impl Pose {
    /// The ray through a point of the film, pixels from its top left, and through the point of the
    /// lens that two numbers in [0,1) choose.
    #[must_use]
    pub fn ray(&self, film: &Film, at: [f32; 2], on_lens: [f32; 2]) -> CameraRay {
        let ahead = film.ahead(self.half_width, at);
        let (from, toward) = match self.lens {
            Some(lens) => {
                let [x, y] = sampling::disk(on_lens).map(|c| c * lens.aperture);
                let from = Vec3::new(x, y, 0.0);
                (from, ahead * lens.focus_distance - from)
            }
            None => (Vec3::ZERO, ahead),
        };
        let place = self.scene_from_camera;
        CameraRay {
            origin: place.transform_point3(from),
            direction: place.transform_vector3(toward).normalize(),
        }
    }

    /// Where a point is seen through the middle of the lens, pixels from the film's top left, and
    /// its depth along the axis; `None` if that is behind.
    #[must_use]
    pub fn on_film(&self, film: &Film, point: Vec3) -> Option<([f32; 2], f32)> {
        let place = &self.scene_from_camera;
        let away = point - Vec3::from(place.translation);
        let axes = place.matrix3;
        let [x, y, z] = [axes.x_axis, axes.y_axis, axes.z_axis].map(|a| away.dot(a.into()));
        let depth = -z;
        (depth > 0.0).then(|| {
            let scale = film.width as f32 / (2.0 * self.half_width * depth);
            let middle = [0.5 * film.width as f32, 0.5 * film.height as f32];
            ([middle[0] + x * scale, middle[1] - y * scale], depth)
        })
    }
}

/// A ray of a camera with a lens or an open shutter.
#[derive(Clone, Copy, Debug)]
pub struct CameraRay {
    /// A point of the lens, scene space.
    pub origin: Vec3,
    /// Unit direction, scene space.
    pub direction: Vec3,
}
