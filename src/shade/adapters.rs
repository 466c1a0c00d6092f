//! What gathering and lights see of a scene and a tree that they do not know themselves.

use crate::gather::Geometry;
use crate::math::Hit;
use crate::trace::{Tracer, unit_normal};
use glam::Vec3;

impl Geometry for Tracer<'_> {
    fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        self.closest(origin, direction, t_max)
    }

    fn closest_together(&self, rays: &[(Vec3, Vec3)], t_max: f32, hits: &mut [Option<Hit>]) {
        self.closest_together(rays, t_max, hits);
    }

    fn triangles(&self) -> u32 {
        self.scene.mesh.triangles.len() as u32
    }

    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.scene.mesh.corners(triangle as usize)
    }

    fn normal(&self, triangle: u32) -> Vec3 {
        unit_normal(Geometry::corners(self, triangle))
    }

    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32> {
        let material = self.scene.mesh.material[triangle as usize];
        self.pieces.area_over_mean(material)
    }
}
