//! The columns of pages: names, widths, and how they are put together.

use crate::bytes::{self, Cursor};
use crate::{FormatError, Result};

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
pub const LVOXELS: [Column; 8] = [
    column("volume", 2, Rows::Lvoxels),
    column("level", 1, Rows::Lvoxels),
    column("block_gap", 8, Rows::Lvoxels),
    column("sigma_t", 2, Rows::Lvoxels),
    column("sigma_t_f32", 4, Rows::Lvoxels),
    column("source", 4, Rows::Lvoxels),
    column("source_grey", 2, Rows::Lvoxels),
    column("source_f32", 12, Rows::Lvoxels),
];
pub const VOLUME: usize = 0;
pub const LEVEL: usize = 1;
pub const BLOCK_GAP: usize = 2;
pub const SIGMA_T: usize = 3;
pub const SIGMA_T_F32: usize = 4;
pub const SOURCE: usize = 5;

/// A page before compression: header, then the columns, each in byte planes.
pub struct PageBuilder {
    table: &'static [Column],
    columns: Vec<(usize, Vec<u8>)>,
}

impl PageBuilder {
    pub fn new(table: &'static [Column]) -> Self {
        Self {
            table,
            columns: Vec::new(),
        }
    }

    /// Adds a column; they must come in order.
    pub fn push(&mut self, index: usize, rows: Vec<u8>) {
        debug_assert!(self.columns.last().is_none_or(|(last, _)| *last < index));
        debug_assert_eq!(rows.len() % self.table[index].width, 0);
        self.columns.push((index, rows));
    }

    pub fn mask(&self) -> u32 {
        self.columns.iter().fold(0, |mask, (i, _)| mask | 1 << i)
    }

    /// The columns behind a header, and where each lies.
    pub fn build(self, header: &[u8]) -> (Vec<u8>, Vec<(usize, std::ops::Range<usize>)>) {
        let mut raw = header.to_vec();
        let mut ranges = Vec::with_capacity(self.columns.len());
        for (index, rows) in self.columns {
            let start = raw.len();
            bytes::to_planes(&rows, self.table[index].width, &mut raw);
            ranges.push((index, start..raw.len()));
        }
        (raw, ranges)
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
            let rows = values.iter().flatten().flat_map(|v| v.to_le_bytes());
            builder.push(first + 2, rows.collect());
            written.exact = true;
            return written;
        };
        written.base = code.base;
        if values.iter().all(|[r, g, b]| r == g && g == b) {
            written.saved = 2 * values.len() as u64;
            let rows = values.iter_mut().flat_map(|v| {
                let c = code.encode_grey(v[0]);
                *v = code.decode_grey(c);
                c.to_le_bytes()
            });
            builder.push(first + 1, rows.collect());
        } else {
            let rows = values.iter_mut().flat_map(|v| {
                let c = code.encode(*v);
                *v = code.decode(c);
                c.to_le_bytes()
            });
            builder.push(first, rows.collect());
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
