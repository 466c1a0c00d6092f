//! The surface that a surfel of a tree stands on.

use crate::math::Ray;
use crate::trace::{Surface, Tracer, offset};
use glam::Vec3;
use lvox_formats::record::Surfel;

/// Cosine between the normals of a surfel and its surface, at least.
pub const SAME: f32 = 0.9;

/// Finds the surface of the scene that a surfel stands on, facing as it does; `None` if there is
/// none that near, as for a tree of another scene.
///
/// Surfaces that cross it there are passed, and masks are not asked: the surfel says that its own
/// is there, and files round places.
pub fn surface_below(tracer: &Tracer, surfel: &Surfel) -> Option<Surface> {
    /// Heights from which it is looked for, over the radius: files round places, and surfels of a
    /// camera stand where its rays ended. What stands on the surface is to be below the lower one.
    const HEIGHTS: [f32; 2] = [0.05, 0.5];
    /// Surfaces that are looked at on the way.
    const MOST_CROSSING: usize = 4;
    let (centre, normal) = (Vec3::from(surfel.position), Vec3::from(surfel.normal));
    HEIGHTS.iter().find_map(|height| {
        let height = height * surfel.radius;
        let mut ray = Ray::new(centre + normal * height, -normal, 2.0 * height);
        (0..MOST_CROSSING).find_map(|_| {
            let hit = tracer.closest_unmasked(&ray)?;
            let surface = Surface::new(tracer.scene, hit.triangle, hit.uv);
            let beyond = hit.t + offset(surface.position);
            ray = Ray::new(ray.at(beyond), -normal, ray.t_max - beyond);
            (surface.face_normal.dot(normal).abs() > SAME).then(|| surface.facing(normal))
        })
    })
}
