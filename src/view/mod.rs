//! A traced scene as a camera and as gathers see it.
//!
//! [`View`] is a camera before a traced scene, `geometry` lets gathers meet its triangles, `levels`
//! chooses the voxels of media that its pixels show.

mod geometry;
mod levels;

pub use levels::{bytes_of_media, media_of_all_cameras, media_on_pixels};

use crate::image::Region;
use crate::math::{PhaseFunction, SeenPhase};
use crate::scene::{Camera, Film, Scene};
use crate::trace::{Surface, Tracer, offset};
use crate::{Error, Result};
use glam::{DAffine3, DVec2, DVec3, Vec3};

/// A camera looking at a traced scene.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The scene that rays from the camera meet.
    pub tracer: &'a Tracer<'a>,
    /// The camera, in scene space.
    pub camera: &'a Camera,
    /// Size of the whole frame in pixels, and its exposure.
    pub film: Film,
    /// Angle that a pixel in the middle covers, radians.
    pub pixel_angle: f32,
    /// Rotation and position.
    camera_from_scene: DAffine3,
    /// Key of the frame's random choices.
    pub seed: u64,
}

/// The parts of media that have to be lit.
#[derive(Clone, Copy, Debug)]
pub enum VisibleMedia<'a> {
    /// What rays through these parts of the film may pass.
    ThroughRegions(&'a [Region]),
    /// All of them, whatever camera looks.
    All,
}

/// Refuses a scene whose positions are not in the frame of a tree's.
///
/// # Errors
/// Names both frames.
pub fn check_frame(scene: &Scene, world_from_tree: [f64; 3]) -> Result<()> {
    if world_from_tree == scene.world_from_scene.to_array() {
        return Ok(());
    }
    Err(Error::input(format!(
        "the scene's frame is at {:?} in the world, that of the tree at {world_from_tree:?}",
        scene.world_from_scene.to_array()
    ))
    .hint("bring the scene into the tree's frame, `Scene::in_frame`"))
}

/// Angle that a pixel in the middle of a film covers, radians.
fn pixel_angle(camera: &Camera, film: Film) -> f32 {
    2.0 * libm::tanf(0.5 * camera.fov_x_rad) / film.width as f32
}

impl<'a> View<'a> {
    /// A view of the whole film.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>, camera: &'a Camera, film: Film, seed: u64) -> Self {
        let pixel_angle = pixel_angle(camera, film);
        let columns = camera.scene_from_camera.to_cols_array().map(f64::from);
        let scene_from_camera = DAffine3::from_cols_array(&columns);
        Self {
            tracer,
            camera,
            film,
            pixel_angle,
            camera_from_scene: scene_from_camera.inverse(),
            seed,
        }
    }

    /// Where the rays of a gather at a surface that the camera sees start: off the surfaces that
    /// meet its own there, too.
    pub fn off_surface(&self, surface: &Surface) -> Vec3 {
        /// Disks stand where their places were rounded to, some of them before the wall that the
        /// receiver is on: gathers start so many times further off it than rays to triangles need.
        const ROUNDING: f32 = 8.0;
        let towards_camera = (self.camera.origin() - surface.position).normalize_or_zero();
        let off = surface.face_normal + towards_camera;
        surface.position + off * (ROUNDING * offset(surface.position))
    }

    /// How the camera sees a phase function at a point, if that is not isotropic.
    #[inline]
    pub fn seen(&self, phase: PhaseFunction, point: Vec3) -> Option<SeenPhase> {
        if phase.is_isotropic() {
            return None;
        }
        let direction = (point - self.camera.origin()).normalize_or(Vec3::Z);
        SeenPhase::of(phase, direction)
    }

    /// A point of scene space as the camera sees it: x to the right, y up, -z ahead.
    pub fn local(&self, point: Vec3) -> DVec3 {
        self.camera_from_scene.transform_point3(point.as_dvec3())
    }

    /// Where on the film a point ahead of the camera is, pixels from its top left: double, since
    /// what is beside the camera is far outside of the film.
    pub fn on_film(&self, local: DVec3) -> DVec2 {
        let scale = 1.0 / (-local.z * f64::from(self.pixel_angle));
        let middle = 0.5 * DVec2::new(self.film.width.into(), self.film.height.into());
        middle + DVec2::new(local.x, -local.y) * scale
    }

    /// Radius on the film, in pixels, over which a lens spreads the points of a hull at most.
    fn most_confusion(&self, points: [Vec3; 8]) -> f32 {
        let Some(lens) = self.camera.lens else {
            return 0.0;
        };
        // It falls towards the focus, and rises behind it.
        let depths = points.map(|p| (p - self.camera.origin()).dot(self.camera.axis()));
        let spread = depths.map(|depth| lens.confusion(depth.max(0.0)));
        spread.into_iter().fold(0.0, f32::max) / self.pixel_angle
    }

    /// Whether the hull of some points matters: for regions, as [`Self::may_see`] tells.
    #[must_use]
    pub fn may_matter(&self, visible: VisibleMedia, margin: f32, points: [Vec3; 8]) -> bool {
        match visible {
            VisibleMedia::ThroughRegions(regions) => {
                (regions.iter()).any(|&r| self.may_see(r, margin, points))
            }
            VisibleMedia::All => true,
        }
    }

    /// Whether rays through a region of the film, or up to `margin` pixels beside it, may pass the
    /// hull of some points. May say yes where none does, never no where one does.
    #[must_use]
    pub fn may_see(&self, region: Region, margin: f32, points: [Vec3; 8]) -> bool {
        if !self.camera.path.is_empty() {
            return true;
        }
        let margin = margin + self.most_confusion(points);
        let (mut lower, mut upper) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for point in points {
            let local = self.local(point);
            if local.z >= -1e-6 * local.length() {
                return true;
            }
            let on_film = self.on_film(local);
            lower = lower.min(on_film);
            upper = upper.max(on_film);
        }
        let first = DVec2::new(region.x0.into(), region.y0.into()) - f64::from(margin);
        let last = DVec2::new(region.x1.into(), region.y1.into()) + f64::from(margin);
        lower.cmple(last).all() && upper.cmpge(first).all()
    }
}
