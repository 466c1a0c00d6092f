//! The media before corners, marched at some of them where those between are alike.

use super::coarse_to_fine::FirstCorners;
use super::{Corner, Corners};
use crate::math::{Aabb, Rgb, Spectrum};
use crate::scene::{Light, Volume};
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::shade::pixels::sample::Sample;
use crate::shade::pixels::shader::PixelShader;
use crate::view::View;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

impl<A: CameraMedia> Corners<'_, A> {
    /// By how much, of 1 and of the light seen, media before corners may differ for those between
    /// to take their mean, times the root of the gather rays in media, as noise goes that pictures
    /// have of them anyway.
    const MAX_MEDIA_DIFFERENCE: f32 = 0.5;
    /// By how much media before a pixel's corners may differ for the mean of those to be that of
    /// its square.
    const MAX_FLAT_DIFFERENCE: f32 = 0.01;

    /// Marches the media before corners that are some way apart, and before those between where the
    /// media of their neighbours differ.
    pub(super) fn pass_media(&mut self) {
        // A pixel needs the ring around its own corners.
        let rim = self.rings as usize - 1;
        let first = FirstCorners {
            spacing: Self::marched_spacing(&self.shader.view),
            origin: 0,
        };
        self.coarse_to_fine(rim, first, |corners, visit| {
            let i = visit.index;
            let between = (visit.between).and_then(|(is, step)| corners.media_between(i, is, step));
            let march = || corners.shader.march(&corners.corners[i].sample);
            corners.corners[i].sample.passed = between.unwrap_or_else(march);
        });
    }

    /// Corners between those that march whatever their neighbours do: so few that no voxel of a
    /// medium fits between them unseen.
    fn marched_spacing(view: &View) -> usize {
        let scene = view.tracer.scene;
        let Aabb { min, max } = view.tracer.media_bounds();
        let is_in_media = |p: Vec3| p.cmpge(min).all() && p.cmple(max).all();
        let is_small = |light: &Light| match light {
            // Its beam is as narrow as can be.
            Light::Spot { .. } => true,
            // Media glow around it.
            _ => light.point_source().is_some_and(|(at, _)| is_in_media(at)),
        };
        if scene.lights.iter().any(is_small) {
            return 1;
        }
        let voxel_in_pixels = |v: &Volume| {
            let distance = |corner: Vec3| corner.distance(view.camera.origin());
            let farthest = v.corners().map(distance).into_iter().fold(0.0, f32::max);
            v.shortest_voxel_edge() / (farthest * view.pixel_angle)
        };
        let emissive = scene.emissive.iter().map(|e| &e.values);
        let volumes = view.tracer.volumes.iter().chain(emissive);
        let least = volumes.map(voxel_in_pixels).fold(f32::INFINITY, f32::min);
        // Samples stand in the middle of voxels and reach one further.
        let fits = |&step: &usize| step as f32 <= 2.0 * least;
        [4, 2].into_iter().find(fits).unwrap_or(1)
    }

    /// Corners from one that marches to the next where media before them do nearly the same, and
    /// whether they do before some so far apart.
    pub fn marches_alike(
        shader: &PixelShader<A>,
        sample: impl Fn(u32) -> Sample<A::Passed>,
    ) -> (usize, bool) {
        let spacing = Self::marched_spacing(&shader.view);
        let around = [0, spacing as u32].map(sample);
        let mut mix = MediaMix::new(shader.media_have_colors);
        around.iter().for_each(|s| mix.add(&s.passed));
        (spacing, Self::do_alike(shader, &mix, around.iter()))
    }

    /// The mean of what the media do before the corners `step` beside or around one, if they do
    /// nearly the same.
    fn media_between(&self, i: usize, is_between: [bool; 2], step: usize) -> Option<A::Passed> {
        let like = &self.corners[i].sample;
        let mut mix = MediaMix::new(self.shader.media_have_colors);
        let around = self.around(i, is_between, step);
        let around = around.map(|j| &self.corners[j].sample);
        for sample in around {
            if !self.shader.same_end(like, sample) {
                return None;
            }
            mix.add(&sample.passed);
        }
        Self::do_alike(self.shader, &mix, around.into_iter()).then(|| mix.mean())
    }

    /// Whether media do nearly the same before some corners, of which they are the mix.
    fn do_alike<'s>(
        shader: &PixelShader<A>,
        mix: &MediaMix<<A::Passed as PassedMedia>::Share>,
        around: impl Iterator<Item = &'s Sample<A::Passed>>,
    ) -> bool {
        let mean: A::Passed = mix.mean();
        let in_media = mean.radiance().luminance();
        let alike = Self::MAX_MEDIA_DIFFERENCE / (shader.counts.volume as f32).sqrt();
        // What is behind them need not be looked at where they alone tell.
        mix.is_within(alike, in_media) || {
            let behind: f32 = around.map(light_behind).sum();
            mix.is_within(alike, in_media + behind / mix.count)
        }
    }

    /// What the media before the corners of a pixel do on the mean over its square. Where they
    /// differ, and the corners around end alike, that is the mean of the cubic through four corners
    /// in a row: the mean of the pixel's own corners would blur media over two pixels.
    pub(super) fn media_over_pixel<'c>(
        &self,
        own: [&Sample<A::Passed>; 4],
        at: impl Fn(usize, usize) -> &'c Corner<A::Passed>,
    ) -> [A::Passed; 4]
    where
        A::Passed: 'c,
    {
        const WEIGHTS: [f32; 4] = [-1.0 / 24.0, 13.0 / 24.0, 13.0 / 24.0, -1.0 / 24.0];
        let passed = own.map(|s| s.passed);
        if A::Passed::IS_VACUUM {
            return passed;
        }
        let mut mix = MediaMix::new(self.shader.media_have_colors);
        passed.iter().for_each(|p| mix.add(p));
        let mean: A::Passed = mix.mean();
        if mix.is_within(Self::MAX_FLAT_DIFFERENCE, mean.radiance().luminance()) {
            return passed;
        }
        let mut radiance = Rgb::BLACK;
        let mut transmittance = <A::Passed as PassedMedia>::Share::default();
        for (row, along) in WEIGHTS.into_iter().enumerate() {
            for (column, across) in WEIGHTS.into_iter().enumerate() {
                let sample = &at(column, row).sample;
                if !self.shader.same_end(own[0], sample) {
                    return passed;
                }
                radiance += sample.passed.radiance() * (along * across);
                transmittance += sample.passed.transmittance() * (along * across);
            }
        }
        let radiance = Rgb(radiance.0.map(|c| c.max(0.0)));
        let least = mean.transmittance().each(|t| t.max(f32::MIN_POSITIVE));
        let scale = transmittance.each(|t| t.max(0.0)).over(least);
        passed.map(|p| {
            let scaled = p.transmittance().times(scale);
            A::Passed::of(scaled.each(|t| t.min(1.0)), radiance)
        })
    }
}

