//! One pixel from samples of its own: primary visibility, direct light, the media before it, and
//! where indirect light is looked up.

use super::emitter_borders::EmitterBorders;
use super::pattern::Pattern;
use super::piece::Piece;
use super::pixel::Pixel;
use super::pixel_sum::PixelSum;
use super::sample::{Sample, SampleCounts};
use crate::gather::SampleRange;
use crate::light::{DirectLight, Lights, ShadowRays, Visibility};
use crate::math::{Ray, Rgb, Spectrum, sampling};
use crate::run::Cancel;
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::shade::surfaces::{GatherAtSurfaces, Lattice, WithSky};
use crate::trace::Surface;
use crate::view::View;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Everything a pixel may look at.
pub struct PixelShader<'a, A: CameraMedia> {
    /// Camera and scene.
    pub view: View<'a>,
    /// Emissive triangles whose borders are in sight.
    pub borders: &'a EmitterBorders,
    /// What lights surfaces directly.
    pub lights: &'a Lights<'a, A::Shadows>,
    /// Indirect light on surfaces.
    pub lattice: &'a Lattice,
    /// For surfaces that the lattice missed.
    pub gatherer: &'a dyn GatherAtSurfaces,
    /// What camera rays pass.
    pub media: &'a A,
    /// Samples and rays that a pixel may take.
    pub counts: SampleCounts,
    /// Whether the environment is seen where no surface is.
    pub shows_background: bool,
    /// Whether media may differ in colour where they are as bright.
    pub media_have_colors: bool,
    /// What pixels need to tell where their samples end, if that was asked for.
    pub ends: Option<EndsOfView>,
    /// Media are passed no more once that says so: nobody will have the pixels.
    pub cancel: &'a Cancel,
}

/// What pixels need to tell where their samples end.
#[derive(Clone, Copy, Debug)]
pub struct EndsOfView {
    origin: Vec3,
    axis: Vec3,
    world_from_scene: Vec3,
    /// Mean albedo of the scene's media, as denoisers take it.
    albedo_of_media: Rgb,
}

impl EndsOfView {
    /// Of a camera before a scene.
    #[must_use]
    pub fn of(view: &View) -> Self {
        let scene = view.tracer.scene;
        let albedos = scene.volumes.iter().map(|v| Rgb(v.albedo));
        let sum = albedos.fold(Rgb::BLACK, |sum, albedo| sum + albedo);
        Self {
            origin: view.camera.origin(),
            axis: view.camera.axis(),
            world_from_scene: scene.world_from_scene.as_vec3(),
            albedo_of_media: sum * (1.0 / scene.volumes.len().max(1) as f32),
        }
    }
}

impl<'a, A: CameraMedia> PixelShader<'a, A> {
    /// The same with other borders of emitters.
    #[must_use]
    pub fn with_borders(&self, borders: &'a EmitterBorders) -> Self {
        Self { borders, ..*self }
    }
}

