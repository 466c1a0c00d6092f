//! Lights without extent: one ray tells all of each, and the mean over a segment of what point and
//! spot lights send to it is a closed form.

use super::direct::DirectLight;
use super::shading_point::{Arrival, Receiver, ShadingPoint};
use super::shadows::{ShadowMedia, Shadows};
use crate::math::magnitude::to_unit;
use crate::math::{Rgb, SeenPhase, Spectrum};
use crate::scene::Light;
use crate::trace::short_of;
use glam::Vec3;
use std::f32::consts::TAU;

/// The way from a point to a delta light.
struct Beam {
    /// Unit direction to the light, and how far rays to it go.
    direction: Vec3,
    end: f32,
    /// What the light sends, and the part of that which the receiver responds to.
    sent: Rgb,
    response: f32,
}

impl Beam {
    /// The way to a point, spot or parallel light; `None` for others, and at the light itself.
    fn of<R: Receiver>(light: &Light, at: &ShadingPoint<impl Shadows, R>) -> Option<Self> {
        if let Light::Directional {
            direction,
            irradiance,
            ..
        } = *light
        {
            return Some(Self {
                direction: -direction,
                end: f32::INFINITY,
                sent: Rgb(irradiance),
                response: at.receiver.response(-direction),
            });
        }
        let (position, intensity) = light.point_source()?;
        let to_light = position - at.origin;
        let distance = to_light.length();
        let d = to_light / distance;
        let response = at.receiver.response(d) / (distance * distance) * light.falloff(-d);
        (distance > 0.0).then_some(Self {
            direction: d,
            end: short_of(position, distance),
            sent: Rgb(intensity),
            response,
        })
    }
}

/// Adds what arrives of a point, spot or parallel light. Media before it are those of `media`, or
/// the scene's own.
pub fn trace<S: Shadows>(
    total: &mut DirectLight,
    light: &Light,
    index: usize,
    at: &ShadingPoint<S, impl Receiver>,
    media: Option<&dyn ShadowMedia<S::Share>>,
) {
    if let Some(beam) = Beam::of(light, at)
        && beam.response > 0.0
    {
        let transmittance = at.transmittance(beam.direction, beam.end, media);
        total.visibility.note_delta(index, transmittance.mean());
        let arriving = (transmittance * beam.response).filter(beam.sent);
        at.receiver
            .note(beam.direction, arriving.mean(), Arrival::Delta);
        total.delta += arriving;
    }
}

/// A segment as a point or spot light sees it.
pub struct SegmentFromLight {
    /// What lengths here are multiplied with: their fourth powers would leave the range of f32.
    scale: f32,
    /// From the light to the ends.
    ends: [Vec3; 2],
    /// Twice the area of the triangle that they make.
    twice_area: f32,
    along: f32,
}

impl SegmentFromLight {
    /// The segment between two points, in the space of the light's position.
    pub fn new(light: Vec3, [from, to]: [Vec3; 2]) -> Self {
        let (u, v) = (from - light, to - light);
        let scale = to_unit(u.abs().max(v.abs()).max_element());
        let (u, v) = (u * scale, v * scale);
        Self {
            scale,
            ends: [u, v],
            // A segment through the light would get infinite light: one that passes is a millionth
            // of its length away.
            twice_area: u
                .cross(v)
                .length()
                .max(1e-6 * ((to - from) * scale).length_squared()),
            along: u.dot(v),
        }
    }

    /// The same where the segment stands for a beam that is so wide at the light: of one through the
    /// light no ray passes nearer than half the radius of its disk, in the mean of one over the
    /// distance.
    #[must_use]
    pub fn of_beam(mut self, width: f32) -> Self {
        const NEAREST: f32 = 0.282_094_8; // 1 / (2 sqrt(pi))
        let [u, v] = self.ends;
        let area = NEAREST * width * self.scale * (v - u).length();
        self.twice_area = self.twice_area.max(area);
        self
    }

