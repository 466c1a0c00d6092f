//! The tree file: pages of nodes and surfels, and pages of lvoxels.

mod columns;
mod decode;
mod encode;
mod gaps;
mod lvoxels;
mod place;
mod read;
mod stats;
#[cfg(test)]
mod tests;
mod write;

pub use encode::{EncodedPage, node_bytes, surfel_bytes};
pub use read::Tree;
pub use write::TreeWriter;

/// A page has at most this many bytes before compression; readers refuse more.
pub const MAX_PAGE_BYTES: usize = 1 << 20;
/// A page has at most this many nodes, and at most this many surfels or lvoxels.
pub const MAX_PAGE_RECORDS: usize = 32768;
