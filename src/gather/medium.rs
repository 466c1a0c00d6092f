//! What is between surfaces, as a type: kernels are compiled for each, and a frame chooses one of them once.

use super::Crossing;
use crate::math::Rgb;
use crate::math::segment::{Composite, Segment};
use glam::Vec3;

/// What a ray passes between surfaces.
pub trait Medium: Copy + Sync {
    /// Gives every stretch of medium between `origin` and `t_max`, front to back, to `add` until that says no; returns
    /// whether it never did.
    fn walk(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        add: &mut impl FnMut(Segment) -> bool,
    ) -> bool;

    /// Passes what is between `origin` and `t_max`, and on the way the surfaces in `crossings`, which are sorted.
    #[inline]
    fn pass(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        crossings: &[Crossing],
        light: &mut Composite,
    ) {
        let mut crossings = crossings.iter().peekable();
        let mut add = |mut s: Segment| {
            while let Some(c) = crossings.next_if(|c| c.t < s.far) {
                let share = ((c.t - s.near) / (s.far - s.near)).clamp(0.0, 1.0);
                light.medium(s.tau * share, s.source);
                light.surface(c.opacity, c.radiance);
                s.tau *= 1.0 - share;
                s.near = s.near.max(c.t);
            }
            light.medium(s.tau, s.source);
            light.transmittance > Composite::NOTHING
        };
        if self.walk(origin, direction, t_max, &mut add) {
            crossings.for_each(|c| light.surface(c.opacity, c.radiance));
        }
    }
}

/// Nothing between surfaces.
#[derive(Clone, Copy, Debug)]
pub struct NoMedia;

impl Medium for NoMedia {
    #[inline]
    fn walk(&self, _: Vec3, _: Vec3, _: f32, _: &mut impl FnMut(Segment) -> bool) -> bool {
        true
    }
}

/// The source function of an lvoxel as it is held in memory: [`Rgb`], or one channel where all three are equal.
pub trait Source: Copy + std::fmt::Debug + Default + Send + Sync {
    /// From all channels.
    fn of(radiance: Rgb) -> Self;

    /// All channels.
    fn rgb(self) -> Rgb;
}

impl Source for Rgb {
    #[inline]
    fn of(radiance: Rgb) -> Self {
        radiance
    }

    #[inline]
    fn rgb(self) -> Rgb {
        self
    }
}

impl Source for f32 {
    #[inline]
    fn of(radiance: Rgb) -> Self {
        radiance.0[0]
    }

    #[inline]
    fn rgb(self) -> Rgb {
        Rgb::splat(self)
    }
}
