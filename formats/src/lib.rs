//! Bytes on disk and nothing else: the cloud (`.lvc`), tree (`.lvt`) and scattered light (`.lvs`)
//! files of lvox. `SPEC.md` is the one statement of these formats.
//!
//! [`CloudWriter`], [`TreeWriter`] and [`ScatterWriter`] write, [`Cloud`], [`Tree`] and [`Scatter`]
//! read. Readers take any bytes; [`MappedFile`] gives those of a file. `open` is cheap (header and
//! tables), `verify` reads everything.

#![deny(missing_docs, unsafe_code)]

mod atomic;
mod bytes;
mod check;
mod cloud;
mod codec;
mod error;
mod format;
mod frame;
mod map;
mod meta;
pub mod morton;
mod opened;
mod output;
pub mod quantise;
pub mod record;
mod scatter;
mod summary;
mod tree;

pub use atomic::{AtomicFile, Overwrite};
pub use cloud::{CHUNK_RECORDS, Cloud, CloudFormat, CloudWriter};
pub use error::{FormatError, Result};
pub use format::{Format, PointBlocks};
pub use frame::{Block, BlockKind, FileKind, VERSION};
pub use map::MappedFile;
pub use meta::{CloudMeta, ScatterMeta, TreeMeta};
pub use opened::Opened;
pub use record::{
    Below, Bounds, ClipEdge, Clips, Lvoxel, Node, Surfel, SurfelAggregate, SurfelLeaves,
    SurfelPage, VolumeInfo,
};
pub use scatter::{
    CLUSTER_CUBES, CLUSTER_EDGE, CUBE_EDGE, ClusterId, Scatter, ScatterFormat, ScatterWriter,
    VertexCluster,
};
pub use summary::{
    CloudSummary, ColumnBytes, LeftOut, Level, ScatterSummary, Sums, TreeSummary, VolumeSums,
    WorstError,
};
pub use tree::{
    EncodedPage, MAX_PAGE_BYTES, MAX_PAGE_RECORDS, Tree, TreeFormat, TreeWriter, node_bytes,
    surfel_bytes,
};
