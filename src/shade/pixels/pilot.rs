//! What a pixel takes, told by the rays through its corners.

use super::camera_media::CameraMedia;
use super::corners::Corners;
use super::sample::Sample;
use super::shader::PixelShader;
use crate::inscatter::Marched;
use crate::light::{ShadowRays, Visibility};
use crate::run::Walked;
use crate::trace::Surface;
use std::cell::Cell;

/// A pixel whose corners were looked at.
#[derive(Clone, Copy, Debug)]
pub struct PilotPixel {
    /// What its four corners took: camera rays and shadow rays.
    pub corners: Walked,
    /// Whether it needs samples inside.
    pub has_edge: bool,
    /// Whether masks have a say in it.
    pub is_masked: bool,
    /// Whether its corners need more shadow rays.
    pub has_penumbra: bool,
    /// What its first corner sees that has a surface, and how far away.
    pub surface: Option<(Surface, f32)>,
}

/// What marches through media took.
#[derive(Clone, Copy, Debug)]
pub struct PilotMarch {
    /// Cells and lit parts.
    pub marched: Marched,
    /// What the light of those took, and the cells.
    pub walked: Walked,
    /// By which that is to be multiplied for a pixel.
    pub share: f64,
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
        let is_whole = self.end_alike(corners.iter());
        let seen = corners.iter().find_map(|c| Some((c.surface?, c.t)));
        PilotPixel {
            corners: walked,
            has_edge: !is_whole || visibility.has_edge(),
            is_masked: corners.iter().any(|c| c.is_masked),
            has_penumbra: visibility.has_penumbra(),
            surface: seen,
        }
    }

    /// Marches of a pilot in each place.
    const MARCHES: usize = 2;

    /// What the media before the first corner of pixel (x, y) take, lit as for a picture, and the
    /// share of the corners around for which they are marched: others have the mean of those around
    /// them.
    #[must_use]
    pub fn pilot_march(&self, x: u32, y: u32) -> PilotMarch {
        let took = Cell::new((Marched::default(), Walked::default()));
        let sample = |away: u32| {
            let mut sample = self.corner(x + away, y + away);
            let before = Walked::of_thread();
            let (passed, more) = (self.media).march_counted(&self.view, &self.way_to(&sample));
            let (marched, walked) = took.get();
            let marched = Marched {
                cells: marched.cells + more.cells,
                segments: marched.segments + more.segments,
            };
            took.set((marched, walked + (Walked::of_thread() - before)));
            sample.passed = passed;
            sample
        };
        let (spacing, is_alike) = Corners::marches_alike(self, sample);
        let is_shared = self.counts.pixel == 1 && is_alike;
        let corners = if is_shared { spacing * spacing } else { 1 };
        let (marched, walked) = took.get();
        PilotMarch {
            marched,
            walked,
            share: 1.0 / (Self::MARCHES * corners) as f64,
        }
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
