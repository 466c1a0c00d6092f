//! What is between a camera and what it sees, as a type: the pixels of a scene without media are
//! shaded by code that has no work for them, and a frame chooses once.

use crate::inscatter::{GatherInMedia, InScatter, Marched, MediaCounts};
use crate::light::{SceneMedia, Shadows, Vacuum};
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb};
use crate::view::View;
use glam::Vec3;

/// What camera rays and shadow rays pass.
pub trait CameraMedia: Sync {
    /// What a camera ray passed.
    type Passed: PassedMedia;
    /// What shadow rays pass.
    type Shadows: Shadows;

    /// Passes what is between the camera and `t_max` along a unit direction.
    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Self::Passed;

    /// The same, and what it took.
    fn march_counted(&self, view: &View, direction: Vec3, t_max: f32) -> (Self::Passed, Marched);

    /// What lighting media took so far.
    fn counts(&self) -> MediaCounts;
}

/// What the media before a sample took and added.
pub trait PassedMedia: Copy + Default + Send + Sync + 'static {
    /// Whether there can be media.
    const IS_VACUUM: bool;

    /// What took this share of the light behind it less than all, and added this radiance.
    fn of(transmittance: f32, radiance: Rgb) -> Self;

    /// Share of the light behind that comes through.
    fn transmittance(&self) -> f32;

    /// Radiance scattered towards the camera.
    fn radiance(&self) -> Rgb;
}

impl CameraMedia for Vacuum {
    type Passed = Self;
    type Shadows = Self;

    #[inline]
    fn march(&self, _: &View, _: Vec3, _: f32) -> Self {
        Self
    }

    fn march_counted(&self, _: &View, _: Vec3, _: f32) -> (Self, Marched) {
        (Self, Marched::default())
    }

    fn counts(&self) -> MediaCounts {
        MediaCounts::default()
    }
}

impl PassedMedia for Vacuum {
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

/// Media before a camera ray, marched by code for whichever pages and media there are.
pub struct ScatteringMedia<'a>(pub &'a (dyn March + 'a));

/// Marches of camera rays through media.
pub trait March: Sync {
    /// Passes what is between the camera and `t_max` along a unit direction.
    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Composite;

    /// The same, and what it took.
    fn march_counted(&self, view: &View, direction: Vec3, t_max: f32) -> (Composite, Marched);

    /// What lighting media took so far.
    fn counts(&self) -> MediaCounts;
}

impl<'a> CameraMedia for ScatteringMedia<'a> {
    type Passed = Composite;
    type Shadows = SceneMedia<'a>;

    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Composite {
        self.0.march(view, direction, t_max)
    }

    fn march_counted(&self, view: &View, direction: Vec3, t_max: f32) -> (Composite, Marched) {
        self.0.march_counted(view, direction, t_max)
    }

    fn counts(&self) -> MediaCounts {
        self.0.counts()
    }
}

impl<G: GatherInMedia> March for InScatter<'_, G> {
    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Composite {
        self.march(&Ray::new(view.camera.origin(), direction, t_max))
    }

    fn march_counted(&self, view: &View, direction: Vec3, t_max: f32) -> (Composite, Marched) {
        self.march_counted(&Ray::new(view.camera.origin(), direction, t_max))
    }

    fn counts(&self) -> MediaCounts {
        self.counts()
    }
}

/// Media that light comes from, with the way of a camera ray through those that scatter it.
pub struct EmissiveMedia<'a>(pub &'a (dyn March + 'a));

impl EmissiveMedia<'_> {
    fn emitting(view: &View, direction: Vec3, t_max: f32, passed: Composite) -> Composite {
        let ray = Ray::new(view.camera.origin(), direction, t_max);
        Composite {
            radiance: passed.radiance + view.tracer.emitted(&ray),
            ..passed
        }
    }
}

impl March for EmissiveMedia<'_> {
    fn march(&self, view: &View, direction: Vec3, t_max: f32) -> Composite {
        let passed = self.0.march(view, direction, t_max);
        Self::emitting(view, direction, t_max, passed)
    }

    fn march_counted(&self, view: &View, direction: Vec3, t_max: f32) -> (Composite, Marched) {
        let (passed, took) = self.0.march_counted(view, direction, t_max);
        (Self::emitting(view, direction, t_max, passed), took)
    }

    fn counts(&self) -> MediaCounts {
        self.0.counts()
    }
}

impl PassedMedia for Composite {
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
