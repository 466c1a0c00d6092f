//! What every pixel of a frame shares.

use crate::scene::{Camera, Film};
use crate::trace::Tracer;

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
}
