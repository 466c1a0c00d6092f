//! One path: from the camera through surfaces and media until it is absorbed, leaves the scene, or
//! is long enough.
//!
//! At every vertex lights are asked for (next-event estimation), and emission that the path itself
//! runs into is weighed against that by the power heuristic (Veach 1997). The densities are those
//! of directions alone: both ways estimate the transmittance of each channel without bias, so
//! weights that add up to 1 leave none, whatever media are between. An environment image is asked
//! for by where it is bright. One of one colour is not: the lobes of matt surfaces and of media are
//! the best distribution there is. Phase functions are sampled exactly. Shadow rays cross media by
//! ratio tracking: on the scenes of the tests that has 1.04 to 1.09 times the error of integrating
//! all cells, in 0.69 to 0.85 of the time.

use super::flight;
use super::sample::Sample;
use super::sampler::Sampler;
use super::sources::Sources;
use crate::Result;
use crate::math::{PhaseFunction, Ray, Rgb, sampling};
use crate::run::Cancel;
use crate::scene::{Scene, Volume};
use crate::trace::{Hit, Surface, TriangleBvh, each_emitting_cell, offset, short_of};
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// Vertices after which a path may be ended by chance.
const SURE_VERTICES: u32 = 4;

/// Vertices after which it may be even if nothing absorbs: in a closed box without absorption no
/// path would end.
const MANY_VERTICES: u32 = 10_000;

/// Estimates radiance along camera rays.
#[derive(Debug)]
pub struct PathTracer<'a> {
    scene: &'a Scene,
    triangles: TriangleBvh<'a>,
    sources: Sources<'a>,
    max_depth: u32,
}

/// A vertex of a path that scatters light.
struct Vertex {
    /// Where rays begin.
    origin: Vec3,
    lobe: Lobe,
}

#[derive(Clone, Copy)]
enum Lobe {
    /// A matt surface of albedo 1, by shading and face normal on the side the path came from.
    Matt(Vec3, Vec3),
    /// A medium of albedo 1, by its phase function and the direction in which light travelled that
    /// is scattered back along the path.
    Medium(PhaseFunction, Vec3),
}

impl Lobe {
    /// Scattered over incident light per steradian, cosine included; also the density of
    /// [`Lobe::sample`].
    fn response(self, d: Vec3) -> f32 {
        match self {
            Self::Medium(phase, travel) => phase.value(d.dot(travel)),
            Self::Matt(normal, face_normal) if d.dot(face_normal) > 0.0 => {
                d.dot(normal).max(0.0) * FRAC_1_PI
            }
            Self::Matt(..) => 0.0,
        }
    }

    fn sample(self, u: [f32; 2]) -> Vec3 {
        match self {
            Self::Medium(phase, travel) => phase.sample(travel, u),
            Self::Matt(normal, _) => {
                let (x, y) = sampling::tangents(normal);
                let d = sampling::cosine_hemisphere(u);
                (x * d.x + y * d.y + normal * d.z).normalize()
            }
        }
    }
}

/// Weight of a sample of density `own` against another way of density `other` (power heuristic).
fn weight(own: f32, other: f32) -> f32 {
    let ratio = other / own;
    1.0 / (1.0 + ratio * ratio)
}

impl<'a> PathTracer<'a> {
    /// Paths of at most `max_depth` segments between camera and light, both included; 0 for no
    /// limit.
    ///
    /// # Errors
    /// As [`TriangleBvh::of_scene`] and [`Volume::ready`].
    pub fn new(scene: &'a Scene, max_depth: u32, cancel: &Cancel) -> Result<Self> {
        scene.grids().try_for_each(Volume::ready)?;
        Ok(Self {
            scene,
            triangles: TriangleBvh::of_scene(scene, cancel)?,
            sources: Sources::new(scene),
            max_depth: if max_depth == 0 { u32::MAX } else { max_depth },
        })
    }

