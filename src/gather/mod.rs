//! Gathers: the light that arrives at a point, from an open tree.
//!
//! A [`PointGatherer`] takes a point and a normal, or a point in a medium, casts rays and returns a
//! [`Gathered`]. No scene is needed.
//!
//! Three kernels find what ends a ray:
//! - `plain`: the paper's, every disk of the tree (the reference for the others);
//! - `cone`: disks, and nodes whole where they are seen under less than the largest solid angle;
//! - `patch_radiance`: the scene's triangles, where it is at hand, with radiance from the tree.
//!
//! | file | what it does |
//! | --- | --- |
//! | `gatherer` | gathers at receivers of any kind: rays, and what arrives along them |
//! | `points` | gathers at points from a tree alone, for applications |
//! | `dispatch` | the choice of compiled code by the kind of media |
//! | `medium` | what rays pass between surfaces, as a type that kernels are compiled for |
//! | `directions` | the sequences of directions of a hemisphere |
//! | `neighbours` | gathers of points near each other, in an order that keeps memory near |
//! | `order` | things near each other in space, one after the other |
//! | `geometry` | the scene's triangles as this module needs them |
//! | `crossing` | what kernels tell of a ray |
//! | `patch_id` | the parts of triangles that radiance is evaluated for |
//! | `patch` | what the tree says that one patch sends |
//! | `radiance_cache` | the table in which the radiance of patches is kept |
//! | `bright` | patches that send far more than most, which are sampled as lights are |
//!
//! Points and directions are those of scene space, distances are scene units, light is linear
//! Rec.709.

pub(crate) mod bright;
pub(crate) mod cone;
pub(crate) mod crossing;
mod directions;
mod dispatch;
pub(crate) mod gatherer;
mod geometry;
pub(crate) mod medium;
pub(crate) mod neighbours;
mod order;
mod patch;
mod patch_id;
pub(crate) mod patch_radiance;
pub(crate) mod plain;
mod points;
mod radiance_cache;

pub(crate) use crate::tree::LvoxelBlock;
pub(crate) use bright::{BrightHit, BrightPatch};
pub(crate) use crossing::Crossing;
pub(crate) use dispatch::{TreeTask, with_surfels, with_tree};
pub use gatherer::Gathered;
pub(crate) use gatherer::{
    Gatherer, Incident, RayKernel, RaySettings, SampleRange, check_max_solid_angle,
};
pub(crate) use geometry::Geometry;
pub(crate) use medium::{ColoredMedia, Medium, NoMedia};
pub(crate) use neighbours::{Around, DirectionOrder, SurfacePoint};
pub(crate) use order::in_order_of_places;
pub(crate) use patch_radiance::{
    MAX_PACKET, PatchRadiance, PatchRequest, PatchStats, UnknownPatches,
};
pub use points::{Kernel, PointGatherer, Settings};