    /// Mean over the segment of one over the squared distance: the angle that it is seen under,
    /// over twice the area of the triangle.
    pub fn mean_inverse_square(&self) -> f32 {
        let mean = if self.twice_area > 1e-3 * self.along {
            libm::atan2f(self.twice_area, self.along) / self.twice_area
        } else {
            let x = self.twice_area / self.along;
            (1.0 - x * x * (1.0 / 3.0)) / self.along
        };
        mean * self.scale * self.scale
    }

    /// The place on the segment, from 0 to 1, on either side of which is half of its light: where
    /// the middle of the angle meets it.
    pub fn median(&self) -> f32 {
        let [u, v] = self.ends.map(Vec3::length);
        if u + v > 0.0 { u / (u + v) } else { 0.5 }
    }

    /// Mean of a light's falloff over the angle that the segment is seen under, which is its mean
    /// over the segment weighted by the inverse square: the part inside a spot's inner cone counts
    /// whole, what is between both cones by four points (Gauss-Legendre) on either side, and a beam
    /// narrower than the segment is not missed.
    pub fn falloff(&self, light: &Light) -> f32 {
        let Light::Spot {
            direction,
            cos_inner,
            cos_outer,
            ..
        } = *light
        else {
            return 1.0;
        };
        let [u, v] = self.ends;
        let first = u.normalize_or_zero();
        let across = (v - first * v.dot(first)).normalize_or_zero();
        let angle = libm::atan2f(self.twice_area, self.along);
        if angle <= 1e-4 {
            return light.falloff((0.5 * (u + v)).normalize_or_zero());
        }
        // Along the fan of directions the cosine to the axis is that of the angle to the nearest
        // one, times its own.
        let (x, y) = (first.dot(direction), across.dot(direction));
        let nearest = libm::hypotf(x, y);
        let middle = libm::atan2f(y, x);
        let half = |cos: f32| {
            if cos >= nearest {
                0.0
            } else {
                libm::acosf((cos / nearest).max(-1.0))
            }
        };
        let (inner, outer) = (half(cos_inner), half(cos_outer));
        let mut sum = 0.0;
        for middle in [middle, middle + TAU] {
            let part = |from: f32, to: f32| {
                let from = (middle + from).max(0.0);
                (from, ((middle + to).min(angle) - from).max(0.0))
            };
            sum += part(-inner, inner).1;
            for (from, width) in [part(-outer, -inner), part(inner, outer)] {
                if width > 0.0 {
                    for (at, weight) in GAUSS {
                        let phi = from + width * at;
                        let towards = first * libm::cosf(phi) + across * libm::sinf(phi);
                        sum += width * weight * light.falloff(towards);
                    }
                }
            }
        }
        (sum / angle).min(1.0)
    }

    /// Mean of what the medium scatters along a ray of the light, over what an isotropic one does:
    /// over the angle that the segment is seen under, as [`Self::falloff`].
    pub fn scattered(&self, seen: SeenPhase) -> f32 {
        let [u, v] = self.ends;
        let first = u.normalize_or_zero();
        let across = (v - first * v.dot(first)).normalize_or_zero();
        let angle = libm::atan2f(self.twice_area, self.along);
        if angle <= 0.05 {
            return seen.response(-(0.5 * (u + v)).normalize_or_zero());
        }
        let at = |(at, weight): (f32, f32)| {
            let towards = first * libm::cosf(angle * at) + across * libm::sinf(angle * at);
            weight * seen.response(-towards)
        };
        GAUSS.into_iter().map(at).sum()
    }

    /// Distance of the nearest point of the segment from the light.
    pub fn distance(&self) -> f32 {
        let [u, v] = self.ends;
        let way = v - u;
        let t = (-u.dot(way) / way.length_squared()).clamp(0.0, 1.0);
        (u + way * t).length() / self.scale
    }
}

