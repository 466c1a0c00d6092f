//! What a packed scene is seen by.

use super::rules::{MAX_SIDE, check, cross, dot, is_near, is_unit};
use crate::Result;
use crate::packed::column::MAX_COORDINATE;

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
    /// The camera at some frames, in increasing order, if it moves.
    pub keys: Vec<PackedCameraKey>,
}

/// A moving camera at a frame, in world space. Between two keys each number is in between.
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
pub struct PackedCameraKey {
    /// Number of the frame.
    pub frame: i32,
    /// Where it stands.
    pub position: [f64; 3],
    /// What is in the middle of its picture.
    pub target: [f64; 3],
    /// Where the upper border of its picture points to.
    pub up: [f64; 3],
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f64,
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
        check(is_right, &what, expected, self)?;
        let in_order = self.keys.windows(2).all(|k| k[0].frame < k[1].frame);
        check(in_order, &what, "keys in the order of frames", ())?;
        let near = |place: [f64; 3]| place.iter().all(|v| v.abs() <= f64::from(MAX_COORDINATE));
        for key in &self.keys {
            let places = [key.position, key.target, key.up];
            let is_right =
                places.into_iter().all(near) && key.fov_x_rad >= 1e-4 && key.fov_x_rad <= 3.13;
            check(
                is_right,
                &what,
                "keys that are places near the origin and fields of view",
                key,
            )?;
        }
        Ok(())
    }
}
