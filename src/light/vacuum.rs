//! A scene without media, as a type: shadow rays have no work for any, and nothing to note of them.

use super::shadows::{OpticalDepth, Shadows};
use super::sight::Dimming;
use crate::trace::Tracer;
use glam::Vec3;

/// No medium anywhere.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vacuum;

impl Shadows for Vacuum {
    type Dimming = Self;

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

impl Dimming for Vacuum {
    #[inline]
    fn note(&mut self, _: u64, _: f32) {}

    #[inline]
    fn differs(&self, _: u64, _: u64) -> bool {
        false
    }

    #[inline]
    fn join(&mut self, _: Self) {}
}
