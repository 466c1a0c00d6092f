//! What chunks of a cloud take in a file, from a sample of their records.

use super::columns::{self as col, DIRECTORY_ENTRY, ZSTD_LEVEL, is_constant};
use super::write::{Columns, lvoxel_columns, surfel_columns};
use super::{CHUNK_RECORDS, CloudFormat};
use crate::bytes::{self, Column};
use crate::format::Format;
use crate::frame::{ENTRY_LEN, HEADER_LEN};
use crate::record::{Lvoxel, Surfel};
use crate::{CloudMeta, Result, codec};

/// The size of a cloud that is not there yet, by samples of its chunks. A sample is packed as the
/// writer would pack the chunk, and nothing is written.
#[derive(Debug)]
pub struct CloudSample {
    overlap: f32,
    /// Bytes of header, metadata and summary.
    fixed: usize,
    surfels: Packed,
    lvoxels: Packed,
}

/// Records that were packed, and their share of the bytes of their chunks.
#[derive(Debug, Default)]
struct Packed {
    records: u64,
    bytes: f64,
}

impl CloudSample {
    /// No sample yet of the cloud that has this metadata.
    ///
    /// # Errors
    /// Metadata that no file can hold.
    pub fn new(meta: &CloudMeta) -> Result<Self> {
        /// Of the summary: sums, bounds, and names and sizes of columns.
        const SUMMARY_BYTES: usize = 600;
        /// Of that, the sums of a volume.
        const VOLUME_BYTES: usize = 16;
        CloudFormat::check_meta(meta)?;
        let meta_bytes = codec::encode(meta, "metadata")?.len();
        Ok(Self {
            overlap: meta.disk_overlap,
            fixed: HEADER_LEN + meta_bytes + SUMMARY_BYTES + VOLUME_BYTES * meta.volumes.len(),
            surfels: Packed::default(),
            lvoxels: Packed::default(),
        })
    }

    /// Looks at some of the surfels of a chunk of so many, in their order: runs that are spread
    /// over it, or all.
    ///
    /// # Errors
    /// If zstd fails.
    pub fn add_surfels(&mut self, sample: &mut [Surfel], chunk: usize) -> Result<()> {
        let (columns, _) = surfel_columns(sample, self.overlap);
        self.surfels
            .add(&col::SURFELS, &columns, sample.len(), chunk)
    }

    /// Looks at some of the lvoxels of a chunk of so many, as [`Self::add_surfels`] does.
    ///
    /// # Errors
    /// If zstd fails.
    pub fn add_lvoxels(&mut self, sample: &[Lvoxel], chunk: usize) -> Result<()> {
        let (columns, _) = lvoxel_columns(sample);
        self.lvoxels
            .add(&col::LVOXELS, &columns, sample.len(), chunk)
    }

    /// Bytes of a file with so many points, about.
    #[must_use]
    pub fn file_bytes(&self, surfels: u64, lvoxels: u64) -> u64 {
        self.fixed as u64 + self.surfels.bytes_of(surfels) + self.lvoxels.bytes_of(lvoxels)
    }
}

impl Packed {
    fn add(
        &mut self,
        table: &[Column],
        columns: &Columns,
        records: usize,
        chunk: usize,
    ) -> Result<()> {
        if records == 0 {
            return Ok(());
        }
        let share = records as f64 / chunk.max(records) as f64;
        let mut planes = Vec::new();
        for (index, rows) in columns {
            let width = table[*index].width;
            self.bytes += share * DIRECTORY_ENTRY as f64;
            if is_constant(rows, width) {
                self.bytes += share * width as f64;
                continue;
            }
            planes.clear();
            bytes::to_planes(rows, width, &mut planes);
            self.bytes += stored_bytes(&planes, width, share)?;
        }
        self.records += records as u64;
        Ok(())
    }

    fn bytes_of(&self, records: u64) -> u64 {
        let each = self.bytes / self.records.max(1) as f64;
        let chunks = records.div_ceil(CHUNK_RECORDS as u64);
        (each * records as f64) as u64 + chunks * ENTRY_LEN as u64
    }
}

/// Bytes of planes, as that share of longer ones. zstd has a code for each of its blocks, and
/// planes that share one take more than they do alone: those that would be in other blocks are
/// packed apart, too. But one that repeats another takes least beside it.
fn stored_bytes(planes: &[u8], width: usize, share: f64) -> Result<f64> {
    /// The largest block of zstd.
    const BLOCK_BYTES: f64 = 131_072.0;
    let plane = (planes.len() / width).max(1);
    let in_block = (BLOCK_BYTES * share / plane as f64).max(1.0) as usize;
    let mut stored = 0;
    for planes in planes.chunks(plane * in_block) {
        let zstd = bytes::compress(planes, ZSTD_LEVEL)?;
        stored += zstd.map_or(planes.len(), |zstd| zstd.len());
    }
    let together = bytes::compress(planes, ZSTD_LEVEL)?;
    Ok(together.map_or(stored, |zstd| zstd.len().min(stored)) as f64)
}
