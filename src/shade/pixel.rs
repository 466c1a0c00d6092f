//! One pixel from samples of its own: primary visibility, direct light, the media before it, and where indirect light
//! is looked up.

use super::inscatter::InScatter;
use super::lamps::Lamps;
use super::lattice::{Lattice, gather_surface};
use super::view::View;
use crate::gather::{Gatherer, Medium, Pages, Stretch};
use crate::light::{Arrival, Direct, Lights, ShadowRays};
use crate::math::exp::exp_neg;
use crate::math::segment::Composite;
use crate::math::{Rgb, sampling};
use crate::trace::Surface;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// What a pixel came to, box-filtered over its square.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pixel {
    /// Emitted and directly lit, behind media.
    pub direct: Rgb,
    /// Lit by other surfaces and media, behind media.
    pub indirect: Rgb,
    /// Scattered by media towards the camera.
    pub volume: Rgb,
    /// Mean distance along the rays that hit, infinite if none did.
    pub depth: f32,
    /// Mean unit normal.
    pub normal: Vec3,
    /// Whether the border of a lamp runs through it, so that its light is told in closed form.
    pub has_lamp_border: bool,
}

impl Pixel {
    /// All light of the pixel.
    #[must_use]
    pub fn radiance(&self) -> Rgb {
        self.direct + self.indirect + self.volume
    }
}

/// Everything a pixel may look at.
pub struct PixelShader<'a, P, M> {
    /// Camera and scene.
    pub view: View<'a>,
    /// Lamps whose borders are in sight.
    pub lamps: &'a Lamps,
    /// Lights.
    pub lights: &'a Lights<'a>,
    /// Indirect light on surfaces.
    pub lattice: &'a Lattice,
    /// For surfaces that the lattice missed.
    pub gatherer: &'a Gatherer<'a, P, M>,
    /// Light in media.
    pub in_scatter: &'a InScatter<'a, P, M>,
    /// How many samples.
    pub counts: SampleCounts,
}

/// Samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleCounts {
    /// Always taken; 1 for the pixel's corners, which neighbours share.
    pub pixel: u32,
    /// Taken where those disagree.
    pub edge: u32,
    /// Shadow rays to lights with an extent, at each of those; shared corners take a number of their own.
    pub shadow: u32,
}

/// One primary ray.
#[derive(Clone, Copy)]
pub struct Sample {
    /// What it hit.
    pub surface: Option<Surface>,
    /// The triangle that this is on, if any.
    pub triangle: u32,
    /// How far away, infinite if nothing.
    pub t: f32,
    /// Unit direction.
    pub direction: Vec3,
    /// Direct light there.
    pub direct: Direct,
    /// Media on the way.
    pub passed: Composite,
}

/// A smooth piece of surface in a pixel, whose samples share their indirect light and their shadow rays.
pub struct Piece {
    /// A point of it.
    pub surface: Surface,
    /// Indirect light.
    pub irradiance: Rgb,
    rays: Arrival,
}

impl Piece {
    /// A piece of which no sample is known yet.
    pub fn new(surface: Surface, irradiance: Rgb) -> Self {
        Self {
            surface,
            irradiance,
            rays: Arrival::default(),
        }
    }
}

