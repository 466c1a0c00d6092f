//! The columns of pages: names, widths, and how they are put together.

use crate::bytes::Cursor;
use crate::{FormatError, Result};
use std::ops::Range;

/// Name of a column, bytes per row, and what a row belongs to.
pub struct Column {
    pub name: &'static str,
    pub width: usize,
    pub rows: Rows,
}

/// The things that have a row in a column.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Rows {
    Nodes,
    Links,
    LitAxes,
    Surfels,
    Edges,
    Lvoxels,
}

const fn column(name: &'static str, width: usize, rows: Rows) -> Column {
    Column { name, width, rows }
}

/// By bit in the mask of a page of surfels.
pub const SURFELS: [Column; 29] = [
    column("node_below", 1, Rows::Nodes),
    column("node_link", 4, Rows::Links),
    column("node_box", 12, Rows::Nodes),
    column("node_box_f32", 24, Rows::Nodes),
    column("node_area", 4, Rows::Nodes),
    column("node_centre", 6, Rows::Nodes),
    column("node_centre_f32", 12, Rows::Nodes),
    column("node_normal", 6, Rows::Nodes),
    column("node_moment", 12, Rows::Nodes),
    column("axis_area", 12, Rows::Nodes),
    column("axis_radiance", 4, Rows::LitAxes),
    column("axis_radiance_grey", 2, Rows::LitAxes),
    column("axis_radiance_f32", 12, Rows::LitAxes),
    column("position", 6, Rows::Surfels),
    column("position_f32", 12, Rows::Surfels),
    column("normal", 4, Rows::Surfels),
    column("radius", 2, Rows::Surfels),
    column("radius_f32", 4, Rows::Surfels),
    column("area", 2, Rows::Surfels),
    column("area_f32", 4, Rows::Surfels),
    column("front", 4, Rows::Surfels),
    column("front_grey", 2, Rows::Surfels),
    column("front_f32", 12, Rows::Surfels),
    column("back", 4, Rows::Surfels),
    column("back_grey", 2, Rows::Surfels),
    column("back_f32", 12, Rows::Surfels),
    column("clip_count", 1, Rows::Surfels),
    column("clip_edge", 2, Rows::Edges),
    column("back_axes", 1, Rows::Nodes),
];
pub const BELOW: usize = 0;
pub const LINK: usize = 1;
pub const BOX: usize = 2;
pub const BOX_F32: usize = 3;
pub const NODE_AREA: usize = 4;
pub const CENTRE: usize = 5;
pub const CENTRE_F32: usize = 6;
pub const NODE_NORMAL: usize = 7;
pub const MOMENT: usize = 8;
pub const AXIS_AREA: usize = 9;
pub const AXIS_RADIANCE: usize = 10;
pub const POSITION: usize = 13;
pub const POSITION_F32: usize = 14;
pub const NORMAL: usize = 15;
pub const RADIUS: usize = 16;
pub const RADIUS_F32: usize = 17;
pub const AREA: usize = 18;
pub const AREA_F32: usize = 19;
pub const FRONT: usize = 20;
pub const BACK: usize = 23;
pub const CLIP_COUNT: usize = 26;
pub const CLIP_EDGE: usize = 27;
pub const BACK_AXES: usize = 28;

/// By bit in the mask of a page of lvoxels.
pub const LVOXELS: [Column; 13] = [
    column("volume", 2, Rows::Lvoxels),
    column("level", 1, Rows::Lvoxels),
    column("block_gap", 8, Rows::Lvoxels),
    column("sigma_t", 2, Rows::Lvoxels),
    column("sigma_t_f32", 4, Rows::Lvoxels),
    column("source", 4, Rows::Lvoxels),
    column("source_grey", 2, Rows::Lvoxels),
    column("source_f32", 12, Rows::Lvoxels),
    column("lobe", 3, Rows::Lvoxels),
    column("incident", 4, Rows::Lvoxels),
    column("incident_grey", 2, Rows::Lvoxels),
    column("incident_f32", 12, Rows::Lvoxels),
    column("single", 4, Rows::Lvoxels),
];
pub const VOLUME: usize = 0;
pub const LEVEL: usize = 1;
pub const BLOCK_GAP: usize = 2;
pub const SIGMA_T: usize = 3;
pub const SIGMA_T_F32: usize = 4;
pub const SOURCE: usize = 5;
pub const LOBE: usize = 8;
pub const INCIDENT: usize = 9;
pub const SINGLE: usize = 12;

