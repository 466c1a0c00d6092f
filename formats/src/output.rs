//! The writing that all writers share: blocks behind room for a header, then the sections.

use crate::format::Format;
use crate::frame::{self, Block, BlockKind, HEADER_LEN};
use crate::{AtomicFile, FormatError, Overwrite, Result, codec};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// A file of blocks while it is written. Dropped unfinished, it leaves nothing behind.
pub struct BlockWriter<F: Format> {
    file: BufWriter<AtomicFile>,
    /// Bytes so far, the header's room included: where the next byte goes.
    position: u64,
    pub meta: F::Meta,
    pub blocks: Vec<Block>,
}

/// A block that is ready to be written, but for its place in the file.
pub struct BlockContent<'a> {
    pub kind: BlockKind,
    pub stored: &'a [u8],
    pub raw_bytes: u32,
    pub records: u32,
    pub nodes: u32,
    pub columns: u32,
    pub checksum: u64,
}

impl<F: Format> BlockWriter<F> {
    /// Checks the metadata, opens a temporary file beside `path` and leaves room for a header.
    pub fn create(path: &Path, meta: F::Meta, overwrite: Overwrite) -> Result<Self> {
        F::check_meta(&meta).map_err(|e| e.at(path))?;
        let file = AtomicFile::create(path, overwrite)?;
        let mut writer = Self {
            file: BufWriter::with_capacity(1 << 20, file),
            position: 0,
            meta,
            blocks: Vec::new(),
        };
        writer.append(&[0; HEADER_LEN])?;
        Ok(writer)
    }

    /// The final name.
    pub fn path(&self) -> &Path {
        self.file.get_ref().path()
    }

    /// Where the next block will be.
    pub fn position(&self) -> u64 {
        self.position
    }

    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file
            .write_all(bytes)
            .map_err(|e| FormatError::io("cannot write")(e).at(self.path()))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Appends a block.
    pub fn push(&mut self, content: &BlockContent<'_>) -> Result<()> {
        self.blocks.push(Block {
            offset: self.position,
            stored_bytes: content.stored.len() as u32,
            raw_bytes: content.raw_bytes,
            kind: content.kind,
            records: content.records,
            nodes: content.nodes,
            columns: content.columns,
            checksum: content.checksum,
        });
        self.append(content.stored)
    }

    /// Writes the sections behind the blocks, then the header; syncs, and gives the file its name.
    pub fn finish(mut self, summary: &F::Summary) -> Result<()> {
        F::check_summary(summary, &self.meta).map_err(|e| e.at(self.path()))?;
        let meta = codec::encode(&self.meta, "metadata")?;
        let summary = codec::encode(summary, "summary")?;
        let table = frame::encode_table(&self.blocks);
        let sections = [&meta[..], &summary, &table];
        let header = frame::header(F::KIND, self.position, sections);
        for section in sections {
            self.append(section)?;
        }
        self.file
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.file.write_all(&header))
            .and_then(|()| self.file.flush())
            .map_err(|e| FormatError::io("cannot write")(e).at(self.path()))?;
        // Nothing is left in the buffer.
        self.file.into_parts().0.commit()
    }
}