impl<P: Pages, M: Medium> PixelShader<'_, P, M> {
    /// Shades pixel (x, y) by samples of its own: few first, and more if they disagree.
    #[must_use]
    pub fn shade(&self, x: u32, y: u32) -> Pixel {
        let mut samples: Vec<Sample> = Vec::with_capacity(self.counts.pixel as usize);
        let sample = |i| self.sample_in(x, y, i, self.counts.shadow, i * self.counts.shadow);
        samples.extend((0..self.counts.pixel).map(sample));
        if self.counts.edge > self.counts.pixel && self.disagree(&samples) {
            samples.extend((self.counts.pixel..self.counts.edge).map(sample));
        }
        let known = samples.len().min(2);
        for s in &mut samples[..known] {
            s.passed = self.march(s);
        }
        let smooth = samples[..known]
            .iter()
            .all(|s| alike(&samples[0].passed, &s.passed));
        self.pass_media(&mut samples, known, smooth);
        self.resolve(&samples, &mut Vec::new(), x, y)
    }

    /// Shades pixel (x, y) by the larger number of samples, given what is known of it: samples with their media passed,
    /// and pieces of surface with their indirect light.
    #[must_use]
    pub fn refine(&self, x: u32, y: u32, known: &[Sample], pieces: &mut Vec<Piece>) -> Pixel {
        let mut samples = Vec::with_capacity(self.counts.edge as usize + known.len());
        samples.extend_from_slice(known);
        for i in 0..self.counts.edge {
            samples.push(self.sample_in(x, y, i, self.counts.shadow, i * self.counts.shadow));
        }
        // Where nothing needs more samples, the corners' own media are good enough, too.
        self.pass_media(&mut samples, known.len(), true);
        samples.drain(..known.len());
        self.resolve(&samples, pieces, x, y)
    }

    fn sample_in(&self, x: u32, y: u32, i: u32, per_light: u32, first: u32) -> Sample {
        let seed = sampling::hash(&[self.view.seed, u64::from(x), u64::from(y)]);
        let [u, v] = sampling::sobol2(i, 1, seed as u32);
        let rays = ShadowRays::Sequence {
            per_light,
            first,
            seed,
        };
        self.sample(x as f32 + u, y as f32 + v, rays)
    }

    /// The sample at a point of the film, pixels from its top left, media not yet passed.
    pub fn sample(&self, x: f32, y: f32, rays: ShadowRays) -> Sample {
        let view = &self.view;
        let direction = view.camera.direction(&view.film, x, y);
        let hit = view
            .tracer
            .closest(view.camera.origin(), direction, f32::INFINITY);
        let surface =
            hit.map(|h| Surface::new(view.tracer.scene, h.triangle, h.uv).facing(-direction));
        let direct = surface
            .filter(|s| !s.albedo.is_black())
            .map_or_else(Direct::default, |s| {
                self.lights
                    .irradiance(s.position, s.normal, s.face_normal, rays)
            });
        Sample {
            surface,
            triangle: hit.map_or(u32::MAX, |h| h.triangle),
            t: hit.map_or(f32::INFINITY, |h| h.t),
            direction,
            direct,
            passed: Composite::default(),
        }
    }

    /// Marches the media before samples after the first `known`. Where `smooth` says so, those take what the known ones on
    /// their piece of surface passed, on average.
    fn pass_media(&self, samples: &mut [Sample], known: usize, smooth: bool) {
        if self.view.tracer.scene.volumes.is_empty() {
            return;
        }
        let (known, rest) = samples.split_at_mut(known);
        for s in rest {
            let mut passed = Composite {
                radiance: Rgb::BLACK,
                transmittance: 0.0,
            };
            let mut alike = 0;
            for k in known.iter().filter(|k| smooth && self.same_end(k, s)) {
                passed.radiance += k.passed.radiance;
                passed.transmittance += k.passed.transmittance;
                alike += 1;
            }
            s.passed = if alike > 0 {
                let share = 1.0 / alike as f32;
                passed.radiance *= share;
                passed.transmittance *= share;
                passed
            } else {
                self.march(s)
            };
        }
    }

    /// What the media before a sample take and add.
    pub fn march(&self, sample: &Sample) -> Composite {
        let mut passed = Composite::default();
        self.view.tracer.march(
            self.view.camera.origin(),
            sample.direction,
            sample.t,
            |volume, stretch, _| {
                let at = |t| self.view.camera.origin() + sample.direction * t;
                let ends = [at(stretch.near), at(stretch.far)];
                self.in_scatter.source(volume, ends, stretch.tau)
            },
            |s| {
                passed.medium(s.tau, s.source);
                !passed.is_opaque()
            },
        );
        if passed.is_opaque() {
            // What the march left out still hides what is behind, however bright that is.
            let (tracer, origin) = (&self.view.tracer, self.view.camera.origin());
            passed.transmittance =
                exp_neg(tracer.optical_depth(origin, sample.direction, sample.t));
        }
        passed
    }

    /// Whether more samples would tell more.
    fn disagree(&self, samples: &[Sample]) -> bool {
        let (mut seen, mut hidden) = (0, 0);
        for s in samples {
            seen |= s.direct.seen;
            hidden |= s.direct.hidden;
        }
        seen & hidden != 0 || samples.iter().any(|s| !self.same_end(&samples[0], s))
    }

    /// Whether two samples end on the same piece of surface, or both on none.
    pub fn same_end(&self, a: &Sample, b: &Sample) -> bool {
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

    fn resolve(&self, samples: &[Sample], pieces: &mut Vec<Piece>, x: u32, y: u32) -> Pixel {
        let mut piece_of = Vec::with_capacity(samples.len());
        for sample in samples {
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
            pieces[index].rays += sample.direct.rays;
            piece_of.push(index);
        }
        let mut pixel = PixelSum::of(x, y);
        for (sample, &index) in samples.iter().zip(&piece_of) {
            match sample.surface {
                Some(_) => {
                    let piece = &pieces[index];
                    let direct = sample.direct.sharp + piece.rays.of(sample.direct.open);
                    self.add_surface(&mut pixel, sample, direct, piece.irradiance);
                }
                None => self.add_nothing(&mut pixel, sample),
            }
        }
        self.finish(pixel)
    }

    /// Mean of what was added, and the lamps whose borders are in the pixel.
    pub fn finish(&self, pixel: PixelSum) -> Pixel {
        let [x, y] = pixel.at;
        let mut pixel = pixel.mean();
        pixel.has_lamp_border = self.lamps.is_border(x, y);
        if pixel.has_lamp_border {
            pixel.direct += self.lamps.radiance(&self.view, x, y);
        }
        pixel
    }

    /// Adds a sample that hit a surface of the given direct and indirect irradiance.
    pub fn add_surface(&self, pixel: &mut PixelSum, sample: &Sample, direct: Rgb, indirect: Rgb) {
        let Some(surface) = &sample.surface else {
            return;
        };
        let through = sample.passed.transmittance;
        let reflect = surface.albedo * (FRAC_1_PI * through);
        let [x, y] = pixel.at;
        let mut emission = surface.emission(self.view.tracer.scene, -sample.direction);
        if !emission.is_black() && self.lamps.has(x, y, sample.triangle) {
            emission = Rgb::BLACK;
        }
        pixel.sum.direct += reflect * direct + emission * through;
        pixel.sum.indirect += reflect * indirect;
        pixel.sum.volume += sample.passed.radiance;
        pixel.sum.depth += sample.t;
        pixel.sum.normal += surface.normal;
        pixel.hits += 1;
        pixel.samples += 1;
    }

    /// Adds a sample that hit nothing.
    pub fn add_nothing(&self, pixel: &mut PixelSum, sample: &Sample) {
        pixel.sum.direct += self.lights.environment() * sample.passed.transmittance;
        pixel.sum.volume += sample.passed.radiance;
        pixel.samples += 1;
    }

    /// Indirect irradiance of a surface that pixel or corner (x, y) sees.
    pub fn indirect(&self, surface: &Surface, x: u32, y: u32) -> Rgb {
        self.spread(surface, x, y)
            .unwrap_or_else(|| self.gathered(surface, x, y))
    }

    /// The same as the lattice has it, if it does.
    pub fn spread(&self, surface: &Surface, x: u32, y: u32) -> Option<Rgb> {
        if surface.albedo.is_black() {
            return Some(Rgb::BLACK);
        }
        self.lattice.irradiance(surface, x, y)
    }

    /// The same by a gather of its own.
    pub fn gathered(&self, surface: &Surface, x: u32, y: u32) -> Rgb {
        let seed = sampling::hash(&[self.view.seed, u64::from(x), u64::from(y)]);
        gather_surface(&self.view, self.gatherer, surface, Stretch::first(seed)).light
    }
}