/// A page before compression: header, then the columns, each in byte planes.
pub struct PageBuilder {
    table: &'static [Column],
    raw: Vec<u8>,
    /// Columns, and where each lies.
    ranges: Vec<(usize, Range<usize>)>,
}

impl PageBuilder {
    /// A page that begins with a header of so many bytes.
    pub fn new(table: &'static [Column], header_bytes: usize) -> Self {
        Self {
            table,
            raw: vec![0; header_bytes],
            ranges: Vec::with_capacity(table.len()),
        }
    }

    /// Adds a column of bytes; columns must come in order.
    pub fn push_u8(&mut self, index: usize, rows: impl IntoIterator<Item = u8>) {
        let start = self.raw.len();
        self.raw.extend(rows);
        self.note(index, start);
    }

    /// Adds a column whose rows are two-byte numbers.
    pub fn push_u16<const N: usize>(&mut self, index: usize, rows: &[[u16; N]]) {
        let start = self.raw.len();
        self.raw.reserve(2 * N * rows.len());
        for k in 0..N {
            self.raw.extend(rows.iter().map(|row| row[k] as u8));
            self.raw.extend(rows.iter().map(|row| (row[k] >> 8) as u8));
        }
        self.note(index, start);
    }

    /// Adds a column whose rows are four-byte numbers.
    pub fn push_u32<const N: usize>(&mut self, index: usize, rows: &[[u32; N]]) {
        let start = self.raw.len();
        self.raw.reserve(4 * N * rows.len());
        for k in 0..N {
            for shift in [0, 8, 16, 24] {
                let plane = rows.iter().map(|row| (row[k] >> shift) as u8);
                self.raw.extend(plane);
            }
        }
        self.note(index, start);
    }

    /// Adds a column whose rows are eight-byte numbers.
    pub fn push_u64(&mut self, index: usize, rows: &[u64]) {
        let start = self.raw.len();
        self.raw.reserve(8 * rows.len());
        for byte in 0..8 {
            self.raw
                .extend(rows.iter().map(|row| (row >> (8 * byte)) as u8));
        }
        self.note(index, start);
    }

    /// Adds a column whose rows are floats.
    pub fn push_f32<const N: usize>(&mut self, index: usize, rows: &[[f32; N]]) {
        let bits: Vec<[u32; N]> = rows.iter().map(|row| row.map(f32::to_bits)).collect();
        self.push_u32(index, &bits);
    }

    fn note(&mut self, index: usize, start: usize) {
        debug_assert!(self.ranges.last().is_none_or(|(last, _)| *last < index));
        debug_assert_eq!((self.raw.len() - start) % self.table[index].width, 0);
        self.ranges.push((index, start..self.raw.len()));
    }

    pub fn mask(&self) -> u32 {
        self.ranges.iter().fold(0, |mask, (i, _)| mask | 1 << i)
    }

    /// The page with its header, which must be as long as was said, and where its columns lie.
    pub fn build(mut self, header: &[u8]) -> (Vec<u8>, Vec<(usize, Range<usize>)>) {
        self.raw[..header.len()].copy_from_slice(header);
        (self.raw, self.ranges)
    }
}

/// The columns of a decompressed page.
pub struct PageColumns<'a> {
    columns: Vec<Option<&'a [u8]>>,
    table: &'static [Column],
}

