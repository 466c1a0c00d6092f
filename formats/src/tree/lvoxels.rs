//! Pages of lvoxels.

use super::MAX_PAGE_RECORDS;
use super::columns::{self as col, PageBuilder, PageColumns, Planes, Rows, radiance};
use super::forecast::Forecast;
use super::gaps;
use super::stats::{self, ColumnStats, Errors};
use crate::bytes::{self, Cursor};
use crate::frame::Block;
use crate::quantise::{GreyCode, SharedExponent, Steps};
use crate::record::{Lvoxel, MAX_LEVEL};
use crate::{FormatError, Result};

/// A page ready to be compressed.
pub struct RawPage {
    pub raw: Vec<u8>,
    pub mask: u32,
    /// As a reader decodes them.
    pub decoded: Vec<Lvoxel>,
}

/// Lays out a page; the lvoxels must be checked before.
pub fn encode(
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
    let mut builder = PageBuilder::new(&col::LVOXELS);
    let (volume, level) = (lvoxels[0].volume, lvoxels[0].level);
    if lvoxels.iter().all(|v| v.volume == volume) {
        columns.leave_out(col::VOLUME, 2 * n as u64);
    } else {
        let rows = lvoxels.iter().flat_map(|v| v.volume.to_le_bytes());
        builder.push(col::VOLUME, rows.collect());
    }
    if lvoxels.iter().all(|v| v.level == level) {
        columns.leave_out(col::LEVEL, n as u64);
    } else {
        builder.push(col::LEVEL, lvoxels.iter().map(|v| v.level).collect());
    }
    let gaps = gaps::encode(lvoxels);
    if gaps.is_none() {
        let rows = lvoxels.iter().flat_map(|v| v.block);
        builder.push(col::BLOCK, rows.flat_map(u16::to_le_bytes).collect());
    }

    let steps = Steps::fit(lvoxels.iter().map(|v| v.sigma_t));
    if let Some(steps) = steps {
        let mut rows = Vec::with_capacity(2 * n);
        for v in &mut decoded {
            let code = steps.encode(v.sigma_t);
            let sigma_t = steps.decode(code);
            let off = f64::from(sigma_t) / f64::from(v.sigma_t) - 1.0;
            errors.note(stats::SIGMA_T, off.abs());
            v.sigma_t = sigma_t;
            rows.extend(code.to_le_bytes());
        }
        if rows.iter().all(|b| *b == 0) {
            columns.leave_out(col::SIGMA_T, 2 * n as u64);
        } else {
            builder.push(col::SIGMA_T, rows);
        }
    } else {
        let rows = lvoxels.iter().flat_map(|v| v.sigma_t.to_le_bytes());
        builder.push(col::SIGMA_T_F32, rows.collect());
    }
    let mut source: Vec<_> = lvoxels.iter().map(|v| v.source).collect();
    let written = radiance::encode(&mut builder, col::SOURCE, &mut source);
    columns.leave_out(col::SOURCE, written.saved);
    for (v, c) in decoded.iter_mut().zip(&source) {
        errors.note_radiance(v.source, *c);
        v.source = *c;
    }

    if let Some(gaps) = gaps {
        let rows = gaps.into_iter().flat_map(u64::to_le_bytes);
        builder.push(col::BLOCK_GAP, rows.collect());
        let places: Vec<_> = lvoxels
            .iter()
            .map(|v| (gaps::first_voxel(v), v.level))
            .collect();
        prefer_steps(&mut builder, col::SIGMA_T, col::SIGMA_T_STEP, &places, Some)?;
        prefer_steps(
            &mut builder,
            col::SOURCE_GREY,
            col::SOURCE_GREY_STEP,
            &places,
            GreyCode::rank,
        )?;
    }
    let mask = builder.mask();
    let steps = steps.unwrap_or(Steps { base: 0, shift: 0 });
    let mut header = Vec::with_capacity(20);
    header.extend((n as u32).to_le_bytes());
    header.extend(mask.to_le_bytes());
    header.extend(steps.base.to_le_bytes());
    header.extend(written.base.to_le_bytes());
    header.extend(volume.to_le_bytes());
    header.extend([steps.shift, level, 0, 0]);
    let (raw, ranges) = builder.build(&header);
    columns.add_page(&raw, &ranges, stats::LVOXEL_ZSTD_LEVEL)?;
    Ok(RawPage { raw, mask, decoded })
}

/// Replaces a column of u16 by steps from what neighbours let expect, if those are shorter once they are compressed.
/// `rank` gives the numbers that steps are taken of, or nothing for codes that have none.
fn prefer_steps(
    builder: &mut PageBuilder,
    codes: usize,
    steps: usize,
    places: &[(u64, u8)],
    rank: fn(u16) -> Option<u16>,
) -> Result<()> {
    let Some(rows) = builder.take(codes) else {
        return Ok(());
    };
    let number = |row: &[u8]| rank(u16::from_le_bytes([row[0], row[1]]));
    let numbers: Option<Vec<u16>> = rows.chunks_exact(2).map(number).collect();
    if let Some(numbers) = numbers {
        let stepped = Forecast::encode(places, numbers.into_iter());
        let stepped: Vec<u8> = stepped.into_iter().flat_map(u16::to_le_bytes).collect();
        if packed(&stepped)? < packed(&rows)? {
            builder.push(steps, stepped);
            return Ok(());
        }
    }
    builder.insert(codes, rows);
    Ok(())
}

