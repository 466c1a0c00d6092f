//! What is between a camera and what it sees, as a type: the pixels of a scene without media are
//! shaded by code that has no work for them, and a frame chooses once.

use super::media::{InScatter, Known};
use super::view::View;
use crate::gather::Medium;
use crate::light::{SceneMedia, Shadows, Vacuum};
use crate::math::exp::exp_neg;
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb};
use crate::tree::Pages;
use glam::Vec3;
use std::cell::RefCell;

/// What camera rays and shadow rays pass.
pub trait Air: Sync {
    /// What a camera ray passed.
    type Passed: Passed;
    /// What shadow rays pass.
    type Shadows: Shadows;

    /// Passes what is between the camera and `t_max` along a unit direction.
    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Self::Passed;
}

/// What the media before a sample took and added.
pub trait Passed: Copy + Default + Send + Sync + 'static {
    /// Whether there can be media.
    const IS_VACUUM: bool;

    /// What took this share of the light behind it less than all, and added this radiance.
    fn of(transmittance: f32, radiance: Rgb) -> Self;

    /// Share of the light behind that comes through.
    fn transmittance(&self) -> f32;

    /// Radiance scattered towards the camera.
    fn radiance(&self) -> Rgb;
}

impl Air for Vacuum {
    type Passed = Self;
    type Shadows = Self;

    #[inline]
    fn march(&self, _: &View, _: Vec3, _: f32) -> Self {
        Self
    }
}

impl Passed for Vacuum {
    const IS_VACUUM: bool = true;

    #[inline]
    fn of(_: f32, _: Rgb) -> Self {
        Self
    }

    #[inline]
    fn transmittance(&self) -> f32 {
        1.0
    }

    #[inline]
    fn radiance(&self) -> Rgb {
        Rgb::BLACK
    }
}

impl<'a, P: Pages, M: Medium> Air for InScatter<'a, P, M> {
    type Passed = Composite;
    type Shadows = SceneMedia<'a>;

    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Composite {
        let mut passed = Composite::default();
        let (tracer, origin) = (view.tracer, view.camera.origin());
        let known = RefCell::new(Known::default());
        tracer.march(
            &Ray::new(origin, direction, t_max),
            |volume, stretch, _| {
                let at = |t| origin + direction * t;
                let ends = [at(stretch.near), at(stretch.far)];
                self.source(volume, ends, stretch.tau, &mut known.borrow_mut())
            },
            |s| {
                passed.medium(s.tau, s.source);
                !passed.is_opaque()
            },
        );
        if passed.is_opaque() {
            // What the march left out still hides what is behind, however bright that is.
            passed.transmittance =
                exp_neg(tracer.optical_depth(&Ray::new(origin, direction, t_max)));
        }
        passed
    }
}

impl Passed for Composite {
    const IS_VACUUM: bool = false;

    #[inline]
    fn of(transmittance: f32, radiance: Rgb) -> Self {
        Self {
            radiance,
            transmittance,
        }
    }

    #[inline]
    fn transmittance(&self) -> f32 {
        self.transmittance
    }

    #[inline]
    fn radiance(&self) -> Rgb {
        self.radiance
    }
}