impl<'a> PageColumns<'a> {
    /// Splits what follows the header; the lengths must add up.
    pub fn read(
        cursor: &mut Cursor<'a>,
        table: &'static [Column],
        mask: u32,
        rows: impl Fn(Rows) -> usize,
    ) -> Result<Self> {
        if mask.checked_shr(table.len() as u32).unwrap_or(0) != 0 {
            return Err(FormatError::invalid(
                "columns of the page",
                format!("a mask of {} bits", table.len()),
                format!("{mask:#x}"),
            ));
        }
        let mut columns = vec![None; table.len()];
        for (index, slot) in columns.iter_mut().enumerate() {
            if mask >> index & 1 == 1 {
                let column = &table[index];
                *slot = Some(cursor.take(rows(column.rows) * column.width)?);
            }
        }
        cursor.end()?;
        Ok(Self { columns, table })
    }

    pub fn has(&self, index: usize) -> bool {
        self.columns[index].is_some()
    }

    /// A column as it lies in the page, if it is there.
    pub fn planes(&self, index: usize) -> Option<&'a [u8]> {
        self.columns[index]
    }

    /// Rows of a column, if it is there.
    pub fn get(&self, index: usize) -> Option<Planes<'a>> {
        let planes = self.columns[index]?;
        Some(Planes {
            planes,
            count: planes.len() / self.table[index].width,
        })
    }

    /// Rows of a column that must be there.
    pub fn required(&self, index: usize) -> Result<Planes<'a>> {
        self.get(index).ok_or_else(|| {
            FormatError::invalid(
                "columns of the page",
                format!("column {}", self.table[index].name),
                "none",
            )
        })
    }

    /// An error unless exactly one of the columns is there.
    pub fn one_of(&self, indices: &[usize]) -> Result<()> {
        if indices.iter().filter(|i| self.has(**i)).count() == 1 {
            return Ok(());
        }
        let names: Vec<_> = indices.iter().map(|i| self.table[*i].name).collect();
        Err(FormatError::invalid(
            "columns of the page",
            format!("one of {}", names.join(", ")),
            "none or several",
        ))
    }

    /// An error if more than one of the columns is there.
    pub fn at_most_one_of(&self, indices: &[usize]) -> Result<()> {
        if indices.iter().any(|i| self.has(*i)) {
            self.one_of(indices)
        } else {
            Ok(())
        }
    }
}

/// A column in byte planes: numbers are put together as they are read.
#[derive(Clone, Copy)]
pub struct Planes<'a> {
    planes: &'a [u8],
    count: usize,
}

impl Planes<'_> {
    fn byte(&self, row: usize, byte: usize) -> u8 {
        self.planes[byte * self.count + row]
    }

    /// The byte of a one-byte row.
    pub fn u8(&self, row: usize) -> u8 {
        self.byte(row, 0)
    }

    /// The k-th signed byte of a row.
    pub fn i8(&self, row: usize, k: usize) -> i8 {
        self.byte(row, k) as i8
    }

    /// The k-th two-byte number of a row.
    pub fn u16(&self, row: usize, k: usize) -> u16 {
        u16::from_le_bytes([self.byte(row, 2 * k), self.byte(row, 2 * k + 1)])
    }

    /// The k-th four-byte number of a row.
    pub fn u32(&self, row: usize, k: usize) -> u32 {
        u32::from_le_bytes(std::array::from_fn(|i| self.byte(row, 4 * k + i)))
    }

    /// The k-th two-byte number of all rows: plane by plane, which is faster than row by row.
    pub fn u16s(&self, k: usize) -> impl Iterator<Item = u16> {
        let plane = |byte: usize| &self.planes[byte * self.count..(byte + 1) * self.count];
        let pairs = plane(2 * k).iter().zip(plane(2 * k + 1));
        pairs.map(|(low, high)| u16::from_le_bytes([*low, *high]))
    }

    /// The k-th four-byte number of all rows.
    fn u32s(&self, k: usize) -> impl Iterator<Item = u32> {
        let pairs = self.u16s(2 * k).zip(self.u16s(2 * k + 1));
        pairs.map(|(low, high)| u32::from(low) | u32::from(high) << 16)
    }

    /// The eight-byte number of all rows.
    pub fn u64s(&self) -> Vec<u64> {
        let mut numbers = vec![0; self.count];
        for (byte, plane) in self.planes.chunks_exact(self.count.max(1)).enumerate() {
            // Most high bytes of most columns are 0.
            if plane.iter().fold(0, |all, b| all | b) != 0 {
                for (number, b) in numbers.iter_mut().zip(plane) {
                    *number |= u64::from(*b) << (8 * byte);
                }
            }
        }
        numbers
    }

    /// The k-th four-byte float of a row.
    pub fn f32(&self, row: usize, k: usize) -> f32 {
        f32::from_bits(self.u32(row, k))
    }

    /// Three floats.
    pub fn f32x3(&self, row: usize, first: usize) -> [f32; 3] {
        std::array::from_fn(|k| self.f32(row, first + k))
    }
}