impl<A: CameraMedia> PixelShader<'_, A> {
    /// Shades pixel (x, y) by samples of its own: few first, and more if they disagree.
    #[must_use]
    pub fn shade(&self, x: u32, y: u32) -> Pixel {
        let mut samples: Vec<Sample<A::Passed>> = Vec::with_capacity(self.counts.pixel as usize);
        let seed = self.key(x, y) as u32;
        let sample = |i| self.sample_in(x, y, i, sampling::sobol2(i, 1, seed));
        samples.extend((0..self.counts.pixel).map(sample));
        let edge = self.counts.edge_of(samples.iter().any(|s| s.is_masked));
        if edge > self.counts.pixel && self.disagree(&samples) {
            samples.extend((self.counts.pixel..edge).map(sample));
        }
        if !A::Passed::IS_VACUUM {
            let known = samples.len().min(2);
            let (known, rest) = samples.split_at_mut(known);
            for s in known.iter_mut() {
                s.passed = self.march(s);
            }
            let first = known[0].passed;
            let smooth = (known.iter()).all(|s| alike(&first, &s.passed, self.media_have_colors));
            self.pass_media(known.iter(), rest, smooth);
        }
        self.resolve(samples.iter().map(|s| (1.0, s)), &mut Vec::new(), x, y)
    }

    /// Shades pixel (x, y) by the larger number of samples inside it and by its corners, given what
    /// is known of it: the samples at those, with their media passed, and pieces of surface with
    /// their indirect light.
    #[must_use]
    pub fn refine(
        &self,
        x: u32,
        y: u32,
        corners: [&Sample<A::Passed>; 4],
        pieces: &mut Vec<Piece>,
    ) -> Pixel {
        let edge = self.counts.edge_of(corners.iter().any(|c| c.is_masked));
        let pattern = Pattern::new(edge, self.key(x, y));
        let mut inside = Vec::with_capacity(edge as usize);
        for i in 0..edge {
            inside.push(self.sample_in(x, y, i, pattern.point(i)));
        }
        // Where nothing needs more samples, the corners' own media are good enough, too.
        self.pass_media(corners.into_iter(), &mut inside, true);
        let corners = corners.into_iter().map(|s| (pattern.corner_weight(), s));
        let inside = inside.iter().map(|s| (1.0, s));
        self.resolve(corners.chain(inside), pieces, x, y)
    }

    /// Key of a pixel's random choices.
    pub fn key(&self, x: u32, y: u32) -> u64 {
        sampling::hash(&[self.view.seed, u64::from(x), u64::from(y)])
    }

    /// Sample `i` of a pixel, at a point of its unit square.
    fn sample_in(&self, x: u32, y: u32, i: u32, [u, v]: [f32; 2]) -> Sample<A::Passed> {
        let rays = ShadowRays::Sequence {
            per_light: self.counts.shadow,
            first: i * self.counts.shadow,
            seed: self.key(x, y),
        };
        self.sample(x as f32 + u, y as f32 + v, rays)
    }

    /// The sample at a point of the film, pixels from its top left, media not yet passed.
    fn sample(&self, x: f32, y: f32, rays: ShadowRays) -> Sample<A::Passed> {
        let mut sample = self.look(x, y);
        if let Some(surface) = sample.lit_surface() {
            sample.direct =
                self.lights
                    .irradiance(surface.position, surface.normal, surface.face_normal, rays);
        }
        sample
    }

    /// The sample at a point of the film, without any light and with media not yet passed.
    pub fn look(&self, x: f32, y: f32) -> Sample<A::Passed> {
        let view = &self.view;
        let direction = view.camera.direction(&view.film, x, y);
        self.look_along(&Ray::endless(view.camera.origin(), direction))
    }

    /// The sample along an endless camera ray, without any light and with media not yet passed.
    #[inline]
    pub fn look_along(&self, ray: &Ray) -> Sample<A::Passed> {
        let (view, direction) = (&self.view, ray.direction);
        let (hit, is_masked) = view.tracer.closest_seen_and_masked(ray);
        let surface =
            hit.map(|h| Surface::new(view.tracer.scene, h.triangle, h.uv).facing(-direction));
        Sample {
            surface,
            triangle: hit.map_or(u32::MAX, |h| h.triangle),
            is_masked,
            t: hit.map_or(f32::INFINITY, |h| h.t),
            direction,
            direct: DirectLight::default(),
            passed: A::Passed::default(),
        }
    }

    /// Marches the media before some samples. Where `smooth` says so, those take what the known
    /// ones on their piece of surface passed, on average.
    fn pass_media<'s>(
        &self,
        known: impl Iterator<Item = &'s Sample<A::Passed>> + Clone,
        samples: &mut [Sample<A::Passed>],
        smooth: bool,
    ) {
        if A::Passed::IS_VACUUM {
            return;
        }
        for s in samples {
            let mut radiance = Rgb::BLACK;
            let mut transmittance = <A::Passed as PassedMedia>::Share::default();
            let mut alike = 0;
            for k in known.clone().filter(|k| smooth && self.same_end(k, s)) {
                radiance += k.passed.radiance();
                transmittance += k.passed.transmittance();
                alike += 1;
            }
            s.passed = if alike > 0 {
                let share = 1.0 / alike as f32;
                A::Passed::of(transmittance * share, radiance * share)
            } else {
                self.march(s)
            };
        }
    }

    /// What the media before a sample take and add.
    pub fn march(&self, sample: &Sample<A::Passed>) -> A::Passed {
        if self.cancel.check().is_err() {
            return A::Passed::default();
        }
        self.media.march(&self.view, &self.way_to(sample))
    }

    /// The way of the camera ray of a sample through a pinhole.
    pub fn way_to(&self, sample: &Sample<A::Passed>) -> Ray {
        Ray::new(self.view.camera.origin(), sample.direction, sample.t)
    }

    /// Whether more samples would tell more.
    fn disagree(&self, samples: &[Sample<A::Passed>]) -> bool {
        let mut visibility = Visibility::default();
        samples
            .iter()
            .for_each(|s| visibility += s.direct.visibility);
        visibility.has_edge() || visibility.has_penumbra() || !self.end_alike(samples.iter())
    }

    /// Whether all samples of a pixel end on the same piece of surface, or on none, and so does
    /// what is between them.
    pub fn end_alike<'s>(
        &self,
        mut samples: impl Iterator<Item = &'s Sample<A::Passed>> + Clone,
    ) -> bool {
        let first = samples.clone().next();
        first.is_none_or(|first| samples.all(|s| !s.is_masked && self.same_end(first, s)))
    }

    /// Whether two samples end on the same piece of surface, or both on none.
    pub fn same_end(&self, a: &Sample<A::Passed>, b: &Sample<A::Passed>) -> bool {
        match (&a.surface, &b.surface) {
            (None, None) => true,
            (Some(p), Some(q)) => self.same_piece(p, q, a.t),
            _ => false,
        }
    }

    /// Whether two points, seen from `t` away, lie on one smooth piece of surface.
    pub fn same_piece(&self, a: &Surface, b: &Surface, t: f32) -> bool {
        let footprint = t * self.view.pixel_angle;
        a.material == b.material
            && a.normal.dot(b.normal) > 0.98
            && (a.position - b.position).dot(b.face_normal).abs() < 0.5 * footprint
    }

    /// Whether two points on one piece of surface, seen from `t` away, see lights under nearly the
    /// same angles.
    pub fn is_lit_alike(&self, a: &Surface, b: &Surface, t: f32) -> bool {
        a.faces_as(b) && self.same_piece(a, b, t)
    }

    /// The pixel of samples and their weights.
    fn resolve<'s>(
        &self,
        samples: impl Iterator<Item = (f32, &'s Sample<A::Passed>)> + Clone,
        pieces: &mut Vec<Piece>,
        x: u32,
        y: u32,
    ) -> Pixel {
        let mut piece_of = Vec::with_capacity(samples.size_hint().0);
        for (_, sample) in samples.clone() {
            let Some(surface) = &sample.surface else {
                piece_of.push(0);
                continue;
            };
            let known = pieces
                .iter()
                .position(|p| self.same_piece(surface, &p.surface, sample.t));
            let index = known.unwrap_or_else(|| {
                pieces.push(Piece::new(*surface, self.indirect(surface, x, y)));
                pieces.len() - 1
            });
            pieces[index].ratio += sample.direct.ratio;
            pieces[index].sky_ratio += sample.direct.sky.ratio;
            piece_of.push(index);
        }
        let mut pixel = PixelSum::of(x, y);
        for ((weight, sample), &index) in samples.zip(&piece_of) {
            match sample.surface {
                Some(_) => {
                    let piece = &pieces[index];
                    let direct = sample.direct.arriving(&piece.ratio, &piece.sky_ratio);
                    let irradiance = [direct.into(), piece.irradiance];
                    self.add_surface(&mut pixel, weight, sample, &sample.passed, irradiance, None);
                }
                None => self.add_nothing(&mut pixel, weight, sample.direction, &sample.passed),
            }
        }
        self.finish(pixel)
    }

    /// Mean of what was added, and the emissive triangles whose borders are in the pixel.
    pub fn finish(&self, pixel: PixelSum) -> Pixel {
        let [x, y] = pixel.at();
        let mut pixel = pixel.mean();
        pixel.has_emitter_border = self.borders.is_border(x, y);
        if pixel.has_emitter_border {
            let seen = self.borders.seen(&self.view, self.lights, x, y);
            pixel.direct += seen.radiance;
            // No light of an emitter that rays missed is without its share of the pixel.
            pixel.ends.alpha = pixel.ends.alpha.max(seen.share);
        }
        pixel
    }

    /// What a surface that a sample met sends to the camera by itself, unless that is told by
    /// borders.
    pub fn emission(&self, at: [u32; 2], sample: &Sample<A::Passed>, surface: &Surface) -> Rgb {
        let (scene, [x, y]) = (self.view.tracer.scene, at);
        let emission = surface.emission(scene, sample.triangle, -sample.direction);
        match !emission.is_black() && self.borders.has(x, y, sample.triangle) {
            true => Rgb::BLACK,
            false => emission,
        }
    }

    /// Adds a sample that hit a surface of the given direct and indirect irradiance behind media.
    /// Its emission is its own, unless that `over_pixel` is known.
    pub fn add_surface(
        &self,
        pixel: &mut PixelSum,
        weight: f32,
        sample: &Sample<A::Passed>,
        passed: &A::Passed,
        [direct, indirect]: [WithSky; 2],
        over_pixel: Option<Rgb>,
    ) {
        let Some(surface) = &sample.surface else {
            return;
        };
        let through = passed.transmittance();
        let reflect = (through * FRAC_1_PI).filter(surface.albedo);
        let own = || self.emission(pixel.at(), sample, surface);
        let emission = over_pixel.unwrap_or_else(own);
        let radiance = [
            WithSky {
                all: reflect * direct.all + through.filter(emission),
                sky: reflect * direct.sky,
            },
            WithSky {
                all: reflect * indirect.all,
                sky: reflect * indirect.sky,
            },
        ];
        pixel.add_hit(weight, radiance, passed, sample.t, surface.normal);
        if let Some(ends) = &self.ends {
            let depth = (surface.position - ends.origin).dot(ends.axis);
            let position = surface.position + ends.world_from_scene;
            let scene = self.view.tracer.scene;
            let emission = surface.emission(scene, sample.triangle, -sample.direction);
            let albedo = Rgb((surface.albedo + emission).0.map(|c| c.min(1.0)));
            let stopped = through.each(|through| 1.0 - through);
            let albedo = through.filter(albedo) + stopped.filter(ends.albedo_of_media);
            (pixel.ends).add_surface(weight, depth, position, albedo);
        }
    }

    /// Adds a sample that hit nothing behind media.
    pub fn add_nothing(
        &self,
        pixel: &mut PixelSum,
        weight: f32,
        direction: Vec3,
        passed: &A::Passed,
    ) {
        let sky = passed.transmittance().filter(self.background(direction));
        pixel.add_miss(weight, WithSky { all: sky, sky }, passed);
        if let Some(ends) = &self.ends {
            let alpha = 1.0 - passed.transmittance().mean();
            (pixel.ends).add_nothing(weight, alpha, ends.albedo_of_media * alpha);
        }
    }

    /// What is seen where no surface is.
    pub fn background(&self, direction: Vec3) -> Rgb {
        match self.shows_background {
            true => (self.lights).seen_environment(direction, self.view.pixel_angle),
            false => Rgb::BLACK,
        }
    }

    /// Indirect irradiance of a surface that pixel or corner (x, y) sees.
    pub fn indirect(&self, surface: &Surface, x: u32, y: u32) -> WithSky {
        self.spread(surface, x, y)
            .unwrap_or_else(|| self.gathered(surface, x, y))
    }

    /// Indirect irradiance of a surface as the lattice has it, if it does.
    pub fn spread(&self, surface: &Surface, x: u32, y: u32) -> Option<WithSky> {
        if !surface.reflects {
            return Some(WithSky::BLACK);
        }
        self.lattice.irradiance(surface, x, y)
    }

    /// Indirect irradiance of a surface by a gather of its own: few pixels see it.
    pub fn gathered(&self, surface: &Surface, x: u32, y: u32) -> WithSky {
        let stretch = SampleRange::first(self.key(x, y));
        let gathered = self.gatherer.gather(surface, stretch);
        WithSky {
            all: gathered.light,
            sky: gathered.environment,
        }
    }
}

/// Whether two rays of a pixel passed media alike, to a fiftieth; in each channel if those may
/// differ where luminances do not.
fn alike<T: PassedMedia>(a: &T, b: &T, by_channel: bool) -> bool {
    let is_near = |a: f32, b: f32| (a - b).abs() <= 0.02 * (a + b);
    let apart = (a.transmittance() - b.transmittance()).each(f32::abs);
    let (a, b) = (a.radiance(), b.radiance());
    apart.most() <= 0.02
        && is_near(a.luminance(), b.luminance())
        && (!by_channel || (0..3).all(|c| is_near(a.0[c], b.0[c])))
}
