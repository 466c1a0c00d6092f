//! Writing a cloud: one chunk at a time.

use super::columns::{self as col, Packed};
use super::{CHUNK_RECORDS, CloudFormat};
use crate::bytes::{Column, floats};
use crate::frame::BlockKind;
use crate::output::{BlockContent, BlockWriter};
use crate::quantise::{
    area_of_disk, decode_edge, decode_normal, encode_edge, encode_normal, is_area_of_disk,
};
use crate::record::{Bounds, Lvoxel, Surfel};
use crate::summary::{CloudSummary, ColumnBytes, LeftOut, Sums};
use crate::{CloudMeta, FormatError, Overwrite, Result, check};
use std::path::Path;

/// Writes a cloud file as points come. Memory is that of one chunk and of 40 bytes per chunk
/// written.
///
/// The file gets its name in [`Self::finish`]; dropped before that, the writer leaves nothing
/// behind.
pub struct CloudWriter {
    file: BlockWriter<CloudFormat>,
    surfels: Vec<Surfel>,
    lvoxels: Vec<Lvoxel>,
    sums: Sums,
    bounds: Bounds,
    /// Raw and stored bytes by column.
    surfel_bytes: [(u64, u64); col::SURFELS.len()],
    lvoxel_bytes: [(u64, u64); col::LVOXELS.len()],
    surfel_left_out: [u64; col::SURFELS.len()],
    lvoxel_left_out: [u64; col::LVOXELS.len()],
}

impl CloudWriter {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// [`crate::FormatError::Exists`] if the file may not be replaced,
    /// [`crate::FormatError::Folder`] if the folder cannot be written,
    /// [`crate::FormatError::Invalid`] for metadata that no reader would accept.
    pub fn create(path: &Path, meta: CloudMeta, overwrite: Overwrite) -> Result<Self> {
        let sums = Sums::of_nothing(meta.volumes.len());
        Ok(Self {
            file: BlockWriter::create(path, meta, overwrite)?,
            surfels: Vec::new(),
            lvoxels: Vec::new(),
            sums,
            bounds: Bounds::EMPTY,
            surfel_bytes: Default::default(),
            lvoxel_bytes: Default::default(),
            surfel_left_out: Default::default(),
            lvoxel_left_out: Default::default(),
        })
    }

    /// Appends surfels. How they are split over calls does not change the file, but what comes
    /// between surfels and lvoxels does.
    ///
    /// # Errors
    /// [`crate::FormatError::Invalid`] for a surfel that is not finite or out of range,
    /// [`crate::FormatError::Io`].
    pub fn push_surfels(&mut self, surfels: &[Surfel]) -> Result<()> {
        for surfel in surfels {
            let index = self.sums.surfels + self.surfels.len() as u64;
            check::surfel(surfel, &|| format!("surfel {index}"))
                .map_err(|e| e.at(self.file.path()))?;
            self.surfels.push(*surfel);
            if self.surfels.len() == CHUNK_RECORDS {
                self.flush_surfels()?;
            }
        }
        Ok(())
    }

    /// Appends lvoxels.
    ///
    /// # Errors
    /// As [`Self::push_surfels`]; the volume and the block must be those of the metadata.
    pub fn push_lvoxels(&mut self, lvoxels: &[Lvoxel]) -> Result<()> {
        for lvoxel in lvoxels {
            let index = self.sums.lvoxels() + self.lvoxels.len() as u64;
            if lvoxel.incident != [0.0; 3] {
                return Err(FormatError::invalid(
                    format!("incident light of lvoxel {index}"),
                    "none in a cloud",
                    format!("{:?}", lvoxel.incident),
                ));
            }
            check::lvoxel(lvoxel, &self.file.meta.volumes, &|| {
                format!("lvoxel {index}")
            })
            .map_err(|e| e.at(self.file.path()))?;
            self.lvoxels.push(*lvoxel);
            if self.lvoxels.len() == CHUNK_RECORDS {
                self.flush_lvoxels()?;
            }
        }
        Ok(())
    }

