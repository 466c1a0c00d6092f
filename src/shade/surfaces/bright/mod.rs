//! Bright patches as lights: where a few places send much of a frame's light, as where the sun
//! falls into a room, gathers ask them by rays of their own.

mod pilot;

use crate::gather::{BrightPatch, PatchRadiance, SampleRange};
use crate::light::{Emitter, Lights, SceneMedia, ShadowRays, Vacuum};
use crate::math::{Rgb, Spectrum, sampling};
use crate::shade::settings::Settings;
use crate::trace::Surface;
use crate::tree::SurfelStore;
use crate::view::View;
use pilot::{BrightHits, PilotGathers};

/// Bright patches of a frame, which gathers leave out of what their rays meet.
#[derive(Debug)]
pub struct BrightPatchLights<'a> {
    lights: Lights<'a, Vacuum>,
    /// Rays of each gather.
    rays: u32,
}

impl<'a> BrightPatchLights<'a> {
    /// Of so many rays of a gather one goes to them.
    const RAYS_FOR_EACH: u32 = 5;

    /// Finds the bright patches of a frame, if pilot gathers tell that they send much of its light,
    /// and if there is nothing between surfaces for gathers.
    pub fn find<K: Spectrum>(
        view: &View,
        lights: &Lights<'a, SceneMedia<'a, K>>,
        tree_patches: &mut PatchRadiance,
        pages: &SurfelStore,
        settings: &Settings,
    ) -> Option<Self> {
        // Patches that are too far away to be seen would still be asked.
        if !settings.bright_patches || settings.max_dist.is_some() {
            return None;
        }
        let pilots = PilotGathers {
            view,
            patches: tree_patches,
            pages,
            environment: lights.environment(),
            max_solid_angle: settings.max_solid_angle,
        };
        let BrightHits { hits, least } = pilots.bright()?;
        let patches = tree_patches.find_bright(pages, &hits, BrightHits::MIN_SUPPORT, least);
        if patches.is_empty() {
            return None;
        }
        let emitters = (0..).zip(&patches).map(emitter).collect();
        Some(Self {
            lights: lights.of_emitters(emitters).in_vacuum(),
            rays: settings.samples.div_ceil(Self::RAYS_FOR_EACH),
        })
    }

    /// Of so many rays of a gather those that are left to look around where there are bright
    /// patches: what they meet differs less.
    pub fn other_rays(samples: u32) -> u32 {
        (samples * 3).div_ceil(5)
    }

    /// What they send to a surface, by a range of rays.
    pub fn irradiance(&self, surface: &Surface, range: SampleRange) -> Rgb {
        let Surface {
            position,
            normal,
            face_normal,
            ..
        } = *surface;
        let rays = ShadowRays::Sequence {
            per_light: self.rays,
            first: range.index * self.rays,
            seed: sampling::hash(&[range.seed, 1]),
        };
        self.lights
            .irradiance(position, normal, face_normal, rays)
            .light()
    }
}

fn emitter((surface, patch): (u32, &BrightPatch)) -> Emitter {
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
        surface,
    }
}