/// Radiance in one of three codings, whose columns are adjacent: colour, grey, three floats.
pub mod radiance {
    use super::{PageBuilder, PageColumns};
    use crate::quantise::SharedExponent;
    use crate::{FormatError, Result, check};

    /// Raw bytes saved by a column that is grey or dark.
    pub struct Written {
        /// The exponent's base, for the header.
        pub base: i16,
        /// Bytes that colour would have taken beyond those that were needed.
        pub saved: u64,
        /// Whether the values are as given.
        pub exact: bool,
    }

    /// Writes a column and replaces the values by what a reader decodes.
    pub fn encode(builder: &mut PageBuilder, first: usize, values: &mut [[f32; 3]]) -> Written {
        let mut written = Written {
            base: 0,
            saved: 0,
            exact: false,
        };
        if values.iter().all(|c| *c == [0.0; 3]) {
            written.saved = 4 * values.len() as u64;
            written.exact = true;
            return written;
        }
        let Some(code) = SharedExponent::fit(values.iter().copied()) else {
            builder.push_f32(first + 2, values);
            written.exact = true;
            return written;
        };
        written.base = code.base;
        if values.iter().all(|[r, g, b]| r == g && g == b) {
            written.saved = 2 * values.len() as u64;
            let encode = |v: &mut [f32; 3]| {
                let c = code.encode_grey(v[0]);
                *v = code.decode_grey(c);
                [c]
            };
            let rows: Vec<[u16; 1]> = values.iter_mut().map(encode).collect();
            builder.push_u16(first + 1, &rows);
        } else {
            let encode = |v: &mut [f32; 3]| {
                let c = code.encode(*v);
                *v = code.decode(c);
                [c]
            };
            let rows: Vec<[u32; 1]> = values.iter_mut().map(encode).collect();
            builder.push_u32(first, &rows);
        }
        written
    }

    /// Reads a column into `values`, which are dark if there is none.
    pub fn decode<'a>(
        columns: &PageColumns<'_>,
        first: usize,
        base: i16,
        values: impl Iterator<Item = &'a mut [f32; 3]>,
    ) -> Result<()> {
        columns.at_most_one_of(&[first, first + 1, first + 2])?;
        let code = SharedExponent::checked(base)?;
        if let Some(rows) = columns.get(first) {
            for (v, c) in values.zip(rows.u32s(0)) {
                *v = code.decode(c);
            }
        } else if let Some(rows) = columns.get(first + 1) {
            for (v, c) in values.zip(rows.u16s(0)) {
                *v = code.decode_grey(c);
            }
        } else if let Some(rows) = columns.get(first + 2) {
            for (i, v) in values.enumerate() {
                *v = rows.f32x3(i, 0);
                if !check::is_radiance(*v) {
                    return Err(FormatError::invalid(
                        "radiance of the page",
                        "numbers of at least 0",
                        format!("{v:?}"),
                    ));
                }
            }
        }
        Ok(())
    }
}
