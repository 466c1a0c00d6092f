//! Lights that are not geometry. Emissive meshes are materials with emission.

use glam::Vec3;

/// A light source, in scene space.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// Isotropic point: irradiance is `intensity cos / r^2`.
    Point {
        /// Position in scene space.
        position: Vec3,
        /// Radiant intensity per steradian.
        intensity: [f32; 3],
    },
    /// Point light inside a cone.
    Spot {
        /// Position in scene space.
        position: Vec3,
        /// Unit axis of the cone, the way the light travels.
        direction: Vec3,
        /// Radiant intensity per steradian on the axis.
        intensity: [f32; 3],
        /// Cosine of the half angle up to which the intensity is full.
        cos_inner: f32,
        /// Cosine of the half angle beyond which there is none; less than `cos_inner`.
        cos_outer: f32,
    },
    /// Parallel light, or a disk at infinity.
    Directional {
        /// Unit direction, the way the light travels.
        direction: Vec3,
        /// Irradiance on a plane that faces the light.
        irradiance: [f32; 3],
        /// Half angle of the disk, radians; 0 for parallel light.
        angular_radius_rad: f32,
    },
    /// The same radiance from everywhere that no surface covers.
    Environment {
        /// Radiance from every direction, linear Rec.709.
        radiance: [f32; 3],
    },
}

impl Light {
    /// Position and intensity, W/sr, of a point or spot light; `None` for others.
    #[must_use]
    pub fn point_source(&self) -> Option<(Vec3, [f32; 3])> {
        match *self {
            Self::Point {
                position,
                intensity,
            }
            | Self::Spot {
                position,
                intensity,
                ..
            } => Some((position, intensity)),
            _ => None,
        }
    }

    /// Multiplies its intensity, irradiance or radiance.
    pub(super) fn scale(&mut self, factor: f32) {
        let (Self::Point {
            intensity: color, ..
        }
        | Self::Spot {
            intensity: color, ..
        }
        | Self::Directional {
            irradiance: color, ..
        }
        | Self::Environment { radiance: color }) = self;
        color.iter_mut().for_each(|c| *c *= factor);
    }

    /// Share of the intensity that leaves towards a unit direction: less than 1 off the axis of a
    /// spot.
    #[must_use]
    pub fn falloff(&self, towards: Vec3) -> f32 {
        let Self::Spot {
            direction,
            cos_inner,
            cos_outer,
            ..
        } = self
        else {
            return 1.0;
        };
        let s = ((towards.dot(*direction) - cos_outer) / (cos_inner - cos_outer)).clamp(0.0, 1.0);
        s * s * (3.0 - 2.0 * s)
    }
}
