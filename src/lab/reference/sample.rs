//! A way to a light.

use crate::math::Rgb;
use glam::Vec3;

/// A way to a light from some point.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Unit direction to the light.
    pub direction: Vec3,
    /// Distance, infinite for what is infinitely far.
    pub distance: f32,
    /// Radiance over density: times the receiver's response it estimates what arrives if nothing is
    /// between.
    pub light: Rgb,
    /// Density of the direction, per steradian.
    pub pdf: f32,
}
