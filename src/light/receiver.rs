//! What light falls on, as a type: light on surfaces is asked for by code of its own.

use crate::math::polygon;
use glam::Vec3;
use std::f32::consts::PI;

/// Share of the sphere that a unit of solid angle is, per steradian.
pub const INVERSE_SPHERE: f32 = 1.0 / (4.0 * PI);

/// What light falls on.
pub trait Receiver: Copy {
    /// Response to light from a unit direction.
    fn response(self, d: Vec3) -> f32;

    /// Its integral over a triangle seen from the receiver at the origin: closed form, in units of
    /// the triangle's radiance.
    fn of_triangle(self, corners: [Vec3; 3]) -> f32;

    /// Unit normals, that of the response first, on whose side a light must be; `None` if it may be
    /// on any.
    fn normals(self) -> Option<[Vec3; 2]>;
}

/// A piece of surface, lit on the side of both normals, by the cosine to the first.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Normal for shading, interpolated over the triangle; unit length, scene space.
    pub normal: Vec3,
    /// Normal of the triangle itself; unit length, scene space.
    pub face_normal: Vec3,
}

impl Receiver for Surface {
    #[inline]
    fn response(self, d: Vec3) -> f32 {
        if d.dot(self.face_normal) > 0.0 {
            d.dot(self.normal).max(0.0)
        } else {
            0.0
        }
    }

    #[inline]
    fn of_triangle(self, corners: [Vec3; 3]) -> f32 {
        if self.normal == self.face_normal {
            polygon::irradiance(corners, self.normal)
        } else {
            polygon::irradiance_above(corners, self.normal, self.face_normal)
        }
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        Some([self.normal, self.face_normal])
    }
}

/// A point of a medium that scatters the same to all sides.
#[derive(Clone, Copy, Debug)]
pub struct Medium;

impl Receiver for Medium {
    #[inline]
    fn response(self, _: Vec3) -> f32 {
        1.0
    }

    #[inline]
    fn of_triangle(self, corners: [Vec3; 3]) -> f32 {
        polygon::solid_angle(corners)
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        None
    }
}
