//! An emissive triangle or a part of one, and how its points are chosen.

use crate::math::{Rgb, polygon, sampling};
use glam::Vec3;

/// An emissive triangle, or a part of one that has a texture.
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
    /// Number of the triangle among those that emit: rays to its parts tell edges of one shadow.
    pub surface: u32,
}

/// The way from a point to one of an emitter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Towards {
    /// Unit direction.
    pub direction: Vec3,
    /// Length of the way, scene units.
    pub distance: f32,
    /// Density of the direction, per steradian.
    pub pdf: f32,
}

impl Emitter {
    /// Uniform point for two numbers in [0,1).
    fn point(&self, u: [f32; 2]) -> Vec3 {
        let w = sampling::triangle(u);
        self.corners[0] * w[0] + self.corners[1] * w[1] + self.corners[2] * w[2]
    }

    /// The way to the point that two numbers in [0,1) choose: uniform over the emitter's solid
    /// angle if its area over its squared distance is more than `near`, else uniform over its area.
    pub(super) fn sample(&self, origin: Vec3, u: [f32; 2], near: f32) -> Towards {
        let corners = self.corners.map(|c| c - origin);
        let middle = (corners[0] + corners[1] + corners[2]) * (1.0 / 3.0);
        if self.area > near * middle.length_squared()
            && let Some(d) = polygon::sample_solid_angle(corners, u)
        {
            let distance = corners[0].dot(self.normal) / d.dot(self.normal);
            return Towards {
                direction: d,
                distance,
                pdf: 1.0 / polygon::solid_angle(corners),
            };
        }
        let to_light = self.point(u) - origin;
        let distance = to_light.length();
        let d = to_light / distance;
        Towards {
            direction: d,
            distance,
            pdf: distance * distance / (self.area * self.normal.dot(d).abs()),
        }
    }

    /// Whether the emitter shines towards a point.
    pub(super) fn faces(&self, point: Vec3) -> bool {
        self.both_sides || (point - self.corners[0]).dot(self.normal) > 0.0
    }
}
