//! NIfTI volumes of version 1 or 2 in one file, plain or gzip; any integer to 64 bits and floats,
//! either byte order, with slope and intercept.
//!
//! The file is placed by `sform` if that has a code (any affine map), else by `qform` (a turn, with
//! or without a mirror), else by voxel sizes alone. All three are right, anterior, superior of a
//! patient. Values are `scl_slope` times what is stored plus `scl_inter`.

use super::field::Field;
use super::files::Files;
use super::patient::PatientSpace;
use super::samples::{Array, Number, Samples, byte_length};
use super::unpack::{self, Packing};
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// Bytes of the longer of the two headers.
const LONGEST_HEADER: usize = 540;

/// Reads a NIfTI file, of which gzip is told by its first bytes.
pub(super) fn read(content: Vec<u8>, path: &Path, files: &mut Files) -> Result<Field> {
    let is_packed = content.starts_with(&[0x1f, 0x8b]);
    let start = match is_packed {
        true => Packing::Gzip.start(&content, LONGEST_HEADER)?,
        false => content[..content.len().min(LONGEST_HEADER)].to_vec(),
    };
    let header = Header::of(&start)?;
    let dims = header.dims()?;
    let number = header.number()?;
    let expected = byte_length(dims, number)?;
    let at = header.data_at()?;
    let ras_from_index = header.ras_from_index(path, files)?;
    let data = match is_packed {
        true => Packing::Gzip.unpack(&content, Some(at), expected, &files.cancel)?,
        false => unpack::raw(content, Some(at), at, expected)?,
    };
    if data.is_longer {
        files.warn(format!(
            "{}: there is more data than `dim` says; the rest is left out",
            path.display()
        ));
    }
    let space = PatientSpace::Ras;
    Ok(Field {
        name: None,
        dims,
        first: [0; 3],
        padding: 0,
        world_from_file: Some(space.to_lps() * ras_from_index),
        patient: Some(space),
        samples: Samples::Array(Array {
            dims,
            bytes: data.bytes.into(),
            number,
            big_endian: header.big_endian,
            rescale: header.rescale(),
        })
        .into(),
        start: [0; 3],
    })
}

/// The header of a file, and how to read it.
struct Header<'a> {
    bytes: &'a [u8],
    big_endian: bool,
    is_second: bool,
}

impl<'a> Header<'a> {
    fn of(bytes: &'a [u8]) -> Result<Self> {
        let other = || {
            Error::input("expected a NIfTI header of 348 or 540 bytes, found another kind of file")
        };
        let size: [u8; 4] = bytes
            .get(..4)
            .and_then(|b| b.try_into().ok())
            .ok_or_else(other)?;
        let sizes = [i32::from_le_bytes(size), i32::from_be_bytes(size)];
        let (big_endian, is_second) = match sizes {
            [348, _] => (false, false),
            [_, 348] => (true, false),
            [540, _] => (false, true),
            [_, 540] => (true, true),
            _ => return Err(other()),
        };
        let length = if is_second { 540 } else { 348 };
        if bytes.len() < length {
            return Err(Error::input(format!(
                "expected a header of {length} bytes, found {}; the file is truncated",
                bytes.len()
            )));
        }
        let magic = if is_second {
            &bytes[4..8]
        } else {
            &bytes[344..348]
        };
        match (magic, is_second) {
            (b"n+1\0", false) | (b"n+2\0", true) => Ok(Self {
                bytes,
                big_endian,
                is_second,
            }),
            (b"ni1\0", false) | (b"ni2\0", true) => Err(Error::input(
                "the header says that samples are in an .img file, which is not read",
            )
            .hint("write it as one file, for example with `nib.save(image, \"a.nii.gz\")`")),
            _ => Err(Error::input(
                "expected the magic \"n+1\" or \"n+2\" of NIfTI, found none; \
                 ANALYZE files are not read",
            )
            .hint("write it as NIfTI, for example with `nib.save(image, \"a.nii.gz\")`")),
        }
    }

