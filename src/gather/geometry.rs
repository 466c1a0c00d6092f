//! The scene's triangles, as gathers see them.

use crate::math::{Hit, Ray};
use glam::Vec3;

/// The triangles of a scene, which the gather does not know itself: it works where only a tree is
/// at hand, too.
pub trait Geometry: std::fmt::Debug + Sync {
    /// Returns the nearest triangle along a ray.
    fn closest(&self, ray: &Ray) -> Option<Hit>;

    /// Finds the nearest triangle along each ray of a packet, as [`Self::closest`] does, for
    /// `hits`, which has as many; faster where the rays go much the same way.
    fn closest_of_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        for (ray, hit) in rays.iter().zip(hits) {
            *hit = self.closest(ray);
        }
    }

    /// Returns the number of triangles for which something may be kept; there may be many more, of
    /// meshes that are placed many times, whose numbers come behind these.
    fn triangles(&self) -> u32;

    /// Returns the corners of a triangle, scene space.
    fn corners(&self, triangle: u32) -> [Vec3; 3];

    /// Returns a triangle's unit normal, on the side from which its corners wind counter-clockwise.
    fn normal(&self, triangle: u32) -> Vec3;

    /// Returns the area that a surfel on a triangle stands for, over the mean of all surfels;
    /// `None` if the triangle reflects nothing, so that no tree need be asked.
    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32>;

    /// Returns the share of a triangle that is there at barycentric weights of its second and third
    /// corner: rays meet so many of its places, and pass the others. `None` if the triangle has no
    /// mask.
    fn opacity(&self, _triangle: u32, _uv: [f32; 2]) -> Option<f32> {
        None
    }
}
