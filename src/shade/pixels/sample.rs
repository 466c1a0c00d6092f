//! Samples of a pixel.

use crate::light::Direct;
use crate::shade::air::Passed;
use crate::trace::Surface;
use glam::Vec3;

/// One primary ray.
#[derive(Clone, Copy)]
pub struct Sample<T: Passed> {
    /// The nearest surface, `None` if it met none.
    pub surface: Option<Surface>,
    /// Index of the triangle that this is on; `u32::MAX` for none.
    pub triangle: u32,
    /// How far away, scene units; infinite if nothing.
    pub t: f32,
    /// Unit direction from the camera, scene space.
    pub direction: Vec3,
    /// Direct irradiance there.
    pub direct: Direct<T::Dimming>,
    /// Media on the way.
    pub passed: T,
}

impl<T: Passed> Sample<T> {
    /// The surface, if light on it is seen.
    pub fn lit_surface(&self) -> Option<&Surface> {
        self.surface.as_ref().filter(|s| !s.albedo.is_black())
    }
}

/// How many samples a pixel has, and what it looks at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleCounts {
    /// Always taken; 1 for the pixel's corners, which neighbours share.
    pub pixel: u32,
    /// Taken where those disagree.
    pub edge: u32,
    /// Shadow rays to lights with an extent, at each of those; shared corners take a number of their own.
    pub shadow: u32,
    /// Gather rays of each vertex in media.
    pub volume: u32,
}
