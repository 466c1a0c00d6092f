//! An emissive triangle.

use crate::math::{Rgb, polygon, sampling};
use glam::Vec3;

/// A triangle that emits.
#[derive(Clone, Copy, Debug)]
pub struct Emitter {
    /// Corners, scene space.
    pub corners: [Vec3; 3],
    /// Unit normal of the side that emits.
    pub normal: Vec3,
    /// Emitted radiance, linear Rec.709, the same in all directions.
    pub radiance: Rgb,
    /// Area, scene units squared.
    pub area: f32,
    /// Whether the other side emits, too.
    pub both_sides: bool,
}

impl Emitter {
    /// Uniform point for two numbers in [0,1).
    fn point(&self, u: [f32; 2]) -> Vec3 {
        let w = sampling::triangle(u);
        self.corners[0] * w[0] + self.corners[1] * w[1] + self.corners[2] * w[2]
    }

    /// A direction from `origin` to the emitter, the distance along it, and its density per
    /// steradian: uniform over the emitter's solid angle if its area over its squared distance is
    /// more than `near`, else uniform over its area.
    pub fn look_at(&self, origin: Vec3, u: [f32; 2], near: f32) -> (Vec3, f32, f32) {
        let corners = self.corners.map(|c| c - origin);
        let middle = (corners[0] + corners[1] + corners[2]) * (1.0 / 3.0);
        if self.area > near * middle.length_squared()
            && let Some(d) = polygon::sample_solid_angle(corners, u)
        {
            let distance = corners[0].dot(self.normal) / d.dot(self.normal);
            return (d, distance, 1.0 / polygon::solid_angle(corners));
        }
        let to_light = self.point(u) - origin;
        let distance = to_light.length();
        let d = to_light / distance;
        let pdf = distance * distance / (self.area * self.normal.dot(d).abs());
        (d, distance, pdf)
    }

    /// Whether it emits towards a point.
    pub fn lights(&self, point: Vec3) -> bool {
        self.both_sides || (point - self.corners[0]).dot(self.normal) > 0.0
    }
}
