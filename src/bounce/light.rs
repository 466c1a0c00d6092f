//! What lvoxels, rays and solvers reckon with.

use crate::math::{Rgb, Spectrum};
use glam::Vec3A;

/// Light, by channel.
pub type Light = Vec3A;

/// Optical depths and shares of light that solvers reckon with: one number where media are grey,
/// one for each channel where they have colour.
pub trait Share: Spectrum {
    /// The same as factors of each channel of light.
    fn light(self) -> Light;
}

impl Share for f32 {
    #[inline]
    fn light(self) -> Light {
        Light::splat(self)
    }
}

impl Share for Rgb {
    #[inline]
    fn light(self) -> Light {
        Light::from(self.0)
    }
}
