//! Where the picture is taken from, and its size.

use super::lens::{CameraRay, Lens, Pose};
use crate::{Error, Result};
use glam::{Affine3A, DAffine3, DMat3, DMat4, DVec3, Vec3};

/// A camera: looks down its local -z, +x right, +y up.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Name, by which it is chosen.
    pub name: String,
    /// Rotation and position; no scale.
    pub scene_from_camera: Affine3A,
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f32,
    /// Where it is at some frames, in their order, if it moves; [`super::Scene::go_to_frame`] moves
    /// it.
    pub keys: Vec<CameraKey>,
    /// Its lens; `None` for a pinhole.
    pub lens: Option<Lens>,
    /// When its shutter opens and closes, in frames from the number of the one that is taken;
    /// `None` for a moment.
    pub shutter: Option<[f64; 2]>,
    /// Where it is while its shutter is open, at the middles of as many equal parts of that time;
    /// empty if it stands still.
    pub path: Vec<Pose>,
}

/// A moving camera at a frame, in world space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraKey {
    /// Number of the frame.
    pub frame: i32,
    /// Where it stands.
    pub position: DVec3,
    /// What is in the middle of its picture.
    pub target: DVec3,
    /// The direction that the upper border of its picture points to.
    pub up: DVec3,
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f64,
    /// Its lens; `None` for a pinhole.
    pub lens: Option<Lens>,
}

impl CameraKey {
    /// What is in between two keys, at a share of the way from the first to the second.
    fn between(a: &Self, b: &Self, share: f64) -> Self {
        Self {
            frame: a.frame,
            position: a.position.lerp(b.position, share),
            target: a.target.lerp(b.target, share),
            up: a.up.lerp(b.up, share),
            fov_x_rad: a.fov_x_rad + (b.fov_x_rad - a.fov_x_rad) * share,
            lens: Lens::between(a.lens, b.lens, share as f32),
        }
    }

    /// The camera at a time, in frames: in between the keys around it, or at the first or last of
    /// them. `None` without keys.
    pub(super) fn at(keys: &[Self], time: f64) -> Option<Self> {
        let after = keys.partition_point(|key| f64::from(key.frame) <= time);
        let (before, next) = (after.checked_sub(1).map(|i| &keys[i]), keys.get(after));
        match (before, next) {
            (Some(a), Some(b)) => {
                let length = |to: f64| to - f64::from(a.frame);
                Some(Self::between(a, b, length(time) / length(b.frame.into())))
            }
            (Some(key), None) | (None, Some(key)) => Some(*key),
            (None, None) => None,
        }
    }

    /// Rotation and position.
    ///
    /// # Errors
    /// A camera at its own target, or one that looks along its `up`.
    pub(super) fn world_from_camera(&self) -> Result<DAffine3> {
        look_at(self.position, self.target, self.up)
            .ok_or_else(|| Error::input("the camera is at its own target, or looks along its `up`"))
    }
}

/// A place and rotation in the world, in scene space.
pub(super) fn in_scene(world_from_camera: &DAffine3, world_from_scene: DVec3) -> Affine3A {
    let map = DAffine3::from_translation(-world_from_scene) * *world_from_camera;
    Affine3A::from_mat3_translation(map.matrix3.as_mat3(), map.translation.as_vec3())
}

