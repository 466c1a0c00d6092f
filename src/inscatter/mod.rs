//! Light that media scatter, at any point of a ray: what frames look up and `scatter` makes for all
//! cameras.
//!
//! A scene with its lights, and gathers from a tree, enter ([`MediaLights`]); the source function
//! along segments of camera rays leaves ([`InScatter::source`]), or the light of all vertices that
//! any camera may ask for ([`InScatter::light_all`]).
//!
//! | file | what it does |
//! | --- | --- |
//! | `march` | the way of a camera ray through media, in parts that are lit as one |
//! | `source/` | the source function between vertices; light of every vertex |
//! | `vertices` | lattices of values made on demand, and interpolation between eight of them |
//! | `sparse`, `occupied` | chosen vertices of a lattice: those around cells that hold any medium |
//! | `bricks`, `density` | a value for each brick of a volume; how fast light changes there |
//! | `spacing` | how close a camera needs vertices to stand |
//! | `near_emitters` | how close they must stand beside emitters |
//! | `direct` | direct light at vertices, and how it falls between them |
//! | `sweep/` | indirect light at the vertices of thin bricks, by discrete ordinates |
//! | `lvoxel_light` | light that lvoxels send each other, of a tree that tells it |
//! | `walls` | surfaces among media |
//! | `far_field` | probes of the surfaces around a medium |
//! | `dense` | light in voxels so deep that no vertex tells |
//! | `seen_channels` | which channels of a medium a camera ray still sees
//! | `scattered` | light that was made beforehand, read from a file |
//! | `gatherer`, `memory`, `counts` | what is asked of a gatherer; limits on memory; what it took |

mod bricks;
mod counts;
mod dense;
mod density;
mod direct;
mod far_field;
mod gatherer;
mod lvoxel_light;
mod march;
mod memory;
mod near_emitters;
mod occupied;
mod scattered;
mod seen_channels;
mod source;
mod spacing;
pub mod sparse;
mod sweep;
#[cfg(test)]
mod tests;
mod vertices;
mod walls;

pub use counts::MediaCounts;
pub use gatherer::GatherInMedia;
pub use march::Marched;
pub use memory::bytes_for;
pub use scattered::{check_colors, check_volumes};
pub use source::{InScatter, MediaLights, VolumeLight};
pub use sparse::SparseValues;

use crate::gather::{Medium, RaySettings};
use crate::scene::Volume;
use crate::tree::IncidentGrid;

/// Solid angle below which nodes are taken whole by rays of media, over that of rays of surfaces:
/// few rays look along the whole sphere, so that each stands for far more of it, and their light is
/// a mean of all directions.
const SOLID_ANGLE_OVER_SURFACES: f32 = 4.0;

/// What the lvoxels of a tree tell of the light that they send each other, where that is all light
/// of media: of one medium, as far as rays go, that scatters alike in all directions. Comes with
/// the media to gather from, which then send no light.
#[must_use]
pub fn known_incident<'a, M: Medium>(
    media: &'a M,
    volumes: &[Volume],
    max_dist: f32,
) -> (M, Option<IncidentGrid<'a>>) {
    let known = match volumes {
        [one] if one.phase.is_isotropic() && max_dist.is_infinite() => media.incident(0),
        _ => None,
    };
    match known {
        Some(_) => (media.without_incident(), known),
        None => (*media, None),
    }
}

/// Settings of gathers inside media, of so many samples, given those on surfaces.
#[must_use]
pub fn gather_settings(on_surfaces: RaySettings<'_>, samples: u32) -> RaySettings<'_> {
    RaySettings {
        samples,
        max_solid_angle: SOLID_ANGLE_OVER_SURFACES * on_surfaces.max_solid_angle,
        ..on_surfaces
    }
}
