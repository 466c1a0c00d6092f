//! A scene without media, as a type: shadow rays have no work for any, and nothing to note of them.

use super::shadows::{OpticalDepth, Shadows};
use crate::trace::Tracer;
use glam::Vec3;

/// No medium anywhere.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vacuum;

impl Shadows for Vacuum {
    #[inline]
    fn transmittance(
        &self,
        tracer: &Tracer,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        _: Option<&dyn OpticalDepth>,
    ) -> f32 {
        if tracer.is_occluded(origin, direction, t_max) {
            0.0
        } else {
            1.0
        }
    }

    #[inline]
    fn before_triangles(&self) -> Option<&dyn OpticalDepth> {
        None
    }
}
