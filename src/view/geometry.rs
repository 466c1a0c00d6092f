//! The triangles of a traced scene, for gathers.

use crate::gather::Geometry;
use crate::math::{Hit, Ray};
use crate::trace::{Tracer, unit_normal};
use glam::Vec3;

impl Geometry for Tracer<'_> {
    fn closest(&self, ray: &Ray) -> Option<Hit> {
        self.closest(ray)
    }

    fn closest_of_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        self.closest_of_packet(rays, hits);
    }

    fn triangles(&self) -> u32 {
        self.scene.mesh.flat_count() as u32
    }

    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.scene.mesh.corners(triangle as usize)
    }

    fn normal(&self, triangle: u32) -> Vec3 {
        unit_normal(Geometry::corners(self, triangle))
    }

    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32> {
        let material = self.scene.mesh.material_of(triangle as usize);
        self.pieces.area_over_mean(material)
    }

    fn opacity(&self, triangle: u32, uv: [f32; 2]) -> Option<f32> {
        self.opacity(triangle, uv)
    }
}
