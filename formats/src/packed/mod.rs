//! The packed scene, `.lvp`: all that stages need of a scene, and a tree and scattered light with
//! it, in columns that are used as they lie.
//!
//! - `meta`: what is small: cameras and film (`view`), lights, surfaces, volumes, what the columns
//!   are, and `parts` that most scenes have not; `rules`: values that these may have
//! - `column`: the columns, and what their rows must be
//! - `hierarchy`: that nodes over triangles are a tree
//! - `levels`: levels of volumes, whose tables and pages `media` codes
//! - `write`: a scene to a file; `read`: a file to columns

mod column;
mod hierarchy;
mod levels;
mod meta;
mod read;
mod write;

pub use column::{COLUMN_ALIGNMENT, ColumnRows, PackedColumn};
pub use hierarchy::MAX_NODE_LEVELS;
pub use levels::MediaLevel;
pub use meta::{
    PackedCamera, PackedCameraKey, PackedEmissionTexture, PackedEnvironment, PackedFilm,
    PackedHierarchy, PackedImage, PackedInstances, PackedLens, PackedLight, PackedMask,
    PackedMasks, PackedMaterial, PackedMesh, PackedMeta, PackedParts, PackedPhase, PackedPrototype,
    PackedSummary, PackedTexture, PackedVolume, PackedWrap,
};
pub use read::{Packed, PackedBlocks, PackedFormat};
pub use write::PackedWriter;
