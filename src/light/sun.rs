//! A sun: the light of a directional light with an angular radius.

use super::direct::DirectLight;
use super::shading_point::{Arrival, Receiver, ShadingPoint};
use super::shadows::{ShadowMedia, Shadows};
use crate::math::sampling::{self, disk, tangents};
use crate::math::{Rgb, Spectrum};
use crate::scene::Light;
use glam::Vec3;

/// A directional light with an extent: a cone of directions of constant radiance.
#[derive(Clone, Copy, Debug)]
pub struct Sun {
    /// Unit direction in which its light travels, on average.
    direction: Vec3,
    /// Irradiance of a surface that faces it.
    irradiance: Rgb,
    /// Half of the angle that it is seen under.
    angular_radius_rad: f32,
}

impl Sun {
    /// Points of the disk that tell the light of one which the horizon cuts.
    const POINTS_OF_CUT_DISK: u64 = 256;

    /// Unshadowed irradiance of a surface, the same along every direction in which it is as smooth;
    /// `None` in media.
    fn unshadowed(&self, receiver: impl Receiver, disk: &DiskTowards) -> Option<Rgb> {
        let [x, _] = disk.across;
        let radius = x.length();
        let heights = receiver.normals()?.map(|normal| normal.dot(disk.axis));
        let response = if heights.iter().all(|height| *height >= radius) {
            // What is beside the axis on one side and on the other cancel out.
            receiver.response(disk.axis)
        } else if heights.iter().any(|height| *height <= -radius) {
            0.0
        } else {
            let point = |i| disk.at(sampling::r2(i, [0.5; 2]), receiver).1;
            (0..Self::POINTS_OF_CUT_DISK).map(point).sum::<f32>() / Self::POINTS_OF_CUT_DISK as f32
        };
        Some(self.irradiance * response)
    }

    /// The sun that a light is, if it is directional and has an extent.
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

    /// Adds unshadowed light, and what rays find of it; of surfaces rays tell how much arrives
    /// alone, unless they are to tell all. Media before the sun are those of `media`, or the
    /// scene's own.
    pub fn trace<S: Shadows>(
        &self,
        total: &mut DirectLight,
        index: usize,
        at: &ShadingPoint<S, impl Receiver>,
        by_rays_alone: bool,
        media: Option<&dyn ShadowMedia<S::Share>>,
    ) {
        let disk_towards = DiskTowards::new(self);
        let rays = at.rays;
        let unshadowed = match by_rays_alone {
            true => None,
            false => self.unshadowed(at.receiver, &disk_towards),
        };
        total.unshadowed += unshadowed.unwrap_or(Rgb::BLACK);
        for i in 0..rays.count() {
            let (d, w) = disk_towards.at(rays.point(i, index as u32), at.receiver);
            if w > 0.0 {
                let light = self.irradiance * w;
                if unshadowed.is_none() {
                    total.unshadowed += light * (1.0 / rays.count() as f32);
                }
                let transmittance = at.transmittance(d, f32::INFINITY, media);
                at.receiver
                    .note(d, transmittance.mean_of(light), Arrival::Ray);
                total.note_ray(index, light, transmittance);
            }
        }
    }
}

/// The directions to the points of a sun.
struct DiskTowards {
    /// Unit axis, and two axes across as long as the sine of the angular radius.
    axis: Vec3,
    across: [Vec3; 2],
}

impl DiskTowards {
    fn new(sun: &Sun) -> Self {
        let axis = -sun.direction;
        let (x, y) = tangents(axis);
        let radius = libm::sinf(sun.angular_radius_rad);
        Self {
            axis,
            across: [x * radius, y * radius],
        }
    }

    /// The unit direction to the point of the disk that two numbers in [0,1) choose, and the
    /// response to it over what the sun sends a surface that faces it.
    #[inline]
    fn at(&self, u: [f32; 2], receiver: impl Receiver) -> (Vec3, f32) {
        let [u, v] = disk(u);
        let [x, y] = self.across;
        let beside = x * u + y * v;
        // Points of the disk are spread by their cosine to the sun's axis.
        let cos = (1.0 - beside.length_squared()).max(1e-4).sqrt();
        let d = (self.axis * cos + beside).normalize();
        (d, receiver.response(d) / cos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::shading_point::SurfaceReceiver;

    /// The irradiance of a surface that nothing shadows, by one set of points and by many rays.
    #[test]
    fn what_a_sun_sends_has_no_noise() {
        for (degrees, height_deg) in [(0.3_f32, 5.0_f32), (5.0, 60.0), (5.0, 3.0), (5.0, -2.0)] {
            let height = height_deg.to_radians();
            let sun = Sun {
                direction: -Vec3::new(height.cos(), height.sin(), 0.0),
                irradiance: Rgb([2.0; 3]),
                angular_radius_rad: degrees.to_radians(),
            };
            let disk = DiskTowards::new(&sun);
            for normal in [Vec3::Y, Vec3::new(0.1, 1.0, 0.2).normalize()] {
                let receiver = SurfaceReceiver {
                    normal,
                    face_normal: Vec3::Y,
                };
                let found = sun.unshadowed(receiver, &disk).unwrap().0[0];
                let many = 1 << 16;
                let sum: f64 = (0..many)
                    .map(|i| f64::from(disk.at(sampling::r2(i, [0.1, 0.7]), receiver).1))
                    .sum();
                let exact = 2.0 * sum / many as f64;
                let off = (f64::from(found) - exact).abs();
                assert!(
                    off <= 0.04 * exact.max(0.005),
                    "{degrees} {height_deg}: {found}, {exact}"
                );
                if height_deg > degrees {
                    assert!(
                        off <= 1e-3 * exact,
                        "{degrees} {height_deg}: {found}, {exact}"
                    );
                }
            }
        }
    }
}
