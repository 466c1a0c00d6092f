//! Reading a cloud.

use super::CHUNK_RECORDS;
use super::columns::{self as col, Chunk};
use crate::bytes::{Column, Cursor, singles, triples};
use crate::format::{Format, PointBlocks};
use crate::frame::{Block, FileKind};
use crate::opened::{Opened, nth};
use crate::quantise::{NORMAL_MAX, area_of_disk, decode_clips, decode_normal};
use crate::record::{Bounds, Lvoxel, Surfel};
use crate::summary::{CloudSummary, Sums};
use crate::{CloudMeta, FormatError, MappedFile, Result, check};

/// The format of a cloud file.
#[derive(Debug)]
pub enum CloudFormat {}

/// A cloud file that was opened: surfels and lvoxels in the order they came, in chunks.
pub type Cloud<D> = Opened<D, CloudFormat>;

impl Format for CloudFormat {
    type Meta = CloudMeta;
    type Summary = CloudSummary;
    type Blocks = PointBlocks;
    const KIND: FileKind = FileKind::Cloud;

    fn check_meta(meta: &CloudMeta) -> Result<()> {
        meta.validate()
    }

    fn arrange(blocks: Vec<Block>, summary: &CloudSummary) -> Result<PointBlocks> {
        PointBlocks::new(blocks, &summary.sums, |i, block| {
            if !(1..=CHUNK_RECORDS).contains(&(block.records as usize)) || block.nodes != 0 {
                return Err(FormatError::invalid(
                    format!("records of block {i}"),
                    format!("1 to {CHUNK_RECORDS}, and no nodes"),
                    format!("{} and {} nodes", block.records, block.nodes),
                ));
            }
            Ok(())
        })
    }

    fn check_summary(summary: &CloudSummary, meta: &CloudMeta) -> Result<()> {
        check::sums(&summary.sums, meta.volumes.len())?;
        let bounds = summary.bounds.as_ref();
        bounds.map_or(Ok(()), |b| {
            check::bounds(b, &|| "bounds in the summary".into())
        })
    }

    fn verify<D: AsRef<[u8]>, E: From<FormatError>>(
        cloud: &Cloud<D>,
        mut after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        let mut sums = Sums::of_nothing(cloud.meta().volumes.len());
        let mut bounds = Bounds::EMPTY;
        for i in 0..cloud.surfel_chunks() {
            for surfel in cloud.surfel_chunk(i)? {
                sums.add_surfel(&surfel);
                bounds = bounds.union(Bounds::of_surfel(&surfel));
            }
            after_block()?;
        }
        for i in 0..cloud.lvoxel_chunks() {
            for lvoxel in cloud.lvoxel_chunk(i)? {
                sums.add_lvoxel(&lvoxel);
            }
            after_block()?;
        }
        let bounds = (sums.surfels > 0).then_some(bounds);
        let summary = cloud.summary();
        cloud.named(|| {
            if sums != summary.sums || !same_box(bounds, summary.bounds) {
                return Err(FormatError::invalid(
                    "summary",
                    format!("the sums of the points, {sums:?} in {bounds:?}"),
                    format!("{:?} in {:?}", summary.sums, summary.bounds),
                ));
            }
            Ok(())
        })?;
        Ok(())
    }
}

impl Cloud<MappedFile> {
    /// Gives the memory of some chunks of surfels back to the system; what is read of them again is
    /// read from the file again.
    pub fn release_surfel_chunks(&self, chunks: std::ops::Range<usize>) {
        self.release(self.surfel_blocks().get(chunks).unwrap_or_default());
    }

    /// Gives the memory of some chunks of lvoxels back to the system.
    pub fn release_lvoxel_chunks(&self, chunks: std::ops::Range<usize>) {
        self.release(self.lvoxel_blocks().get(chunks).unwrap_or_default());
    }
}

impl<D: AsRef<[u8]>> Cloud<D> {
    /// Chunks of surfels, in file order.
    pub fn surfel_blocks(&self) -> &[Block] {
        &self.table().surfels
    }

    /// Chunks of lvoxels, in file order.
    pub fn lvoxel_blocks(&self) -> &[Block] {
        &self.table().lvoxels
    }

    /// Number of chunks of surfels.
    pub fn surfel_chunks(&self) -> usize {
        self.surfel_blocks().len()
    }

