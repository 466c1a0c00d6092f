//! Reading a packed scene.

use super::column::{COLUMN_ALIGNMENT, ColumnRows, PackedColumn, check_rows};
use super::hierarchy;
use super::levels::{self, LevelBlocks};
use super::meta::{PackedMeta, PackedSummary};
use crate::format::Format;
use crate::frame::{Block, BlockKind, FileKind};
use crate::opened::{Opened, nth};
use crate::{FormatError, MappedFile, Result, bytes};
use std::ops::Range;

/// The format of a packed scene.
#[derive(Debug)]
pub enum PackedFormat {}

/// A packed scene that was opened: columns as they lie in the file, and levels of volumes.
pub type Packed<D> = Opened<D, PackedFormat>;

/// The block table of a packed scene.
#[derive(Clone, Debug)]
pub struct PackedBlocks {
    all: Vec<Block>,
    /// Columns, and which blocks each has.
    columns: Vec<(ColumnRows, Range<usize>)>,
    /// By volume and level, where its blocks are.
    pub(super) levels: Vec<Vec<LevelBlocks>>,
}

impl Format for PackedFormat {
    type Meta = PackedMeta;
    type Summary = PackedSummary;
    type Blocks = PackedBlocks;
    const KIND: FileKind = FileKind::Packed;

    fn check_meta(meta: &PackedMeta) -> Result<()> {
        meta.validate()
    }

    fn check_summary(summary: &PackedSummary, meta: &PackedMeta) -> Result<()> {
        if *summary == meta.summary() {
            return Ok(());
        }
        Err(FormatError::invalid(
            "columns in the summary",
            "those of the metadata",
            format!("{} others", summary.columns.len()),
        ))
    }

    fn arrange(blocks: Vec<Block>, summary: &PackedSummary) -> Result<PackedBlocks> {
        let mut next = 0;
        let mut columns = Vec::with_capacity(summary.columns.len());
        for &rows in &summary.columns {
            next += usize::from(check_padding(&blocks, next)?);
            let first = next;
            let mut left = rows.rows;
            while left > 0 {
                left -= check_piece(&blocks, next, next == first, rows, left)?;
                next += 1;
            }
            columns.push((rows, first..next));
        }
        let levels = levels::arrange(&blocks, next, &summary.bricks)?;
        Ok(PackedBlocks {
            all: blocks,
            columns,
            levels,
        })
    }

    fn verify<D: AsRef<[u8]>, E: From<FormatError>>(
        file: &Packed<D>,
        mut after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        let kind = |i: usize| file.blocks()[i].kind;
        let columns = (0..file.blocks().len())
            .filter(|i| !matches!(kind(*i), BlockKind::MediaTable | BlockKind::MediaPage));
        for i in columns {
            file.check_block(i)?;
            after_block()?;
        }
        file.check_levels(&mut after_block)?;
        Ok(file.check_hierarchy()?)
    }
}

/// Whether the next block is padding, as it is if a column may not start there.
fn check_padding(blocks: &[Block], i: usize) -> Result<bool> {
    let block = nth(blocks, i, "block")?;
    let missing = block.offset.next_multiple_of(COLUMN_ALIGNMENT) - block.offset;
    if block.kind != BlockKind::Padding {
        return Ok(false);
    }
    let is_right = u64::from(block.stored_bytes) == missing
        && missing > 0
        && block.raw_bytes == block.stored_bytes
        && block.records == 0
        && block.nodes == 0
        && block.columns == 0;
    match is_right {
        true => Ok(true),
        false => Err(FormatError::invalid(
            format!("block {i}"),
            format!("padding of {missing} bytes"),
            format!("{block:?}"),
        )),
    }
}

