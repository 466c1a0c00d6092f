//! What light falls on.

use crate::math::polygon;
use glam::Vec3;

/// A piece of surface, or of a medium that scatters the same to all sides.
#[derive(Clone, Copy, Debug)]
pub enum Receiver {
    /// Lit on the side of both normals, by the cosine to the first.
    Surface {
        /// Unit shading normal.
        normal: Vec3,
        /// Unit geometric normal.
        face_normal: Vec3,
    },
    /// Lit from all round.
    Medium,
}

impl Receiver {
    /// Response to light from a unit direction.
    pub fn response(self, d: Vec3) -> f32 {
        match self {
            Self::Surface {
                normal,
                face_normal,
            } => {
                if d.dot(face_normal) > 0.0 {
                    d.dot(normal).max(0.0)
                } else {
                    0.0
                }
            }
            Self::Medium => 1.0,
        }
    }

    /// Its integral over a triangle seen from the receiver at the origin: closed form, in units of the triangle's radiance.
    pub fn of_triangle(self, corners: [Vec3; 3]) -> f32 {
        match self {
            Self::Surface { normal, .. } => polygon::irradiance(corners, normal),
            Self::Medium => polygon::solid_angle(corners),
        }
    }
}
