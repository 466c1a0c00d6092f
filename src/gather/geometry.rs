//! The scene's triangles, as gathers see them.

use crate::math::Hit;
use glam::Vec3;

/// The triangles of a scene, which the gather does not know itself: it works where only a tree is
/// at hand, too.
pub trait Geometry: std::fmt::Debug + Sync {
    /// The nearest triangle before `t_max` along a ray of unit direction.
    fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit>;

    /// As [`Self::closest`], for each of some rays, origins and unit directions, of which `hits`
    /// has as many; faster where they go much the same way.
    fn closest_together(&self, rays: &[(Vec3, Vec3)], t_max: f32, hits: &mut [Option<Hit>]) {
        for (&(origin, direction), hit) in rays.iter().zip(hits) {
            *hit = self.closest(origin, direction, t_max);
        }
    }

    /// How many triangles there are.
    fn triangles(&self) -> u32;

    /// The corners of a triangle.
    fn corners(&self, triangle: u32) -> [Vec3; 3];

    /// Its unit normal, on the side its corners wind counter-clockwise.
    fn normal(&self, triangle: u32) -> Vec3;

    /// Area that a surfel on it stands for, over the mean of all surfels; `None` if it reflects
    /// nothing, so that a tree need not be asked.
    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32>;
}
