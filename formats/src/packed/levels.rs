//! Levels of volumes in a packed scene: for each a block of its table, then its pages.

use super::meta::{PackedMeta, PackedVolume};
use super::read::{Packed, PackedBlocks};
use super::write::PackedWriter;
use crate::bytes::{self, Cursor};
use crate::format::expect_count;
use crate::frame::{Block, BlockKind};
use crate::media::{self, BrickSamples, BrickTable, Coding, ENTRY_BYTES, MediaPage, PAGE_BRICKS};
use crate::opened::nth;
use crate::output::BlockContent;
use crate::{FormatError, MappedFile, Palette, Result};
use std::ops::Range;
use xxhash_rust::xxh3::xxh3_64;

/// Fast, and tables are small beside pages.
const ZSTD_LEVEL: i32 = 3;

/// Where a level lies in a file: the block of its table, then those of its pages.
#[derive(Clone, Debug)]
pub struct LevelBlocks {
    table: usize,
    pages: Range<usize>,
}

/// A level of a volume whose table was read.
#[derive(Debug)]
pub struct MediaLevel {
    /// Voxels along x, y, z.
    pub dims: [u32; 3],
    table: BrickTable,
    palette: Palette,
    pages: Range<usize>,
}

impl MediaLevel {
    /// Its bricks.
    #[must_use]
    pub fn table(&self) -> &BrickTable {
        &self.table
    }

    /// The block of a page.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for a page that does not exist.
    pub fn block(&self, page: usize) -> Result<usize> {
        let found = self.pages.clone().nth(page);
        let below = || FormatError::invalid("page", format!("below {}", self.pages.len()), page);
        found.ok_or_else(below)
    }
}

/// Bricks of page `page` of a level of so many.
fn bricks_of_page(bricks: u64, page: usize) -> u64 {
    let left = bricks.saturating_sub((page as u64).saturating_mul(PAGE_BRICKS as u64));
    left.min(PAGE_BRICKS as u64)
}

/// Finds the blocks of all levels, by volume and level, from block `next` on, where they have to
/// lie one after the other up to the last block.
pub fn arrange(
    blocks: &[Block],
    mut next: usize,
    bricks: &[Vec<u64>],
) -> Result<Vec<Vec<LevelBlocks>>> {
    let mut volumes = Vec::with_capacity(bricks.len());
    for (volume, levels) in (0..).zip(bricks) {
        let mut found = Vec::with_capacity(levels.len());
        for (level, &count) in (0..).zip(levels) {
            let table = next;
            next += 1;
            let first = next;
            for page in 0..usize::try_from(count.div_ceil(PAGE_BRICKS as u64)).unwrap_or(usize::MAX)
            {
                check_page(
                    nth(blocks, next, "block")?,
                    next,
                    volume,
                    bricks_of_page(count, page),
                )?;
                next += 1;
            }
            // There are as many bricks as the table claims: what it takes is bounded by the file.
            check_table(nth(blocks, table, "block")?, table, [volume, level], count)?;
            found.push(LevelBlocks {
                table,
                pages: first..next,
            });
        }
        volumes.push(found);
    }
    expect_count("blocks", next as u64, blocks.len() as u64)?;
    Ok(volumes)
}

fn check_table(block: &Block, i: usize, [volume, level]: [u32; 2], bricks: u64) -> Result<()> {
    let entries = bricks.saturating_mul(ENTRY_BYTES as u64);
    let raw = entries + 4..=entries + 4 + Palette::MOST_BYTES as u64;
    let is_right = block.kind == BlockKind::MediaTable
        && (block.nodes, block.columns) == (volume, level)
        && u64::from(block.records) == bricks
        && raw.contains(&u64::from(block.raw_bytes))
        && block.stored_bytes <= block.raw_bytes;
    if is_right {
        return Ok(());
    }
    let expected = format!("the table of {bricks} bricks of level {level} of volume {volume}");
    Err(FormatError::invalid(
        format!("block {i}"),
        expected,
        format!("{block:?}"),
    ))
}

fn check_page(block: &Block, i: usize, volume: u32, bricks: u64) -> Result<()> {
    let is_right = block.kind == BlockKind::MediaPage
        && block.nodes == volume
        && u64::from(block.records) == bricks;
    if !is_right {
        let expected = format!("a page of {bricks} bricks of volume {volume}");
        return Err(FormatError::invalid(
            format!("block {i}"),
            expected,
            format!("{block:?}"),
        ));
    }
    let coding = Coding::read(block.columns).map_err(|e| e.within(&format!("block {i}")))?;
    let raw = coding.raw_bytes(bricks as usize);
    if block.raw_bytes as usize != raw || block.stored_bytes > block.raw_bytes {
        let expected = format!("{raw} raw bytes, and no more stored");
        return Err(FormatError::invalid(
            format!("block {i}"),
            expected,
            format!("{block:?}"),
        ));
    }
    Ok(())
}

impl PackedWriter {
    /// Appends the table of the next level of a volume. All levels come in order, those of the
    /// first volume first; each with its pages before the next.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another level than the next, or another number of bricks;
    /// [`FormatError::Io`].
    pub fn level(&mut self, table: &BrickTable, palette: Option<&Palette>) -> Result<()> {
        let path = self.file.path().to_owned();
        let count = table.entries().len() as u64;
        let expected = self.bricks_of_next_level();
        if expected != Some(count) || self.left > 0 {
            let expected = format!("one of {expected:?} bricks, after all pages of the last");
            return Err(FormatError::invalid("level", expected, count).at(&path));
        }
        let values = palette.map_or(0, |p| p.values().len()) as u32;
        let mut raw = values.to_le_bytes().to_vec();
        raw.extend(palette.map(Palette::encode).unwrap_or_default());
        raw.extend(table.encode());
        let raw_bytes = u32::try_from(raw.len()).map_err(|_| {
            FormatError::invalid("table of a level", "at most 4 GiB", raw.len()).at(&path)
        })?;
        let compressed = bytes::compress(&raw, ZSTD_LEVEL).map_err(|e| e.at(&path))?;
        let stored = compressed.as_ref().unwrap_or(&raw);
        let [volume, level] = self.next_level;
        self.file.push(&BlockContent {
            kind: BlockKind::MediaTable,
            stored,
            raw_bytes,
            records: count as u32,
            nodes: volume,
            columns: level,
            checksum: xxh3_64(stored),
        })?;
        self.left = count;
        self.next_level = [volume, level + 1];
        Ok(())
    }

