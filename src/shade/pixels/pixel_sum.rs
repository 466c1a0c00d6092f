//! A pixel in the making.

use super::ends::EndsSum;
use super::pixel::Pixel;
use crate::image::BACKGROUND_DEPTH;
use crate::shade::pixels::camera_media::PassedMedia;
use crate::shade::surfaces::WithSky;
use glam::Vec3;

/// A pixel as the sum of its samples so far.
#[derive(Debug)]
pub struct PixelSum {
    at: [u32; 2],
    sum: Pixel,
    weight: f32,
    weight_of_hits: f32,
    /// Of the samples for which it was asked.
    pub ends: EndsSum,
}

impl PixelSum {
    /// Pixel (x, y), of which nothing is known.
    #[must_use]
    pub fn of(x: u32, y: u32) -> Self {
        Self {
            at: [x, y],
            sum: Pixel::default(),
            weight: 0.0,
            weight_of_hits: 0.0,
            ends: EndsSum::default(),
        }
    }

    /// Its column and row.
    #[must_use]
    pub fn at(&self) -> [u32; 2] {
        self.at
    }

    /// Adds a sample that hit a surface `t` away: the direct and indirect radiance that comes from
    /// there through media, and theirs.
    pub fn add_hit(
        &mut self,
        weight: f32,
        [direct, indirect]: [WithSky; 2],
        passed: &impl PassedMedia,
        t: f32,
        normal: Vec3,
    ) {
        self.sum.indirect += indirect.all * weight;
        self.sum.sky_of_indirect += indirect.sky * weight;
        self.sum.distance += t * weight;
        self.sum.normal += normal * weight;
        self.weight_of_hits += weight;
        self.add_miss(weight, direct, passed);
    }

    /// Adds a sample that hit nothing: the radiance that comes from there through media, and
    /// theirs.
    pub fn add_miss<T: PassedMedia>(&mut self, weight: f32, direct: WithSky, passed: &T) {
        self.sum.direct += direct.all * weight;
        self.sum.sky_of_direct += direct.sky * weight;
        if !T::IS_VACUUM {
            self.sum.volume += passed.radiance() * weight;
        }
        self.weight += weight;
    }

    /// The mean of what was added.
    #[must_use]
    pub fn mean(self) -> Pixel {
        let mut pixel = self.sum;
        let scale = 1.0 / self.weight;
        pixel.direct *= scale;
        pixel.indirect *= scale;
        pixel.sky_of_direct *= scale;
        pixel.sky_of_indirect *= scale;
        pixel.volume *= scale;
        pixel.distance /= self.weight_of_hits;
        if self.weight_of_hits <= 0.0 {
            pixel.distance = BACKGROUND_DEPTH;
        }
        pixel.ends = self.ends.mean(scale);
        pixel.normal = pixel.normal.normalize_or_zero();
        pixel
    }
}
