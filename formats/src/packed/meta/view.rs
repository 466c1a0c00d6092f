//! What a packed scene is seen by.

use super::rules::{MAX_SIDE, check, cross, dot, is_near, is_unit};
use crate::Result;

/// Image size and tone map.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedFilm {
    /// Pixels in a row of the whole frame, 1 to 65,536.
    pub width: u32,
    /// Rows of pixels of the whole frame, 1 to 65,536.
    pub height: u32,
    /// Factor on linear radiance before clipping, 1e-30 to 1e30.
    pub exposure: f32,
}

/// A pinhole camera that looks down its local -z.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedCamera {
    /// Name, by which it is chosen.
    pub name: String,
    /// Three columns of a rotation, then the position.
    pub scene_from_camera: [[f32; 3]; 4],
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f32,
}

impl PackedFilm {
    pub(super) fn validate(&self) -> Result<()> {
        let sides = 1..=MAX_SIDE;
        let is_right = sides.contains(&self.width)
            && sides.contains(&self.height)
            && (1e-30..=1e30).contains(&self.exposure);
        let expected = "1 to 65,536 pixels a side, and an exposure from 1e-30 to 1e30";
        check(is_right, &|| "film".into(), expected, self)
    }
}

impl PackedCamera {
    pub(super) fn validate(&self) -> Result<()> {
        let [x, y, z, position] = self.scene_from_camera;
        let is_rotation = [x, y, z].into_iter().all(is_unit)
            && [dot(x, y), dot(y, z), dot(z, x)]
                .iter()
                .all(|d| d.abs() <= 1e-3)
            && dot(cross(x, y), z) > 0.0;
        let is_right =
            is_rotation && is_near(position) && self.fov_x_rad >= 1e-4 && self.fov_x_rad <= 3.13;
        let what = || format!("camera {:?}", self.name);
        let expected = "a rotation, a position and a field of view below pi";
        check(is_right, &what, expected, self)
    }
}
