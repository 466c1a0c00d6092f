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
mod frame;
mod map;
mod meta;
pub mod morton;
mod output;
pub mod quantise;
pub mod record;
mod scatter;
mod summary;
mod tree;

pub use atomic::AtomicFile;
pub use cloud::{CHUNK_RECORDS, Cloud, CloudWriter};
pub use error::{FormatError, Result};
pub use frame::{Block, BlockKind, FileKind, VERSION};
pub use map::MappedFile;
pub use meta::{CloudMeta, ScatterMeta, TreeMeta};
pub use record::{
    Below, Bounds, ClipEdge, Clips, Lvoxel, Node, Surfel, SurfelAggregate, SurfelLeaves,
    SurfelPage, VolumeInfo,
};
pub use scatter::{PART_CUBES, PART_EDGE, Part, PartPlace, Scatter, ScatterWriter, VERTEX_CUBE};
pub use summary::{
    CloudSummary, ColumnBytes, LeftOut, Level, ScatterSummary, Sums, TreeSummary, VolumeSums,
    WorstError,
};
pub use tree::{
    EncodedPage, MAX_PAGE_BYTES, MAX_PAGE_RECORDS, Tree, TreeWriter, node_bytes, surfel_bytes,
};
