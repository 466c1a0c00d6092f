//! Cameras as they are handed to a builder.

use super::bounds::Bounds;
use super::check_near;
use crate::scene::camera::{in_scene, look_at};
use crate::scene::{Camera, CameraKey, Film, Lens};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};

/// A camera in world space: a pinhole until it has a lens.
#[derive(Clone, Debug)]
pub struct CameraInput {
    pub(in crate::scene) name: String,
    /// Rotation and position.
    pub(in crate::scene) world_from_camera: DAffine3,
    /// Full horizontal field of view, radians.
    pub(in crate::scene) fov_x_rad: f64,
    /// Where it is at some frames, if it moves.
    pub(in crate::scene) keys: Vec<CameraKey>,
    /// Its lens, if it is no pinhole.
    pub(in crate::scene) lens: Option<Lens>,
    /// When its shutter opens and closes, in frames from that of the picture.
    pub(in crate::scene) shutter: Option<[f64; 2]>,
}

impl CameraInput {
    /// A camera that stands at `position` and has `target` in the middle of its picture; `up` is
    /// the direction that its upper border points to, `fov_x_rad` its full horizontal field of
    /// view in radians.
    ///
    /// # Errors
    /// A camera at its own target, or one that looks along `up`.
    pub fn look_at(
        name: impl Into<String>,
        position: impl Into<DVec3>,
        target: impl Into<DVec3>,
        up: impl Into<DVec3>,
        fov_x_rad: f64,
    ) -> Result<Self> {
        let world_from_camera = look_at(position.into(), target.into(), up.into());
        Ok(Self {
            name: name.into(),
            world_from_camera: world_from_camera.ok_or_else(|| {
                Error::input("the camera is at its own target, or looks along its `up`")
            })?,
            fov_x_rad,
            keys: Vec::new(),
            lens: None,
            shutter: None,
        })
    }

    /// A camera that moves: at the frames of its keys it is there, between them in between.
    ///
    /// # Errors
    /// No keys, or two of one frame; at the first of them, a camera at its own target, or one that
    /// looks along its `up`.
    pub fn moving(name: impl Into<String>, mut keys: Vec<CameraKey>) -> Result<Self> {
        keys.sort_by_key(|key| key.frame);
        if let Some(pair) = keys.windows(2).find(|pair| pair[0].frame == pair[1].frame) {
            return Err(Error::input(format!(
                "two keys are of frame {}",
                pair[0].frame
            )));
        }
        let Some(first) = keys.first() else {
            return Err(Error::input("expected a key at least, found none"));
        };
        Ok(Self {
            name: name.into(),
            world_from_camera: first.world_from_camera()?,
            fov_x_rad: first.fov_x_rad,
            lens: first.lens,
            shutter: None,
            keys,
        })
    }

    /// A camera that is placed by a map from its space, in which it looks along -z with +y up, to
    /// world space. What six digits in a file leave of a rotation is made a rotation again.
    ///
    /// # Errors
    /// A map that scales, shears or mirrors.
    pub fn placed(
        name: impl Into<String>,
        world_from_camera: DAffine3,
        fov_x_rad: f64,
    ) -> Result<Self> {
        let mut map = world_from_camera;
        let (x, y, z) = (map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis);
        let lengths = [x, y, z].map(|a| (a.length() - 1.0).abs());
        let angles = [x.dot(y), y.dot(z), z.dot(x)].map(f64::abs);
        let turns = x.cross(y).dot(z) > 0.0;
        if !turns || !lengths.iter().chain(&angles).all(|e| *e <= 1e-4) {
            return Err(Error::input(
                "expected a rotation and a position, without scale, shear or mirror",
            ));
        }
        map.matrix3.z_axis = z.normalize();
        map.matrix3.x_axis = y.cross(map.matrix3.z_axis).normalize();
        map.matrix3.y_axis = map.matrix3.z_axis.cross(map.matrix3.x_axis);
        Ok(Self {
            name: name.into(),
            world_from_camera: map,
            fov_x_rad,
            keys: Vec::new(),
            lens: None,
            shutter: None,
        })
    }

    /// Gives it a thin lens: radius of its opening, 0 for a pinhole, and the distance along its
    /// axis of what is sharp. Keys that have a lens keep theirs.
    #[must_use]
    pub fn lens(mut self, aperture: f32, focus_distance: f32) -> Self {
        let lens = Lens::new(aperture, focus_distance);
        self.lens = lens;
        for key in &mut self.keys {
            key.lens = key.lens.or(lens);
        }
        if let Some(first) = self.keys.first() {
            self.lens = first.lens;
        }
        self
    }

