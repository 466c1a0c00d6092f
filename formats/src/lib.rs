//! The files of lvox: clouds (`.lvc`), trees (`.lvt`), scattered light (`.lvs`) and packed scenes
//! (`.lvp`). `SPEC.md` is the one statement of these formats.
//!
//! [`CloudWriter`], [`TreeWriter`], [`ScatterWriter`] and [`PackedWriter`] write, [`Cloud`],
//! [`Tree`], [`Scatter`] and [`Packed`] read. Readers take any bytes; [`MappedFile`] gives those of
//! a file. Opening is cheap (header and tables), [`Opened::verify`] reads everything.
//!
//! ```
//! use lvox_formats::{Cloud, CloudMeta, CloudWriter, Overwrite, Surfel};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("one.lvc");
//! let surfel = Surfel {
//!     position: [1.0, 2.0, 3.0],
//!     normal: [0.0, 1.0, 0.0],
//!     radius: 0.5,
//!     area: 0.25,
//!     front: [0.1, 0.2, 0.4],
//!     ..Surfel::default()
//! };
//! let mut writer = CloudWriter::create(&path, CloudMeta::default(), Overwrite::Refuse)?;
//! writer.push_surfels(&[surfel])?;
//! writer.finish()?;
//!
//! let cloud = Cloud::open_path(&path)?;
//! cloud.verify()?;
//! assert_eq!(cloud.surfel_chunk(0)?, [surfel]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Which file does what:
//!
//! - `record`, `meta`, `summary`: what files hold, decoded; `parts`: what few of them hold.
//!   `check`: what every record must be.
//! - `frame`: header and block table. `format`: what tells the kinds of file apart. `opened`,
//!   `output`: the one reader and the one writer of the frame.
//! - `cloud`, `tree`, `scatter`, `packed`: the blocks of each kind. `media`: levels of
//!   volumes, coded.
//! - `quantise`: values to codes and back. `morton`, `bytes`, `codec`: tools.
//! - `atomic`, `temporary`, `map`, `scratch`, `error`: files that appear complete, folders that go
//!   away, mapped files, files without a name, and errors. `give_back`: memory of the two before.
//!   `leftover`: what a killed process left of the first two;
//!   `emergency`: what one must know that ends at once. `text`: the one line that a message is.

#![deny(missing_docs, unsafe_code)]

mod atomic;
mod bytes;
mod check;
mod cloud;
mod codec;
pub mod emergency;
mod error;
mod format;
mod frame;
mod give_back;
mod leftover;
mod map;
mod media;
mod meta;
pub mod morton;
mod opened;
mod output;
mod packed;
mod parts;
mod quantise;
pub mod record;
mod scatter;
mod scratch;
mod summary;
mod temporary;
mod text;
mod tree;

pub use atomic::{AtomicFile, Overwrite};
pub use cloud::{CHUNK_RECORDS, Cloud, CloudFormat, CloudSample, CloudWriter};
pub use error::{FormatError, Result};
pub use format::{Format, PointBlocks};
pub use frame::{Block, BlockKind, FileKind, VERSION};
pub use give_back::GiveBack;
pub use map::MappedFile;
pub use media::{
    BRICK_EDGE, BRICK_VOXELS, BrickEntry, BrickSamples, BrickTable, MediaPage, PAGE_BRICKS,
    Palette, PaletteIndex,
};
pub use meta::{CloudMeta, ScatterMeta, TreeMeta};
pub use opened::Opened;
pub use packed::{
    COLUMN_ALIGNMENT, ColumnRows, MAX_NODE_LEVELS, MediaLevel, Packed, PackedBlocks, PackedCamera,
    PackedCameraKey, PackedColumn, PackedEmissionTexture, PackedEnvironment, PackedFilm,
    PackedFormat, PackedHierarchy, PackedImage, PackedInstances, PackedLens, PackedLight,
    PackedMask, PackedMasks, PackedMaterial, PackedMesh, PackedMeta, PackedParts, PackedPhase,
    PackedPrototype, PackedSummary, PackedTexture, PackedVolume, PackedWrap, PackedWriter,
};
pub use record::{
    Below, Bounds, ClipEdge, Clips, ExtinctionColor, Lvoxel, Node, Surfel, SurfelAggregate,
    SurfelLeaves, SurfelPage, VolumeInfo,
};
pub use scatter::{
    CLUSTER_CUBES, CLUSTER_EDGE, CUBE_EDGE, ClusterId, Scatter, ScatterFormat, ScatterWriter,
    VertexCluster,
};
pub use scratch::{ScratchFile, ScratchPages};
pub use summary::{
    CloudSummary, ColumnBytes, LeftOut, ScatterSummary, Sums, TreeLevel, TreeSummary, VolumeSums,
    WorstError,
};
pub use temporary::TemporaryFolder;
pub use text::one_line;
pub use tree::{
    EncodedLvoxels, EncodedPage, MAX_PAGE_BYTES, MAX_PAGE_RECORDS, Tree, TreeFormat, TreeWriter,
    node_bytes, surfel_bytes,
};
