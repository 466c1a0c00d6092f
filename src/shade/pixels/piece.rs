//! Pieces of surface that a pixel sees.

use crate::light::ShadowRatio;
use crate::math::Rgb;
use crate::trace::Surface;

/// A smooth piece of surface in a pixel, whose samples share their indirect light and their shadow
/// rays.
pub struct Piece {
    /// A point of it.
    pub surface: Surface,
    /// Indirect irradiance on the side that the pixel sees.
    pub irradiance: Rgb,
    /// What shadow rays from all of its samples brought.
    pub ratio: ShadowRatio,
}

impl Piece {
    /// A piece of which no sample is known yet.
    pub fn new(surface: Surface, irradiance: Rgb) -> Self {
        Self {
            surface,
            irradiance,
            ratio: ShadowRatio::default(),
        }
    }
}
