//! One pixel: primary visibility, direct light, the media before it, and where indirect light is looked up.
//!
//! A pixel starts with few samples. Only if they disagree (two surfaces, or partly hidden lights) does it take more.

use super::inscatter::InScatter;
use super::lattice::{Lattice, gather_surface};
use super::view::View;
use crate::gather::{Gatherer, Pages};
use crate::light::{Direct, Lights, ShadowRays};
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
}

/// Samples of a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleCounts {
    /// Always taken.
    pub pixel: u32,
    /// Taken where those disagree.
    pub edge: u32,
    /// Shadow rays to each area light at each sample.
    pub shadow: u32,
}

/// Everything a pixel may look at.
pub struct PixelShader<'a, P> {
    /// Camera and scene.
    pub view: View<'a>,
    /// Lights.
    pub lights: &'a Lights<'a>,
    /// Indirect light on surfaces.
    pub lattice: &'a Lattice,
    /// For surfaces that the lattice missed.
    pub gatherer: &'a Gatherer<'a, P>,
    /// Light in media.
    pub in_scatter: &'a InScatter<'a, P>,
    /// How many samples.
    pub counts: SampleCounts,
}

/// One primary ray.
#[derive(Clone, Copy)]
struct Sample {
    surface: Option<Surface>,
    t: f32,
    direction: Vec3,
    direct: Direct,
    passed: Composite,
}

/// Samples that hit the same smooth piece of surface share their indirect light.
struct Group {
    surface: Surface,
    irradiance: Rgb,
}

