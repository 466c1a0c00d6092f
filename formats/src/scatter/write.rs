//! Writing scattered light: one part at a time.

use super::part::{self, COLUMNS, Part, PartPlace};
use crate::frame::{self, Block, BlockKind, FileKind, HEADER_LEN};
use crate::output::Output;
use crate::summary::{ColumnBytes, LeftOut, ScatterSummary};
use crate::{FormatError, Result, ScatterMeta, bytes, codec};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

const ZSTD_LEVEL: i32 = 3;

/// Writes a file of scattered light, part by part. Memory is that of one part and of 50 bytes for
/// each that was written.
///
/// The file gets its name in [`Self::finish`]; dropped before that, the writer leaves nothing
/// behind.
pub struct ScatterWriter {
    output: Output,
    meta: ScatterMeta,
    blocks: Vec<Block>,
    parts: Vec<PartPlace>,
    /// Raw bytes by column, and what those take that are compressed apart.
    columns: [(u64, u64); COLUMNS.len()],
    left_out: [u64; COLUMNS.len()],
    stored: u64,
}

impl ScatterWriter {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// [`FormatError::Exists`] unless `force`, [`FormatError::Io`] if the folder cannot be written,
    /// [`FormatError::Invalid`] for metadata that no reader would accept.
    pub fn create(path: &Path, meta: ScatterMeta, force: bool) -> Result<Self> {
        meta.validate().map_err(|e| e.at(path))?;
        Ok(Self {
            output: Output::create(path, force, HEADER_LEN)?,
            meta,
            blocks: Vec::new(),
            parts: Vec::new(),
            columns: Default::default(),
            left_out: Default::default(),
            stored: 0,
        })
    }

    /// Appends a part of direct or indirect light. Parts come volume by volume, those of direct
    /// light first, and each kind in the order of places.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another order, no vertices, some outside of their volume, or
    /// light that is not finite and at least 0; [`FormatError::Io`].
    pub fn push(&mut self, kind: BlockKind, place: PartPlace, part: &Part) -> Result<()> {
        let mut encode = || {
            let last = self.blocks.last().zip(self.parts.last());
            check_order(last.map(|(b, p)| (b.kind, *p)), (kind, place))?;
            let packed = part.pack(kind, place, &self.meta.volumes)?;
            for (index, range) in &packed.ranges {
                let column = &packed.planes[range.clone()];
                let alone = bytes::compress(column, ZSTD_LEVEL)?.map_or(column.len(), |p| p.len());
                self.columns[*index].0 += column.len() as u64;
                self.columns[*index].1 += alone as u64;
            }
            for (index, saved) in &packed.left_out {
                self.left_out[*index] += saved;
            }
            let compressed = bytes::compress(&packed.planes, ZSTD_LEVEL)?;
            Ok((packed, compressed))
        };
        let (packed, compressed) = encode().map_err(|e: FormatError| e.at(self.output.path()))?;
        let stored = compressed.as_ref().unwrap_or(&packed.planes);
        self.blocks.push(Block {
            offset: self.output.position(),
            stored_bytes: stored.len() as u32,
            raw_bytes: packed.planes.len() as u32,
            kind,
            records: packed.records as u32,
            nodes: 0,
            columns: packed.mask,
            checksum: xxh3_64(stored),
        });
        self.parts.push(place);
        self.stored += stored.len() as u64;
        self.output.append(stored)
    }

    /// Vertices so far, of both kinds of light.
    #[must_use]
    pub fn vertices(&self) -> u64 {
        self.blocks.iter().map(|b| u64::from(b.records)).sum()
    }

    /// Writes the tables, and gives the file its name.
    ///
    /// # Errors
    /// [`FormatError::Io`], [`FormatError::Exists`] if the name was taken meanwhile.
    pub fn finish(self) -> Result<ScatterSummary> {
        let apart: u64 = self.columns.iter().map(|c| c.1).sum();
        let named = || COLUMNS.iter().map(|c| c.name);
        let columns = named().zip(self.columns).filter(|(_, c)| c.0 > 0);
        let left_out = named().zip(self.left_out).filter(|(_, bytes)| *bytes > 0);
        let summary = ScatterSummary {
            parts: self.parts,
            columns: columns
                .map(|(name, (raw, alone))| ColumnBytes {
                    name: name.into(),
                    raw_bytes: raw,
                    stored_bytes: (self.stored as f64 * alone as f64 / apart as f64).round() as u64,
                })
                .collect(),
            left_out: left_out
                .map(|(name, raw_bytes)| LeftOut {
                    name: name.into(),
                    because: "dark, or grey".into(),
                    raw_bytes,
                })
                .collect(),
        };
        let meta = codec::encode(&self.meta, "metadata")?;
        let encoded = codec::encode(&summary, "summary")?;
        frame::finish(
            self.output,
            FileKind::Scatter,
            &self.blocks,
            &meta,
            &encoded,
        )?;
        Ok(summary)
    }
}

/// Volume by volume, direct light comes before indirect light, and no part twice.
pub fn check_order(
    last: Option<(BlockKind, PartPlace)>,
    next: (BlockKind, PartPlace),
) -> Result<()> {
    let order =
        |(kind, place): (BlockKind, PartPlace)| (place.volume, kind == BlockKind::Indirect, place);
    match last {
        Some(last) if order(last) >= order(next) => Err(FormatError::invalid(
            "order of parts",
            format!("one after {last:?}"),
            format!("{next:?}"),
        )),
        _ => Ok(()),
    }
}

/// Bytes of a part before compression, at most.
pub const MAX_RAW_BYTES: usize = 8 * part::PART_CUBES + 24 * part::PART_EDGE.pow(3);
