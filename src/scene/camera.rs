//! Where the picture is taken from, and its size.

use crate::{Error, Result};
use glam::{Affine3A, Vec3};

/// A pinhole camera: looks down its local -z, +x right, +y up.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name, by which it is chosen.
    pub name: String,
    /// Rotation and position; no scale.
    pub scene_from_camera: Affine3A,
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f32,
}

/// The image plane: size in pixels and the tone map of previews and perceptual metrics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Film {
    /// Pixels in a row of the whole frame.
    pub width: u32,
    /// Rows of pixels of the whole frame.
    pub height: u32,
    /// Factor on linear radiance before clipping to `[0,1]` and the 1/2.2 power.
    pub exposure: f32,
}

impl Film {
    /// Pixels along a side of the largest film.
    pub(super) const MAX_SIDE: u32 = 65_536;
    /// Exposures that are taken for no mistake.
    pub(super) const EXPOSURES: std::ops::RangeInclusive<f64> = 1e-30..=1e30;

    /// Refuses sizes and exposures out of range.
    pub(super) fn check(&self) -> Result<()> {
        let sides = 1..=Self::MAX_SIDE;
        if !sides.contains(&self.width) || !sides.contains(&self.height) {
            return Err(Error::input(format!(
                "expected a film of 1 to {} pixels a side, found {} x {}",
                Self::MAX_SIDE,
                self.width,
                self.height
            )));
        }
        if !Self::EXPOSURES.contains(&self.exposure.into()) {
            return Err(Error::input(format!(
                "expected an exposure from 1e-30 to 1e30, found {}",
                self.exposure
            )));
        }
        Ok(())
    }
}

impl Camera {
    /// Ray direction (unit length, scene space) through continuous pixel coordinates; (0,0) is the
    /// top left corner.
    #[must_use]
    pub fn direction(&self, film: &Film, x: f32, y: f32) -> Vec3 {
        let half_width = libm::tanf(0.5 * self.fov_x_rad);
        let pixel = 2.0 * half_width / film.width as f32;
        let local = Vec3::new(
            (x - 0.5 * film.width as f32) * pixel,
            (0.5 * film.height as f32 - y) * pixel,
            -1.0,
        );
        self.scene_from_camera.transform_vector3(local).normalize()
    }

    /// Position in scene space.
    #[must_use]
    pub fn origin(&self) -> Vec3 {
        self.scene_from_camera.translation.into()
    }
}
