//! Point and spot lights near a segment, whose inverse square is integrated in closed form, and a spot's falloff beside it.

use super::{INVERSE_SPHERE, Lights, Shadows};
use crate::math::Rgb;
use crate::scene::Light;
use glam::Vec3;
use std::f32::consts::TAU;

/// A segment as a lamp sees it.
struct Seen {
    /// From the lamp to the ends.
    ends: [Vec3; 2],
    /// Twice the area of the triangle that they make.
    twice_area: f32,
    along: f32,
}

impl Seen {
    fn new(lamp: Vec3, [from, to]: [Vec3; 2]) -> Self {
        let (u, v) = (from - lamp, to - lamp);
        Self {
            ends: [u, v],
            // A segment through the light would get no end of it: one that passes is a millionth of its length away.
            twice_area: u.cross(v).length().max(1e-6 * (to - from).length_squared()),
            along: u.dot(v),
        }
    }

    /// Mean of the inverse square over the segment: the angle that it is seen under, over twice the triangle.
    fn mean_inverse_square(&self) -> f32 {
        if self.twice_area > 1e-3 * self.along {
            libm::atan2f(self.twice_area, self.along) / self.twice_area
        } else {
            let x = self.twice_area / self.along;
            (1.0 - x * x * (1.0 / 3.0)) / self.along
        }
    }

    /// Where half of the light on the segment is on either side, from 0 to 1: where the middle of the angle meets it.
    fn median(&self) -> f32 {
        let [u, v] = self.ends.map(Vec3::length);
        if u + v > 0.0 { u / (u + v) } else { 0.5 }
    }

    /// Mean of a light's falloff over the angle that the segment is seen under, which is its mean over the segment weighted by
    /// the inverse square: the part inside a spot's inner cone counts whole, what is between both cones by four points
    /// (Gauss-Legendre) on either side, and a beam narrower than the segment is not missed.
    fn falloff(&self, light: &Light) -> f32 {
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
        // Along the fan of directions the cosine to the axis is that of the angle to the nearest one, times its own.
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

    fn distance(&self) -> f32 {
        let [u, v] = self.ends;
        let way = v - u;
        let t = (-u.dot(way) / way.length_squared()).clamp(0.0, 1.0);
        (u + way * t).length()
    }
}

/// Points of [0,1] and their weights (Gauss-Legendre).
const GAUSS: [(f32, f32); 4] = [
    (0.069_431_85, 0.173_927_42),
    (0.330_009_5, 0.326_072_58),
    (0.669_990_52, 0.326_072_58),
    (0.930_568_16, 0.173_927_42),
];

impl<S> Lights<'_, S> {
    fn lamps(&self) -> impl Iterator<Item = (Vec3, Rgb, &Light)> {
        let lights = self.tracer.scene.lights.iter();
        lights.filter_map(|l| l.lamp().map(|(at, intensity)| (at, Rgb(intensity), l)))
    }

    /// Mean radiance over the sphere that point and spot lights would send with nothing between, averaged over a segment
    /// in closed form.
    #[must_use]
    pub fn sent(&self, from: Vec3, to: Vec3) -> Rgb {
        let mut total = Rgb::BLACK;
        for (position, intensity, light) in self.lamps() {
            let seen = Seen::new(position, [from, to]);
            let mean = seen.mean_inverse_square();
            if mean.is_finite() {
                total += intensity * (mean * INVERSE_SPHERE * seen.falloff(light));
            }
        }
        total
    }

    /// What arrives at a point of a medium of all that point and spot lights send, per channel.
    pub(super) fn share_of_lamps(&self, point: Vec3) -> Rgb
    where
        S: Shadows,
    {
        // What is beside a spot's beam counts little, but tells what arrives in a beam that passes between such points.
        const BESIDE: f32 = 1e-3;
        let (mut arriving, mut sent) = (Rgb::BLACK, Rgb::BLACK);
        for (position, intensity, light) in self.lamps() {
            let to_light = position - point;
            let distance = to_light.length();
            if distance == 0.0 {
                continue;
            }
            let d = to_light / distance;
            let light = intensity * (light.falloff(-d).max(BESIDE) / (distance * distance));
            arriving += light * self.through(point, d, distance);
            sent += light;
        }
        Rgb(std::array::from_fn(|c| {
            if sent.0[c] > 0.0 {
                arriving.0[c] / sent.0[c]
            } else {
                0.0
            }
        }))
    }

    /// Whether no light has an extent, so that [`InMedium::rest`](super::InMedium::rest) has no noise of shadow rays.
    #[must_use]
    pub fn rest_is_exact(&self) -> bool {
        let has_extent = |l: &Light| matches!(l, Light::Directional { angular_radius_rad, .. } if *angular_radius_rad > 0.0);
        self.emitters.is_empty() && !self.tracer.scene.lights.iter().any(has_extent)
    }

    /// Whether a point or spot light is nearer to a segment than `distance`; then, for the nearest, the place from 0 to 1 that
    /// halves its light on the segment.
    #[must_use]
    pub fn lamp_near(&self, from: Vec3, to: Vec3, distance: f32) -> Option<f32> {
        self.lamps()
            .map(|(position, ..)| Seen::new(position, [from, to]))
            .map(|seen| (seen.distance(), seen))
            .filter(|(d, _)| *d < distance)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, seen)| seen.median())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::{hash, sphere, unit, unit2};

    /// By many points in angle as the lamp sees them.
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
                Seen::new(Vec3::ZERO, ends).falloff(&light),
                sampled(ends, &light),
            ];
            met += u32::from(expected > 0.0 && expected < 1.0);
            assert!((got - expected).abs() < 2e-3, "{i}: {got} {expected}");
        }
        assert!(met > 30, "{met}");
    }
}
