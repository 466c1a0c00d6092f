//! Linear RGB triples.

use std::ops::{Add, AddAssign, Mul, MulAssign, Sub};

/// Linear Rec.709 radiance, irradiance or albedo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rgb(pub [f32; 3]);

impl Rgb {
    /// No light.
    pub const BLACK: Self = Self([0.0; 3]);

    /// A colour of one value in all channels.
    #[must_use]
    pub const fn splat(v: f32) -> Self {
        Self([v; 3])
    }

    /// Mean of the channels: unlike luminance, the same for channels in any order.
    #[must_use]
    #[inline]
    pub fn mean(self) -> f32 {
        (self.0[0] + self.0[1] + self.0[2]) * (1.0 / 3.0)
    }

    /// Relative luminance, Rec.709.
    #[must_use]
    pub fn luminance(self) -> f32 {
        0.2126 * self.0[0] + 0.7152 * self.0[1] + 0.0722 * self.0[2]
    }

    /// The largest of red, green and blue.
    #[must_use]
    pub fn max(self) -> f32 {
        self.0[0].max(self.0[1]).max(self.0[2])
    }

    /// What it is of another light, by channel; 0 of none.
    #[must_use]
    pub fn over(self, whole: Self) -> Self {
        let share = |i: usize| match whole.0[i] > 0.0 {
            true => self.0[i] / whole.0[i],
            false => 0.0,
        };
        Self(std::array::from_fn(share))
    }

    /// Whether all channels are zero.
    #[must_use]
    pub fn is_black(self) -> bool {
        self.0 == [0.0; 3]
    }
}

impl Add for Rgb {
    type Output = Self;
    #[inline]
    fn add(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] + o.0[i]))
    }
}

impl AddAssign for Rgb {
    #[inline]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}

impl Sub for Rgb {
    type Output = Self;
    #[inline]
    fn sub(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] - o.0[i]))
    }
}

impl Mul for Rgb {
    type Output = Self;
    #[inline]
    fn mul(self, o: Self) -> Self {
        Self(std::array::from_fn(|i| self.0[i] * o.0[i]))
    }
}

impl Mul<f32> for Rgb {
    type Output = Self;
    #[inline]
    fn mul(self, s: f32) -> Self {
        Self(self.0.map(|v| v * s))
    }
}

impl MulAssign<f32> for Rgb {
    #[inline]
    fn mul_assign(&mut self, s: f32) {
        *self = *self * s;
    }
}

impl From<[f32; 3]> for Rgb {
    fn from(v: [f32; 3]) -> Self {
        Self(v)
    }
}
