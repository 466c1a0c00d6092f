//! All that shines in a scene, as a path asks for it: emissive triangles, lights without size, the
//! environment.

use super::sample::Sample;
use super::sky::Sky;
use crate::math::{Rgb, sampling};
use crate::scene::{Light, Material, Scene};
use crate::trace::unit_normal;
use glam::Vec3;

#[derive(Clone, Copy, Debug)]
struct Emitter {
    corners: [Vec3; 3],
    normal: Vec3,
    material: u32,
}

/// The lights of a scene.
#[derive(Debug)]
pub struct Sources<'a> {
    scene: &'a Scene,
    emitters: Vec<Emitter>,
    /// Running sum of the emitters' powers, over pi.
    running_power: Vec<f64>,
    environment: Rgb,
    sky: Option<Sky<'a>>,
}

/// Luminance times the number of sides that emit: an emitter's power per area, over pi.
fn strength(material: &Material) -> f64 {
    let sides = if material.emits_both_sides { 2.0 } else { 1.0 };
    sides * f64::from(Rgb(material.emission).luminance())
}

impl<'a> Sources<'a> {
    /// Finds them.
    #[must_use]
    pub fn new(scene: &'a Scene) -> Self {
        let mut emitters = Vec::new();
        let mut running_power = Vec::new();
        let mut sum = 0.0;
        for (t, &material) in scene.mesh.material.iter().enumerate() {
            let strength = strength(&scene.materials[material as usize]);
            if strength > 0.0 {
                let corners = scene.mesh.corners(t);
                emitters.push(Emitter {
                    corners,
                    normal: unit_normal(corners),
                    material,
                });
                sum += strength * f64::from(scene.mesh.area(t));
                running_power.push(sum);
            }
        }
        Self {
            scene,
            emitters,
            running_power,
            environment: scene.environment(),
            sky: scene.environment_image.as_ref().and_then(Sky::new),
        }
    }

    /// Radiance that a camera sees in a direction in which no surface is.
    #[must_use]
    pub fn seen_environment(&self, direction: Vec3) -> Rgb {
        if !self.scene.is_environment_seen {
            return Rgb::BLACK;
        }
        let sky = self.sky.as_ref();
        self.environment + sky.map_or(Rgb::BLACK, |sky| sky.seen(direction))
    }

    /// The environment of one colour, for which the lobes of surfaces and media are the best
    /// distribution there is: only paths look for it.
    #[must_use]
    pub fn even_environment(&self) -> Rgb {
        self.environment
    }

    /// The environment image.
    #[must_use]
    pub fn sky(&self) -> Option<&Sky<'a>> {
        self.sky.as_ref()
    }

    /// Whether a ray can run into light: without emitters and environment only shadow rays find
    /// any.
    #[must_use]
    pub fn can_be_hit(&self) -> bool {
        !self.emitters.is_empty() || !self.environment.is_black() || self.sky.is_some()
    }

    fn total_power(&self) -> f64 {
        self.running_power.last().copied().unwrap_or(0.0)
    }

    /// Density per steradian with which [`Sources::emitter`] finds a point of an emissive material
    /// that is `distance` away and seen under `cos` to its normal.
    #[must_use]
    pub fn emitter_pdf(&self, material: u32, distance: f32, cos: f32) -> f32 {
        let per_area = strength(&self.scene.materials[material as usize]) / self.total_power();
        per_area as f32 * distance * distance / cos.abs()
    }

    /// A point on an emissive triangle, by power: `choice` picks the triangle, `u` the point.
    /// `None` if that point does not shine this way.
    #[must_use]
    pub fn emitter(&self, origin: Vec3, choice: f32, u: [f32; 2]) -> Option<Sample> {
        if self.emitters.is_empty() {
            return None;
        }
        let target = f64::from(choice) * self.total_power();
        let index = self.running_power.partition_point(|&p| p <= target);
        let emitter = &self.emitters[index.min(self.emitters.len() - 1)];
        let material = &self.scene.materials[emitter.material as usize];
        let w = sampling::triangle(u);
        let [a, b, c] = emitter.corners.map(|p| p - origin);
        let to_light = a * w[0] + b * w[1] + c * w[2];
        let distance = to_light.length();
        let direction = to_light / distance;
        let cos = -direction.dot(emitter.normal);
        if !(cos > 0.0 || (material.emits_both_sides && cos < 0.0)) {
            return None;
        }
        let pdf = self.emitter_pdf(emitter.material, distance, cos);
        (pdf > 0.0 && pdf.is_finite()).then(|| Sample {
            direction,
            distance,
            light: Rgb(material.emission) * (1.0 / pdf),
            pdf,
        })
    }

    /// One of the lights that rays cannot run into (points, spots, suns), chosen by what each would
    /// send to a receiver of this `response` if nothing were between. `disk` picks the point of a
    /// sun.
    #[must_use]
    pub fn delta_light(
        &self,
        origin: Vec3,
        response: impl Fn(Vec3) -> f32,
        choice: f32,
        disk: [f32; 2],
    ) -> Option<Sample> {
        let power = |s: &Sample| s.light.luminance() * response(s.direction);
        let ways = || {
            self.scene
                .lights
                .iter()
                .filter_map(|light| way_to(light, origin, disk))
        };
        let total: f32 = ways().map(|s| power(&s)).sum();
        if total.is_nan() || total <= 0.0 {
            return None;
        }
        let mut left = choice * total;
        let mut chosen: Option<(Sample, f32)> = None;
        for way in ways() {
            let p = power(&way);
            if p > 0.0 {
                chosen = Some((way, p));
                if left < p {
                    break;
                }
                left -= p;
            }
        }
        chosen.map(|(mut way, p)| {
            way.light *= total / p;
            way
        })
    }
}

/// The way to a light that has no size or is infinitely far, with the irradiance that it sends to a
/// plane facing it.
fn way_to(light: &Light, origin: Vec3, disk: [f32; 2]) -> Option<Sample> {
    let near = |position: Vec3, intensity: Rgb| {
        let to_light = position - origin;
        let distance = to_light.length();
        (distance > 0.0).then(|| Sample {
            direction: to_light / distance,
            distance,
            light: intensity * (1.0 / (distance * distance)),
            pdf: f32::INFINITY,
        })
    };
    match *light {
        Light::Environment { .. } => None,
        Light::Point {
            position,
            intensity,
        } => near(position, Rgb(intensity)),
        Light::Spot {
            position,
            intensity,
            ..
        } => {
            let mut way = near(position, Rgb(intensity))?;
            let falloff = light.falloff(-way.direction);
            way.light *= falloff;
            (falloff > 0.0).then_some(way)
        }
        Light::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        } => {
            let mut way = Sample {
                direction: -direction,
                distance: f32::INFINITY,
                light: Rgb(irradiance),
                pdf: f32::INFINITY,
            };
            if angular_radius_rad > 0.0 {
                // Uniform in the projection on a plane that faces the light, where every part sends
                // the same irradiance.
                let (x, y) = sampling::tangents(-direction);
                let radius = libm::sinf(angular_radius_rad);
                let [u, v] = sampling::disk(disk).map(|c| c * radius);
                let cos = (1.0 - u * u - v * v).max(0.0).sqrt();
                if cos <= 0.0 {
                    return None;
                }
                way.direction = (x * u + y * v - direction * cos).normalize();
                way.light *= 1.0 / cos;
            }
            Some(way)
        }
    }
}
