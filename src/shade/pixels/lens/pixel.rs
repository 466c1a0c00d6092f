//! A pixel by samples over the lens and the time that the shutter is open.

use super::MUCH;
use super::confusion::Confusion;
use super::film_light::FilmLight;
use super::smooth::{RADIUS_PER_PIXEL, RIM};
use crate::light::ShadowRays;
use crate::math::{Ray, Rgb, Spectrum, sampling};
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::shade::pixels::pixel::Pixel;
use crate::shade::pixels::pixel_sum::PixelSum;
use crate::shade::pixels::sample::Sample;
use crate::shade::pixels::shader::PixelShader;
use crate::shade::surfaces::WithSky;
use crate::trace::Surface;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Shades pixels by samples over the lens.
pub struct LensSampler<'a, A: CameraMedia> {
    /// With no borders of emitters: those are where a pinhole sees them.
    pub shader: &'a PixelShader<'a, A>,
    /// How far points are spread.
    pub confusion: &'a Confusion<'a>,
    /// Light that samples find.
    pub light: &'a FilmLight<A::Passed>,
}

/// How many samples a pixel may take.
#[derive(Clone, Copy, Debug)]
pub struct LensSamples {
    /// At first.
    pub first: u32,
    /// In all, where the first differ and are sharp.
    pub most: u32,
    /// By how much what is spread into the pixel differs over its mean.
    pub contrast: f32,
    /// Whether media before the pixel are even.
    pub even_media: bool,
}

/// A pixel, and how far all is spread that it shows.
pub struct SpreadPixel {
    /// Its light.
    pub pixel: Pixel,
    /// The least radius in pixels.
    pub radius: f32,
}

/// A sample over the lens, lit.
struct LensSample<T: PassedMedia> {
    sample: Sample<T>,
    origin: Vec3,
    irradiance: [WithSky; 2],
    /// Whether media before it are those that a pinhole sees before the place where it ends.
    is_media_known: bool,
}

/// Surfaces of a pixel that light is gathered for.
type OwnGathers = Vec<(Surface, WithSky)>;

