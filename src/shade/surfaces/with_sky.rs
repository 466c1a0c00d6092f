//! Light of which a part comes straight from the sky.

use crate::math::Rgb;
use std::ops::{AddAssign, Mul};

/// Light, and the part of it that comes straight from the environment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WithSky {
    /// All of it.
    pub all: Rgb,
    /// That part.
    pub sky: Rgb,
}

impl WithSky {
    /// No light.
    pub const BLACK: Self = Self {
        all: Rgb::BLACK,
        sky: Rgb::BLACK,
    };
}

impl From<[Rgb; 2]> for WithSky {
    fn from([all, sky]: [Rgb; 2]) -> Self {
        Self { all, sky }
    }
}

impl AddAssign for WithSky {
    fn add_assign(&mut self, other: Self) {
        self.all += other.all;
        self.sky += other.sky;
    }
}

impl Mul<f32> for WithSky {
    type Output = Self;
    fn mul(self, scale: f32) -> Self {
        Self {
            all: self.all * scale,
            sky: self.sky * scale,
        }
    }
}