    /// Number of chunks of lvoxels.
    pub fn lvoxel_chunks(&self) -> usize {
        self.lvoxel_blocks().len()
    }

    /// Decodes chunk `i` of surfels.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn surfel_chunk(&self, i: usize) -> Result<Vec<Surfel>> {
        self.named(|| {
            let chunk = self.chunk(self.surfel_blocks(), i, "surfel chunk", &col::SURFELS)?;
            decode_surfels(&chunk, self.meta().disk_overlap)
        })
    }

    /// Decodes the positions of chunk `i` of surfels, and nothing else of it.
    ///
    /// # Errors
    /// As [`Self::surfel_chunk`].
    pub fn surfel_positions(&self, i: usize) -> Result<Vec<[f32; 3]>> {
        self.named(|| {
            let chunk = self.chunk(self.surfel_blocks(), i, "surfel chunk", &col::SURFELS)?;
            let positions = triples(&chunk.required(col::POSITION)?);
            match positions.iter().flatten().find(|v| !v.is_finite()) {
                Some(v) => Err(FormatError::invalid(
                    format!("position in {}", chunk.place()),
                    "finite numbers",
                    v,
                )),
                None => Ok(positions),
            }
        })
    }

    /// Decodes chunk `i` of lvoxels.
    ///
    /// # Errors
    /// As [`Self::surfel_chunk`].
    pub fn lvoxel_chunk(&self, i: usize) -> Result<Vec<Lvoxel>> {
        self.named(|| {
            let chunk = self.chunk(self.lvoxel_blocks(), i, "lvoxel chunk", &col::LVOXELS)?;
            let lvoxels = decode_lvoxels(&chunk)?;
            for (k, v) in lvoxels.iter().enumerate() {
                check::lvoxel(v, &self.meta().volumes, &|| {
                    format!("lvoxel {k} of {}", chunk.place())
                })?;
            }
            Ok(lvoxels)
        })
    }

    fn chunk(
        &self,
        blocks: &[Block],
        i: usize,
        name: &str,
        table: &'static [Column],
    ) -> Result<Chunk<'_>> {
        let block = nth(blocks, i, name)?;
        Chunk::open(self.stored(block), block, table, format!("{name} {i}"))
    }
}

/// Whether two boxes are the same, but for how a machine rounds.
fn same_box(a: Option<Bounds>, b: Option<Bounds>) -> bool {
    let (Some(a), Some(b)) = (a, b) else {
        return a.is_none() && b.is_none();
    };
    let numbers = |b: Bounds| [b.min, b.max].concat();
    let size = numbers(a).into_iter().fold(0f32, |m, v| m.max(v.abs()));
    numbers(a)
        .into_iter()
        .zip(numbers(b))
        .all(|(a, b)| (a - b).abs() <= size * 1e-5)
}

fn shorts(rows: &[u8]) -> impl Iterator<Item = u16> + '_ {
    rows.chunks_exact(2)
        .map(|b| u16::from_le_bytes([b[0], b[1]]))
}

/// Radiance of each record: three channels, one, or none.
fn radiance(chunk: &Chunk<'_>, (rgb, grey): (usize, usize)) -> Result<Option<Vec<[f32; 3]>>> {
    if chunk.has(rgb) && chunk.has(grey) {
        return Err(FormatError::invalid(
            format!("columns of {}", chunk.place()),
            "colour or grey",
            "both",
        ));
    }
    if let Some(rows) = chunk.column(rgb, chunk.records())? {
        return Ok(Some(triples(&rows)));
    }
    let rows = chunk.column(grey, chunk.records())?;
    Ok(rows.map(|rows| singles(&rows).map(|v| [v; 3]).collect()))
}