/// A pixel in the making.
#[derive(Debug)]
pub struct PixelSum {
    at: [u32; 2],
    sum: Pixel,
    samples: u32,
    hits: u32,
}

impl PixelSum {
    /// Pixel (x, y), of which nothing is known.
    #[must_use]
    pub fn of(x: u32, y: u32) -> Self {
        Self {
            at: [x, y],
            sum: Pixel::default(),
            samples: 0,
            hits: 0,
        }
    }

    /// The mean of what was added.
    #[must_use]
    pub fn mean(self) -> Pixel {
        let mut pixel = self.sum;
        let scale = 1.0 / self.samples.max(1) as f32;
        pixel.direct *= scale;
        pixel.indirect *= scale;
        pixel.volume *= scale;
        pixel.depth /= self.hits as f32;
        if self.hits == 0 {
            pixel.depth = f32::INFINITY;
        }
        pixel.normal = pixel.normal.normalize_or_zero();
        pixel
    }
}

/// Whether two rays of a pixel passed media alike, to a fiftieth.
fn alike(a: &Composite, b: &Composite) -> bool {
    let (la, lb) = (a.radiance.luminance(), b.radiance.luminance());
    (a.transmittance - b.transmittance).abs() <= 0.02 && (la - lb).abs() <= 0.02 * (la + lb)
}
