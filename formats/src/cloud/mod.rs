//! The cloud file: surfels and lvoxels in the order they came.

mod columns;
mod read;
mod write;

pub use read::Cloud;
pub use write::CloudWriter;

/// A chunk has at most this many records.
pub const CHUNK_RECORDS: usize = 65536;