    /// Writes what is left, and gives the file its name.
    ///
    /// # Errors
    /// [`crate::FormatError::Io`], [`crate::FormatError::Exists`] if the name was taken meanwhile.
    pub fn finish(mut self) -> Result<CloudSummary> {
        self.flush_surfels()?;
        self.flush_lvoxels()?;
        let mut columns = Vec::new();
        let mut left_out = Vec::new();
        let all = col::SURFELS.iter().chain(&col::LVOXELS);
        let bytes = self.surfel_bytes.iter().chain(&self.lvoxel_bytes);
        let out = self.surfel_left_out.iter().chain(&self.lvoxel_left_out);
        for ((Column { name, .. }, (raw, stored)), out) in all.zip(bytes).zip(out) {
            if *stored > 0 {
                columns.push(ColumnBytes {
                    name: (*name).into(),
                    raw_bytes: *raw,
                    stored_bytes: *stored,
                });
            }
            if *out > 0 {
                left_out.push(LeftOut {
                    name: (*name).into(),
                    because: reason(name).into(),
                    raw_bytes: *out,
                });
            }
        }
        let summary = CloudSummary {
            bounds: (self.sums.surfels > 0).then_some(self.bounds),
            sums: self.sums,
            columns,
            left_out,
        };
        self.file.finish(&summary)?;
        Ok(summary)
    }

    fn flush_surfels(&mut self) -> Result<()> {
        if self.surfels.is_empty() {
            return Ok(());
        }
        let (columns, left_out) = surfel_columns(&mut self.surfels, self.file.meta.disk_overlap);
        for surfel in &self.surfels {
            self.sums.add_surfel(surfel);
            self.bounds = self.bounds.union(Bounds::of_surfel(surfel));
        }
        let packed = col::pack(&col::SURFELS, &columns)?;
        for (index, raw, stored) in &packed.sizes {
            self.surfel_bytes[*index].0 += raw;
            self.surfel_bytes[*index].1 += stored;
        }
        for (sum, bytes) in self.surfel_left_out.iter_mut().zip(left_out) {
            *sum += bytes;
        }
        self.write(BlockKind::Surfels, self.surfels.len(), &packed)?;
        self.surfels.clear();
        Ok(())
    }

    fn flush_lvoxels(&mut self) -> Result<()> {
        if self.lvoxels.is_empty() {
            return Ok(());
        }
        for lvoxel in &self.lvoxels {
            self.sums.add_lvoxel(lvoxel);
        }
        let (columns, left_out) = lvoxel_columns(&self.lvoxels);
        let packed = col::pack(&col::LVOXELS, &columns)?;
        for (index, raw, stored) in &packed.sizes {
            self.lvoxel_bytes[*index].0 += raw;
            self.lvoxel_bytes[*index].1 += stored;
        }
        for (sum, bytes) in self.lvoxel_left_out.iter_mut().zip(left_out) {
            *sum += bytes;
        }
        self.write(BlockKind::Lvoxels, self.lvoxels.len(), &packed)?;
        self.lvoxels.clear();
        Ok(())
    }

    fn write(&mut self, kind: BlockKind, records: usize, packed: &Packed) -> Result<()> {
        self.file.push(&BlockContent {
            kind,
            stored: &packed.bytes,
            raw_bytes: packed.raw_bytes,
            records: records as u32,
            nodes: 0,
            columns: packed.mask,
            checksum: packed.checksum,
        })
    }
}

fn reason(column: &str) -> &'static str {
    match column {
        "area" => "it follows from the radius",
        "front" | "back" | "source" => "dark, or grey",
        "clip_counts" => "nothing is clipped",
        "volume" => "volume 0 alone",
        _ => "not needed",
    }
}

pub type Columns = Vec<(usize, Vec<u8>)>;

