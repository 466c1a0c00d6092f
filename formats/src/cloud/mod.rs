//! The cloud file, `.lvc`: surfels and lvoxels in the order they came, in chunks.
//!
//! - `columns`: the columns of a chunk, each compressed apart behind a directory of them.
//! - `write`: points to chunks.
//! - `read`: chunks to points.
//! - `sample`: bytes that chunks will take.

mod columns;
mod read;
mod sample;
mod write;

pub use read::{Cloud, CloudFormat};
pub use sample::CloudSample;
pub use write::CloudWriter;

/// The most records in a chunk.
pub const CHUNK_RECORDS: usize = 65536;