/// Points of [0,1] and their weights (Gauss-Legendre).
const GAUSS: [(f32, f32); 4] = [
    (0.069_431_85, 0.173_927_42),
    (0.330_009_5, 0.326_072_58),
    (0.669_990_52, 0.326_072_58),
    (0.930_568_16, 0.173_927_42),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::{hash, sphere, unit, unit2};

    /// By many points in angle as the light sees them.
    fn sampled(ends: [Vec3; 2], light: &Light) -> f32 {
        let [u, v] = ends;
        let (mut sum, mut weights) = (0.0, 0.0);
        let count = 20_000;
        for i in 0..count {
            let p = u + (v - u) * ((i as f32 + 0.5) / count as f32);
            sum += f64::from(light.falloff(p.normalize()) / p.length_squared());
            weights += f64::from(1.0 / p.length_squared());
        }
        (sum / weights) as f32
    }

    #[test]
    fn segments_of_any_scale_are_seen_alike() {
        for i in 0..100_u64 {
            let numbers = |k: u64| unit2(hash(&[i, k]));
            let light = Light::Spot {
                position: Vec3::ZERO,
                direction: sphere(numbers(1)),
                intensity: [1.0; 3],
                cos_inner: 0.7,
                cos_outer: 0.5,
            };
            let position = sphere(numbers(4)) * 0.3;
            let ends = [sphere(numbers(2)) * 1.3, sphere(numbers(3)) * 0.8];
            let seen = |exponent: i32| {
                let scale = libm::ldexpf(1.0, exponent);
                let seen = SegmentFromLight::new(position * scale, ends.map(|e| e * scale));
                (
                    seen.mean_inverse_square() * scale * scale,
                    seen.median(),
                    seen.falloff(&light),
                    seen.distance() / scale,
                )
            };
            for exponent in [-50, -33, 33, 50] {
                assert_eq!(seen(exponent), seen(0), "{i}: {exponent}");
            }
        }
    }

    #[test]
    fn a_beam_through_a_light_gets_the_mean_of_its_rays() {
        let (width, length) = (0.02_f32, 4.0);
        let along = |x: f32, y: f32| {
            let ends = [-length, length].map(|z| Vec3::new(x, y, z));
            SegmentFromLight::new(Vec3::ZERO, ends)
        };
        let count = 400_u64;
        let mean = (0..count * count).map(|i| {
            let [x, y] = [i % count, i / count].map(|n| (n as f32 + 0.5) / count as f32 - 0.5);
            f64::from(along(x * width, y * width).mean_inverse_square())
        });
        let mean = mean.sum::<f64>() / (count * count) as f64;
        let through = f64::from(along(0.0, 0.0).of_beam(width).mean_inverse_square());
        assert!((through / mean - 1.0).abs() < 0.03, "{through} {mean}");
        // One that passes beside it is that of its middle.
        let beside = along(width, 0.0);
        let exact = beside.mean_inverse_square();
        assert_eq!(beside.of_beam(width).mean_inverse_square(), exact);
    }

    #[test]
    fn the_mean_falloff_of_a_segment_is_that_of_its_points() {
        let mut met = 0;
        for i in 0..200_u64 {
            let numbers = |k: u64| unit2(hash(&[i, k]));
            let inner = 0.02 + 1.5 * unit(hash(&[i, 9])).powi(3);
            let light = Light::Spot {
                position: Vec3::ZERO,
                direction: sphere(numbers(1)),
                intensity: [1.0; 3],
                cos_inner: inner.cos(),
                cos_outer: (1.2 * inner + 0.02).cos(),
            };
            let ends = [sphere(numbers(2)) * 1.3, sphere(numbers(3)) * 0.8];
            let [got, expected] = [
                SegmentFromLight::new(Vec3::ZERO, ends).falloff(&light),
                sampled(ends, &light),
            ];
            met += u32::from(expected > 0.0 && expected < 1.0);
            assert!((got - expected).abs() < 2e-3, "{i}: {got} {expected}");
        }
        assert!(met > 30, "{met}");
    }
}
