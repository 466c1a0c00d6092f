//! What is in a cloud or a tree, for people and for scripts: descriptions, first points, PLY for viewers, and the
//! complete check of a file.

mod describe;
mod ply;
mod points;
mod samples;
mod text;
mod verify;

pub use describe::{BlockSizes, Description, PointKind, describe};
pub use ply::{Exported, export_ply};
pub use points::{Points, points};
pub use samples::{Samples, samples};
pub use verify::{Check, Depth, Verification, verify};

use crate::Result;
use crate::formats::{Cloud, FileKind, MappedFile, Tree};
use std::path::Path;

/// Either file, opened.
enum File {
    Cloud(Cloud<MappedFile>),
    Tree(Tree<MappedFile>),
}

impl File {
    fn open(path: &Path) -> Result<Self> {
        let kind = FileKind::of(MappedFile::open(path)?.as_ref()).map_err(|e| e.at(path))?;
        Ok(match kind {
            FileKind::Cloud => Self::Cloud(Cloud::open_path(path)?),
            FileKind::Tree => Self::Tree(Tree::open_path(path)?),
        })
    }
}
