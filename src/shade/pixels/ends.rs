//! Where the samples of a pixel end: what compositors and denoisers ask for beside light.

use crate::image::BACKGROUND_DEPTH;
use crate::math::Rgb;
use glam::Vec3;

/// Where the samples of a pixel end.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// Distance along the camera's axis to the nearest of them, scene units; that of the background
    /// if all met nothing.
    pub depth: f32,
    /// That point, world space; 0 if all met nothing.
    pub position: Vec3,
    /// Mean albedo of surfaces and of media before them; black of what met nothing.
    pub albedo: Rgb,
    /// Share of the light from behind the scene that surfaces and media keep from the camera.
    pub alpha: f32,
}

/// The same in the making.
#[derive(Clone, Copy, Debug)]
pub struct EndsSum {
    nearest: f32,
    position: Vec3,
    albedo: Rgb,
    alpha: f32,
}

impl Default for EndsSum {
    fn default() -> Self {
        Self {
            nearest: f32::INFINITY,
            position: Vec3::ZERO,
            albedo: Rgb::BLACK,
            alpha: 0.0,
        }
    }
}

impl EndsSum {
    /// Adds a sample that ended on a surface, at a point in the world so far along the camera's
    /// axis, and what it saw of albedos.
    pub fn add_surface(&mut self, weight: f32, depth: f32, position: Vec3, albedo: Rgb) {
        if depth < self.nearest {
            (self.nearest, self.position) = (depth, position);
        }
        self.albedo += albedo * weight;
        self.alpha += weight;
    }

    /// Adds a sample that met no surface, and that media kept so much of the light behind from.
    pub fn add_nothing(&mut self, weight: f32, alpha: f32, albedo: Rgb) {
        self.albedo += albedo * weight;
        self.alpha += alpha * weight;
    }

    /// The mean, for the inverse of the sum of weights.
    #[must_use]
    pub fn mean(self, scale: f32) -> Ends {
        let met_nothing = self.nearest == f32::INFINITY;
        Ends {
            depth: if met_nothing {
                BACKGROUND_DEPTH
            } else {
                self.nearest
            },
            position: self.position,
            albedo: self.albedo * scale,
            // Weights need not sum to 1 to the last digit.
            alpha: (self.alpha * scale).min(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_end_is_told_and_the_rest_is_a_mean() {
        let mut sum = EndsSum::default();
        assert_eq!(sum.mean(1.0).depth, BACKGROUND_DEPTH);
        sum.add_nothing(1.0, 0.5, Rgb([0.5; 3]));
        sum.add_surface(2.0, 7.0, Vec3::X, Rgb([0.25; 3]));
        sum.add_surface(1.0, 6.0, Vec3::Y, Rgb([1.0; 3]));
        let ends = sum.mean(0.25);
        assert_eq!((ends.depth, ends.position), (6.0, Vec3::Y));
        assert_eq!((ends.albedo, ends.alpha), (Rgb([0.5; 3]), 0.875));
    }
}