impl<P: Pages> PixelShader<'_, P> {
    /// Shades pixel (x, y).
    #[must_use]
    pub fn shade(&self, x: u32, y: u32) -> Pixel {
        let seed = sampling::hash(&[self.view.seed, u64::from(x), u64::from(y)]);
        let mut samples: Vec<Sample> = Vec::with_capacity(self.counts.edge as usize);
        // The first samples have one shadow ray each: together they tell whether a light is partly hidden.
        for i in 0..self.counts.pixel {
            samples.push(self.sample(x, y, i, 1, i, seed));
        }
        if self.counts.edge > self.counts.pixel && self.disagree(&samples) {
            let mut next_shadow = self.counts.pixel;
            for i in self.counts.pixel..self.counts.edge {
                samples.push(self.sample(x, y, i, self.counts.shadow, next_shadow, seed));
                next_shadow += self.counts.shadow;
            }
        }
        self.pass_media(&mut samples);
        self.resolve(&samples, x, y, seed)
    }

    fn sample(
        &self,
        x: u32,
        y: u32,
        i: u32,
        shadow_rays: u32,
        first_shadow_ray: u32,
        seed: u64,
    ) -> Sample {
        let view = &self.view;
        let [u, v] = sampling::sobol2(i, 1, seed as u32);
        let direction = view
            .camera
            .direction(&view.film, x as f32 + u, y as f32 + v);
        let origin = view.camera.origin();
        let hit = view.tracer.closest(origin, direction, f32::INFINITY);
        let t = hit.map_or(f32::INFINITY, |h| h.t);
        let surface =
            hit.map(|h| Surface::new(view.tracer.scene, h.triangle, h.uv).facing(-direction));
        let direct = surface.map_or_else(Direct::default, |s| {
            let rays = ShadowRays {
                per_light: shadow_rays,
                first: first_shadow_ray,
                seed,
            };
            self.lights
                .irradiance(s.position, s.normal, s.face_normal, rays)
        });
        Sample {
            surface,
            t,
            direction,
            direct,
            passed: Composite::default(),
        }
    }

    /// Marches the media before a pixel. Where two rays of it agree, the others take after the one that ends on the
    /// same piece of surface.
    fn pass_media(&self, samples: &mut [Sample]) {
        if self.view.tracer.scene.volumes.is_empty() {
            return;
        }
        let first = samples.len().min(2);
        for s in &mut samples[..first] {
            s.passed = self.march(s.direction, s.t);
        }
        if samples.len() <= first {
            return;
        }
        let smooth = alike(&samples[0].passed, &samples[1].passed);
        for i in first..samples.len() {
            let (known, rest) = samples.split_at_mut(i);
            let s = &mut rest[0];
            let twin = known.iter().find(|k| smooth && self.same_end(k, s));
            s.passed = twin.map_or_else(|| self.march(s.direction, s.t), |k| k.passed);
        }
    }

    fn same_end(&self, a: &Sample, b: &Sample) -> bool {
        match (&a.surface, &b.surface) {
            (None, None) => true,
            (Some(p), Some(q)) => self.same_piece(p, q, a.t),
            _ => false,
        }
    }

    fn march(&self, direction: Vec3, t: f32) -> Composite {
        let mut passed = Composite::default();
        self.view.tracer.march(
            self.view.camera.origin(),
            direction,
            t,
            |volume, stretch, tau| {
                let at = |t| self.view.camera.origin() + direction * t;
                self.in_scatter.source(
                    volume,
                    [at(stretch.near), at(stretch.far)],
                    stretch.tau,
                    tau,
                )
            },
            |s| {
                passed.medium(s.tau, s.source);
                !passed.is_opaque()
            },
        );
        if passed.is_opaque() {
            // What the march left out still hides what is behind, however bright that is.
            let (tracer, origin) = (&self.view.tracer, self.view.camera.origin());
            passed.transmittance = exp_neg(tracer.optical_depth(origin, direction, t));
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

    fn same_piece(&self, a: &Surface, b: &Surface, t: f32) -> bool {
        let footprint = t * self.view.pixel_angle;
        a.material == b.material
            && a.normal.dot(b.normal) > 0.98
            && (a.position - b.position).dot(b.face_normal).abs() < 0.5 * footprint
    }

    fn resolve(&self, samples: &[Sample], x: u32, y: u32, seed: u64) -> Pixel {
        let mut groups: Vec<Group> = Vec::with_capacity(2);
        let mut pixel = Pixel {
            depth: f32::INFINITY,
            ..Pixel::default()
        };
        let (mut depth, mut hits) = (0.0, 0);
        for sample in samples {
            pixel.volume += sample.passed.radiance;
            let through = sample.passed.transmittance;
            let Some(surface) = &sample.surface else {
                pixel.direct += self.lights.environment() * through;
                continue;
            };
            depth += sample.t;
            hits += 1;
            pixel.normal += surface.normal;
            let known = groups
                .iter()
                .find(|g| self.same_piece(surface, &g.surface, sample.t));
            let irradiance = match known {
                Some(group) => group.irradiance,
                None => {
                    let irradiance = self.indirect(surface, x, y, seed);
                    groups.push(Group {
                        surface: *surface,
                        irradiance,
                    });
                    irradiance
                }
            };
            let reflect = surface.albedo * (FRAC_1_PI * through);
            let emission = surface.emission(self.view.tracer.scene, -sample.direction);
            pixel.direct += reflect * sample.direct.light + emission * through;
            pixel.indirect += reflect * irradiance;
        }
        let scale = 1.0 / samples.len().max(1) as f32;
        pixel.direct *= scale;
        pixel.indirect *= scale;
        pixel.volume *= scale;
        if hits > 0 {
            pixel.depth = depth / hits as f32;
            pixel.normal = pixel.normal.normalize_or_zero();
        }
        pixel
    }

    fn indirect(&self, surface: &Surface, x: u32, y: u32, seed: u64) -> Rgb {
        if surface.albedo.is_black() {
            return Rgb::BLACK;
        }
        self.lattice
            .irradiance(surface, x, y)
            .unwrap_or_else(|| gather_surface(&self.view, self.gatherer, surface, seed).light)
    }
}

/// Whether two rays of a pixel passed media alike, to a fiftieth.
fn alike(a: &Composite, b: &Composite) -> bool {
    let (la, lb) = (a.radiance.luminance(), b.radiance.luminance());
    (a.transmittance - b.transmittance).abs() <= 0.02 && (la - lb).abs() <= 0.02 * (la + lb)
}