impl<A: CameraMedia> LensSampler<'_, A> {
    /// Radius from which on neighbours tell more than samples do.
    const SMOOTH: f32 = RADIUS_PER_PIXEL;
    /// Samples where neighbours tell as much as they can, or less, by contrast: little, much, very
    /// much.
    const AMONG_NEIGHBOURS: [[u32; 3]; 2] = [[2, 4, 8], [4, 8, 16]];
    /// Root mean square of the differences of samples over their mean, up to which there are no
    /// more.
    const EVEN: f32 = 0.08;
    /// The same up to which half of the most are enough.
    const LITTLE: f32 = 0.2;
    /// Samples whose media tell whether others take their mean.
    const MARCHES: u32 = 4;
    /// By how much media may differ for that.
    const ALIKE: f32 = 0.1;

    /// Shades pixel (x, y).
    #[must_use]
    pub fn shade(&self, x: u32, y: u32, counts: LensSamples) -> SpreadPixel {
        let mut own = OwnGathers::new();
        let mut samples = Vec::with_capacity(counts.most as usize);
        let mut radius = f32::INFINITY;
        let seed = sampling::hash(&[self.shader.key(x, y), 11]) as u32;
        for i in 0..counts.most {
            if i.is_power_of_two() && self.are_enough(&samples, radius, &counts) {
                break;
            }
            samples.push(self.sample([x, y], i, seed, counts.even_media, &mut own, &mut radius));
        }
        if !A::Passed::IS_VACUUM {
            self.pass_media(&mut samples);
        }
        let mut sum = PixelSum::of(x, y);
        for s in &samples {
            let passed = &s.sample.passed;
            match s.sample.surface {
                Some(_) => {
                    (self.shader).add_surface(&mut sum, 1.0, &s.sample, passed, s.irradiance, None)
                }
                None => (self.shader).add_nothing(&mut sum, 1.0, s.sample.direction, passed),
            }
        }
        SpreadPixel {
            pixel: self.shader.finish(sum),
            radius,
        }
    }

    /// Sample `i` of a pixel.
    fn sample(
        &self,
        [x, y]: [u32; 2],
        i: u32,
        seed: u32,
        even_media: bool,
        own: &mut OwnGathers,
        radius: &mut f32,
    ) -> LensSample<A::Passed> {
        let [u, v, on_lens @ ..] = sampling::sobol4(i, 0, seed);
        let time = match self.confusion.moves() {
            true => sampling::sobol4(i, 1, seed)[0],
            false => 0.0,
        };
        let film = &self.shader.view.film;
        let pose = self.confusion.pose(time);
        let at = [x as f32 + u, y as f32 + v];
        let ray = pose.ray(film, at, on_lens);
        let mut sample = (self.shader).look_along(&Ray::endless(ray.origin, ray.direction));
        let mut is_media_known = false;
        let irradiance = match &sample.surface {
            Some(surface) => {
                *radius = radius.min(self.confusion.radius(surface.position));
                let (irradiance, passed) = self.light(surface, sample.t, [x, y], i, own);
                is_media_known = even_media && passed.is_some();
                sample.passed = passed.unwrap_or_default();
                irradiance
            }
            None => {
                *radius = radius.min(self.confusion.radius_of_background(sample.direction));
                [WithSky::BLACK; 2]
            }
        };
        if !A::Passed::IS_VACUUM {
            let way = Ray::new(ray.origin, ray.direction, sample.t);
            match self.confusion.span_of_media(&way) {
                Some(span) => {
                    let [least, _] = self.confusion.radii_in_media(&way, span);
                    *radius = radius.min(least);
                    let seen = self.media_at(&way, span, [x, y]);
                    is_media_known |= seen.is_some();
                    sample.passed = seen.unwrap_or(sample.passed);
                }
                None => (is_media_known, sample.passed) = (true, A::Passed::default()),
            }
        }
        LensSample {
            sample,
            origin: ray.origin,
            irradiance,
            is_media_known,
        }
    }

    /// The media along a way, as a pinhole sees what is in the middle of them.
    fn media_at(&self, way: &Ray, span: [f32; 2], [x, y]: [u32; 2]) -> Option<A::Passed> {
        let reach = self.confusion.reach() as f32;
        let middle = way.at(0.5 * (span[0] + span[1].min(way.t_max)));
        let at = self.confusion.on_film(middle)?;
        let is_near =
            (at[0] - x as f32 - 0.5).abs() <= reach && (at[1] - y as f32 - 0.5).abs() <= reach;
        let origin = self.shader.view.camera.origin();
        is_near
            .then(|| self.light.media_at(at, origin, way.t_max, span))
            .flatten()
    }

    /// Direct and indirect irradiance of a surface that sample `i` of pixel (x, y) met, and media
    /// as a pinhole sees them before it.
    fn light(
        &self,
        surface: &Surface,
        t: f32,
        [x, y]: [u32; 2],
        i: u32,
        own: &mut OwnGathers,
    ) -> ([WithSky; 2], Option<A::Passed>) {
        if !surface.reflects && A::Passed::IS_VACUUM {
            return ([WithSky::BLACK; 2], None);
        }
        let reach = self.confusion.reach() as f32;
        let seen = self.confusion.on_film(surface.position);
        // What is spread farther no tile would know.
        let is_near = |at: &[f32; 2]| {
            (at[0] - x as f32 - 0.5).abs() <= reach && (at[1] - y as f32 - 0.5).abs() <= reach
        };
        let seen = seen.filter(is_near);
        let footprint = t * self.shader.view.pixel_angle;
        let known = seen.and_then(|at| self.light.at(at, surface, footprint));
        if let Some(known) = &known
            && !known.is_edge
        {
            return ([known.direct, known.indirect], Some(known.passed));
        }
        let rays = ShadowRays::Sequence {
            per_light: self.shader.counts.shadow,
            first: i * self.shader.counts.shadow,
            seed: self.shader.key(x, y),
        };
        let direct = (self.shader.lights).irradiance(
            surface.position,
            surface.normal,
            surface.face_normal,
            rays,
        );
        let direct: WithSky = direct.arriving(&direct.ratio, &direct.sky.ratio).into();
        if let Some(known) = known {
            return ([direct, known.indirect], Some(known.passed));
        }
        let spread = seen
            .filter(|[x, y]| *x >= 0.0 && *y >= 0.0)
            .and_then(|[x, y]| self.shader.spread(surface, x as u32, y as u32));
        let indirect = spread.unwrap_or_else(|| self.gathered(surface, t, [x, y], own));
        ([direct, indirect], None)
    }

    /// Indirect irradiance by a gather of the pixel's own, one for each piece of surface.
    fn gathered(
        &self,
        surface: &Surface,
        t: f32,
        [x, y]: [u32; 2],
        own: &mut OwnGathers,
    ) -> WithSky {
        let known = own
            .iter()
            .find(|(other, _)| self.shader.same_piece(surface, other, t));
        if let Some((_, light)) = known {
            return *light;
        }
        let light = self.shader.gathered(surface, x, y);
        own.push((*surface, light));
        light
    }

    /// Whether a pixel has samples enough: where neighbours tell more, as many as contrast asks
    /// for, and elsewhere as many as these differ.
    fn are_enough(
        &self,
        samples: &[LensSample<A::Passed>],
        radius: f32,
        counts: &LensSamples,
    ) -> bool {
        let taken = samples.len() as u32;
        if radius >= Self::SMOOTH {
            let is_smoothest = radius >= Self::SMOOTH * RIM as f32;
            let contrast = usize::from(counts.contrast > MUCH) + usize::from(counts.contrast > 1.0);
            return taken >= Self::AMONG_NEIGHBOURS[usize::from(!is_smoothest)][contrast];
        }
        taken >= counts.first && {
            let differ = self.difference(samples);
            differ <= Self::EVEN || (differ <= Self::LITTLE && 2 * taken >= counts.most)
        }
    }

    /// Root mean square of the differences of samples over their mean.
    fn difference(&self, samples: &[LensSample<A::Passed>]) -> f32 {
        let scene = self.shader.view.tracer.scene;
        let light = |s: &LensSample<A::Passed>| match &s.sample.surface {
            Some(surface) => {
                let [direct, indirect] = s.irradiance;
                let reflected = surface.albedo * ((direct.all + indirect.all) * FRAC_1_PI);
                reflected + surface.emission(scene, s.sample.triangle, -s.sample.direction)
            }
            None => self.shader.background(s.sample.direction),
        };
        let count = samples.len() as f32;
        let lights: Vec<Rgb> = samples.iter().map(light).collect();
        let mean = lights.iter().fold(Rgb::BLACK, |sum, l| sum + *l) * (1.0 / count);
        let squares = lights.iter().map(|l| {
            let away = (0..3).map(|c| (l.0[c] - mean.0[c]).abs());
            away.fold(0.0, f32::max).powi(2)
        });
        let rms = (squares.sum::<f32>() / count).sqrt();
        rms / mean.luminance().max(1e-6)
    }

    /// Marches the media before samples of which nothing is known. Some march, and if they pass
    /// alike others take their mean.
    fn pass_media(&self, samples: &mut [LensSample<A::Passed>]) {
        let (mut radiance, mut count) = (Rgb::BLACK, 0_u32);
        let mut transmittance = <A::Passed as PassedMedia>::Share::default();
        let (mut least, mut most) = ([f32::INFINITY; 2], [0.0_f32; 2]);
        for s in samples {
            if s.is_media_known {
                continue;
            }
            let is_alike = count >= Self::MARCHES
                && most[0] - least[0] <= Self::ALIKE
                && most[1] - least[1] <= Self::ALIKE * most[1];
            if is_alike && s.sample.surface.is_some() {
                let share = 1.0 / count as f32;
                s.sample.passed = A::Passed::of(transmittance * share, radiance * share);
                continue;
            }
            let ray = Ray::new(s.origin, s.sample.direction, s.sample.t);
            let passed = self.shader.media.march(&self.shader.view, &ray);
            s.sample.passed = passed;
            radiance += passed.radiance();
            transmittance += passed.transmittance();
            count += 1;
            let values = [passed.transmittance().mean(), passed.radiance().luminance()];
            for k in 0..2 {
                least[k] = least[k].min(values[k]);
                most[k] = most[k].max(values[k]);
            }
        }
    }
}
