//! The media before corners, marched at some of them where those between are alike.

use super::Corners;
use crate::gather::{Medium, Pages};
use crate::math::Rgb;
use crate::scene::{Light, Volume};
use crate::shade::air::{Air, Passed};
use crate::trace::media_bounds;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

impl<P: Pages, M: Medium, A: Air> Corners<'_, P, M, A> {
    /// By how much, of 1 and of the light seen, media before corners may differ for those between to take their mean.
    const ALIKE: f32 = 0.1;

    /// Marches the media before corners some way apart, and before those between where the media of their neighbours differ.
    pub(super) fn pass_media(&mut self, height: usize) {
        let spacing = self.marched_spacing();
        let mut step = spacing;
        while step > 0 {
            // Corners between need those up to one step less one away.
            let rim = Self::RINGS as usize + 1 - step;
            for row in rim..height - rim {
                for column in rim..self.width - rim {
                    let [x, y] = Self::place(self.region, column, row)
                        .moved
                        .map(|c| c as usize);
                    if x % step != 0 || y % step != 0 {
                        continue;
                    }
                    let i = row * self.width + column;
                    let between = if step < spacing {
                        let is_between = [x, y].map(|c| c % (2 * step) != 0);
                        if is_between == [false; 2] {
                            continue;
                        }
                        self.media_between(i, is_between, step)
                    } else {
                        None
                    };
                    let march = || self.shader.march(&self.corners[i].sample);
                    self.corners[i].sample.passed = between.unwrap_or_else(march);
                }
            }
            step /= 2;
        }
    }

    /// Corners between those that march whatever their neighbours do: so few that no voxel of a medium fits between them
    /// unseen.
    fn marched_spacing(&self) -> usize {
        let view = &self.shader.view;
        let scene = view.tracer.scene;
        let (min, max) = media_bounds(scene);
        let is_in_media = |p: Vec3| p.cmpge(min).all() && p.cmple(max).all();
        let mut lamps = scene.lights.iter().filter_map(Light::lamp);
        if lamps.any(|(position, _)| is_in_media(position)) {
            // Media glow around it, and that is as small as can be.
            return 1;
        }
        let voxel_in_pixels = |v: &Volume| {
            let distance = |corner: Vec3| corner.distance(view.camera.origin());
            let farthest = v.corners().map(distance).into_iter().fold(0.0, f32::max);
            v.shortest_voxel_edge() / (farthest * view.pixel_angle)
        };
        let volumes = scene.volumes.iter();
        let least = volumes.map(voxel_in_pixels).fold(f32::INFINITY, f32::min);
        // Samples stand in the middle of voxels and reach one further.
        let fits = |&step: &usize| step as f32 <= 2.0 * least;
        [4, 2].into_iter().find(fits).unwrap_or(1)
    }

    /// The mean of what the media do before the corners `step` beside or around one, if they do nearly the same.
    fn media_between(&self, i: usize, is_between: [bool; 2], step: usize) -> Option<A::Passed> {
        let around = self.around(i, is_between, step);
        let like = &self.corners[i].sample;
        let share = 1.0 / around.len() as f32;
        let (mut mean_radiance, mut mean_transmittance) = (Rgb::BLACK, 0.0);
        let (mut least, mut most) = ([f32::INFINITY; 2], [0.0_f32; 2]);
        let mut seen = Rgb::BLACK;
        for j in around {
            let sample = &self.corners[j].sample;
            if !self.shader.same_end(like, sample) {
                return None;
            }
            let passed = &sample.passed;
            let values = [passed.transmittance(), passed.radiance().luminance()];
            for (k, v) in values.into_iter().enumerate() {
                least[k] = least[k].min(v);
                most[k] = most[k].max(v);
            }
            mean_radiance += passed.radiance() * share;
            mean_transmittance += passed.transmittance() * share;
            let behind = sample
                .surface
                .map_or(Rgb::BLACK, |s| s.albedo * sample.direct.light() * FRAC_1_PI);
            seen += (passed.radiance() + behind * passed.transmittance()) * share;
        }
        let [transmittance, radiance] = [0, 1].map(|k| most[k] - least[k]);
        let alike = transmittance <= Self::ALIKE && radiance <= Self::ALIKE * seen.luminance();
        alike.then(|| A::Passed::of(mean_transmittance, mean_radiance))
    }
}
