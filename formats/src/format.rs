//! What tells the four kinds of file apart, for the one reader and the one writer of their frame.

use crate::frame::{Block, FileKind};
use crate::opened::Opened;
use crate::summary::Sums;
use crate::{FormatError, Result};

/// A kind of file: its metadata, its summary and the rules that they and the block table keep.
///
/// [`crate::CloudFormat`], [`crate::TreeFormat`], [`crate::ScatterFormat`] and
/// [`crate::PackedFormat`] implement it; there are no others.
pub trait Format: Sized {
    /// Metadata: where the file comes from.
    type Meta: bincode::Encode + bincode::Decode<()> + std::fmt::Debug;
    /// Summary: what was counted while the file was written.
    type Summary: bincode::Encode + bincode::Decode<()> + std::fmt::Debug;
    /// Entries of the block table, as readers look them up.
    type Blocks: std::fmt::Debug;
    /// The kind that the header states.
    const KIND: FileKind;

    /// Refuses metadata that readers cannot rely on.
    ///
    /// # Errors
    /// [`FormatError::Invalid`].
    fn check_meta(meta: &Self::Meta) -> Result<()>;

    /// Refuses a summary that readers cannot rely on; writers ask this, too, so that they write
    /// none that no reader takes.
    ///
    /// # Errors
    /// [`FormatError::Invalid`].
    fn check_summary(summary: &Self::Summary, meta: &Self::Meta) -> Result<()>;

    /// Checks the block table against the summary, and arranges it.
    ///
    /// # Errors
    /// [`FormatError::Invalid`].
    fn arrange(blocks: Vec<Block>, summary: &Self::Summary) -> Result<Self::Blocks>;

    /// Reads every block and checks every value; calls `after_block` after each block.
    ///
    /// # Errors
    /// The first damage found, or what `after_block` returns.
    fn verify<D: AsRef<[u8]>, E: From<FormatError>>(
        file: &Opened<D, Self>,
        after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E>;
}

/// The block table of a cloud or a tree: entries of surfels and of lvoxels, each in file order.
#[derive(Clone, Debug)]
pub struct PointBlocks {
    pub(crate) surfels: Vec<Block>,
    pub(crate) lvoxels: Vec<Block>,
}

impl PointBlocks {
    /// Sorts entries by kind, has each checked, and checks the counts that the summary gives. A
    /// large tree has millions: they are walked once.
    pub(crate) fn new(
        mut blocks: Vec<Block>,
        sums: &Sums,
        mut check: impl FnMut(usize, &Block) -> Result<()>,
    ) -> Result<Self> {
        let is_surfels = |b: &Block| b.kind == crate::BlockKind::Surfels;
        let mut records = [0_u64; 2];
        let (mut of_surfels, mut end_of_surfels) = (0, 0);
        for (i, block) in blocks.iter().enumerate() {
            check(i, block)?;
            let kind = usize::from(!is_surfels(block));
            records[kind] += u64::from(block.records);
            if kind == 0 {
                of_surfels += 1;
                end_of_surfels = i + 1;
            }
        }
        expect_count("surfels", records[0], sums.surfels)?;
        expect_count("lvoxels", records[1], sums.lvoxels())?;
        // Writers put all of them before the others.
        let lvoxels = if of_surfels == end_of_surfels {
            blocks.split_off(end_of_surfels)
        } else {
            let lvoxels = blocks.iter().filter(|b| !is_surfels(b)).copied().collect();
            blocks.retain(is_surfels);
            lvoxels
        };
        let surfels = blocks;
        Ok(Self { surfels, lvoxels })
    }
}

/// Checks a count of the summary against that of the rest of the file.
pub fn expect_count(what: &str, expected: u64, found: u64) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    let what = format!("{what} in the summary");
    Err(FormatError::invalid(what, expected.to_string(), found))
}
