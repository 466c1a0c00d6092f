//! Writing scattered light: one cluster at a time.

use super::ScatterFormat;
use super::cluster::{CLUSTER_CUBES, CLUSTER_EDGE, COLUMNS, ClusterId, VertexCluster};
use crate::frame::BlockKind;
use crate::output::{BlockContent, BlockWriter};
use crate::summary::{ColumnBytes, LeftOut, ScatterSummary};
use crate::{FormatError, Overwrite, Result, ScatterMeta, bytes};
use std::path::Path;
use xxhash_rust::xxh3::xxh3_64;

const ZSTD_LEVEL: i32 = 3;

/// Writes a file of scattered light, cluster by cluster. Memory is that of one cluster and of 50
/// bytes for each that was written.
///
/// The file gets its name in [`Self::finish`]; dropped before that, the writer leaves nothing
/// behind.
pub struct ScatterWriter {
    file: BlockWriter<ScatterFormat>,
    clusters: Vec<ClusterId>,
    /// Raw bytes by column, and bytes of the columns when each is compressed apart.
    columns: [(u64, u64); COLUMNS.len()],
    left_out: [u64; COLUMNS.len()],
    stored: u64,
}

impl ScatterWriter {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// [`FormatError::Exists`] if the file may not be replaced, [`FormatError::Folder`] if the
    /// folder cannot be written, [`FormatError::Invalid`] for metadata that no reader would accept.
    pub fn create(path: &Path, meta: ScatterMeta, overwrite: Overwrite) -> Result<Self> {
        Ok(Self {
            file: BlockWriter::create(path, meta, overwrite)?,
            clusters: Vec::new(),
            columns: Default::default(),
            left_out: Default::default(),
            stored: 0,
        })
    }

    /// Appends a cluster of direct or indirect light. Clusters come volume by volume, those of
    /// direct light first, and each kind in the order of [`ClusterId`].
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another order, no vertices, some outside of their volume, or
    /// light that is not finite and at least 0; [`FormatError::Io`].
    pub fn push(&mut self, kind: BlockKind, id: ClusterId, cluster: &VertexCluster) -> Result<()> {
        let mut encode = || {
            let last = self.file.blocks.last().zip(self.clusters.last());
            check_order(last.map(|(b, id)| (b.kind, *id)), (kind, id))?;
            let packed = cluster.pack(kind, id, &self.file.meta.volumes)?;
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
        let (packed, compressed) = encode().map_err(|e: FormatError| e.at(self.file.path()))?;
        let stored = compressed.as_ref().unwrap_or(&packed.planes);
        self.clusters.push(id);
        self.stored += stored.len() as u64;
        self.file.push(&BlockContent {
            kind,
            stored,
            raw_bytes: packed.planes.len() as u32,
            records: packed.records as u32,
            nodes: 0,
            columns: packed.mask,
            checksum: xxh3_64(stored),
        })
    }

    /// Vertices so far, of both kinds of light.
    #[must_use]
    pub fn vertices(&self) -> u64 {
        self.file.blocks.iter().map(|b| u64::from(b.records)).sum()
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
            clusters: self.clusters,
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
        self.file.finish(&summary)?;
        Ok(summary)
    }
}

/// Checks that clusters come volume by volume, direct light before indirect light, and none twice.
pub fn check_order(
    last: Option<(BlockKind, ClusterId)>,
    next: (BlockKind, ClusterId),
) -> Result<()> {
    let order = |(kind, id): (BlockKind, ClusterId)| (id.volume, kind == BlockKind::Indirect, id);
    match last {
        Some(last) if order(last) >= order(next) => Err(FormatError::invalid(
            "order of clusters",
            format!("one after {last:?}"),
            format!("{next:?}"),
        )),
        _ => Ok(()),
    }
}

/// Bytes of a cluster before compression, at most.
pub const MAX_RAW_BYTES: usize = 8 * CLUSTER_CUBES + 24 * CLUSTER_EDGE.pow(3);
