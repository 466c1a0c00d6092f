//! What is between a camera and what it sees, as a type: the pixels of a scene without media are
//! shaded by code that has no work for them, and a frame chooses once.

use crate::inscatter::{GatherInMedia, InScatter, Marched, MediaCounts};
use crate::light::{SceneMedia, Shadows, Vacuum};
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb, Spectrum};
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
    /// What tells shares of light.
    type Share: Spectrum;

    /// What took this share of the light behind it less than all, and added this radiance.
    fn of(transmittance: Self::Share, radiance: Rgb) -> Self;

    /// Share of the light behind that comes through.
    fn transmittance(&self) -> Self::Share;

    /// Radiance scattered towards the camera.
    fn radiance(&self) -> Rgb;

    /// Whether they take or add anything that is seen.
    fn shows(&self) -> bool {
        /// Share of light that is not.
        const LITTLE: f32 = 1e-3;
        !Self::IS_VACUUM
            && (self.transmittance().least() < 1.0 - LITTLE || !self.radiance().is_black())
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
    type Share = f32;

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

/// Media before a camera ray, marched by code for whichever media there are.
pub struct ScatteringMedia<'a, K>(pub &'a (dyn March<K> + 'a));

/// Marches of camera rays through media.
pub trait March<K>: Sync {
    /// Passes what is along a camera ray.
    fn march(&self, view: &View, ray: &Ray) -> Composite<K>;

    /// The same, and what it took.
    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite<K>, Marched);

    /// What lighting media took so far.
    fn counts(&self) -> MediaCounts;
}

impl<'a, K: Spectrum> CameraMedia for ScatteringMedia<'a, K> {
    type Passed = Composite<K>;
    type Shadows = SceneMedia<'a, K>;

    fn march(&self, view: &View, ray: &Ray) -> Composite<K> {
        self.0.march(view, ray)
    }

    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite<K>, Marched) {
        self.0.march_counted(view, ray)
    }

    fn counts(&self) -> MediaCounts {
        self.0.counts()
    }
}

impl<G: GatherInMedia> March<G::Share> for InScatter<'_, G> {
    fn march(&self, _: &View, ray: &Ray) -> Composite<G::Share> {
        self.march(ray)
    }

    fn march_counted(&self, _: &View, ray: &Ray) -> (Composite<G::Share>, Marched) {
        self.march_counted(ray)
    }

    fn counts(&self) -> MediaCounts {
        self.counts()
    }
}

/// Media that light comes from, with the way of a camera ray through those that scatter it.
pub struct EmissiveMedia<'a, K>(pub &'a (dyn March<K> + 'a));

impl<K: Spectrum> EmissiveMedia<'_, K> {
    fn emitting(view: &View, ray: &Ray, passed: Composite<K>) -> Composite<K> {
        Composite {
            radiance: passed.radiance + view.tracer.emitted::<K>(ray),
            ..passed
        }
    }
}

impl<K: Spectrum> March<K> for EmissiveMedia<'_, K> {
    fn march(&self, view: &View, ray: &Ray) -> Composite<K> {
        let passed = self.0.march(view, ray);
        Self::emitting(view, ray, passed)
    }

    fn march_counted(&self, view: &View, ray: &Ray) -> (Composite<K>, Marched) {
        let (passed, took) = self.0.march_counted(view, ray);
        (Self::emitting(view, ray, passed), took)
    }

    fn counts(&self) -> MediaCounts {
        self.0.counts()
    }
}

impl<K: Spectrum> PassedMedia for Composite<K> {
    const IS_VACUUM: bool = false;
    type Share = K;

    #[inline]
    fn of(transmittance: K, radiance: Rgb) -> Self {
        Self {
            radiance,
            transmittance,
        }
    }

    #[inline]
    fn transmittance(&self) -> K {
        self.transmittance
    }

    #[inline]
    fn radiance(&self) -> Rgb {
        self.radiance
    }
}
