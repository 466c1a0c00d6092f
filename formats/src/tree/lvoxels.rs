//! Pages of lvoxels.

use super::MAX_PAGE_RECORDS;
use super::columns::{self as col, PageBuilder, PageColumns, Rows, radiance};
use super::gaps;
use super::stats::{self, ColumnStats, Errors};
use crate::bytes::Cursor;
use crate::frame::Block;
use crate::quantise::Steps;
use crate::record::{LightPart, Lvoxel, MAX_LEVEL, VolumeInfo};
use crate::{FormatError, Result, check};
use xxhash_rust::xxh3::xxh3_64;

/// Bytes of the header of a page of lvoxels.
const PAGE_HEADER_BYTES: usize = 20;

/// A page of lvoxels, quantised and compressed, that [`super::TreeWriter`] can append. Pages can be
/// encoded by many threads.
#[derive(Clone)]
pub struct EncodedLvoxels {
    pub(super) bytes: Vec<u8>,
    pub(super) raw_bytes: u32,
    pub(super) mask: u32,
    pub(super) checksum: u64,
    pub(super) columns: ColumnStats,
    pub(super) errors: Errors,
    /// As a reader decodes them.
    pub(super) decoded: Vec<Lvoxel>,
}

impl EncodedLvoxels {
    /// Encodes a page; `volumes` are those of the cloud.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for values out of range or too many of them.
    pub fn new(lvoxels: &[Lvoxel], volumes: &[VolumeInfo]) -> Result<Self> {
        for (i, v) in lvoxels.iter().enumerate() {
            check::lvoxel(v, volumes, &|| format!("lvoxel {i} of the page"))?;
        }
        let mut columns = stats::lvoxel_columns();
        let mut errors = Errors::default();
        let page = encode(lvoxels, &mut columns, &mut errors)?;
        let (bytes, raw_bytes) = stats::pack_page(page.raw, stats::LVOXEL_ZSTD_LEVEL)?;
        Ok(Self {
            checksum: xxh3_64(&bytes),
            bytes,
            raw_bytes,
            mask: page.mask,
            columns,
            errors,
            decoded: page.decoded,
        })
    }

    /// Bytes in the file.
    #[must_use]
    pub fn stored_bytes(&self) -> usize {
        self.bytes.len()
    }
}

/// A page ready to be compressed.
pub(super) struct RawPage {
    pub(super) raw: Vec<u8>,
    mask: u32,
    decoded: Vec<Lvoxel>,
}

/// Lays out a page; the lvoxels must be checked before.
pub(super) fn encode(
    lvoxels: &[Lvoxel],
    columns: &mut ColumnStats,
    errors: &mut Errors,
) -> Result<RawPage> {
    let n = lvoxels.len();
    if !(1..=MAX_PAGE_RECORDS).contains(&n) {
        return Err(FormatError::invalid(
            "lvoxels of the page",
            format!("1 to {MAX_PAGE_RECORDS}"),
            n,
        ));
    }
    let mut decoded = lvoxels.to_vec();
    let mut builder = PageBuilder::new(&col::LVOXELS, PAGE_HEADER_BYTES);
    let (volume, level) = (lvoxels[0].volume, lvoxels[0].level);
    if lvoxels.iter().all(|v| v.volume == volume) {
        columns.leave_out(col::VOLUME, 2 * n as u64);
    } else {
        let rows: Vec<_> = lvoxels.iter().map(|v| [v.volume]).collect();
        builder.push_u16(col::VOLUME, &rows);
    }
    if lvoxels.iter().all(|v| v.level == level) {
        columns.leave_out(col::LEVEL, n as u64);
    } else {
        builder.push_u8(col::LEVEL, lvoxels.iter().map(|v| v.level));
    }
    let gaps: Vec<u64> = gaps::encode(lvoxels).collect();
    builder.push_u64(col::BLOCK_GAP, &gaps);

    let steps = Steps::fit(lvoxels.iter().map(|v| v.sigma_t));
    if let Some(steps) = steps {
        let mut rows = Vec::with_capacity(n);
        for v in &mut decoded {
            let code = steps.encode(v.sigma_t);
            let sigma_t = steps.decode(code);
            let off = f64::from(sigma_t) / f64::from(v.sigma_t) - 1.0;
            errors.note(stats::SIGMA_T, off.abs());
            v.sigma_t = sigma_t;
            rows.push([code]);
        }
        if rows.iter().all(|row| *row == [0]) {
            columns.leave_out(col::SIGMA_T, 2 * n as u64);
        } else {
            builder.push_u16(col::SIGMA_T, &rows);
        }
    } else {
        let rows: Vec<_> = lvoxels.iter().map(|v| [v.sigma_t]).collect();
        builder.push_f32(col::SIGMA_T_F32, &rows);
    }
    let mut source: Vec<_> = lvoxels.iter().map(|v| v.source).collect();
    let written = radiance::encode(&mut builder, col::SOURCE, &mut source);
    columns.leave_out(col::SOURCE, written.saved);
    for (v, c) in decoded.iter_mut().zip(&source) {
        errors.note_radiance(v.source, *c);
        v.source = *c;
    }
    // What most scenes do not have is not told as left out.
    if lvoxels.iter().any(|v| v.lobe != [0; 3]) {
        let plane = |k: usize| lvoxels.iter().map(move |v| v.lobe[k] as u8);
        builder.push_u8(col::LOBE, (0..3).flat_map(plane));
    }

    let mut incident_base = 0;
    if lvoxels.iter().any(|v| v.incident != [0.0; 3]) {
        let mut incident: Vec<_> = lvoxels.iter().map(|v| v.incident).collect();
        let written = radiance::encode(&mut builder, col::INCIDENT, &mut incident);
        columns.leave_out(col::INCIDENT, written.saved);
        incident_base = written.base;
        for (v, c) in decoded.iter_mut().zip(&incident) {
            errors.note_radiance(v.incident, *c);
            v.incident = *c;
        }
    }

    if lvoxels.iter().any(|v| v.single != LightPart::default()) {
        let plane = |k: usize| lvoxels.iter().map(move |v| v.single.bytes()[k]);
        builder.push_u8(col::SINGLE, (0..4).flat_map(plane));
    }

    let mask = builder.mask();
    let steps = steps.unwrap_or(Steps { base: 0, shift: 0 });
    let mut header = Vec::with_capacity(PAGE_HEADER_BYTES);
    header.extend((n as u32).to_le_bytes());
    header.extend(mask.to_le_bytes());
    header.extend(steps.base.to_le_bytes());
    header.extend(written.base.to_le_bytes());
    header.extend(volume.to_le_bytes());
    header.extend([steps.shift, level]);
    header.extend(incident_base.to_le_bytes());
    let (raw, ranges) = builder.build(&header);
    columns.add_page(&raw, &ranges, stats::LVOXEL_ZSTD_LEVEL)?;
    Ok(RawPage { raw, mask, decoded })
}

