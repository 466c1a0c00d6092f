//! A shaded pixel.

use super::ends::Ends;
use crate::math::Rgb;
use glam::Vec3;

/// What a pixel came to, box-filtered over its square; its light is radiance towards the camera.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pixel {
    /// Emitted, directly lit by lights, and the environment where it is seen, behind media.
    pub direct: Rgb,
    /// Lit by what gathers meet, behind media.
    pub indirect: Rgb,
    /// The parts of both that come straight from the environment.
    pub sky_of_direct: Rgb,
    /// See above.
    pub sky_of_indirect: Rgb,
    /// Scattered by media towards the camera.
    pub volume: Rgb,
    /// Mean distance along the rays that hit, scene units; that of the background if none did.
    pub distance: f32,
    /// Mean shading normal in scene space, of unit length; 0 if no ray hit.
    pub normal: Vec3,
    /// Where its samples end, if that was asked for.
    pub ends: Ends,
    /// Whether the border of an emissive triangle runs through it, so that its light is told in
    /// closed form.
    pub has_emitter_border: bool,
}

impl Pixel {
    /// All light of the pixel.
    #[must_use]
    pub fn radiance(&self) -> Rgb {
        self.direct + self.indirect + self.volume
    }
}
