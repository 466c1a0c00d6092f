//! What kernels tell of a ray.

use crate::math::Rgb;

/// A surface that a ray meets: where, how much of the ray it covers, and what it sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Distance along the ray.
    pub t: f32,
    /// Share of the ray that it covers; 1 ends it.
    pub opacity: f32,
    /// Radiance towards the ray's origin.
    pub radiance: Rgb,
}
