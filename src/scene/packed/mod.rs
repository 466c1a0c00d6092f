//! A scene as a packed file holds it: one file, no assets, columns used as they lie there.
//!
//! - `instances`: what is stored once and placed many times
//! - `write`: a scene to its description and columns
//! - `read`: description and columns to a scene

mod instances;
mod read;
mod write;

pub(super) use read::read;
pub use write::{columns, description, level_tables, media};

use super::Mesh;
use crate::column::Column;
use crate::formats::{MappedFile, Packed, PackedColumn};
use crate::run::Lists;
use crate::{Error, Result};
use bytemuck::Pod;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The file that a scene lies in.
#[derive(Clone, Debug)]
pub struct PackedScene {
    file: Arc<Packed<MappedFile>>,
    path: PathBuf,
    /// Where the grids of its volumes go.
    lists: Lists,
}

impl PackedScene {
    /// The file itself.
    #[must_use]
    pub fn file(&self) -> &Packed<MappedFile> {
        &self.file
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Bytes of the file that are used where they lie.
    pub(in crate::scene) fn mapped_bytes(&self) -> u64 {
        let columns = self.file.columns().iter().map(|(rows, _)| rows);
        let used =
            columns.filter(|rows| !matches!(rows.column, PackedColumn::Tree | PackedColumn::Light));
        used.map(|rows| self.file.range(rows.column, rows.item).len() as u64)
            .sum()
    }

    /// Gives the memory of vertices and triangles back to the system, which reads them again for
    /// who asks.
    pub(in crate::scene) fn release_mesh(&self) {
        for column in [
            PackedColumn::Positions,
            PackedColumn::Normals,
            PackedColumn::Colors,
            PackedColumn::Uvs,
            PackedColumn::Triangles,
            PackedColumn::Materials,
            PackedColumn::Opacities,
        ] {
            self.file.data().release(self.file.range(column, 0));
        }
    }

    /// Whether the triangles of a mesh lie in the file, which then has what was made of them.
    pub(in crate::scene) fn has(&self, mesh: &Mesh) -> bool {
        let lies = |bytes: &[u8], column: PackedColumn| {
            let rows = self.file.rows(column, 0);
            bytes.len() == rows.len() && (rows.is_empty() || bytes.as_ptr() == rows.as_ptr())
        };
        lies(
            bytemuck::cast_slice(&mesh.positions),
            PackedColumn::Positions,
        ) && lies(
            bytemuck::cast_slice(&mesh.triangles),
            PackedColumn::Triangles,
        ) && lies(
            bytemuck::cast_slice(&mesh.material),
            PackedColumn::Materials,
        )
    }

    /// A column where it lies.
    ///
    /// # Errors
    /// A machine whose numbers are not those of files.
    pub fn column<T: Pod>(&self, column: PackedColumn, item: u32) -> Result<Column<T>> {
        check_machine()?;
        let rows = Column::mapped(self.file.data(), self.file.range(column, item));
        rows.ok_or_else(|| {
            Error::input(format!(
                "the {} of the packed scene are not where a machine could use them",
                column.name()
            ))
        })
    }
}

/// Refuses machines whose numbers are not little-endian: rows are used as they lie in the file.
pub fn check_machine() -> Result<()> {
    if cfg!(target_endian = "little") {
        return Ok(());
    }
    Err(Error::input(
        "packed scenes are for machines with little-endian numbers",
    ))
}
