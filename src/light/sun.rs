//! A sun with an extent.

use super::direct::Direct;
use super::receiver::Receiver;
use super::shading_point::ShadingPoint;
use super::shadows::{OpticalDepth, Shadows};
use crate::math::Rgb;
use crate::math::sampling::{disk, tangents};
use crate::scene::Light;
use glam::Vec3;

/// A directional light with an extent: a cone of directions of constant radiance.
#[derive(Clone, Copy, Debug)]
pub struct Sun {
    /// Unit direction in which its light travels, on average.
    direction: Vec3,
    /// Of a surface that faces it.
    irradiance: Rgb,
    /// Half of the angle that it is seen under.
    angular_radius_rad: f32,
}

impl Sun {
    /// The light as a sun, if it is directional and has an extent.
    pub fn of(light: &Light) -> Option<Self> {
        match *light {
            Light::Directional {
                direction,
                irradiance,
                angular_radius_rad,
            } if angular_radius_rad > 0.0 => Some(Self {
                direction,
                irradiance: Rgb(irradiance),
                angular_radius_rad,
            }),
            _ => None,
        }
    }

    /// Adds its light. Media before it are those of `depth`, or the scene's own.
    pub fn add<S: Shadows, R: Receiver>(
        &self,
        total: &mut Direct<S::Dimming>,
        index: usize,
        at: &ShadingPoint<S, R>,
        depth: Option<&dyn OpticalDepth>,
    ) {
        let (x, y) = tangents(-self.direction);
        let radius = libm::sinf(self.angular_radius_rad);
        let rays = at.rays;
        for i in 0..rays.count() {
            let [u, v] = disk(rays.point(i, index as u32)).map(|c| c * radius);
            // Points of the disk are spread by their cosine to the sun's axis.
            let cos = (1.0 - u * u - v * v).max(1e-4).sqrt();
            let d = (-self.direction * cos + x * u + y * v).normalize();
            let w = at.receiver.response(d) / cos;
            if w > 0.0 {
                let light = self.irradiance * w;
                total.open += light * (1.0 / rays.count() as f32);
                let through = at.through(d, f32::INFINITY, depth);
                total.note_ray(index, light, through);
            }
        }
    }
}
