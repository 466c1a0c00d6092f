//! A pixel in the making.

use super::pixel::Pixel;
use crate::math::Rgb;
use crate::shade::air::Passed;
use glam::Vec3;

/// A pixel as the sum of its samples so far.
#[derive(Debug)]
pub struct PixelSum {
    at: [u32; 2],
    sum: Pixel,
    samples: u32,
    hits: u32,
}

impl PixelSum {
    /// Pixel (x, y), of which nothing is known.
    #[must_use]
    pub fn of(x: u32, y: u32) -> Self {
        Self {
            at: [x, y],
            sum: Pixel::default(),
            samples: 0,
            hits: 0,
        }
    }

    /// Its column and row.
    #[must_use]
    pub fn at(&self) -> [u32; 2] {
        self.at
    }

    /// Adds a sample that hit a surface `t` away: the direct and indirect radiance that comes from there through media,
    /// and theirs.
    pub fn add_hit(
        &mut self,
        direct: Rgb,
        indirect: Rgb,
        passed: &impl Passed,
        t: f32,
        normal: Vec3,
    ) {
        self.sum.indirect += indirect;
        self.sum.depth += t;
        self.sum.normal += normal;
        self.hits += 1;
        self.add_miss(direct, passed);
    }

    /// Adds a sample that hit nothing: the radiance that comes from there through media, and theirs.
    pub fn add_miss<T: Passed>(&mut self, direct: Rgb, passed: &T) {
        self.sum.direct += direct;
        if !T::IS_VACUUM {
            self.sum.volume += passed.radiance();
        }
        self.samples += 1;
    }

    /// The mean of what was added.
    #[must_use]
    pub fn mean(self) -> Pixel {
        let mut pixel = self.sum;
        let scale = 1.0 / self.samples.max(1) as f32;
        pixel.direct *= scale;
        pixel.indirect *= scale;
        pixel.volume *= scale;
        pixel.depth /= self.hits as f32;
        if self.hits == 0 {
            pixel.depth = f32::INFINITY;
        }
        pixel.normal = pixel.normal.normalize_or_zero();
        pixel
    }
}
