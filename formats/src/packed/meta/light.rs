//! What lights a packed scene.

use super::rules::{MAX_SIDE, check, is_light, is_near, is_unit};
use crate::Result;

/// A light source.
#[derive(
    Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, bincode::Encode, bincode::Decode,
)]
pub enum PackedLight {
    /// Isotropic point.
    Point {
        /// Position in scene space.
        position: [f32; 3],
        /// Radiant intensity per steradian.
        intensity: [f32; 3],
    },
    /// Point light inside a cone.
    Spot {
        /// Position in scene space.
        position: [f32; 3],
        /// Unit axis of the cone, the way the light travels.
        direction: [f32; 3],
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
        direction: [f32; 3],
        /// Irradiance on a plane that faces the light.
        irradiance: [f32; 3],
        /// Half angle of the disk, radians, below pi/2; 0 for parallel light.
        angular_radius_rad: f32,
    },
    /// The same radiance from everywhere.
    Environment {
        /// Radiance from every direction.
        radiance: [f32; 3],
    },
    /// No light, but that cameras do not see environments, which light the scene as ever.
    UnseenEnvironment,
    /// A volume that is no medium: light comes from it by its samples.
    EmissiveVolume {
        /// Which.
        volume: u32,
        /// Radiance per scene unit of length where the sample is 1.
        radiance: [f32; 3],
    },
    /// A volume that is no medium, but a black body whose kelvin are its samples.
    BlackbodyVolume {
        /// Which.
        volume: u32,
        /// Factor on its radiance per scene unit of length.
        scale: f32,
    },
}

/// A lat-long image of the radiance from all directions.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedEnvironment {
    /// Texels in a row: twice as many as there are rows, at most 65,536.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// Factor on texels.
    pub scale: [f32; 3],
    /// Angle by which the image is turned about +y, right-handed, radians.
    pub rotation_rad: f32,
    /// Texels that send other light than is seen of them, with that, in increasing order.
    pub holes: Vec<(u32, [f32; 3])>,
}

impl PackedLight {
    /// The volume that light comes from, if it is one.
    #[must_use]
    pub fn volume(&self) -> Option<u32> {
        match *self {
            Self::EmissiveVolume { volume, .. } | Self::BlackbodyVolume { volume, .. } => {
                Some(volume)
            }
            _ => None,
        }
    }

    pub(super) fn validate(&self, what: &dyn Fn() -> String) -> Result<()> {
        let is_right = match *self {
            Self::Point {
                position,
                intensity,
            } => is_near(position) && is_light(intensity),
            Self::Spot {
                position,
                direction,
                intensity,
                cos_inner,
                cos_outer,
            } => {
                let cosines = -1.0..=1.0;
                is_near(position)
                    && is_unit(direction)
                    && is_light(intensity)
                    && cosines.contains(&cos_inner)
                    && cosines.contains(&cos_outer)
                    && cos_outer < cos_inner
            }
            Self::Directional {
                direction,
                irradiance,
                angular_radius_rad,
            } => {
                is_unit(direction)
                    && is_light(irradiance)
                    && (0.0..1.56).contains(&angular_radius_rad)
            }
            Self::Environment { radiance } | Self::EmissiveVolume { radiance, .. } => {
                is_light(radiance)
            }
            Self::UnseenEnvironment => true,
            Self::BlackbodyVolume { scale, .. } => is_light([scale; 3]),
        };
        check(
            is_right,
            what,
            "a place, a unit direction, light and angles in range",
            self,
        )
    }
}

impl PackedEnvironment {
    pub(super) fn validate(&self) -> Result<()> {
        let what = || "environment".to_owned();
        let size = [self.width, self.height];
        let is_size = (1..=MAX_SIDE).contains(&self.width)
            && u64::from(self.width) == 2 * u64::from(self.height);
        let expected = "an image twice as wide as high, at most 65,536 across";
        check(is_size, &what, expected, size)?;
        let is_right = is_light(self.scale) && self.rotation_rad.is_finite();
        let expected = "a factor of at least 0 and an angle";
        check(is_right, &what, expected, (self.scale, self.rotation_rad))?;
        let texels = u64::from(self.width) * u64::from(self.height);
        let is_hole =
            |(texel, light): &(u32, [f32; 3])| u64::from(*texel) < texels && is_light(*light);
        let are_holes = self.holes.iter().all(is_hole)
            && self.holes.windows(2).all(|pair| pair[0].0 < pair[1].0);
        let expected = "texels that exist, in order, and light of at least 0";
        check(are_holes, &what, expected, self.holes.len())
    }
}
