//! Light of a constant environment by rays, for those who do not gather it.

use super::lights::Lights;
use super::rays::ShadowRays;
use super::shadows::Shadows;
use crate::math::Rgb;
use crate::math::sampling::{cosine_hemisphere, sphere, tangents};
use crate::trace;
use glam::Vec3;
use std::f32::consts::PI;

impl<S: Shadows> Lights<'_, S> {
    /// Irradiance of a surface point from the environment, by as many rays over the hemisphere as
    /// `rays` are.
    #[must_use]
    pub fn environment_irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Rgb {
        let (x, y) = tangents(normal);
        let origin = point + face_normal * trace::offset(point);
        let share = self.environment_share(origin, rays, |u| {
            let d = cosine_hemisphere(u);
            (x * d.x + y * d.y + normal * d.z).normalize()
        });
        self.environment() * (PI * share)
    }

    /// Mean over the sphere of the environment's radiance at a point of a medium.
    #[must_use]
    pub fn environment_mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Rgb {
        self.environment() * self.environment_share(point, rays, sphere)
    }

    fn environment_share(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        direction: impl Fn([f32; 2]) -> Vec3,
    ) -> f32 {
        if self.environment().is_black() {
            return 0.0;
        }
        let at = self.shading_point(origin, rays, ());
        let through = |i| {
            let direction = direction(rays.point(i, 62));
            at.through(direction, f32::INFINITY, at.shadows.before_triangles())
        };
        (0..rays.count()).map(through).sum::<f32>() / rays.count() as f32
    }
}
