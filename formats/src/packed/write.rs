//! Writing a packed scene: columns in their order, then levels of volumes.

use super::column::{COLUMN_ALIGNMENT, ColumnRows, PackedColumn, check_rows};
use super::meta::{PackedMeta, PackedSummary};
use super::read::PackedFormat;
use crate::frame::BlockKind;
use crate::output::{BlockContent, BlockWriter};
use crate::{FormatError, Overwrite, Result};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

/// Writes a packed scene: first the columns that [`PackedMeta::columns`] lists, in that order, then
/// the levels of each volume. Memory is that of a block, or of the table of a level.
///
/// The file gets its name in [`Self::finish`]; dropped before that, the writer leaves nothing
/// behind.
pub struct PackedWriter {
    pub(super) file: BlockWriter<PackedFormat>,
    /// What is to be in the file.
    pub(super) expected: PackedSummary,
    /// Columns so far.
    columns: usize,
    /// The volume and level whose table comes next.
    pub(super) next_level: [u32; 2],
    /// Bricks of the level before that have not come.
    pub(super) left: u64,
}

impl PackedWriter {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// [`FormatError::Exists`] if the file may not be replaced, [`FormatError::Folder`] if the
    /// folder cannot be written, [`FormatError::Invalid`] for metadata that no reader would accept.
    pub fn create(path: &Path, meta: PackedMeta, overwrite: Overwrite) -> Result<Self> {
        Ok(Self {
            expected: meta.summary(),
            columns: 0,
            next_level: [0; 2],
            left: 0,
            file: BlockWriter::create(path, meta, overwrite)?,
        })
    }

    /// Appends the next column, whose rows these bytes are. Calls `after_piece` after each piece of
    /// it.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another column than the next, another number of rows, or rows
    /// that no reader would accept; [`FormatError::Io`]; or what `after_piece` returns.
    pub fn column<E: From<FormatError>>(
        &mut self,
        column: PackedColumn,
        item: u32,
        bytes: &[u8],
        mut after_piece: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        let width = column.width();
        let found = ColumnRows {
            column,
            item,
            rows: (bytes.len() / width) as u64,
        };
        let next = self.expected.columns.get(self.columns);
        if next != Some(&found) || !bytes.len().is_multiple_of(width) {
            let expected = format!("{next:?}");
            let error = FormatError::invalid("next column", expected, format!("{found:?}"));
            return Err(error.at(self.file.path()).into());
        }
        self.columns += 1;
        self.align()?;
        for (i, piece) in bytes.chunks(column.piece_rows() * width).enumerate() {
            let first = (i * column.piece_rows()) as u64;
            check_rows((column, item), first, piece, &self.file.meta)
                .map_err(|e| e.at(self.file.path()))?;
            self.file.push(&BlockContent {
                kind: BlockKind::Column,
                stored: piece,
                raw_bytes: piece.len() as u32,
                records: (piece.len() / width) as u32,
                nodes: item,
                columns: column.code(),
                checksum: xxh3_64(piece),
            })?;
            after_piece()?;
        }
        Ok(())
    }

    /// Fills up to where a column may start.
    fn align(&mut self) -> Result<()> {
        let missing =
            self.file.position().next_multiple_of(COLUMN_ALIGNMENT) - self.file.position();
        if missing == 0 {
            return Ok(());
        }
        let zeros = vec![0; missing as usize];
        self.file.push(&BlockContent {
            kind: BlockKind::Padding,
            stored: &zeros,
            raw_bytes: missing as u32,
            records: 0,
            nodes: 0,
            columns: 0,
            checksum: xxh3_64(&zeros),
        })
    }

    /// Writes the tables, and gives the file its name.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] if columns or levels are missing; [`FormatError::Io`],
    /// [`FormatError::Exists`] if the name was taken meanwhile.
    pub fn finish(mut self) -> Result<()> {
        let is_whole = self.columns == self.expected.columns.len() && self.has_all_levels();
        if !is_whole {
            let found = format!(
                "{} columns, levels up to {:?}",
                self.columns, self.next_level
            );
            let error =
                FormatError::invalid("parts of the scene", format!("{:?}", self.expected), found);
            return Err(error.at(self.file.path()));
        }
        self.file.finish(&self.expected)
    }
}