/// The inverse of [`encode`]; the lvoxels are still to be checked against the volumes.
pub fn decode(raw: &[u8], block: &Block) -> Result<Vec<Lvoxel>> {
    let mut cursor = Cursor::new(raw, "page");
    let (n, mask) = (cursor.u32()?, cursor.u32()?);
    if (n, mask, 0) != (block.records, block.columns, block.nodes)
        || !(1..=MAX_PAGE_RECORDS).contains(&(n as usize))
    {
        return Err(FormatError::invalid(
            "count and columns of the page",
            format!("{} lvoxels, {:#x}", block.records, block.columns),
            format!("{n} lvoxels, {mask:#x}"),
        ));
    }
    let base = cursor.u32()?;
    let exponent = cursor.i16()?;
    let volume = cursor.u16()?;
    let (shift, level) = (cursor.u8()?, cursor.u8()?);
    let incident_exponent = cursor.i16()?;
    let has_incident = mask >> col::INCIDENT & 0b111 != 0;
    if shift > Steps::MAX_SHIFT || level > MAX_LEVEL || (incident_exponent != 0 && !has_incident) {
        return Err(FormatError::invalid(
            "header of the page",
            format!(
                "a step of at most {}, a level of at most {MAX_LEVEL}, \
                 and 0 without incident light",
                Steps::MAX_SHIFT
            ),
            format!("{shift}, {level}, {incident_exponent}"),
        ));
    }
    let steps = Steps { base, shift };
    let n = n as usize;
    let columns = PageColumns::read(&mut cursor, &col::LVOXELS, mask, |rows| match rows {
        Rows::Lvoxels => n,
        _ => 0,
    })?;
    decode_columns(
        &columns,
        (volume, level),
        steps,
        [exponent, incident_exponent],
    )
}

/// The lvoxels of a page, whose `volume` and `level` hold where there is no column of them.
fn decode_columns(
    columns: &PageColumns<'_>,
    (volume, level): (u16, u8),
    steps: Steps,
    [source_exponent, incident_exponent]: [i16; 2],
) -> Result<Vec<Lvoxel>> {
    let volumes = columns.get(col::VOLUME);
    let levels = columns.get(col::LEVEL);
    let gaps = columns.required(col::BLOCK_GAP)?.u64s();
    // One column after the other for all lvoxels, which is faster than all columns for one.
    let mut decoder = gaps::Decoder::default();
    let mut lvoxels = Vec::with_capacity(gaps.len());
    for (i, gap) in gaps.into_iter().enumerate() {
        let level = levels.map_or(level, |rows| rows.u8(i));
        let block = decoder.next(gap, level).ok_or_else(|| {
            FormatError::invalid(
                format!("gap before lvoxel {i}"),
                "one that leads to a block of its level",
                format!("{gap} to level {level}"),
            )
        })?;
        lvoxels.push(Lvoxel {
            volume: volumes.map_or(volume, |rows| rows.u16(i, 0)),
            level,
            block,
            ..Lvoxel::default()
        });
    }
    columns.at_most_one_of(&[col::SIGMA_T, col::SIGMA_T_F32])?;
    if let Some(rows) = columns.get(col::SIGMA_T_F32) {
        for (i, v) in lvoxels.iter_mut().enumerate() {
            v.sigma_t = rows.f32(i, 0);
        }
    } else if let Some(rows) = columns.get(col::SIGMA_T) {
        for (v, code) in lvoxels.iter_mut().zip(rows.u16s(0)) {
            v.sigma_t = steps.decode(code);
        }
    } else {
        for v in &mut lvoxels {
            v.sigma_t = steps.decode(0);
        }
    }
    let source = lvoxels.iter_mut().map(|v| &mut v.source);
    radiance::decode(columns, col::SOURCE, source_exponent, source)?;
    if let Some(rows) = columns.get(col::LOBE) {
        for (i, v) in lvoxels.iter_mut().enumerate() {
            v.lobe = [0, 1, 2].map(|k| rows.i8(i, k));
        }
    }
    let incident = lvoxels.iter_mut().map(|v| &mut v.incident);
    radiance::decode(columns, col::INCIDENT, incident_exponent, incident)?;
    if let Some(rows) = columns.get(col::SINGLE) {
        for (i, v) in lvoxels.iter_mut().enumerate() {
            v.single = LightPart::of_bytes([0, 1, 2, 3].map(|k| rows.i8(i, k) as u8));
        }
    }
    Ok(lvoxels)
}
