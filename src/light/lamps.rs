//! Point and spot lights near a segment, whose inverse square is integrated in closed form.

use super::{INVERSE_SPHERE, Lights};
use crate::math::Rgb;
use crate::scene::Light;
use glam::Vec3;

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

    fn distance(&self) -> f32 {
        let [u, v] = self.ends;
        let way = v - u;
        let t = (-u.dot(way) / way.length_squared()).clamp(0.0, 1.0);
        (u + way * t).length()
    }
}

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
            let middle = (0.5 * (seen.ends[0] + seen.ends[1])).normalize_or_zero();
            if mean.is_finite() {
                total += intensity * (mean * INVERSE_SPHERE * light.falloff(middle));
            }
        }
        total
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
