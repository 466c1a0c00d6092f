//! The tree file, `.lvt`: pages of nodes and surfels, and pages of lvoxels.
//!
//! - `columns`: the columns of pages, and how they are put together and taken apart.
//! - `encode`, `place`, `shapes`: a page of nodes and surfels to bytes; `decode`: back.
//! - `relight`: a page of a tree with other light.
//! - `lvoxels`, `gaps`: a page of lvoxels to bytes and back.
//! - `stats`: what a writer counts for the summary.
//! - `write`: pages to a file; `read`: a file to pages.

mod columns;
mod decode;
mod encode;
mod gaps;
mod lvoxels;
mod place;
mod read;
mod relight;
mod shapes;
mod stats;
#[cfg(test)]
mod tests;
mod write;

pub use encode::{EncodedPage, node_bytes, surfel_bytes};
pub use lvoxels::EncodedLvoxels;
pub use read::{Tree, TreeFormat};
pub use write::TreeWriter;

/// A page has at most this many bytes before compression; readers refuse more.
pub const MAX_PAGE_BYTES: usize = 1 << 20;
/// A page has at most this many nodes, and at most this many surfels or lvoxels.
pub const MAX_PAGE_RECORDS: usize = 32768;
