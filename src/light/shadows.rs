//! What shadow rays pass, as a type: light is asked for by code of its own where there are no
//! media.

use super::sight::{Dimmed, Dimming};
use super::soft_shadows::SoftShadows;
use crate::math::exp::exp_neg;
use crate::trace::Tracer;
use glam::Vec3;

/// Media as shadow rays may see them instead of the scene's own.
pub trait OpticalDepth: Sync + std::fmt::Debug {
    /// Optical depth from `origin` to `t_max` along a unit direction.
    fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32;
}

/// What shadow rays pass beside surfaces.
pub trait Shadows: Copy + Sync + std::fmt::Debug {
    /// What rays note of media that let a part of them through.
    type Dimming: Dimming;

    /// Share of light that gets from `origin` to `t_max` along a unit direction; `depth` tells that
    /// of the media, if not the scene's own do.
    fn transmittance(
        &self,
        tracer: &Tracer,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        depth: Option<&dyn OpticalDepth>,
    ) -> f32;

    /// The media before emissive triangles, if not the scene's own.
    fn before_triangles(&self) -> Option<&dyn OpticalDepth>;
}

/// The scene's media.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneMedia<'a> {
    /// What rays to emissive triangles meet instead.
    pub(super) before_triangles: Option<&'a SoftShadows>,
}

impl Shadows for SceneMedia<'_> {
    type Dimming = Dimmed;

    fn transmittance(
        &self,
        tracer: &Tracer,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        depth: Option<&dyn OpticalDepth>,
    ) -> f32 {
        match depth {
            None => tracer.transmittance(origin, direction, t_max),
            Some(_) if tracer.is_occluded(origin, direction, t_max) => 0.0,
            Some(depth) => exp_neg(depth.optical_depth(origin, direction, t_max)),
        }
    }

    fn before_triangles(&self) -> Option<&dyn OpticalDepth> {
        self.before_triangles
            .map(|media| media as &dyn OpticalDepth)
    }
}
