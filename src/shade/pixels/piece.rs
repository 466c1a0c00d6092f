//! Pieces of surface that a pixel sees.

use crate::light::ShadowRatio;
use crate::shade::surfaces::WithSky;
use crate::trace::Surface;

/// A smooth piece of surface in a pixel, whose samples share their indirect light and their shadow
/// rays.
pub struct Piece {
    /// A point of it.
    pub surface: Surface,
    /// Indirect irradiance on the side that the pixel sees.
    pub irradiance: WithSky,
    /// What shadow rays from all of its samples brought.
    pub ratio: ShadowRatio,
    /// The same of the excess of an environment image.
    pub sky_ratio: ShadowRatio,
}

impl Piece {
    /// A piece of which no sample is known yet.
    pub fn new(surface: Surface, irradiance: WithSky) -> Self {
        Self {
            surface,
            irradiance,
            ratio: ShadowRatio::default(),
            sky_ratio: ShadowRatio::default(),
        }
    }
}
