//! Direct light at a point of a surface or of a medium, with shadow rays that see triangles and media.
//!
//! What a light would send without anything between is computed in closed form; rays measure only the share that
//! arrives. So a point in full light has no noise at all.

mod emitters;

use crate::math::sampling::{cosine_hemisphere, disk, hash, mix, sobol2, sphere, tangents};
use crate::math::{Rgb, polygon};
use crate::scene::Light;
use crate::trace::Tracer;
use emitters::Emitters;
use glam::Vec3;
use std::f32::consts::PI;
use std::ops::{AddAssign, Mul};

const INVERSE_SPHERE: f32 = 1.0 / (4.0 * PI);

/// Shadow rays at one point, and the seed that makes them differ from its neighbours'.
#[derive(Clone, Copy, Debug)]
pub struct ShadowRays {
    /// Rays to all emissive triangles together, and to each disk light.
    pub per_light: u32,
    /// First ray of the point's sequence: ask again with the next block for more rays.
    pub first: u32,
    /// Key of the point.
    pub seed: u64,
}

/// What direct light a point gets.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direct {
    /// Irradiance of a surface, or mean radiance over the sphere in a medium.
    pub light: Rgb,
    /// A bit for each light of which a ray came through; of many lights some share a bit.
    pub seen: u64,
    /// A bit for each light of which a ray was stopped by a surface. A light with both bits is partly hidden.
    pub hidden: u64,
}

impl Direct {
    /// Notes a ray to a light, and returns what share of the light comes through. A medium that stops nearly all of it
    /// hides the light like a surface.
    fn note(&mut self, light: usize, through: f32) -> f32 {
        const HIDDEN: f32 = 0.25;
        const SEEN: f32 = 0.35;
        let bit = 1 << (light % 64);
        if through < HIDDEN {
            self.hidden |= bit;
        } else if through > SEEN {
            self.seen |= bit;
        }
        through
    }
}

/// Direct light at a point of a medium, in two parts: that of point and spot lights changes without bound near them, but
/// the share of it that arrives changes no faster than media and shadows do.
#[derive(Clone, Copy, Debug, Default)]
pub struct InMedium {
    /// What arrives of [`Lights::sent`], per channel.
    pub share: Rgb,
    /// Mean over the sphere of the radiance of all other lights.
    pub rest: Rgb,
}

impl AddAssign for InMedium {
    fn add_assign(&mut self, o: Self) {
        self.share += o.share;
        self.rest += o.rest;
    }
}

impl Mul<f32> for InMedium {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        Self {
            share: self.share * s,
            rest: self.rest * s,
        }
    }
}

/// All lights of a scene but a constant environment, which gathering takes care of.
#[derive(Debug)]
pub struct Lights<'a> {
    tracer: &'a Tracer<'a>,
    emitters: Emitters,
    environment: Rgb,
}

