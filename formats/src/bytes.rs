//! Little-endian numbers in and out of byte slices, bounds-checked, and zstd and checksums of them.

use crate::{FormatError, Result};
use std::cell::RefCell;
use xxhash_rust::xxh3::xxh3_64;

/// Reads numbers from the front of a slice.
pub struct Cursor<'a> {
    rest: &'a [u8],
    what: &'static str,
}

impl<'a> Cursor<'a> {
    /// A cursor at the start of `bytes`; `what` names them in errors.
    pub fn new(bytes: &'a [u8], what: &'static str) -> Self {
        Self { rest: bytes, what }
    }

    /// The next `n` bytes.
    pub fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        if n > self.rest.len() {
            return Err(FormatError::invalid(
                self.what,
                format!("{n} more bytes"),
                self.rest.len(),
            ));
        }
        let (head, rest) = self.rest.split_at(n);
        self.rest = rest;
        Ok(head)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    pub fn u8(&mut self) -> Result<u8> {
        Ok(self.array::<1>()?[0])
    }

    pub fn u16(&mut self) -> Result<u16> {
        Ok(u16::from_le_bytes(self.array()?))
    }

    pub fn i16(&mut self) -> Result<i16> {
        Ok(i16::from_le_bytes(self.array()?))
    }

    pub fn u32(&mut self) -> Result<u32> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    pub fn u64(&mut self) -> Result<u64> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    pub fn f32(&mut self) -> Result<f32> {
        Ok(f32::from_le_bytes(self.array()?))
    }

    /// An error unless all was read.
    pub fn end(&self) -> Result<()> {
        if self.rest.is_empty() {
            Ok(())
        } else {
            Err(FormatError::invalid(
                self.what,
                "no bytes after the last value",
                format!("{} bytes", self.rest.len()),
            ))
        }
    }
}

/// Name of a column and bytes in a row of it.
pub struct Column {
    pub name: &'static str,
    pub width: usize,
}

pub const fn column(name: &'static str, width: usize) -> Column {
    Column { name, width }
}

/// Numbers of all rows.
pub fn floats<const N: usize>(values: impl Iterator<Item = [f32; N]>) -> Vec<u8> {
    let mut rows = Vec::with_capacity(values.size_hint().0 * N * size_of::<f32>());
    for value in values.flatten() {
        rows.extend_from_slice(&value.to_le_bytes());
    }
    rows
}

/// Rows of three numbers.
pub fn triples(rows: &[u8]) -> Vec<[f32; 3]> {
    let float = |row: &[u8], i: usize| {
        f32::from_le_bytes([row[4 * i], row[4 * i + 1], row[4 * i + 2], row[4 * i + 3]])
    };
    rows.chunks_exact(12)
        .map(|row| [float(row, 0), float(row, 1), float(row, 2)])
        .collect()
}

/// Rows of one number.
pub fn singles(rows: &[u8]) -> impl Iterator<Item = f32> + '_ {
    rows.chunks_exact(4)
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// Splits rows of `width` bytes into `width` planes: all first bytes, then all second bytes, and so
/// on. Neighbouring numbers share their high bytes, which zstd can only use when they stand
/// together.
pub fn to_planes(rows: &[u8], width: usize, planes: &mut Vec<u8>) {
    debug_assert_eq!(rows.len() % width.max(1), 0);
    planes.reserve(rows.len());
    match width {
        2 => to_planes_of::<2>(rows, planes),
        4 => to_planes_of::<4>(rows, planes),
        6 => to_planes_of::<6>(rows, planes),
        12 => to_planes_of::<12>(rows, planes),
        _ => {
            for byte in 0..width {
                planes.extend(rows.iter().skip(byte).step_by(width));
            }
        }
    }
}

/// As [`to_planes`], with a width that the compiler knows.
fn to_planes_of<const WIDTH: usize>(rows: &[u8], planes: &mut Vec<u8>) {
    let (rows, _) = rows.as_chunks::<WIDTH>();
    for byte in 0..WIDTH {
        planes.extend(rows.iter().map(|row| row[byte]));
    }
}

/// The inverse of [`to_planes`].
pub fn from_planes(planes: &[u8], width: usize) -> Vec<u8> {
    let mut rows = vec![0; planes.len()];
    if width == 0 || planes.is_empty() {
        return rows;
    }
    match width {
        2 => from_planes_of::<2>(planes, &mut rows),
        4 => from_planes_of::<4>(planes, &mut rows),
        6 => from_planes_of::<6>(planes, &mut rows),
        12 => from_planes_of::<12>(planes, &mut rows),
        _ => {
            let count = planes.len() / width;
            for (byte, plane) in planes.chunks_exact(count).enumerate() {
                for (row, value) in rows.chunks_exact_mut(width).zip(plane) {
                    row[byte] = *value;
                }
            }
        }
    }
    rows
}

/// As [`from_planes`], with a width that the compiler knows.
fn from_planes_of<const WIDTH: usize>(planes: &[u8], rows: &mut [u8]) {
    let (rows, _) = rows.as_chunks_mut::<WIDTH>();
    let count = rows.len();
    let plane: [&[u8]; WIDTH] = std::array::from_fn(|k| &planes[k * count..(k + 1) * count]);
    for (i, row) in rows.iter_mut().enumerate() {
        *row = std::array::from_fn(|k| plane[k][i]);
    }
}

/// xxh3-64 of `bytes` must be `expected`.
pub fn check(bytes: &[u8], expected: u64, what: impl FnOnce() -> String) -> Result<()> {
    let found = xxh3_64(bytes);
    if found == expected {
        Ok(())
    } else {
        Err(FormatError::Checksum {
            what: what(),
            expected,
            found,
        })
    }
}

/// One zstd frame of `raw`, or `None` if that is not shorter.
pub fn compress(raw: &[u8], level: i32) -> Result<Option<Vec<u8>>> {
    thread_local! {
        static CONTEXT: RefCell<Option<(i32, zstd::bulk::Compressor<'static>)>> =
            const { RefCell::new(None) };
    }
    CONTEXT.with_borrow_mut(|slot| {
        if slot.as_ref().is_none_or(|(l, _)| *l != level) {
            let context =
                zstd::bulk::Compressor::new(level).map_err(FormatError::io("start zstd"))?;
            *slot = Some((level, context));
        }
        let Some((_, context)) = slot else {
            return Ok(None);
        };
        let packed = context
            .compress(raw)
            .map_err(FormatError::io("compress with zstd"))?;
        Ok((packed.len() < raw.len()).then_some(packed))
    })
}

/// Decompresses one zstd frame, which must fill `raw` exactly.
pub fn decompress(packed: &[u8], raw: &mut [u8], what: &str) -> Result<()> {
    thread_local! {
        static CONTEXT: RefCell<Option<zstd::bulk::Decompressor<'static>>> =
            const { RefCell::new(None) };
    }
    CONTEXT.with_borrow_mut(|slot| {
        if slot.is_none() {
            *slot = Some(zstd::bulk::Decompressor::new().map_err(FormatError::io("start zstd"))?);
        }
        let Some(context) = slot else { return Ok(()) };
        let expected = raw.len();
        match context.decompress_to_buffer(packed, raw) {
            Ok(n) if n == expected => Ok(()),
            Ok(n) => Err(FormatError::invalid(
                what,
                format!("{expected} bytes in the zstd frame"),
                n,
            )),
            Err(error) => Err(FormatError::invalid(
                what,
                format!("a zstd frame of {expected} bytes"),
                error,
            )),
        }
    })
}
