//! Surfaces among media.

use crate::math::Aabb;
use crate::scene::Mesh;
use glam::Vec3;
use rayon::prelude::*;

/// Whether any surface may stand in a box, or at its border.
pub fn are_within(mesh: &Mesh, bounds: Aabb) -> bool {
    let meets = |min: Vec3, max: Vec3| min.cmple(bounds.max).all() && max.cmpge(bounds.min).all();
    let is_within = |i: usize| {
        let [a, b, c] = mesh.corners(i);
        meets(a.min(b).min(c), a.max(b).max(c))
    };
    let mut instances = mesh.instances.list().iter();
    (0..mesh.flat_count()).into_par_iter().any(is_within)
        || instances.any(|i| meets(i.bounds.min, i.bounds.max))
}