    /// `N` bytes, little-endian, from the place for version 1 or that for version 2.
    fn at<const N: usize>(&self, places: [usize; 2]) -> [u8; N] {
        let at = places[usize::from(self.is_second)];
        let mut bytes: [u8; N] = std::array::from_fn(|i| self.bytes[at + i]);
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    fn short(&self, places: [usize; 2]) -> i16 {
        i16::from_le_bytes(self.at(places))
    }

    /// A whole number of 2 or 8 bytes.
    fn length(&self, places: [usize; 2], i: usize) -> i64 {
        match self.is_second {
            true => i64::from_le_bytes(self.at([0, places[1] + 8 * i])),
            false => i16::from_le_bytes(self.at([places[0] + 2 * i, 0])).into(),
        }
    }

    /// A float of 4 or 8 bytes.
    fn float(&self, places: [usize; 2], i: usize) -> f64 {
        match self.is_second {
            true => f64::from_le_bytes(self.at([0, places[1] + 8 * i])),
            false => f32::from_le_bytes(self.at([places[0] + 4 * i, 0])).into(),
        }
    }

    /// A code of 2 or 4 bytes.
    fn code(&self, places: [usize; 2]) -> i32 {
        match self.is_second {
            true => i32::from_le_bytes(self.at(places)),
            false => self.short(places).into(),
        }
    }

    fn dims(&self) -> Result<[usize; 3]> {
        let dim = |i: usize| self.length([40, 16], i);
        let all: Vec<i64> = (0..8).map(dim).collect();
        let count = all[0];
        let wrong = || {
            Error::input(format!(
                "expected 3 to 7 axes of at least 1 voxel, found `dim` {all:?}"
            ))
        };
        if !(3..=7).contains(&count) {
            return Err(wrong());
        }
        let sizes = &all[1..=count as usize];
        if sizes.iter().any(|n| *n < 1) {
            return Err(wrong());
        }
        if sizes[3..].iter().any(|n| *n > 1) {
            return Err(Error::input(format!(
                "expected one volume, found `dim` {sizes:?}: a series, \
                 or more than one value in each voxel"
            ))
            .hint("write one of them as a file of its own, for example with `nib.four_to_three`"));
        }
        let size = |i: usize| usize::try_from(sizes[i]).map_err(|_| wrong());
        Ok([size(0)?, size(1)?, size(2)?])
    }

    fn number(&self) -> Result<Number> {
        let code = self.short([70, 12]);
        let number = match code {
            2 => Number::U8,
            4 => Number::I16,
            8 => Number::I32,
            16 => Number::F32,
            64 => Number::F64,
            256 => Number::I8,
            512 => Number::U16,
            768 => Number::U32,
            1024 => Number::I64,
            1280 => Number::U64,
            _ => {
                let name = match code {
                    1 => "bits",
                    32 | 1792 | 2048 => "complex numbers",
                    128 | 2304 => "colours",
                    1536 => "floats of 128 bits",
                    _ => "an unknown type",
                };
                return Err(
                    Error::input(format!("`datatype` {code}, {name}, is not supported"))
                        .hint("supported are integers of 8 to 64 bits and floats of 32 and 64"),
                );
            }
        };
        let bits = self.short([72, 14]);
        if i64::from(bits) != 8 * number.size() as i64 {
            return Err(Error::input(format!(
                "expected `bitpix` {} for the `datatype` {code}, found {bits}",
                8 * number.size()
            )));
        }
        Ok(number)
    }

    /// Where samples begin; 0 stands for right behind the header and its four bytes of extensions.
    fn data_at(&self) -> Result<usize> {
        let least = if self.is_second { 544 } else { 352 };
        let offset = match self.is_second {
            true => i64::from_le_bytes(self.at([0, 168])) as f64,
            false => f64::from(f32::from_le_bytes(self.at([108, 0]))),
        };
        match offset {
            0.0 => Ok(least),
            _ if offset >= least as f64 && offset < 9e15 && offset.fract() == 0.0 => {
                Ok(offset as usize)
            }
            _ => Err(Error::input(format!(
                "expected a `vox_offset` of at least {least}, found {offset}"
            ))),
        }
    }

    /// Slope and intercept of the values, if there are any.
    fn rescale(&self) -> Option<[f64; 2]> {
        let (slope, inter) = (self.float([112, 176], 0), self.float([116, 184], 0));
        let is_given = slope.is_finite() && inter.is_finite() && slope != 0.0;
        (is_given && [slope, inter] != [1.0, 0.0]).then_some([slope, inter])
    }

    /// From the index space to right, anterior, superior.
    fn ras_from_index(&self, path: &Path, files: &mut Files) -> Result<DAffine3> {
        let (map, by) = if self.code([254, 348]) > 0 {
            (self.sform(), "sform")
        } else if self.code([252, 344]) > 0 {
            (self.qform(), "qform")
        } else {
            files.warn(format!(
                "{}: neither `sform` nor `qform` has a code; voxels are taken to run right, \
                 anterior and superior",
                path.display()
            ));
            (DAffine3::from_scale(self.voxel_size()), "pixdim")
        };
        if is_singular(&map) {
            return Err(Error::input(format!(
                "the placement by `{by}` is singular: it flattens space, or is not finite"
            )));
        }
        Ok(map)
    }

    fn voxel_size(&self) -> DVec3 {
        let size = |i: usize| self.float([76, 104], i).abs();
        DVec3::new(size(1), size(2), size(3))
    }

    fn sform(&self) -> DAffine3 {
        let row = |first: [usize; 2]| -> [f64; 4] { std::array::from_fn(|i| self.float(first, i)) };
        let rows = [row([280, 400]), row([296, 432]), row([312, 464])];
        let column = |i: usize| DVec3::new(rows[0][i], rows[1][i], rows[2][i]);
        DAffine3 {
            matrix3: DMat3::from_cols(column(0), column(1), column(2)),
            translation: column(3),
        }
    }

    fn qform(&self) -> DAffine3 {
        let [b, c, d] = std::array::from_fn(|i| self.float([256, 352], i));
        let rest = 1.0 - (b * b + c * c + d * d);
        // What is left of a length of 1 is lost in rounding where the turn is by 180 degrees.
        let (a, scale) = match rest < 1e-7 {
            true => (0.0, (b * b + c * c + d * d).sqrt().recip()),
            false => (rest.sqrt(), 1.0),
        };
        let [b, c, d] = [b, c, d].map(|v| v * scale);
        let turn = DMat3::from_cols(
            DVec3::new(
                a * a + b * b - c * c - d * d,
                2.0 * (b * c + a * d),
                2.0 * (b * d - a * c),
            ),
            DVec3::new(
                2.0 * (b * c - a * d),
                a * a + c * c - b * b - d * d,
                2.0 * (c * d + a * b),
            ),
            DVec3::new(
                2.0 * (b * d + a * c),
                2.0 * (c * d - a * b),
                a * a + d * d - c * c - b * b,
            ),
        );
        let mut size = self.voxel_size();
        if self.float([76, 104], 0) < 0.0 {
            size.z = -size.z;
        }
        let offset = |i: usize| self.float([268, 376], i);
        DAffine3 {
            matrix3: turn * DMat3::from_diagonal(size),
            translation: DVec3::new(offset(0), offset(1), offset(2)),
        }
    }
}

#[cfg(test)]
mod tests;