/// Luminance of the direct light that comes from the surface behind the media before a corner, and
/// through them.
fn light_behind<T: PassedMedia>(sample: &Sample<T>) -> f32 {
    let surface = sample
        .surface
        .map_or(Rgb::BLACK, |s| s.albedo * sample.direct.light() * FRAC_1_PI);
    sample.passed.transmittance().luminance_of(surface)
}

/// What media do before some corners: sums, and the least and the most of transmittance and
/// luminance, and of red, green and blue where these may differ by more.
#[derive(Debug)]
struct MediaMix<K> {
    radiance: Rgb,
    transmittance: K,
    count: f32,
    least: [f32; 2],
    most: [f32; 2],
    channels: Option<[[f32; 3]; 2]>,
}

impl<K: Spectrum> MediaMix<K> {
    fn new(by_channel: bool) -> Self {
        Self {
            radiance: Rgb::BLACK,
            transmittance: K::default(),
            count: 0.0,
            least: [f32::INFINITY; 2],
            most: [0.0; 2],
            channels: by_channel.then_some([[f32::INFINITY; 3], [0.0; 3]]),
        }
    }

    fn add(&mut self, passed: &impl PassedMedia<Share = K>) {
        self.radiance += passed.radiance();
        self.transmittance += passed.transmittance();
        self.count += 1.0;
        let values = [passed.transmittance().mean(), passed.radiance().luminance()];
        for (k, v) in values.into_iter().enumerate() {
            self.least[k] = self.least[k].min(v);
            self.most[k] = self.most[k].max(v);
        }
        if let Some([least, most]) = &mut self.channels {
            for (c, v) in passed.radiance().0.into_iter().enumerate() {
                least[c] = least[c].min(v);
                most[c] = most[c].max(v);
            }
        }
    }

    fn mean<T: PassedMedia<Share = K>>(&self) -> T {
        let share = 1.0 / self.count;
        T::of(self.transmittance * share, self.radiance * share)
    }

    /// Whether they differ by at most this share of 1, and of the light that is seen there.
    fn is_within(&self, share: f32, seen: f32) -> bool {
        let [transmittance, radiance] = [0, 1].map(|k| self.most[k] - self.least[k]);
        transmittance <= share && radiance <= share * seen && self.is_one_color(share, seen)
    }

    /// Whether each channel differs by at most this share of its mean, or of the light that is
    /// seen.
    fn is_one_color(&self, share: f32, seen: f32) -> bool {
        self.channels.is_none_or(|[least, most]| {
            let means = self.radiance.0.map(|sum| sum / self.count);
            (0..3).all(|c| most[c] - least[c] <= share * means[c].max(seen))
        })
    }
}
