//! Media on disk: a volume as levels of sparse bricks.
//!
//! Level 0 has the voxels, level l means over `2^l` of them along each axis. A level is a table of
//! its bricks of 8^3 samples in Morton order, and pages of 64 of these.
//!
//! - `residual`: codes of a brick to what their neighbours do not foretell, and back.
//! - `palette`: the values of a level that has few.
//! - `page`: the samples of some bricks to bytes and back, bit for bit.
//! - `table`: which bricks there are, and what is known of each without its samples.

mod page;
mod palette;
mod residual;
mod table;

pub use page::{Coding, MediaPage, PAGE_BRICKS, decode};
pub use palette::{Palette, PaletteIndex};
pub use table::{BrickEntry, BrickTable, ENTRY_BYTES};

/// Voxels along an edge of a brick.
pub const BRICK_EDGE: usize = 8;

/// Voxels of a brick.
pub const BRICK_VOXELS: usize = BRICK_EDGE.pow(3);

/// The samples of a brick, x fastest.
pub type BrickSamples = [f32; BRICK_VOXELS];
