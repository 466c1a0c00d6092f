//! The opening that all readers share.

use crate::format::Format;
use crate::frame::{Block, FileKind, Frame};
use crate::packed::{Packed, PackedColumn};
use crate::{FormatError, MappedFile, Result, bytes, codec};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// A file whose header, metadata, summary and block table were read and checked. Its blocks are
/// decoded on request, by any number of threads.
///
/// [`crate::Cloud`], [`crate::Tree`], [`crate::Scatter`] and [`crate::Packed`] are the four kinds.
/// `D` holds the bytes of the file: a [`MappedFile`], a vector or a slice.
#[derive(Debug)]
pub struct Opened<D, F: Format> {
    data: D,
    path: Option<PathBuf>,
    meta: F::Meta,
    summary: F::Summary,
    blocks: F::Blocks,
    content_hash: [u8; 16],
    version: u32,
}

impl<F: Format> Opened<MappedFile, F> {
    /// Maps a file into memory and opens it; all errors name the file.
    ///
    /// # Errors
    /// Those of [`Opened::open`], and [`FormatError::Io`].
    pub fn open_path(path: &Path) -> Result<Self> {
        let mut opened = Self::open(MappedFile::open(path)?).map_err(|e| e.at(path))?;
        opened.path = Some(path.into());
        Ok(opened)
    }

    /// Opens a tree or scattered light: the file itself, or the one that a packed scene holds.
    ///
    /// # Errors
    /// Those of [`Opened::open_path`], and [`FormatError::Invalid`] for a packed scene that holds
    /// none.
    pub fn open_within(path: &Path) -> Result<Self> {
        let column = match F::KIND {
            FileKind::Tree => PackedColumn::Tree,
            FileKind::Scatter => PackedColumn::Light,
            FileKind::Cloud | FileKind::Packed => return Self::open_path(path),
        };
        let file = MappedFile::open(path)?;
        if !FileKind::of(file.as_ref()).is_ok_and(|kind| kind == FileKind::Packed) {
            return Self::open_path(path);
        }
        let range = Packed::open(file).map_err(|e| e.at(path))?.range(column, 0);
        if range.is_empty() {
            let expected = format!("one with a {}", F::KIND.name());
            let error = FormatError::invalid("packed scene", expected, "none in it");
            return Err(error.at(path));
        }
        let file = MappedFile::open_range(path, range)?;
        let mut opened = Self::open(file).map_err(|e| e.at(path))?;
        opened.path = Some(path.into());
        Ok(opened)
    }

    /// Gives the memory of some blocks back to the system, with what the system read around them.
    pub(crate) fn release(&self, blocks: &[Block]) {
        /// Linux maps no more around a byte that is read, by its address, but as much where it has
        /// the file in pieces as large.
        const AROUND: usize = 2 << 20;
        let start = blocks.iter().map(|b| b.offset).min().unwrap_or(0);
        let end = blocks.iter().map(|b| b.offset + u64::from(b.stored_bytes));
        let map = self.data.as_ref().as_ptr().addr();
        let start = (map + start as usize) / AROUND * AROUND;
        let end = (map + end.max().unwrap_or(0) as usize).next_multiple_of(AROUND);
        self.data.release(start.max(map) - map..end - map);
    }

    /// Gives the memory of the whole file back to the system; what is read of it later comes from
    /// the file again.
    pub fn release_all(&self) {
        self.data.release(0..usize::MAX);
    }
}

impl<D: AsRef<[u8]>, F: Format> Opened<D, F> {
    /// Reads header, metadata, summary and block table, and checks them; no block is touched.
    ///
    /// # Errors
    /// Any [`FormatError`] but `Io`, `Exists` and `InFile`.
    pub fn open(data: D) -> Result<Self> {
        let all = data.as_ref();
        let frame = Frame::read(all, F::KIND)?;
        let meta: F::Meta = codec::decode(&all[frame.meta], "metadata")?;
        F::check_meta(&meta)?;
        let summary: F::Summary = codec::decode(&all[frame.summary], "summary")?;
        F::check_summary(&summary, &meta)?;
        Ok(Self {
            path: None,
            blocks: F::arrange(frame.blocks, &summary)?,
            meta,
            summary,
            content_hash: frame.content_hash,
            version: frame.version,
            data,
        })
    }