impl<'a> Lights<'a> {
    /// Finds the lights of the traced scene.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>) -> Self {
        let environment = tracer
            .scene
            .lights
            .iter()
            .filter_map(|l| {
                if let Light::Environment { radiance } = l {
                    Some(Rgb(*radiance))
                } else {
                    None
                }
            })
            .fold(Rgb::BLACK, |a, b| a + b);
        Self {
            tracer,
            emitters: Emitters::new(tracer.scene),
            environment,
        }
    }

    /// Radiance from where no surface is.
    #[must_use]
    pub fn environment(&self) -> Rgb {
        self.environment
    }

    /// Irradiance of a surface point on the side of `normal`; `face_normal` is the geometric one on that side, along
    /// which rays leave.
    #[must_use]
    pub fn irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Direct {
        let origin = point + face_normal * self.tracer.offset;
        self.sum(
            origin,
            rays,
            &|d| {
                if d.dot(face_normal) > 0.0 {
                    d.dot(normal).max(0.0)
                } else {
                    0.0
                }
            },
            &|corners| polygon::irradiance(corners, normal),
        )
    }

    /// Mean over the sphere of the direct radiance at a point of a medium: its in-scattered radiance for an isotropic
    /// phase function.
    #[must_use]
    pub fn mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Direct {
        let mut direct = self.sum(point, rays, &|_| 1.0, &polygon::solid_angle);
        direct.light *= INVERSE_SPHERE;
        direct
    }

    /// The same light in two parts, for what lies between points: `sent` times the share, and the rest.
    #[must_use]
    pub fn in_medium(&self, point: Vec3, rays: ShadowRays) -> InMedium {
        let (mut near, mut rest) = (Direct::default(), Direct::default());
        for (index, light) in self.tracer.scene.lights.iter().enumerate() {
            let is_point = matches!(light, Light::Point { .. } | Light::Spot { .. });
            let total = if is_point { &mut near } else { &mut rest };
            self.add_light(total, light, index, point, rays, &|_| 1.0);
        }
        self.add_emitters(&mut rest, point, rays, &|_| 1.0, &polygon::solid_angle);
        let (arriving, sent) = (near.light * INVERSE_SPHERE, self.sent(point, point));
        InMedium {
            share: Rgb(std::array::from_fn(|c| {
                if sent.0[c] > 0.0 {
                    arriving.0[c] / sent.0[c]
                } else {
                    0.0
                }
            })),
            rest: rest.light * INVERSE_SPHERE,
        }
    }

    /// Mean radiance over the sphere that point and spot lights would send with nothing between, averaged over a segment
    /// in closed form: the angle that it is seen under, over twice the triangle that it makes with the light.
    #[must_use]
    pub fn sent(&self, from: Vec3, to: Vec3) -> Rgb {
        let mut total = Rgb::BLACK;
        for light in &self.tracer.scene.lights {
            let (position, intensity) = match light {
                Light::Point {
                    position,
                    intensity,
                }
                | Light::Spot {
                    position,
                    intensity,
                    ..
                } => (*position, Rgb(*intensity)),
                _ => continue,
            };
            let (u, v) = (from - position, to - position);
            // A segment through the light would get no end of it: one that passes is a millionth of its length away.
            let twice_area = u.cross(v).length().max(1e-6 * (to - from).length_squared());
            let along = u.dot(v);
            let mean = if twice_area > 1e-3 * along {
                libm::atan2f(twice_area, along) / twice_area
            } else {
                let x = twice_area / along;
                (1.0 - x * x * (1.0 / 3.0)) / along
            };
            let middle = (0.5 * (u + v)).normalize_or_zero();
            if mean.is_finite() {
                total += intensity * (mean * INVERSE_SPHERE * light.falloff(middle));
            }
        }
        total
    }

    /// Irradiance of a surface point from the environment, by `rays.per_light` rays over the hemisphere. Gathering sees
    /// the environment by itself; baking does not gather.
    #[must_use]
    pub fn environment_irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Rgb {
        let (x, y) = tangents(normal);
        let origin = point + face_normal * self.tracer.offset;
        let share = self.environment_share(origin, rays, |u| {
            let d = cosine_hemisphere(u);
            (x * d.x + y * d.y + normal * d.z).normalize()
        });
        self.environment * (PI * share)
    }

    /// Mean over the sphere of the environment's radiance at a point of a medium.
    #[must_use]
    pub fn environment_mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Rgb {
        self.environment * self.environment_share(point, rays, sphere)
    }

    fn environment_share(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        direction: impl Fn([f32; 2]) -> Vec3,
    ) -> f32 {
        if self.environment.is_black() {
            return 0.0;
        }
        let seed = mix(rays.seed ^ 0xe417) as u32;
        let through = |i| {
            self.tracer.transmittance(
                origin,
                direction(sobol2(rays.first + i, 62, seed)),
                f32::INFINITY,
            )
        };
        (0..rays.per_light).map(through).sum::<f32>() / rays.per_light.max(1) as f32
    }

    /// Sums over lights: `weight(direction)` is the receiver's response, `closed_form(corners)` its integral over a
    /// triangle seen from the origin.
    fn sum(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        weight: &dyn Fn(Vec3) -> f32,
        closed_form: &dyn Fn([Vec3; 3]) -> f32,
    ) -> Direct {
        let mut total = Direct::default();
        for (index, light) in self.tracer.scene.lights.iter().enumerate() {
            self.add_light(&mut total, light, index, origin, rays, weight);
        }
        self.add_emitters(&mut total, origin, rays, weight, closed_form);
        total
    }

    fn add_light(
        &self,
        total: &mut Direct,
        light: &Light,
        index: usize,
        origin: Vec3,
        rays: ShadowRays,
        weight: &dyn Fn(Vec3) -> f32,
    ) {
        let (position, intensity) = match *light {
            Light::Environment { .. } => return,
            Light::Directional {
                direction,
                irradiance,
                angular_radius_rad,
            } => {
                let seed = mix(rays.seed ^ index as u64) as u32;
                let count = if angular_radius_rad > 0.0 {
                    rays.per_light.max(1)
                } else {
                    1
                };
                let mut sum = 0.0;
                // Uniform in the projection on a plane that faces the light, where every part of the disk sends the same
                // irradiance.
                let (x, y) = tangents(-direction);
                let radius = libm::sinf(angular_radius_rad);
                for i in 0..count {
                    let [u, v] = if angular_radius_rad > 0.0 {
                        disk(sobol2(rays.first + i, index as u32, seed)).map(|c| c * radius)
                    } else {
                        [0.0; 2]
                    };
                    let cos = (1.0 - u * u - v * v).max(0.0).sqrt();
                    let d = (x * u + y * v - direction * cos).normalize();
                    let w = weight(d) / cos;
                    if w > 0.0 && cos > 0.0 {
                        sum += w * total
                            .note(index, self.tracer.transmittance(origin, d, f32::INFINITY));
                    }
                }
                total.light += Rgb(irradiance) * (sum / count as f32);
                return;
            }
            Light::Point {
                position,
                intensity,
            }
            | Light::Spot {
                position,
                intensity,
                ..
            } => (position, intensity),
        };
        let to_light = position - origin;
        let distance = to_light.length();
        if distance == 0.0 {
            return;
        }
        let d = to_light / distance;
        let w = weight(d) / (distance * distance) * light.falloff(-d);
        if w > 0.0 {
            let through = total.note(index, self.tracer.transmittance(origin, d, distance));
            total.light += Rgb(intensity) * (w * through);
        }
    }

    fn add_emitters(
        &self,
        total: &mut Direct,
        origin: Vec3,
        rays: ShadowRays,
        weight: &dyn Fn(Vec3) -> f32,
        closed_form: &dyn Fn([Vec3; 3]) -> f32,
    ) {
        let mut chosen = [Chosen::default(); Emitters::EXACT];
        let seed = mix(rays.seed);
        let mut unoccluded = Rgb::BLACK;
        let mut sum = 0.0;
        let mut count = 0;
        self.emitters.for_point(
            origin,
            hash(&[seed, u64::from(rays.first)]),
            |index, emitter, multiplicity| {
                let response = closed_form(emitter.corners.map(|c| c - origin)) * multiplicity;
                let light = emitter.radiance * response;
                let power = light.luminance();
                if power > 0.0 {
                    unoccluded += light;
                    sum += power;
                    chosen[count] = Chosen {
                        index,
                        running_power: sum,
                        response: response / multiplicity,
                    };
                    count += 1;
                }
            },
        );
        if count == 0 {
            return;
        }
        // Rays share the emitters out by what each would send; each ray counts by what its point would send.
        let (mut arriving, mut all) = (0.0, 0.0);
        let rays_total = rays.per_light.max(1);
        for i in 0..rays_total {
            let [u, v] = sobol2(rays.first + i, 63, seed as u32);
            let target = u * sum;
            let k = chosen[..count]
                .iter()
                .position(|c| target < c.running_power)
                .unwrap_or(count - 1);
            let below = if k == 0 {
                0.0
            } else {
                chosen[k - 1].running_power
            };
            let within = ((target - below) / (chosen[k].running_power - below)).clamp(0.0, 1.0);
            let index = chosen[k].index;
            let emitter = self.emitters.get(index);
            let to_light = emitter.point([within, v]) - origin;
            let distance = to_light.length();
            let d = to_light / distance;
            // What this point sends over what its emitter was expected to: near 1 but for emitters close by.
            let cos = emitter.normal.dot(d).abs();
            let w = weight(d) * cos * emitter.area / (distance * distance * chosen[k].response);
            if w > 0.0 {
                // Stop short of the light itself.
                let through = self.tracer.transmittance(
                    origin,
                    d,
                    distance * (1.0 - 1e-4) - self.tracer.offset,
                );
                // Emitters of one surface are told apart no further than sharing a bit with another.
                arriving += w * total.note(32 + index as usize % 32, through);
                all += w;
            }
        }
        if all > 0.0 {
            total.light += unoccluded * (arriving / all);
        }
    }
}

/// An emitter that rays of a point may go to.
#[derive(Clone, Copy, Default)]
struct Chosen {
    index: u32,
    running_power: f32,
    /// Closed form of the receiver's response to it, per unit radiance.
    response: f32,
}
