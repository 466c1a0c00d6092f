//! Optical depths and what media let through, as a type: one number where media are grey, one for
//! each channel where they have colour. Code for grey media does no work for colours.

use super::Rgb;
use super::exp::exp_neg_and_rest;
use super::lanes::{ColoredLanes, Lanes};
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Mul, Sub};
use wide::f32x4;

/// One number for all channels of light, or one for each: an optical depth, or a share of light.
pub trait Spectrum:
    Copy
    + Debug
    + Default
    + PartialEq
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<f32, Output = Self>
    + 'static
{
    /// Whether it is one number for all channels.
    const IS_GREY: bool;

    /// Light together with such a share of other light.
    type Lanes: Lanes<Share = Self>;

    /// The same number for all channels.
    fn splat(value: f32) -> Self;

    /// Numbers of red, green and blue; the first alone counts if there is one for all.
    fn of_channels(channels: [f32; 3]) -> Self;

    /// The numbers of red, green and blue.
    fn channels(self) -> [f32; 3];

    /// The product by channel.
    #[must_use]
    fn times(self, other: Self) -> Self;

    /// The quotient by channel; 0 where the divisor is 0.
    #[must_use]
    fn over(self, whole: Self) -> Self;

    /// What of light gets through, where this is the share that does.
    fn filter(self, light: Rgb) -> Rgb;

    /// The mean channel of light that gets through, where this is the share that does.
    fn mean_of(self, light: Rgb) -> f32;

    /// The luminance of the same.
    #[inline]
    fn luminance_of(self, light: Rgb) -> f32 {
        match Self::IS_GREY {
            true => light.luminance() * self.mean(),
            false => self.filter(light).luminance(),
        }
    }

    /// exp(-x) and 1 - exp(-x) of what is at least 0.
    fn exp_neg_and_rest(self) -> (Self, Self);

    /// exp(-x) of what is at least 0.
    #[must_use]
    #[inline]
    fn exp_neg(self) -> Self {
        self.exp_neg_and_rest().0
    }

    /// The mean over channels.
    fn mean(self) -> f32;

    /// The largest of all channels.
    fn most(self) -> f32;

    /// The least of all channels.
    fn least(self) -> f32;

    /// What a function makes of each number.
    #[must_use]
    fn each(self, of: impl Fn(f32) -> f32) -> Self;

    /// A number for all channels, coloured.
    #[inline]
    fn tinted(value: f32, color: &[f32; 3]) -> Self {
        Self::of_channels(*color) * value
    }
}

impl Spectrum for f32 {
    const IS_GREY: bool = true;
    type Lanes = f32x4;

    #[inline]
    fn splat(value: f32) -> Self {
        value
    }

    #[inline]
    fn of_channels([all, _, _]: [f32; 3]) -> Self {
        all
    }

    #[inline]
    fn channels(self) -> [f32; 3] {
        [self; 3]
    }

    #[inline]
    fn times(self, other: Self) -> Self {
        self * other
    }

    #[inline]
    fn over(self, whole: Self) -> Self {
        if whole > 0.0 { self / whole } else { 0.0 }
    }

    #[inline]
    fn filter(self, light: Rgb) -> Rgb {
        light * self
    }

    #[inline]
    fn mean_of(self, light: Rgb) -> f32 {
        light.mean() * self
    }

    #[inline]
    fn exp_neg_and_rest(self) -> (Self, Self) {
        exp_neg_and_rest(self)
    }

    #[inline]
    fn mean(self) -> f32 {
        self
    }

    #[inline]
    fn most(self) -> f32 {
        self
    }

    #[inline]
    fn least(self) -> f32 {
        self
    }

    #[inline]
    fn each(self, of: impl Fn(f32) -> f32) -> Self {
        of(self)
    }

    #[inline]
    fn tinted(value: f32, _: &[f32; 3]) -> Self {
        value
    }
}

impl Spectrum for Rgb {
    const IS_GREY: bool = false;
    type Lanes = ColoredLanes;

    #[inline]
    fn splat(value: f32) -> Self {
        Self::splat(value)
    }

    #[inline]
    fn of_channels(channels: [f32; 3]) -> Self {
        Self(channels)
    }

    #[inline]
    fn channels(self) -> [f32; 3] {
        self.0
    }

    #[inline]
    fn times(self, other: Self) -> Self {
        self * other
    }

    #[inline]
    fn over(self, whole: Self) -> Self {
        Rgb::over(self, whole)
    }

    #[inline]
    fn filter(self, light: Rgb) -> Rgb {
        light * self
    }

    #[inline]
    fn mean_of(self, light: Rgb) -> f32 {
        (light * self).mean()
    }

    #[inline]
    fn exp_neg_and_rest(self) -> (Self, Self) {
        let of = self.0.map(exp_neg_and_rest);
        (Self(of.map(|o| o.0)), Self(of.map(|o| o.1)))
    }

    #[inline]
    fn mean(self) -> f32 {
        Rgb::mean(self)
    }

    #[inline]
    fn most(self) -> f32 {
        Rgb::max(self)
    }

    #[inline]
    fn least(self) -> f32 {
        self.0[0].min(self.0[1]).min(self.0[2])
    }

    #[inline]
    fn each(self, of: impl Fn(f32) -> f32) -> Self {
        Self(self.0.map(of))
    }
}
