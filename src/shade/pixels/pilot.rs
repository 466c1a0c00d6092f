//! What a pixel takes, told by the rays through its corners.

use super::camera_media::CameraMedia;
use super::corners::Corners;
use super::sample::Sample;
use super::shader::PixelShader;
use crate::inscatter::Marched;
use crate::light::{ShadowRays, Visibility};
use crate::run::Walked;
use crate::trace::Surface;

/// A pixel whose corners were looked at.
#[derive(Clone, Copy, Debug)]
pub struct PilotPixel {
    /// What its four corners took: camera rays and shadow rays.
    pub corners: Walked,
    /// Whether it needs samples inside.
    pub has_edge: bool,
    /// Whether its corners need more shadow rays.
    pub has_penumbra: bool,
    /// What its first corner sees that has a surface, and how far away.
    pub surface: Option<(Surface, f32)>,
}

impl<A: CameraMedia> PixelShader<'_, A> {
    /// Looks at the corners of pixel (x, y), as if no neighbour had.
    #[must_use]
    pub fn pilot(&self, x: u32, y: u32) -> PilotPixel {
        const CORNERS: [[u32; 2]; 4] = [[0, 0], [1, 0], [0, 1], [1, 1]];
        let before = Walked::of_thread();
        let corners = CORNERS.map(|[right, down]| self.corner(x + right, y + down));
        let walked = Walked::of_thread() - before;
        let mut visibility = Visibility::default();
        corners
            .iter()
            .for_each(|c| visibility += c.direct.visibility);
        let is_whole = corners[1..].iter().all(|c| self.same_end(&corners[0], c));
        let seen = corners.iter().find_map(|c| Some((c.surface?, c.t)));
        PilotPixel {
            corners: walked,
            has_edge: !is_whole || visibility.has_edge(),
            has_penumbra: visibility.has_penumbra(),
            surface: seen,
        }
    }

    /// About the share of pixels for which media are marched: others have the mean of those around
    /// them.
    #[must_use]
    pub fn share_of_marches(&self) -> f64 {
        if self.counts.pixel > 1 {
            return 1.0;
        }
        match Corners::<A>::marched_spacing(&self.view) {
            1 => 1.0,
            2 => 0.35,
            _ => 0.13,
        }
    }

    /// What the media before the first corner of pixel (x, y) take, lit as for a picture.
    #[must_use]
    pub fn pilot_march(&self, x: u32, y: u32) -> Marched {
        let sample = self.look(x as f32, y as f32);
        (self.media).march_takes(&self.view, sample.direction, sample.t)
    }

    fn corner(&self, x: u32, y: u32) -> Sample<A::Passed> {
        let mut sample = self.look(x as f32, y as f32);
        if let Some(&surface) = sample.lit_surface() {
            let rays = ShadowRays::Sequence {
                per_light: 1,
                first: 0,
                seed: self.key(x, y),
            };
            sample.direct =
                self.lights
                    .irradiance(surface.position, surface.normal, surface.face_normal, rays);
        }
        sample
    }
}