/// Bytes of rows of u16, in planes and compressed.
fn packed(rows: &[u8]) -> Result<usize> {
    let mut planes = Vec::with_capacity(rows.len());
    bytes::to_planes(rows, 2, &mut planes);
    Ok(bytes::compress(&planes, stats::LVOXEL_ZSTD_LEVEL)?.map_or(planes.len(), |p| p.len()))
}

/// Where lvoxels are, row by row.
enum Places<'a> {
    Blocks(Planes<'a>),
    Gaps(Planes<'a>, gaps::Walk),
}

impl Places<'_> {
    /// The block of a row, and the Morton code of its first voxel if gaps tell it.
    fn next(&mut self, row: usize, level: u8) -> Result<(u64, [u16; 3])> {
        match self {
            Self::Blocks(rows) => Ok((0, rows.u16x3(row, 0))),
            Self::Gaps(rows, walk) => {
                let gap = rows.u64(row);
                walk.next(gap, level).ok_or_else(|| {
                    FormatError::invalid(
                        format!("gap before lvoxel {row}"),
                        "one that leads to a block of its level",
                        format!("{gap} to level {level}"),
                    )
                })
            }
        }
    }
}

/// Numbers that are steps from what neighbours let expect.
struct Steppers<'a> {
    rows: Planes<'a>,
    forecast: Forecast,
}

impl<'a> Steppers<'a> {
    fn new(rows: Planes<'a>) -> Self {
        let forecast = Forecast::default();
        Self { rows, forecast }
    }

    fn next(&mut self, row: usize, first_voxel: u64, level: u8) -> u16 {
        let code = self.rows.u16(row, 0);
        self.forecast.decode(first_voxel, level, code)
    }
}

/// The inverse; the lvoxels are still to be checked against the volumes.
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
    if shift > Steps::MAX_SHIFT || level > MAX_LEVEL || cursor.u16()? != 0 {
        return Err(FormatError::invalid(
            "header of the page",
            format!(
                "a step of at most {}, a level of at most {MAX_LEVEL}, and 0",
                Steps::MAX_SHIFT
            ),
            format!("{shift}, {level}"),
        ));
    }
    let steps = Steps { base, shift };
    let n = n as usize;
    let columns = PageColumns::read(&mut cursor, &col::LVOXELS, mask, |rows| match rows {
        Rows::Lvoxels => n,
        _ => 0,
    })?;
    columns.at_most_one_of(&[col::SIGMA_T, col::SIGMA_T_F32, col::SIGMA_T_STEP])?;
    columns.at_most_one_of(&[
        col::SOURCE,
        col::SOURCE_GREY,
        col::SOURCE_F32,
        col::SOURCE_GREY_STEP,
    ])?;
    columns.one_of(&[col::BLOCK, col::BLOCK_GAP])?;
    let steppers = |index| columns.get(index).map(Steppers::new);
    let mut sigma_t_steps = steppers(col::SIGMA_T_STEP);
    let mut grey_steps = steppers(col::SOURCE_GREY_STEP);
    let mut places = match columns.get(col::BLOCK_GAP) {
        Some(gaps) => Places::Gaps(gaps, gaps::Walk::default()),
        None if sigma_t_steps.is_none() && grey_steps.is_none() => {
            Places::Blocks(columns.required(col::BLOCK)?)
        }
        None => {
            return Err(FormatError::invalid(
                "columns of the page",
                "gaps where there are steps",
                "blocks",
            ));
        }
    };
    let (volumes, levels) = (columns.get(col::VOLUME), columns.get(col::LEVEL));
    let (sigma_t, sigma_t_f32) = (columns.get(col::SIGMA_T), columns.get(col::SIGMA_T_F32));
    let grey = SharedExponent::checked(exponent)?;
    let mut lvoxels = Vec::with_capacity(n);
    for i in 0..n {
        let level = levels.map_or(level, |rows| rows.u8(i));
        let (first_voxel, block) = places.next(i, level)?;
        let sigma_t = match (&mut sigma_t_steps, sigma_t_f32) {
            (Some(rows), _) => steps.decode(rows.next(i, first_voxel, level)),
            (None, Some(rows)) => rows.f32(i, 0),
            (None, None) => steps.decode(sigma_t.map_or(0, |rows| rows.u16(i, 0))),
        };
        let source = match &mut grey_steps {
            Some(rows) => {
                let rank = rows.next(i, first_voxel, level);
                grey.decode_grey(GreyCode::of_rank(rank).ok_or_else(|| {
                    FormatError::invalid(
                        format!("source of lvoxel {i}"),
                        format!("a rank of at most {}", GreyCode::MAX_RANK),
                        rank,
                    )
                })?)
            }
            None => [0.0; 3],
        };
        lvoxels.push(Lvoxel {
            volume: volumes.map_or(volume, |rows| rows.u16(i, 0)),
            level,
            block,
            sigma_t,
            source,
        });
    }
    if grey_steps.is_none() {
        let source = lvoxels.iter_mut().map(|v| &mut v.source);
        radiance::decode(&columns, col::SOURCE, exponent, source)?;
    }
    Ok(lvoxels)
}
