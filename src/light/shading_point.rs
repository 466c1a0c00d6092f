//! A point that asks for light.

use super::emitter::Emitter;
use super::rays::ShadowRays;
use super::receiver::Receiver;
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
    /// Share of light that gets here from `t_max` away along a unit direction; `depth` tells that
    /// of the media, if not the scene's own do.
    pub fn through(&self, direction: Vec3, t_max: f32, depth: Option<&dyn OpticalDepth>) -> f32 {
        self.shadows
            .transmittance(self.tracer, self.origin, direction, t_max, depth)
    }

    /// Share of the light that gets here from a point of an emissive triangle, `distance` along a
    /// unit direction.
    fn through_from_triangle(&self, direction: Vec3, distance: f32) -> f32 {
        let end = trace::short_of(self.origin + direction * distance, distance);
        self.through(direction, end, self.shadows.before_triangles())
    }
}

impl<S: Shadows, R: Receiver> ShadingPoint<'_, S, R> {
    /// A ray to the point of an emissive triangle that two numbers in [0,1) choose: what a unit of
    /// radiance from there counts, over `expected` (the chance of the triangle, or its whole
    /// response), and the share of it that gets here. `None` if it counts for nothing.
    pub fn ray_to(&self, emitter: &Emitter, u: [f32; 2], expected: f32) -> Option<(f32, f32)> {
        let (d, distance, pdf) = emitter.look_at(self.origin, u, self.rays.near());
        let w = self.receiver.response(d) / (pdf * expected);
        (w > 0.0 && w.is_finite()).then(|| (w, self.through_from_triangle(d, distance)))
    }
}
