//! Pages of lvoxels.

use super::MAX_PAGE_RECORDS;
use super::columns::{self as col, PageBuilder, PageColumns, Rows, radiance};
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

/// Replaces a column of u16 by steps from what neighbours let expect, if those are shorter once
/// they are compressed. `rank` gives the numbers that steps are taken of, or nothing for codes that
/// have none.
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
    let volumes = columns.get(col::VOLUME);
    let levels = columns.get(col::LEVEL);
    let mut lvoxels: Vec<Lvoxel> = (0..n)
        .map(|i| Lvoxel {
            volume: volumes.map_or(volume, |rows| rows.u16(i, 0)),
            level: levels.map_or(level, |rows| rows.u8(i)),
            ..Lvoxel::default()
        })
        .collect();
    if let Some(rows) = columns.get(col::BLOCK) {
        for (i, v) in lvoxels.iter_mut().enumerate() {
            v.block = rows.u16x3(i, 0);
        }
    }
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
    if !columns.has(col::SOURCE_GREY_STEP) {
        let source = lvoxels.iter_mut().map(|v| &mut v.source);
        radiance::decode(&columns, col::SOURCE, exponent, source)?;
    }
    read_gaps(&columns, &steps, exponent, &mut lvoxels)?;
    Ok(lvoxels)
}

/// Finds the blocks where gaps tell them, and the numbers that are steps from what neighbours let
/// expect.
fn read_gaps(
    columns: &PageColumns<'_>,
    sigma_t: &Steps,
    exponent: i16,
    lvoxels: &mut [Lvoxel],
) -> Result<()> {
    let stepped = [col::SIGMA_T_STEP, col::SOURCE_GREY_STEP];
    let [sigma_t_steps, grey_steps] = stepped.map(|index| columns.has(index));
    let Some(gaps) = columns.get(col::BLOCK_GAP) else {
        return if sigma_t_steps || grey_steps {
            Err(FormatError::invalid(
                "columns of the page",
                "gaps where there are steps",
                "blocks",
            ))
        } else {
            Ok(())
        };
    };
    // One thing for all lvoxels after the other, which is faster than all things for one.
    let mut walk = gaps::Walk::default();
    let mut first_voxels = Vec::with_capacity(lvoxels.len());
    for (v, gap) in lvoxels.iter_mut().zip(gaps.u64s()) {
        let Some((first_voxel, block)) = walk.next(gap, v.level) else {
            return Err(FormatError::invalid(
                format!("gap before lvoxel {}", first_voxels.len()),
                "one that leads to a block of its level",
                format!("{gap} to level {}", v.level),
            ));
        };
        v.block = block;
        first_voxels.push(first_voxel);
    }
    if !(sigma_t_steps || grey_steps) {
        return Ok(());
    }
    let source = SharedExponent::checked(exponent)?;
    let set_grey = |i: usize, v: &mut Lvoxel, rank: u16| {
        let Some(code) = GreyCode::of_rank(rank) else {
            return Err(FormatError::invalid(
                format!("source of lvoxel {i}"),
                format!("a rank of at most {}", GreyCode::MAX_RANK),
                rank,
            ));
        };
        v.source = source.decode_grey(code);
        Ok(())
    };
    let places = lvoxels.iter_mut().zip(first_voxels);
    match stepped.map(|index| columns.get(index)) {
        [Some(sigma_t_rows), Some(grey_rows)] => {
            let mut forecast = Forecast::<2>::default();
            let codes = sigma_t_rows.u16s(0).zip(grey_rows.u16s(0));
            for (i, ((v, at), (a, b))) in places.zip(codes).enumerate() {
                let [code, rank] = forecast.decode(at, v.level, [a, b]);
                v.sigma_t = sigma_t.decode(code);
                set_grey(i, v, rank)?;
            }
        }
        [Some(rows), None] => {
            let mut forecast = Forecast::<1>::default();
            for ((v, at), step) in places.zip(rows.u16s(0)) {
                let [code] = forecast.decode(at, v.level, [step]);
                v.sigma_t = sigma_t.decode(code);
            }
        }
        [None, Some(rows)] => {
            let mut forecast = Forecast::<1>::default();
            for (i, ((v, at), step)) in places.zip(rows.u16s(0)).enumerate() {
                let [rank] = forecast.decode(at, v.level, [step]);
                set_grey(i, v, rank)?;
            }
        }
        [None, None] => {}
    }
    Ok(())
}