/// Checks that a block is the next piece of a column, and returns its rows.
fn check_piece(
    blocks: &[Block],
    i: usize,
    is_first: bool,
    of: ColumnRows,
    left: u64,
) -> Result<u64> {
    let block = nth(blocks, i, "block")?;
    let rows = left.min(of.column.piece_rows() as u64);
    let stored = rows * of.column.width() as u64;
    let is_right = block.kind == BlockKind::Column
        && block.columns == of.column.code()
        && block.nodes == of.item
        && u64::from(block.records) == rows
        && u64::from(block.stored_bytes) == stored
        && block.raw_bytes == block.stored_bytes;
    let is_aligned = !is_first || block.offset.is_multiple_of(COLUMN_ALIGNMENT);
    if is_right && is_aligned {
        return Ok(rows);
    }
    let place = if is_aligned { "" } else { ", aligned" };
    Err(FormatError::invalid(
        format!("block {i}"),
        format!("{rows} rows of the {} {}{place}", of.column.name(), of.item),
        format!("{block:?}"),
    ))
}

impl Packed<MappedFile> {
    /// Refuses a file that has been cut since it was opened, as [`MappedFile::check_length`] does.
    ///
    /// # Errors
    /// [`FormatError::Truncated`], [`FormatError::Io`], with the path.
    pub fn check_length(&self) -> Result<()> {
        self.named(|| self.data().check_length())
    }

    /// Gives the memory of block `i` back to the system, as [`MappedFile::release`] does.
    pub fn release_block(&self, i: usize) {
        if let Some(block) = self.blocks().get(i) {
            self.release(std::slice::from_ref(block));
        }
    }
}

impl<D: AsRef<[u8]>> Packed<D> {
    /// Blocks, in file order.
    pub fn blocks(&self) -> &[Block] {
        &self.table().all
    }

    /// Columns that are there, in file order, each with the numbers of its blocks.
    pub fn columns(&self) -> &[(ColumnRows, Range<usize>)] {
        &self.table().columns
    }

    fn pieces(&self, column: PackedColumn, item: u32) -> Option<Range<usize>> {
        let mut columns = self.columns().iter();
        let found = columns.find(|(c, _)| c.column == column && c.item == item);
        found.map(|(_, blocks)| blocks.clone())
    }

    /// Where the rows of a column are in the file: from a multiple of [`COLUMN_ALIGNMENT`] on, or
    /// an empty range if there are none. Whether they are right is for [`Self::check_block`].
    pub fn range(&self, column: PackedColumn, item: u32) -> Range<usize> {
        let Some(pieces) = self.pieces(column, item) else {
            return 0..0;
        };
        let (first, last) = (&self.blocks()[pieces.start], &self.blocks()[pieces.end - 1]);
        first.offset as usize..last.offset as usize + last.stored_bytes as usize
    }

    /// The rows of a column, as [`Self::range`] tells them.
    pub fn rows(&self, column: PackedColumn, item: u32) -> &[u8] {
        &self.data().as_ref()[self.range(column, item)]
    }

    /// Checks the bytes of block `i`, and all that a column holds there by itself.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn check_block(&self, i: usize) -> Result<()> {
        let block = *nth(self.blocks(), i, "block")?;
        self.named(|| {
            let stored = self.stored(&block);
            bytes::check(stored, block.checksum, || format!("block {i}"))?;
            if block.kind == BlockKind::Padding {
                return match stored.iter().all(|b| *b == 0) {
                    true => Ok(()),
                    false => Err(FormatError::invalid(
                        format!("block {i}"),
                        "zeros",
                        "others",
                    )),
                };
            }
            let columns = self.columns();
            let at = columns.partition_point(|(_, pieces)| pieces.end <= i);
            let Some((of, pieces)) = columns.get(at) else {
                return Ok(());
            };
            let first = (i - pieces.start) as u64 * of.column.piece_rows() as u64;
            check_rows((of.column, of.item), first, stored, self.meta())
        })
    }

    /// Checks that nodes, each of which [`Self::check_block`] found right, are a tree for each
    /// item.
    ///
    /// # Errors
    /// [`FormatError::Invalid`].
    pub fn check_hierarchy(&self) -> Result<()> {
        let columns = self.columns().iter();
        let nodes = columns.filter(|(c, _)| c.column == PackedColumn::Nodes);
        self.named(|| {
            let mut trees = nodes.map(|(c, _)| self.rows(c.column, c.item));
            trees.try_for_each(hierarchy::check_tree)
        })
    }
}