    /// The metadata: where the file comes from.
    pub fn meta(&self) -> &F::Meta {
        &self.meta
    }

    /// The summary: what was counted while the file was written.
    pub fn summary(&self) -> &F::Summary {
        &self.summary
    }

    /// Version of the format that the file was written in.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Length of the file.
    pub fn file_bytes(&self) -> u64 {
        self.data.as_ref().len() as u64
    }

    /// Identity of everything in the file.
    pub fn content_hash(&self) -> [u8; 16] {
        self.content_hash
    }

    /// Reads the whole file and checks it: checksums, the range of every value, and what its parts
    /// say of each other.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        self.verify_with(|| Ok(()))
    }

    /// Does what [`Self::verify`] does, and calls `after_block` after each block.
    ///
    /// # Errors
    /// The first damage found, or what `after_block` returns, which ends the check.
    pub fn verify_with<E: From<FormatError>>(
        &self,
        after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        F::verify(self, after_block)
    }

    /// What holds the bytes of the file.
    pub fn data(&self) -> &D {
        &self.data
    }

    /// The block table.
    pub(crate) fn table(&self) -> &F::Blocks {
        &self.blocks
    }

    /// Runs something whose errors are to name the file.
    pub(crate) fn named<T>(&self, run: impl FnOnce() -> Result<T>) -> Result<T> {
        run().map_err(|e| match &self.path {
            Some(path) => e.at(path),
            None => e,
        })
    }

    /// The bytes of a block as they are in the file. Its checksum is not looked at.
    pub(crate) fn stored(&self, block: &Block) -> &[u8] {
        let start = block.offset as usize;
        &self.data.as_ref()[start..start + block.stored_bytes as usize]
    }

    /// Checks and decompresses block `i` of a list, and decodes it; `name` is that of such a block.
    pub(crate) fn unpacked<T>(
        &self,
        blocks: &[Block],
        i: usize,
        name: &str,
        decode: impl FnOnce(&[u8], &Block) -> Result<T>,
    ) -> Result<T> {
        /// Bytes that a thread keeps for the next block, at most.
        const MOST_KEPT: usize = 1 << 20;
        thread_local! {
            static RAW: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
        }
        self.named(|| {
            let block = nth(blocks, i, name)?;
            let stored = self.stored(block);
            bytes::check(stored, block.checksum, || format!("{name} {i}"))?;
            let decoded = if block.stored_bytes == block.raw_bytes {
                decode(stored, block)
            } else {
                // Taken, as what decodes may read another block.
                let mut raw = RAW.take();
                raw.resize(block.raw_bytes as usize, 0);
                let decoded = bytes::decompress(stored, &mut raw, "compressed data")
                    .and_then(|()| decode(&raw, block));
                if raw.capacity() <= MOST_KEPT {
                    RAW.set(raw);
                }
                decoded
            };
            decoded.map_err(|e| e.within(&format!("{name} {i}")))
        })
    }
}

/// Entry `i` of a list of blocks.
pub fn nth<'a>(blocks: &'a [Block], i: usize, name: &str) -> Result<&'a Block> {
    let below = || FormatError::invalid(name, format!("below {}", blocks.len()), i);
    blocks.get(i).ok_or_else(below)
}

/// Checks the sizes of block `i` of a file whose blocks are compressed whole.
pub fn check_sizes(block: &Block, i: usize, max_raw_bytes: usize) -> Result<()> {
    if block.raw_bytes as usize <= max_raw_bytes && block.stored_bytes <= block.raw_bytes {
        return Ok(());
    }
    Err(FormatError::invalid(
        format!("bytes of block {i}"),
        format!("at most {max_raw_bytes}, and no more stored than raw"),
        format!("{} stored, {} raw", block.stored_bytes, block.raw_bytes),
    ))
}
