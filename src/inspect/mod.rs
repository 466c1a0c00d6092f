//! What is in a cloud, a tree, scattered light, a packed scene or a scene, for people and for
//! scripts: descriptions, first points, PLY for viewers, and the complete check of a file.
//!
//! In: the path of a file. Out: values that print as text and serialise as JSON.
//!
//! - `describe`: a cloud or a tree; `scatter`: scattered light; `packed`: a packed scene;
//!   `samples`: samples of a reference.
//! - `scene`: scene, mesh and volume files, read as for rendering.
//! - `points`: the first points; `ply`: all points, for viewers.
//! - `page`: one page of HTML to look into a file with.
//! - `verify`: the complete check. `text`: tables. `disk`: points as viewers draw them.

mod describe;
mod disk;
mod packed;
mod page;
mod ply;
mod points;
mod samples;
mod scatter;
mod scene;
mod text;
mod verify;

pub use describe::{BlockSizes, Description, PointKind, describe};
pub use packed::{PackedDescription, PackedPart, packed};
pub use page::{Shown, page};
pub use ply::{Exported, export_ply};
pub use points::{Points, points};
pub use samples::{Samples, samples};
pub use scatter::{Scattered, scattered};
pub use scene::{
    CameraDescription, LensDescription, LightDescription, MaterialDescription, MeshDescription,
    ReadFile, SceneDescription, TextureDescription, ValueHistogram, VolumeDescription, WorldBox,
    scene,
};
pub use verify::{Check, Depth, Verification, verify};

use crate::formats::{Cloud, FileKind, FormatError, MappedFile, Tree};
use crate::{Error, Result};
use std::path::Path;

/// Refuses a file that is of another format than those of lvox, and says of which kinds it should
/// be.
///
/// # Errors
/// [`crate::Kind::Input`], also for a file that cannot be read.
pub fn refuse_other_formats(path: &Path, kinds: &str) -> Result<()> {
    let kind = FileKind::of(MappedFile::open(path)?.as_ref());
    kind.map(drop).map_err(|error| {
        let is_other = matches!(error, FormatError::NotOurs { .. });
        let error = Error::from(error.at(path));
        match is_other {
            true => error.hint(format!("give {kinds}")),
            false => error,
        }
    })
}

/// A file that has points, opened: a cloud or a tree.
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
            kind @ (FileKind::Scatter | FileKind::Packed) => {
                let found = match kind {
                    FileKind::Packed => "a packed scene",
                    _ => "scattered light",
                };
                return Err(Error::input(format!(
                    "{}: expected a cloud or a tree, found {found}, which has no points",
                    path.display()
                )));
            }
        })
    }
}