    /// One sample of the radiance that arrives at `origin` from a unit direction.
    #[must_use]
    pub fn radiance(&self, origin: Vec3, direction: Vec3, sampler: &mut Sampler) -> Rgb {
        let (mut origin, mut direction) = (origin, direction);
        let mut sum = Rgb::BLACK;
        let mut throughput = Rgb::splat(1.0);
        // Density with which the path took its direction; the camera's is the only way to what it
        // sees.
        let mut lobe_pdf = f32::INFINITY;
        let mut depth = 1;
        loop {
            if depth == self.max_depth {
                return sum + throughput * self.end(origin, direction, lobe_pdf, sampler);
            }
            let [flight, choice, u, v] = sampler.next4();
            let hit = self.met(&Ray::endless(origin, direction), lobe_pdf);
            let t_max = hit.map_or(f32::INFINITY, |h| h.t);
            let volumes = &self.scene.volumes;
            let ray = Ray::new(origin, direction, t_max);
            let collision = flight::collide(volumes, &ray, flight, &mut throughput, sampler);
            let end = collision.as_ref().map_or(t_max, |c| c.t);
            sum += throughput * self.glow(origin, direction, end);
            let (vertex, albedo) = if let Some(c) = collision {
                let volume = &volumes[c.volume];
                let vertex = Vertex {
                    origin: origin + direction * c.t,
                    lobe: Lobe::Medium(volume.phase, direction),
                };
                let albedo = volume.albedo_in_scene(vertex.origin);
                (vertex, albedo)
            } else if let Some(hit) = hit {
                let surface = Surface::new(self.scene, hit.triangle, hit.uv);
                sum += throughput * self.emitted(&surface, &hit, direction, lobe_pdf);
                let s = surface.facing(-direction);
                let vertex = Vertex {
                    origin: s.position + s.face_normal * offset(s.position),
                    lobe: Lobe::Matt(s.normal, s.face_normal),
                };
                (vertex, s.albedo)
            } else {
                return sum + throughput * self.environment(direction, lobe_pdf);
            };
            throughput = throughput * albedo;
            if throughput.is_black() {
                return sum;
            }
            sum += throughput * self.direct(&vertex, choice, [u, v], sampler);
            let [u, v, roulette, _] = sampler.next4();
            if depth >= SURE_VERTICES {
                let most = if depth < MANY_VERTICES { 1.0 } else { 0.99 };
                let chance = throughput.max().min(most);
                if roulette >= chance {
                    return sum;
                }
                throughput *= 1.0 / chance;
            }
            origin = vertex.origin;
            direction = vertex.lobe.sample([u, v]);
            lobe_pdf = vertex.lobe.response(direction);
            if lobe_pdf <= 0.0 {
                return sum;
            }
            depth += 1;
        }
    }

    /// What a segment of a path runs into: the first is that of a camera, which passes what it does
    /// not see.
    fn met(&self, ray: &Ray, lobe_pdf: f32) -> Option<Hit> {
        match lobe_pdf.is_infinite() {
            true => self.triangles.closest_seen(ray, self.scene),
            false => self.triangles.closest(ray),
        }
    }

    /// Light from lights at a vertex whose albedo is 1.
    fn direct(&self, vertex: &Vertex, choice: f32, u: [f32; 2], sampler: &mut Sampler) -> Rgb {
        let mut sum = Rgb::BLACK;
        let lobe = vertex.lobe;
        if let Some(way) = self.sources.emitter(vertex.origin, choice, u) {
            let response = lobe.response(way.direction);
            if response > 0.0 {
                let weight = weight(way.pdf, response);
                sum += self.arriving(vertex.origin, &way, sampler) * (response * weight);
            }
        }
        if let Some(sky) = self.sources.sky() {
            let [u, v, _, _] = sampler.next4();
            if let Some(way) = sky.sample([u, v]) {
                let response = lobe.response(way.direction);
                if response > 0.0 {
                    let weight = weight(way.pdf, response);
                    sum += self.arriving(vertex.origin, &way, sampler) * (response * weight);
                }
            }
        }
        if !self.scene.lights.is_empty() {
            let [choice, u, v, _] = sampler.next4();
            let response = |d| lobe.response(d);
            if let Some(way) = self
                .sources
                .delta_light(vertex.origin, response, choice, [u, v])
            {
                sum += self.arriving(vertex.origin, &way, sampler) * response(way.direction);
            }
        }
        sum
    }