    /// Appends the next page of the level whose table was appended last.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another number of bricks than the next page has;
    /// [`FormatError::Io`].
    pub fn page(&mut self, page: &MediaPage) -> Result<()> {
        let expected = self.left.min(PAGE_BRICKS as u64);
        let count = u64::from(page.bricks);
        if count != expected {
            let error = FormatError::invalid("bricks of a page", expected.to_string(), count);
            return Err(error.at(self.file.path()));
        }
        self.left -= count;
        self.file.push(&BlockContent {
            kind: BlockKind::MediaPage,
            stored: &page.stored,
            raw_bytes: page.raw_bytes,
            records: page.bricks,
            nodes: self.next_level[0],
            columns: page.coding.code(),
            checksum: xxh3_64(&page.stored),
        })
    }

    /// Bricks of the level that comes next; steps to the next volume behind the last of one.
    fn bricks_of_next_level(&mut self) -> Option<u64> {
        let [volume, level] = self.next_level;
        let levels = self.expected.bricks.get(volume as usize)?;
        if let Some(count) = levels.get(level as usize) {
            return Some(*count);
        }
        self.next_level = [volume + 1, 0];
        self.expected
            .bricks
            .get(volume as usize + 1)?
            .first()
            .copied()
    }

    /// Whether all levels and pages were appended.
    pub(super) fn has_all_levels(&mut self) -> bool {
        self.left == 0 && self.bricks_of_next_level().is_none()
    }
}

impl Packed<MappedFile> {
    /// Gives the memory of a page of a level back to the system, once its samples were taken.
    pub fn release_page(&self, level: &MediaLevel, page: usize) {
        if let Ok(block) = level.block(page) {
            self.release(&self.blocks()[block..=block]);
        }
    }
}

impl<D: AsRef<[u8]>> Packed<D> {
    /// The blocks of a level of a volume, its table first.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for a level that does not exist.
    pub fn level_blocks(&self, volume: usize, level: usize) -> Result<Range<usize>> {
        let blocks = level_blocks(self.table(), volume, level)?;
        Ok(blocks.table..blocks.pages.end)
    }

    /// Reads the table of a level of a volume.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for a level that does
    /// not exist.
    pub fn level(&self, volume: usize, level: usize) -> Result<MediaLevel> {
        let blocks = self.named(|| level_blocks(self.table(), volume, level).cloned())?;
        let dims = nth_volume(self.meta(), volume)?.dims_of_level(level);
        let count = self.blocks()[blocks.table].records as usize;
        self.unpacked(self.blocks(), blocks.table, "block", |raw, _| {
            let mut cursor = Cursor::new(raw, "table of a level");
            let values = cursor.u32()? as usize;
            let palette = Palette::decode(&mut cursor, values)?;
            let table = BrickTable::decode(&mut cursor, count, dims)?;
            cursor.end()?;
            Ok(MediaLevel {
                dims,
                table,
                palette,
                pages: blocks.pages.clone(),
            })
        })
    }

    /// Decodes a page of a level, and gives the samples of each brick to `take` with its number
    /// among those of the page. They are what the table says.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for a page that does
    /// not exist.
    pub fn media_page(
        &self,
        level: &MediaLevel,
        page: usize,
        mut take: impl FnMut(usize, &BrickSamples),
    ) -> Result<()> {
        let block = self.named(|| level.block(page))?;
        let entries = level.table.entries().chunks(PAGE_BRICKS).nth(page);
        let entries = entries.unwrap_or_default();
        self.unpacked(self.blocks(), block, "block", |raw, block| {
            let coding = Coding::read(block.columns)?;
            media::decode(raw, coding, entries.len(), &level.palette, |i, samples| {
                entries[i].check(samples)?;
                take(i, samples);
                Ok(())
            })
        })
    }

    /// Checks all levels of all volumes; calls `after_block` after each block.
    pub(super) fn check_levels<E: From<FormatError>>(
        &self,
        mut after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        for (volume, info) in self.meta().volumes.iter().enumerate() {
            for i in 0..info.levels.len() {
                let level = self.level(volume, i)?;
                after_block()?;
                for page in 0..level.pages.len() {
                    self.media_page(&level, page, |_, _| ())?;
                    after_block()?;
                }
            }
        }
        Ok(())
    }
}

fn level_blocks(blocks: &PackedBlocks, volume: usize, level: usize) -> Result<&LevelBlocks> {
    let found = blocks
        .levels
        .get(volume)
        .and_then(|levels| levels.get(level));
    found.ok_or_else(|| {
        let found = format!("level {level} of volume {volume}");
        FormatError::invalid("level of a volume", "one that is there", found)
    })
}

fn nth_volume(meta: &PackedMeta, volume: usize) -> Result<&PackedVolume> {
    let all = &meta.volumes;
    let found = all.get(volume);
    found.ok_or_else(|| FormatError::invalid("volume", format!("below {}", all.len()), volume))
}
