//! Reading scattered light.

use super::part::{COLUMNS, PART_EDGE, Part, PartPlace};
use super::write::{MAX_RAW_BYTES, check_order};
use crate::frame::{Block, BlockKind, FileKind, Frame};
use crate::summary::ScatterSummary;
use crate::{FormatError, MappedFile, Result, ScatterMeta, bytes, codec};
use std::path::{Path, PathBuf};

/// A file of scattered light, opened. Parts are decoded when asked for, by any number of threads.
#[derive(Debug)]
pub struct Scatter<D> {
    data: D,
    path: Option<PathBuf>,
    blocks: Vec<Block>,
    meta: ScatterMeta,
    summary: ScatterSummary,
    content_hash: [u8; 16],
    version: u32,
}

impl Scatter<MappedFile> {
    /// Maps and opens a file; all errors name it.
    ///
    /// # Errors
    /// As [`Scatter::open`], and [`FormatError::Io`].
    pub fn open_path(path: &Path) -> Result<Self> {
        let mut scatter = Self::open(MappedFile::open(path)?).map_err(|e| e.at(path))?;
        scatter.path = Some(path.into());
        Ok(scatter)
    }
}

impl<D: AsRef<[u8]>> Scatter<D> {
    /// Reads header, metadata, summary and block table, and checks them; no part is touched.
    ///
    /// # Errors
    /// Any [`FormatError`] but `Io`, `Exists` and `InFile`.
    pub fn open(data: D) -> Result<Self> {
        let all = data.as_ref();
        let frame = Frame::read(all, FileKind::Scatter)?;
        let meta: ScatterMeta = codec::decode(&all[frame.meta.clone()], "metadata")?;
        meta.validate()?;
        let summary: ScatterSummary = codec::decode(&all[frame.summary.clone()], "summary")?;
        if summary.parts.len() != frame.blocks.len() {
            return Err(FormatError::invalid(
                "parts in the summary",
                frame.blocks.len().to_string(),
                summary.parts.len(),
            ));
        }
        let mut last = None;
        for (i, (block, place)) in frame.blocks.iter().zip(&summary.parts).enumerate() {
            check_order(last, (block.kind, *place))?;
            last = Some((block.kind, *place));
            let most = PART_EDGE.pow(3) as u32;
            if !(1..=most).contains(&block.records) || block.nodes != 0 {
                return Err(FormatError::invalid(
                    format!("vertices of block {i}"),
                    format!("1 to {most}, and no nodes"),
                    format!("{} and {} nodes", block.records, block.nodes),
                ));
            }
            if block.columns >> COLUMNS.len() != 0 {
                return Err(FormatError::invalid(
                    format!("columns of block {i}"),
                    format!("a mask of {} bits", COLUMNS.len()),
                    format!("{:#x}", block.columns),
                ));
            }
            if block.raw_bytes as usize > MAX_RAW_BYTES || block.stored_bytes > block.raw_bytes {
                return Err(FormatError::invalid(
                    format!("bytes of block {i}"),
                    format!("at most {MAX_RAW_BYTES}, and no more stored than raw"),
                    format!("{} stored, {} raw", block.stored_bytes, block.raw_bytes),
                ));
            }
        }
        Ok(Self {
            path: None,
            blocks: frame.blocks,
            meta,
            summary,
            content_hash: frame.content_hash,
            version: frame.version,
            data,
        })
    }

    /// Where it comes from.
    pub fn meta(&self) -> &ScatterMeta {
        &self.meta
    }

    /// What was counted while it was written, and where the parts are.
    pub fn summary(&self) -> &ScatterSummary {
        &self.summary
    }

    /// Version of the format that the file was written in.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Identity of everything in the file.
    pub fn content_hash(&self) -> [u8; 16] {
        self.content_hash
    }

    /// Parts, in file order.
    pub fn blocks(&self) -> &[Block] {
        &self.blocks
    }

    /// The numbers of the parts of one light of a volume, and where they are.
    pub fn parts(
        &self,
        kind: BlockKind,
        volume: usize,
    ) -> impl Iterator<Item = (usize, PartPlace)> + '_ {
        let places = self.blocks.iter().zip(&self.summary.parts).enumerate();
        places
            .filter(move |(_, (b, p))| b.kind == kind && usize::from(p.volume) == volume)
            .map(|(i, (_, p))| (i, *p))
    }

    /// Checks the bytes of part `i` without decoding them.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] for damage, [`FormatError::Invalid`] for an `i` that does not
    /// exist.
    pub fn check_part(&self, i: usize) -> Result<()> {
        self.named(|| self.stored(i).map(drop))
    }

    /// Decodes part `i`.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn part(&self, i: usize) -> Result<Part> {
        self.named(|| {
            let (block, place, stored) = self.stored(i)?;
            let unpack = |raw: &[u8]| {
                let records = block.records as usize;
                let volumes = &self.meta.volumes;
                Part::unpack(raw, block.columns, records, block.kind, place, volumes)
            };
            if block.stored_bytes == block.raw_bytes {
                return unpack(stored);
            }
            let mut raw = vec![0; block.raw_bytes as usize];
            bytes::decompress(stored, &mut raw, &format!("part {i}"))?;
            unpack(&raw)
        })
    }

    /// A part as it is in the file, its checksum found right.
    fn stored(&self, i: usize) -> Result<(&Block, PartPlace, &[u8])> {
        let (Some(block), Some(&place)) = (self.blocks.get(i), self.summary.parts.get(i)) else {
            let expected = format!("below {}", self.blocks.len());
            return Err(FormatError::invalid("part", expected, i));
        };
        let start = block.offset as usize;
        let stored = &self.data.as_ref()[start..start + block.stored_bytes as usize];
        bytes::check(stored, block.checksum, || format!("part {i}"))?;
        Ok((block, place, stored))
    }

    fn named<T>(&self, run: impl FnOnce() -> Result<T>) -> Result<T> {
        run().map_err(|e| match &self.path {
            Some(path) => e.at(path),
            None => e,
        })
    }

    /// Reads everything: checksums and the range of every value.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        self.verify_with(|| Ok(()))
    }

    /// As [`Self::verify`], and calls `read` after each part.
    ///
    /// # Errors
    /// The first damage found, or what `read` returns, which ends the check.
    pub fn verify_with<E: From<FormatError>>(
        &self,
        mut read: impl FnMut() -> std::result::Result<(), E>,
    ) -> std::result::Result<(), E> {
        for i in 0..self.blocks.len() {
            self.part(i)?;
            read()?;
        }
        Ok(())
    }
}
