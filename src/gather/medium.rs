//! What is between surfaces, as a type: kernels are compiled for each, and a frame chooses one of them once.

use super::{Crossing, Media};
use crate::math::Rgb;
use crate::math::segment::{Composite, Segment};
use glam::Vec3;

/// What a ray passes between surfaces.
pub trait Medium: Copy + Sync {
    /// Passes what is between `origin` and `t_max`, and on the way the surfaces in `crossings`, which are sorted.
    fn pass(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        crossings: &[Crossing],
        light: &mut Composite,
    );

    /// Gives every stretch of medium between `origin` and `t_max`, front to back, to `add` until that says no.
    fn walk(&self, origin: Vec3, direction: Vec3, t_max: f32, add: impl FnMut(Segment) -> bool);
}

/// Nothing between surfaces.
#[derive(Clone, Copy, Debug)]
pub struct NoMedia;

impl Medium for NoMedia {
    #[inline]
    fn pass(&self, _: Vec3, _: Vec3, _: f32, crossings: &[Crossing], light: &mut Composite) {
        for c in crossings {
            light.surface(c.opacity, c.radiance);
        }
    }

    #[inline]
    fn walk(&self, _: Vec3, _: Vec3, _: f32, _: impl FnMut(Segment) -> bool) {}
}

impl<S: Source> Medium for &Media<S> {
    #[inline]
    fn pass(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        crossings: &[Crossing],
        light: &mut Composite,
    ) {
        Media::pass(self, origin, direction, t_max, crossings, light);
    }

    #[inline]
    fn walk(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        mut add: impl FnMut(Segment) -> bool,
    ) {
        Media::walk(self, origin, direction, t_max, &mut add);
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