fn decode_surfels(chunk: &Chunk<'_>, overlap: f32) -> Result<Vec<Surfel>> {
    let n = chunk.records();
    let mut surfels = vec![Surfel::default(); n];
    for (s, p) in surfels
        .iter_mut()
        .zip(triples(&chunk.required(col::POSITION)?))
    {
        s.position = p;
    }
    let rows = chunk.required(col::NORMAL)?;
    let mut codes = shorts(&rows);
    for s in &mut surfels {
        let code = [codes.next().unwrap_or(0), codes.next().unwrap_or(0)];
        if code.iter().any(|c| *c > NORMAL_MAX) {
            return Err(FormatError::invalid(
                format!("normal in {}", chunk.place()),
                format!("at most {NORMAL_MAX}"),
                format!("{code:?}"),
            ));
        }
        s.normal = decode_normal(code);
    }
    for (s, r) in surfels
        .iter_mut()
        .zip(singles(&chunk.required(col::RADIUS)?))
    {
        s.radius = r;
    }
    match chunk.column(col::AREA, n)? {
        Some(rows) => {
            for (s, a) in surfels.iter_mut().zip(singles(&rows)) {
                s.area = a;
            }
        }
        None if overlap > 0.0 => {
            for s in &mut surfels {
                s.area = area_of_disk(s.radius, overlap);
            }
        }
        None => {
            return Err(FormatError::invalid(
                format!("columns of {}", chunk.place()),
                "an area, as radii are free",
                "none",
            ));
        }
    }
    if let Some(values) = radiance(chunk, (col::FRONT, col::FRONT_GREY))? {
        for (s, c) in surfels.iter_mut().zip(values) {
            s.front = c;
        }
    }
    if let Some(values) = radiance(chunk, (col::BACK, col::BACK_GREY))? {
        for (s, c) in surfels.iter_mut().zip(values) {
            s.back = c;
        }
    }
    let edges = decode_edges(chunk, &mut surfels)?;
    chunk.check_raw_bytes(edges)?;
    for (k, s) in surfels.iter().enumerate() {
        check::surfel(s, &|| format!("surfel {k} of {}", chunk.place()))?;
    }
    Ok(surfels)
}

/// Reads the clips, if there are any, and returns how many edges there are.
fn decode_edges(chunk: &Chunk<'_>, surfels: &mut [Surfel]) -> Result<usize> {
    let counts = chunk.column(col::CLIP_COUNTS, surfels.len())?;
    if counts.is_some() != chunk.has(col::CLIP_EDGES) {
        return Err(FormatError::invalid(
            format!("columns of {}", chunk.place()),
            "clip_counts and clip_edges",
            "one of them",
        ));
    }
    let Some(counts) = counts else { return Ok(0) };
    if let Some(count) = counts.iter().find(|c| **c > 3) {
        return Err(FormatError::invalid(
            format!("clip count in {}", chunk.place()),
            "at most 3",
            count,
        ));
    }
    let edges: usize = counts.iter().map(|c| usize::from(*c)).sum();
    let rows = chunk.column(col::CLIP_EDGES, edges)?.unwrap_or_default();
    let (codes, _) = rows.as_chunks::<2>();
    let mut rest = codes;
    for (s, count) in surfels.iter_mut().zip(&counts) {
        let (own, others) = rest.split_at(usize::from(*count));
        s.clips = decode_clips(own);
        rest = others;
    }
    Ok(edges)
}

fn decode_lvoxels(chunk: &Chunk<'_>) -> Result<Vec<Lvoxel>> {
    let n = chunk.records();
    let mut lvoxels = vec![Lvoxel::default(); n];
    if let Some(rows) = chunk.column(col::VOLUME, n)? {
        for (v, volume) in lvoxels.iter_mut().zip(shorts(&rows)) {
            v.volume = volume;
        }
    }
    for (v, level) in lvoxels.iter_mut().zip(chunk.required(col::LEVEL)?) {
        v.level = level;
    }
    let rows = chunk.required(col::BLOCK)?;
    let mut cursor = Cursor::new(&rows, "block column");
    for v in &mut lvoxels {
        v.block = [cursor.u16()?, cursor.u16()?, cursor.u16()?];
    }
    for (v, sigma_t) in lvoxels
        .iter_mut()
        .zip(singles(&chunk.required(col::SIGMA_T)?))
    {
        v.sigma_t = sigma_t;
    }
    if let Some(values) = radiance(chunk, (col::SOURCE, col::SOURCE_GREY))? {
        for (v, c) in lvoxels.iter_mut().zip(values) {
            v.source = c;
        }
    }
    if let Some(rows) = chunk.column(col::LOBE, n)? {
        for (v, lobe) in lvoxels.iter_mut().zip(rows.as_chunks().0) {
            v.lobe = lobe.map(|c: u8| c as i8);
        }
    }
    chunk.check_raw_bytes(0)?;
    Ok(lvoxels)
}