/// Rotation and position of a camera at `position` that looks at `target`; `None` if `up` does not
/// settle it.
pub(super) fn look_at(position: DVec3, target: DVec3, up: DVec3) -> Option<DAffine3> {
    let back = (position - target).try_normalize()?;
    let up = up.try_normalize()?;
    let across = up.cross(back);
    let right = (across.length() > 1e-9).then(|| across.normalize())?;
    Some(DAffine3 {
        matrix3: DMat3::from_cols(right, back.cross(right), back),
        translation: position,
    })
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

    /// The point of the plane one unit ahead of a camera that is seen at a point of the film,
    /// pixels from its top left; `half_width` is the tangent of half its field of view.
    pub(super) fn ahead(&self, half_width: f32, [x, y]: [f32; 2]) -> Vec3 {
        let pixel = 2.0 * half_width / self.width as f32;
        Vec3::new(
            (x - 0.5 * self.width as f32) * pixel,
            (0.5 * self.height as f32 - y) * pixel,
            -1.0,
        )
    }

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
        let local = film.ahead(half_width, [x, y]);
        self.scene_from_camera.transform_vector3(local).normalize()
    }

    /// Position in scene space.
    #[must_use]
    pub fn origin(&self) -> Vec3 {
        self.scene_from_camera.translation.into()
    }

    /// Unit direction of the camera's axis, into the picture, scene space.
    #[must_use]
    pub fn axis(&self) -> Vec3 {
        (-self.scene_from_camera.matrix3.z_axis).into()
    }

    /// World space to the camera's with z into the picture, and to the film: x and y of that from 0
    /// at the top left to 1 at the lower right, once they are divided by w. Column by column, which
    /// is row by row for points that stand before their matrix, as in OpenEXR.
    #[must_use]
    pub fn matrices(&self, film: &Film, world_from_scene: DVec3) -> [[f32; 16]; 2] {
        let columns = self.scene_from_camera.to_cols_array().map(f64::from);
        let scene_from_camera = DAffine3::from_cols_array(&columns);
        let world_from_camera = DAffine3::from_translation(world_from_scene) * scene_from_camera;
        let turned = DAffine3::from_scale(DVec3::new(1.0, 1.0, -1.0));
        let camera = DMat4::from(turned * world_from_camera.inverse());
        let across = 0.5 / libm::tan(0.5 * f64::from(self.fov_x_rad));
        let down = -across * f64::from(film.width) / f64::from(film.height);
        // Depth is 1 - 1/z, so that the matrix has an inverse.
        let film_from_camera = DMat4::from_cols_array(&[
            across, 0.0, 0.0, 0.0, //
            0.0, down, 0.0, 0.0, //
            0.5, 0.5, 1.0, 1.0, //
            0.0, 0.0, -1.0, 0.0,
        ]);
        [camera, film_from_camera * camera].map(|m| m.to_cols_array().map(|v| v as f32))
    }
}

impl Camera {
    /// Whether all its rays start at one point.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        self.lens.is_none() && self.path.is_empty()
    }

    /// The ray through a point of the film, pixels from its top left, and through the point of the
    /// lens, at the moment, that three numbers in [0,1) choose.
    #[must_use]
    pub fn ray(&self, film: &Film, at: [f32; 2], on_lens: [f32; 2], time: f32) -> CameraRay {
        let part = (time * self.path.len() as f32) as usize;
        let pose = self.path.get(part).copied();
        pose.unwrap_or_else(|| self.pose()).ray(film, at, on_lens)
    }

    /// The camera as it is, whatever its shutter does.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose {
            scene_from_camera: self.scene_from_camera,
            half_width: libm::tanf(0.5 * self.fov_x_rad),
            lens: self.lens,
        }
    }

    /// The camera as it is in the middle of the time that its shutter is open.
    #[must_use]
    pub fn amid_shutter(&self) -> Self {
        let mut camera = self.clone();
        if let Some(middle) = self.path.get(self.path.len() / 2) {
            camera.scene_from_camera = middle.scene_from_camera;
            camera.fov_x_rad = 2.0 * libm::atanf(middle.half_width);
            camera.lens = middle.lens;
        }
        camera
    }
}

/// Parts of the time that a shutter is open.
const IN_SHUTTER: usize = 256;

/// A camera by a key, in the frame of a scene.
fn pose_at(key: &CameraKey, world_from_scene: DVec3) -> Result<Pose> {
    Ok(Pose {
        scene_from_camera: in_scene(&key.world_from_camera()?, world_from_scene),
        half_width: libm::tanf(0.5 * key.fov_x_rad as f32),
        lens: key.lens,
    })
}

/// Where a camera is at equal parts of the time between two frames; nothing if it is in one
/// place all the time.
///
/// # Errors
/// A camera at its own target, or one that looks along its `up`.
pub(super) fn path_in_shutter(
    keys: &[CameraKey],
    [open, close]: [f64; 2],
    world_from_scene: DVec3,
) -> Result<Vec<Pose>> {
    let time = |i: usize| {
        let share = (i as f64 + 0.5) / IN_SHUTTER as f64;
        open + (close - open) * share
    };
    let keys = (0..IN_SHUTTER).filter_map(|i| CameraKey::at(keys, time(i)));
    let poses = keys.map(|key| pose_at(&key, world_from_scene));
    let poses = poses.collect::<Result<Vec<_>>>()?;
    let moves = poses.windows(2).any(|pair| pair[0] != pair[1]);
    Ok(if moves { poses } else { Vec::new() })
}
