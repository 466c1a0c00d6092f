//! Bright patches as lamps: where a few places send much of a frame's light, as where the sun falls
//! into a room, gathers ask them by rays of their own.

mod pilot;

use crate::gather::{BrightPatch, PatchRadiance, SampleRange};
use crate::light::{Emitter, Lights, ShadowRays, Vacuum};
use crate::math::{Rgb, sampling};
use crate::shade::settings::Settings;
use crate::trace::Surface;
use crate::tree::Pages;
use crate::view::View;
use pilot::{Bright, PilotGathers};

/// Bright patches of a frame, which gathers leave out of what their rays meet.
#[derive(Debug)]
pub struct BrightPatchLights<'a> {
    lamps: Lights<'a, Vacuum>,
    /// Rays of each gather.
    rays: u32,
}

impl<'a> BrightPatchLights<'a> {
    /// Of so many rays of a gather one goes to them.
    const ONE_OF: u32 = 5;

    /// Those of a frame, if scouts find that they send much of its light, and if there is nothing
    /// between surfaces for gathers.
    pub fn find<P: Pages>(
        view: &View,
        lights: &Lights<'a>,
        outgoing: &mut PatchRadiance,
        pages: &P,
        settings: &Settings,
    ) -> Option<Self> {
        // Lamps that are too far away to be seen would still be asked.
        if !settings.bright_patches || settings.max_dist.is_some() {
            return None;
        }
        let scouts = PilotGathers {
            view,
            outgoing,
            pages,
            environment: lights.environment(),
            max_solid_angle: settings.max_solid_angle,
        };
        let Bright { seeds, least } = scouts.bright()?;
        let patches = outgoing.find_bright(pages, &seeds, Bright::SUPPORT, least);
        if patches.is_empty() {
            return None;
        }
        let emitters = patches.iter().map(emitter).collect();
        Some(Self {
            lamps: lights.of_emitters(emitters).in_vacuum(),
            rays: settings.samples.div_ceil(Self::ONE_OF),
        })
    }

    /// Of so many rays of a gather those that are left to look around where there are bright lamps:
    /// what they meet differs less.
    pub fn other_rays(samples: u32) -> u32 {
        (samples * 3).div_ceil(5)
    }

    /// What they send to a surface, by a stretch of rays.
    pub fn irradiance(&self, surface: &Surface, stretch: SampleRange) -> Rgb {
        let Surface {
            position,
            normal,
            face_normal,
            ..
        } = *surface;
        let rays = ShadowRays::Sequence {
            per_light: self.rays,
            first: stretch.index * self.rays,
            seed: sampling::hash(&[stretch.seed, 1]),
        };
        self.lamps
            .irradiance(position, normal, face_normal, rays)
            .light()
    }
}

fn emitter(patch: &BrightPatch) -> Emitter {
    let [a, b, c] = patch.corners;
    let across = (b - a).cross(c - a);
    Emitter {
        // Counter-clockwise on the side that sends.
        corners: if across.dot(patch.normal) < 0.0 {
            [a, c, b]
        } else {
            [a, b, c]
        },
        normal: patch.normal,
        radiance: patch.radiance,
        area: 0.5 * across.length(),
        both_sides: false,
    }
}
