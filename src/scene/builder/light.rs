//! Lights as they are handed to a builder.

use super::{MAX_EMISSION, check_near};
use crate::scene::{ImageSun, Light};
use crate::{Error, Result};
use glam::{DVec3, Vec3};

/// A light in world space. Meshes that emit are no lights of their own: see
/// [`MeshInput::emission`](super::MeshInput::emission).
#[derive(Clone, Debug)]
pub struct LightInput {
    /// The light but for its position, which is in f32 and in scene space there.
    pub(in crate::scene) light: Light,
    /// Position of a point light or spot light; zero for others.
    pub(in crate::scene) position: DVec3,
}

impl LightInput {
    /// A point light of an intensity per steradian that is equal in all directions.
    #[must_use]
    pub fn point(position: impl Into<DVec3>, intensity: [f32; 3]) -> Self {
        Self {
            light: Light::Point {
                position: Vec3::ZERO,
                intensity,
            },
            position: position.into(),
        }
    }

    /// A spot light that shines along `direction`, of any length above zero. Its intensity per
    /// steradian is full up to `inner_rad` from that axis and none from `outer_rad` on.
    ///
    /// # Errors
    /// A direction of zero length, or an inner angle that is not below the outer one.
    pub fn spot(
        position: impl Into<DVec3>,
        direction: impl Into<DVec3>,
        intensity: [f32; 3],
        inner_rad: f64,
        outer_rad: f64,
    ) -> Result<Self> {
        let cos = |angle: f64| libm::cos(angle) as f32;
        let (cos_inner, cos_outer) = (cos(inner_rad), cos(outer_rad));
        let angles = 0.0..=std::f64::consts::PI;
        let in_range = angles.contains(&inner_rad) && angles.contains(&outer_rad);
        if !in_range || cos_inner <= cos_outer {
            return Err(Error::input(format!(
                "a spot light of cone angles {inner_rad} and {outer_rad}: \
                 the inner must be smaller, both from 0 to pi"
            )));
        }
        Ok(Self {
            light: Light::Spot {
                position: Vec3::ZERO,
                direction: unit(direction.into())?,
                intensity,
                cos_inner,
                cos_outer,
            },
            position: position.into(),
        })
    }

    /// A sun: light that travels along `direction`, of any length above zero, from a disk at
    /// infinity with the half angle `angular_radius_rad`, below pi/2; 0 is parallel light.
    /// `irradiance` is that of a plane which faces the light.
    ///
    /// # Errors
    /// A direction of zero length, or a radius out of range.
    pub fn sun(
        direction: impl Into<DVec3>,
        irradiance: [f32; 3],
        angular_radius_rad: f64,
    ) -> Result<Self> {
        if !(0.0..=89_f64.to_radians()).contains(&angular_radius_rad) {
            return Err(Error::input(format!(
                "expected an angular radius from 0 to 1.55 radians, found {angular_radius_rad}"
            )));
        }
        Ok(Self::without_position(Light::Directional {
            direction: unit(direction.into())?,
            irradiance,
            angular_radius_rad: angular_radius_rad as f32,
        }))
    }

    /// The radiance that comes from every direction in which no surface is.
    #[must_use]
    pub fn environment(radiance: [f32; 3]) -> Self {
        Self::without_position(Light::Environment { radiance })
    }

    /// A sun of an environment image.
    pub(super) fn of_image(sun: &ImageSun) -> Self {
        Self::without_position(Light::Directional {
            direction: -sun.towards,
            irradiance: sun.irradiance,
            angular_radius_rad: sun.angular_radius_rad,
        })
    }

    fn without_position(light: Light) -> Self {
        Self {
            light,
            position: DVec3::ZERO,
        }
    }

    /// The light, in the space of a scene.
    pub(super) fn in_scene(mut self, world_from_scene: DVec3) -> Light {
        if let Light::Point { position, .. } | Light::Spot { position, .. } = &mut self.light {
            *position = (self.position - world_from_scene).as_vec3();
        }
        self.light
    }

    /// Refuses a light that is too far away, or whose colour is none.
    pub(super) fn check(&self, what: impl Fn() -> String) -> Result<()> {
        check_near(&what, self.position)?;
        let color = match self.light {
            Light::Point { intensity, .. } | Light::Spot { intensity, .. } => intensity,
            Light::Directional { irradiance, .. } => irradiance,
            Light::Environment { radiance } => radiance,
        };
        if !color.iter().all(|x| (0.0..=MAX_EMISSION).contains(x)) {
            return Err(Error::input(format!(
                "{}: the colour {color:?} is not in 0 to {MAX_EMISSION:e}",
                what()
            )));
        }
        Ok(())
    }
}

fn unit(direction: DVec3) -> Result<Vec3> {
    let unit = direction.try_normalize();
    unit.map(DVec3::as_vec3).ok_or_else(|| {
        Error::input(format!(
            "expected a direction, found {:?}",
            direction.to_array()
        ))
    })
}
