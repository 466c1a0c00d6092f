//! What is between a camera and what it sees, as a type: the pixels of a scene without media are
//! shaded by code that has no work for them, and a frame chooses once.

use crate::inscatter::{GatherInMedia, InScatter, Marched, MediaCounts};
use crate::light::{SceneMedia, Shadows, Vacuum};
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb};
use crate::view::View;

/// What camera rays and shadow rays pass.
pub trait CameraMedia: Sync {
    /// What a camera ray passed.
    type Passed: PassedMedia;
    /// What shadow rays pass.
    type Shadows: Shadows;

    /// Passes what is along a camera ray.
    fn march(&self, view: &View, ray: &Ray) -> Self::Passed;

    /// The same, and what it took.
    fn march_counted(&self, view: &View, ray: &Ray) -> (Self::Passed, Marched);

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

    /// Whether they take or add anything that is seen.
    fn shows(&self) -> bool {
        /// Share of light that is not.
        const LITTLE: f32 = 1e-3;
        !Self::IS_VACUUM && (self.transmittance() < 1.0 - LITTLE || !self.radiance().is_black())
    }
}

impl CameraMedia for Vacuum {
    type Passed = Self;
    type Shadows = Self;

    #[inline]
    fn march(&self, _: &View, _: &Ray) -> Self {
        Self
    }

    fn march_counted(&self, _: &View, _: &Ray) -> (Self, Marched) {
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
    /// Passes what is along a camera ray.
    fn march(&self, view: &View, ray: &Ray) -> Composite;

    /// The same, and what it took.
    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite, Marched);

    /// What lighting media took so far.
    fn counts(&self) -> MediaCounts;
}

impl<'a> CameraMedia for ScatteringMedia<'a> {
    type Passed = Composite;
    type Shadows = SceneMedia<'a>;

    fn march(&self, view: &View, ray: &Ray) -> Composite {
        self.0.march(view, ray)
    }

    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite, Marched) {
        self.0.march_counted(view, ray)
    }

    fn counts(&self) -> MediaCounts {
        self.0.counts()
    }
}

impl<G: GatherInMedia> March for InScatter<'_, G> {
    fn march(&self, _: &View, ray: &Ray) -> Composite {
        self.march(ray)
    }

    fn march_counted(&self, _: &View, ray: &Ray) -> (Composite, Marched) {
        self.march_counted(ray)
    }

    fn counts(&self) -> MediaCounts {
        self.counts()
    }
}

/// Media that light comes from, with the way of a camera ray through those that scatter it.
pub struct EmissiveMedia<'a>(pub &'a (dyn March + 'a));

impl EmissiveMedia<'_> {
    fn emitting(view: &View, ray: &Ray, passed: Composite) -> Composite {
        Composite {
            radiance: passed.radiance + view.tracer.emitted(ray),
            ..passed
        }
    }
}

impl March for EmissiveMedia<'_> {
    fn march(&self, view: &View, ray: &Ray) -> Composite {
        let passed = self.0.march(view, ray);
        Self::emitting(view, ray, passed)
    }

    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite, Marched) {
        let (passed, took) = self.0.march_counted(view, ray);
        (Self::emitting(view, ray, passed), took)
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
