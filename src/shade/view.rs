//! What every pixel of a frame shares.

use crate::image::Region;
use crate::scene::{Camera, Film};
use crate::trace::Tracer;
use glam::{Vec2, Vec3};

/// A camera looking at a traced scene.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// Where from.
    pub camera: &'a Camera,
    /// Image size.
    pub film: Film,
    /// Angle that a pixel in the middle covers, radians.
    pub pixel_angle: f32,
    /// Key of the frame's random choices.
    pub seed: u64,
}

impl<'a> View<'a> {
    /// A view of the whole film.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>, camera: &'a Camera, film: Film, seed: u64) -> Self {
        let pixel_angle = 2.0 * libm::tanf(0.5 * camera.fov_x_rad) / film.width as f32;
        Self {
            tracer,
            camera,
            film,
            pixel_angle,
            seed,
        }
    }

    /// Whether rays through a region of the film, or up to `margin` pixels beside it, may pass the hull of some points.
    /// May say yes where none does, never no where one does.
    #[must_use]
    pub fn may_see(&self, region: Region, margin: f32, points: [Vec3; 8]) -> bool {
        let camera_from_scene = self.camera.scene_from_camera.inverse();
        let per_unit = 1.0 / self.pixel_angle;
        let (mut lower, mut upper) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        for point in points {
            let p = camera_from_scene.transform_point3(point);
            if p.z >= -1e-6 * p.length() {
                return true;
            }
            let on_film = Vec2::new(p.x, -p.y) * (per_unit / -p.z)
                + 0.5 * Vec2::new(self.film.width as f32, self.film.height as f32);
            lower = lower.min(on_film);
            upper = upper.max(on_film);
        }
        let first = Vec2::new(region.x0 as f32, region.y0 as f32) - margin;
        let last = Vec2::new(region.x1 as f32, region.y1 as f32) + margin;
        lower.cmple(last).all() && upper.cmpge(first).all()
    }
}