    fn arriving(&self, origin: Vec3, way: &Sample, sampler: &mut Sampler) -> Rgb {
        let end = if way.distance.is_finite() {
            short_of(origin + way.direction * way.distance, way.distance)
        } else {
            way.distance
        };
        let ray = Ray::new(origin, way.direction, end);
        let through = self.triangles.let_through(&ray);
        if through == 0.0 {
            return Rgb::BLACK;
        }
        way.light * (flight::transmittance(&self.scene.volumes, &ray, sampler) * through)
    }

    /// Emission of a surface that the path ran into, weighed against having asked for it.
    fn emitted(&self, surface: &Surface, hit: &Hit, direction: Vec3, lobe_pdf: f32) -> Rgb {
        let emission = surface.emission(self.scene, hit.triangle, -direction);
        if emission.is_black() || lobe_pdf.is_infinite() {
            return emission;
        }
        let cos = direction.dot(surface.face_normal);
        let other = self.sources.emitter_pdf(hit, cos);
        emission * weight(lobe_pdf, other)
    }

    /// What a path runs into that meets nothing, the image weighed against having asked for it.
    fn environment(&self, direction: Vec3, lobe_pdf: f32) -> Rgb {
        if lobe_pdf.is_infinite() {
            return self.sources.seen_environment(direction);
        }
        let even = self.sources.even_environment();
        match self.sources.sky() {
            Some(sky) => even + sky.light(direction) * weight(lobe_pdf, sky.pdf(direction)),
            None => even,
        }
    }

    /// What emissive volumes send on the way to where a path ends or collides: as far as light gets
    /// on average, so that nothing need be known of the media before it.
    fn glow(&self, origin: Vec3, direction: Vec3, end: f32) -> Rgb {
        let mut sum = Rgb::BLACK;
        for volume in &self.scene.emissive {
            let ray = Ray::new(origin, direction, end);
            each_emitting_cell(volume, &ray, |_, _, light| {
                sum += light;
                true
            });
        }
        sum
    }

    /// The last segment, which can only run into light: no need to track media unless it does.
    fn end(&self, origin: Vec3, direction: Vec3, lobe_pdf: f32, sampler: &mut Sampler) -> Rgb {
        let mut glow = Rgb::BLACK;
        if !self.scene.emissive.is_empty() {
            let first = sampler.uniform();
            let hit = self.triangles.closest(&Ray::endless(origin, direction));
            let ray = Ray::new(origin, direction, hit.map_or(f32::INFINITY, |h| h.t));
            let mut through = Rgb::splat(1.0);
            let volumes = &self.scene.volumes;
            let collision = flight::collide(volumes, &ray, first, &mut through, sampler);
            let end = collision.map_or(ray.t_max, |c| c.t);
            glow = through * self.glow(origin, direction, end);
        }
        glow + self.end_on_light(origin, direction, lobe_pdf, sampler)
    }

    fn end_on_light(
        &self,
        origin: Vec3,
        direction: Vec3,
        lobe_pdf: f32,
        sampler: &mut Sampler,
    ) -> Rgb {
        if !self.sources.can_be_hit() {
            return Rgb::BLACK;
        }
        let hit = self.met(&Ray::endless(origin, direction), lobe_pdf);
        let light = match &hit {
            None => self.environment(direction, lobe_pdf),
            Some(hit) => {
                let surface = Surface::new(self.scene, hit.triangle, hit.uv);
                self.emitted(&surface, hit, direction, lobe_pdf)
            }
        };
        if light.is_black() {
            return light;
        }
        let t_max = hit.map_or(f32::INFINITY, |h| h.t);
        light
            * flight::transmittance(
                &self.scene.volumes,
                &Ray::new(origin, direction, t_max),
                sampler,
            )
    }
}