/// Three channels, one if grey, none if dark. Adds what was saved.
fn radiance(
    columns: &mut Columns,
    left_out: &mut [u64],
    (rgb, grey): (usize, usize),
    values: impl Iterator<Item = [f32; 3]> + Clone,
    count: usize,
) {
    if values.clone().all(|c| c == [0.0; 3]) {
        left_out[rgb] = 12 * count as u64;
    } else if values.clone().all(|[r, g, b]| r == g && g == b) {
        left_out[rgb] = 8 * count as u64;
        columns.push((grey, floats(values.map(|c| [c[0]]))));
    } else {
        columns.push((rgb, floats(values)));
    }
}

/// Columns of a chunk. The surfels become what a reader will decode.
pub fn surfel_columns(surfels: &mut [Surfel], overlap: f32) -> (Columns, [u64; 10]) {
    let mut left_out = [0; 10];
    let n = surfels.len();
    let mut normals = Vec::with_capacity(n * 4);
    let mut counts = Vec::with_capacity(n);
    let mut edges = Vec::new();
    let area_is_derived = surfels
        .iter()
        .all(|s| is_area_of_disk(s.area, s.radius, overlap));
    for s in surfels.iter_mut() {
        let code = encode_normal(s.normal);
        let normal = decode_normal(code);
        for edge in &mut s.clips.edges[..usize::from(s.clips.count)] {
            let code = encode_edge(*edge, s.normal, normal);
            *edge = decode_edge(code);
            edges.extend(code);
        }
        counts.push(s.clips.count);
        s.normal = normal;
        normals.extend(code.into_iter().flat_map(u16::to_le_bytes));
        if area_is_derived {
            s.area = area_of_disk(s.radius, overlap);
        }
    }
    let surfels = &*surfels;
    let mut columns = vec![
        (col::POSITION, floats(surfels.iter().map(|s| s.position))),
        (col::NORMAL, normals),
        (col::RADIUS, floats(surfels.iter().map(|s| [s.radius]))),
    ];
    if area_is_derived {
        left_out[col::AREA] = 4 * n as u64;
    } else {
        columns.push((col::AREA, floats(surfels.iter().map(|s| [s.area]))));
    }
    let front = (col::FRONT, col::FRONT_GREY);
    radiance(
        &mut columns,
        &mut left_out,
        front,
        surfels.iter().map(|s| s.front),
        n,
    );
    let back = (col::BACK, col::BACK_GREY);
    radiance(
        &mut columns,
        &mut left_out,
        back,
        surfels.iter().map(|s| s.back),
        n,
    );
    if edges.is_empty() {
        left_out[col::CLIP_COUNTS] = n as u64;
    } else {
        columns.push((col::CLIP_COUNTS, counts));
        columns.push((col::CLIP_EDGES, edges));
    }
    (columns, left_out)
}

pub fn lvoxel_columns(lvoxels: &[Lvoxel]) -> (Columns, [u64; col::LVOXELS.len()]) {
    let mut left_out = [0; col::LVOXELS.len()];
    let n = lvoxels.len();
    let mut columns = Vec::new();
    if lvoxels.iter().all(|v| v.volume == 0) {
        left_out[col::VOLUME] = 2 * n as u64;
    } else {
        let rows = lvoxels
            .iter()
            .flat_map(|v| v.volume.to_le_bytes())
            .collect();
        columns.push((col::VOLUME, rows));
    }
    columns.push((col::LEVEL, lvoxels.iter().map(|v| v.level).collect()));
    let blocks = lvoxels
        .iter()
        .flat_map(|v| v.block)
        .flat_map(u16::to_le_bytes);
    columns.push((col::BLOCK, blocks.collect()));
    columns.push((col::SIGMA_T, floats(lvoxels.iter().map(|v| [v.sigma_t]))));
    let source = (col::SOURCE, col::SOURCE_GREY);
    radiance(
        &mut columns,
        &mut left_out,
        source,
        lvoxels.iter().map(|v| v.source),
        n,
    );
    // What most scenes do not have is not told as left out.
    if lvoxels.iter().any(|v| v.lobe != [0; 3]) {
        let rows = lvoxels.iter().flat_map(|v| v.lobe.map(|c| c as u8));
        columns.push((col::LOBE, rows.collect()));
    }
    (columns, left_out)
}