    /// Keeps its shutter open from one time to another, in frames from the number of the one that
    /// is taken: what moves by the keys of the camera is blurred.
    #[must_use]
    pub fn shutter(mut self, open: f64, close: f64) -> Self {
        self.shutter = Some([open, close]);
        self
    }

    /// The camera in scene space.
    pub(super) fn in_scene(self, world_from_scene: DVec3) -> Camera {
        Camera {
            name: self.name,
            scene_from_camera: in_scene(&self.world_from_camera, world_from_scene),
            fov_x_rad: self.fov_x_rad as f32,
            keys: self.keys,
            lens: self.lens,
            shutter: self.shutter,
            path: Vec::new(),
        }
    }

    /// The camera as it is, as that of a frame.
    pub(in crate::scene) fn as_key(&self, frame: i32) -> CameraKey {
        let DAffine3 {
            matrix3,
            translation: position,
        } = self.world_from_camera;
        CameraKey {
            frame,
            position,
            target: position - matrix3.z_axis,
            up: matrix3.y_axis,
            fov_x_rad: self.fov_x_rad,
            lens: self.lens,
        }
    }

    /// A camera in front of everything, a little above, from where the bounding sphere just fits
    /// the film.
    pub(super) fn framing(bounds: &Bounds, film: &Film) -> Self {
        let fov_x_rad = 45_f64.to_radians();
        let aspect = f64::from(film.height) / f64::from(film.width);
        let half_x = 0.5 * fov_x_rad;
        let half_y = libm::atan(libm::tan(half_x) * aspect);
        let distance = bounds.radius() / libm::sin(half_x.min(half_y));
        let target = bounds.centre();
        let position = target + DVec3::new(0.3, 0.35, 1.0).normalize() * distance;
        Self {
            name: "default".into(),
            // The direction is not along y, so this always is a camera unless the scene is a
            // single point.
            world_from_camera: look_at(position, target, DVec3::Y)
                .unwrap_or(DAffine3::from_translation(target)),
            fov_x_rad,
            keys: Vec::new(),
            lens: None,
            shutter: None,
        }
    }

    /// Refuses a camera whose position is out of range, or whose field of view is none.
    pub(super) fn check(&self) -> Result<()> {
        let what = || format!("the camera \"{}\"", self.name);
        check_near(what, self.world_from_camera.translation)?;
        for key in &self.keys {
            [key.position, key.target, key.up]
                .into_iter()
                .try_for_each(|place| check_near(what, place))?;
        }
        let mut fields = self.keys.iter().map(|key| key.fov_x_rad);
        let is_right = |fov: &f64| *fov > 1e-4 && *fov < 3.13;
        let own = Some(self.fov_x_rad).filter(|fov| !is_right(fov));
        if let Some(fov) = own.or_else(|| fields.find(|fov| !is_right(fov))) {
            return Err(Error::input(format!(
                "{}: expected a field of view above 0 and below pi, found {fov}",
                what(),
            )));
        }
        self.check_lens(what)
    }

    /// Refuses lenses and shutters that are none.
    fn check_lens(&self, what: impl Fn() -> String) -> Result<()> {
        let lenses = self.keys.iter().map(|key| key.lens).chain([self.lens]);
        for lens in lenses.flatten() {
            for (name, length) in [
                ("an aperture", lens.aperture),
                ("a focus distance", lens.focus_distance),
            ] {
                if !Lens::LENGTHS.contains(&length) {
                    return Err(Error::input(format!(
                        "{}: expected {name} from 1e-15 to 1e15, found {length}",
                        what()
                    )));
                }
            }
        }
        if let Some([open, close]) = self.shutter {
            let is_right = open < close && [open, close].iter().all(|t| t.abs() <= MOST_FRAMES);
            if !is_right {
                return Err(Error::input(format!(
                    "{}: expected a shutter that opens before it closes, both at most \
                     {MOST_FRAMES} frames away, found {open} to {close}",
                    what()
                )));
            }
        }
        Ok(())
    }
}

/// Frames from that of a picture at which a shutter may open and close.
const MOST_FRAMES: f64 = 1000.0;
