//! Light and the share of other light that gets through, as lanes of numbers that go together.

use super::{Rgb, Spectrum};
use std::fmt::Debug;
use std::ops::{AddAssign, Mul};
use wide::f32x4;

/// Radiance along a ray and the share of the light from behind that gets through, of a type that is
/// summed and weighted at once; 0 by default.
pub trait Lanes:
    Copy + Debug + Default + Send + Sync + AddAssign + Mul<f32x4, Output = Self> + 'static
{
    /// What tells the share.
    type Share: Spectrum;

    /// Numbers that tell a depth, or a share, to [`Self::pass`].
    const DEPTHS: usize;

    /// Radiance and a share.
    fn new(radiance: Rgb, share: Self::Share) -> Self;

    /// The radiance and the share.
    fn parts(self) -> (Rgb, Self::Share);

    /// Adds [`Self::DEPTHS`] numbers for a depth, where a medium has such a colour.
    fn add_depth(depths: &mut Vec<f32>, depth: f32, color: f32x4);

    /// Passes a medium that sends so much, of which the shares `left` get out of it and that lets
    /// the shares `through` through.
    fn pass(&mut self, emitted: f32x4, left: &[f32], through: &[f32]);
}

/// Those of light that all channels share.
impl Lanes for f32x4 {
    type Share = f32;

    const DEPTHS: usize = 1;

    #[inline]
    fn new(radiance: Rgb, share: f32) -> Self {
        let [r, g, b] = radiance.0;
        Self::new([r, g, b, share])
    }

    #[inline]
    fn parts(self) -> (Rgb, f32) {
        let [r, g, b, share] = self.to_array();
        (Rgb([r, g, b]), share)
    }

    #[inline]
    fn add_depth(depths: &mut Vec<f32>, depth: f32, _: f32x4) {
        depths.push(depth);
    }

    #[inline]
    fn pass(&mut self, emitted: f32x4, left: &[f32], through: &[f32]) {
        let left = Self::new([left[0], left[0], left[0], 0.0]);
        *self = *self * Self::splat(through[0]) + emitted * left;
    }
}

/// Radiance and shares of light by channel; the last lane of each has no meaning.
#[derive(Clone, Copy, Debug, Default)]
pub struct ColoredLanes {
    radiance: f32x4,
    share: f32x4,
}

impl AddAssign for ColoredLanes {
    #[inline]
    fn add_assign(&mut self, other: Self) {
        self.radiance += other.radiance;
        self.share += other.share;
    }
}

impl Mul<f32x4> for ColoredLanes {
    type Output = Self;

    #[inline]
    fn mul(self, weight: f32x4) -> Self {
        Self {
            radiance: self.radiance * weight,
            share: self.share * weight,
        }
    }
}

impl Lanes for ColoredLanes {
    type Share = Rgb;

    const DEPTHS: usize = 4;

    #[inline]
    fn new(radiance: Rgb, share: Rgb) -> Self {
        let lanes = |Rgb([r, g, b]): Rgb| f32x4::new([r, g, b, 0.0]);
        Self {
            radiance: lanes(radiance),
            share: lanes(share),
        }
    }

    #[inline]
    fn parts(self) -> (Rgb, Rgb) {
        let channels = |lanes: f32x4| {
            let [r, g, b, _] = lanes.to_array();
            Rgb([r, g, b])
        };
        (channels(self.radiance), channels(self.share))
    }

    #[inline]
    fn add_depth(depths: &mut Vec<f32>, depth: f32, color: f32x4) {
        depths.extend_from_slice(&(f32x4::splat(depth) * color).to_array());
    }

    #[inline]
    fn pass(&mut self, emitted: f32x4, left: &[f32], through: &[f32]) {
        let lanes = |of: &[f32]| f32x4::new([of[0], of[1], of[2], of[3]]);
        let through = lanes(through);
        self.radiance = self.radiance * through + emitted * lanes(left);
        self.share *= through;
    }
}
