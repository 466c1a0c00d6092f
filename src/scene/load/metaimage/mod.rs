//! MetaImage volumes (`.mha`, and `.mhd` with data files): samples in the file, in one beside it or
//! in one for each slice; raw, zlib or text; any integer to 64 bits and floats, either byte order.
//!
//! `Offset`, `TransformMatrix` and `ElementSpacing` place the centre of each voxel, as ITK reads
//! them: the first three numbers of the matrix are the direction of the first axis. The axes are
//! left, posterior, superior of a patient, unless `AnatomicalOrientation` says that it is not
//! known.

use super::field::Field;
use super::files::Files;
use super::nrrd::{Lines, numbered_names};
use super::patient::PatientSpace;
use super::samples::{Array, Number, Samples, byte_length};
use super::unpack::{self, Data, Packing};
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::path::Path;

/// Lines of a header that are read before one that is none is an error.
const MAX_LINES: usize = 1000;

/// Reads a MetaImage file; `files` is asked for its data files.
pub(super) fn read(content: Vec<u8>, path: &Path, files: &mut Files) -> Result<Field> {
    let (header, data_at) = Header::parse(&content)?;
    let dims = header.dims()?;
    let number = header.number()?;
    let expected = byte_length(dims, number)?;
    let world_from_index = header.world_from_index()?;
    let patient = header.patient_space();
    if header.is_rescaled() {
        files.warn(format!(
            "{}: `ElementToIntensityFunctionSlope` and `Offset` are left out, as ITK does; values \
             are those stored",
            path.display()
        ));
    }
    let data = match header.data_files(&content, data_at)? {
        None => header.data(content, data_at, expected, number, files)?,
        Some(names) => Data::of_files(&names, path, expected, files, |content, share, files| {
            header.data(content, 0, share, number, files)
        })?,
    };
    if data.is_longer {
        files.warn(format!(
            "{}: there is more data than `DimSize` says; the rest is left out",
            path.display()
        ));
    }
    Ok(Field {
        name: None,
        dims,
        first: [0; 3],
        padding: 0,
        world_from_file: Some(world_from_index),
        patient,
        samples: Samples::Array(Array {
            dims,
            bytes: data.bytes.into(),
            number: if data.is_f64 { Number::F64 } else { number },
            big_endian: header.is_big_endian() && !data.is_f64,
            rescale: None,
        })
        .into(),
        start: [0; 3],
    })
}

/// The fields of the header, the last of which is `ElementDataFile`.
struct Header {
    fields: HashMap<String, String>,
}

impl Header {
    /// The header and the offset of what follows it.
    fn parse(content: &[u8]) -> Result<(Self, usize)> {
        let mut lines = Lines { content, at: 0 };
        let mut fields = HashMap::new();
        let mut number = 0;
        while let Some(line) = lines.next() {
            number += 1;
            if line.trim().is_empty() {
                continue;
            }
            let Some((name, value)) = line.split_once('=').filter(|_| number <= MAX_LINES) else {
                return Err(match fields.is_empty() {
                    // What is no such file is not quoted.
                    true => Error::input(
                        "expected `Name = value` in the first line of a MetaImage file, found \
                         another kind of file",
                    ),
                    false => Error::input(format!(
                        "line {number}: expected `Name = value` up to `ElementDataFile`, \
                         found \"{}\"",
                        line.chars().take(40).collect::<String>()
                    )),
                });
            };
            let (name, value) = (name.trim().to_owned(), value.trim().to_owned());
            let is_last = name == "ElementDataFile";
            fields.insert(name, value);
            if is_last {
                return Ok((Self { fields }, lines.at));
            }
        }
        Err(Error::input(
            "expected `ElementDataFile` as the last field of a MetaImage header, found none",
        ))
    }

    fn get(&self, names: &[&str]) -> Option<&str> {
        let found = names.iter().find_map(|n| self.fields.get(*n));
        found.map(String::as_str)
    }

    fn require(&self, name: &str) -> Result<&str> {
        self.get(&[name])
            .ok_or_else(|| Error::input(format!("the header has no `{name}`")))
    }

    fn is_true(&self, names: &[&str]) -> bool {
        (self.get(names)).is_some_and(|v| v.starts_with(['T', 't', 'Y', 'y', '1']))
    }

    fn dims(&self) -> Result<[usize; 3]> {
        let count = self.require("NDims")?;
        let text = self.require("DimSize")?;
        let channels = self.get(&["ElementNumberOfChannels"]).unwrap_or("1");
        if count != "3" || channels != "1" {
            return Err(Error::input(format!(
                "expected `NDims = 3` and one channel, found {count} and {channels}; only scalar \
                 volumes are supported"
            )));
        }
        let sizes: Vec<usize> = text
            .split_whitespace()
            .filter_map(|s| s.parse().ok())
            .collect();
        match sizes[..] {
            [x, y, z] if x > 0 && y > 0 && z > 0 => Ok([x, y, z]),
            _ => Err(Error::input(format!(
                "expected three sizes of at least 1, found `DimSize = {text}`"
            ))),
        }
    }

    fn number(&self) -> Result<Number> {
        let name = self.require("ElementType")?;
        Ok(match name {
            "MET_CHAR" => Number::I8,
            "MET_UCHAR" => Number::U8,
            "MET_SHORT" => Number::I16,
            "MET_USHORT" => Number::U16,
            "MET_INT" | "MET_LONG" => Number::I32,
            "MET_UINT" | "MET_ULONG" => Number::U32,
            "MET_LONG_LONG" => Number::I64,
            "MET_ULONG_LONG" => Number::U64,
            "MET_FLOAT" => Number::F32,
            "MET_DOUBLE" => Number::F64,
            _ => {
                return Err(
                    Error::input(format!("`ElementType = {name}` is not supported")).hint(
                        "supported are MET_CHAR to MET_LONG_LONG, MET_UCHAR to MET_ULONG_LONG, \
                         MET_FLOAT and MET_DOUBLE",
                    ),
                );
            }
        })
    }

    fn is_big_endian(&self) -> bool {
        self.is_true(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])
    }

    fn patient_space(&self) -> Option<PatientSpace> {
        let known = self.get(&["AnatomicalOrientation"]).unwrap_or_default();
        (!known.contains('?')).then_some(PatientSpace::Lps)
    }

    fn is_rescaled(&self) -> bool {
        let number = |name: &str, plain: f64| {
            let text = self.get(&[name]);
            text.is_some_and(|t| t.parse::<f64>() != Ok(plain))
        };
        number("ElementToIntensityFunctionSlope", 1.0)
            || number("ElementToIntensityFunctionOffset", 0.0)
    }

    /// Names of the data files, `None` if the data follows the header.
    fn data_files(&self, content: &[u8], at: usize) -> Result<Option<Vec<String>>> {
        let text = self.require("ElementDataFile")?;
        if text.is_empty() {
            return Err(Error::input(
                "expected LOCAL, LIST or a name in `ElementDataFile`, found nothing",
            ));
        }
        if text.eq_ignore_ascii_case("LOCAL") {
            return Ok(None);
        }
        if text.starts_with("LIST") {
            let names = Lines { content, at };
            let names = names.map(|line| line.trim().to_owned());
            let names: Vec<String> = names.filter(|line| !line.is_empty()).collect();
            if names.is_empty() {
                return Err(Error::input(
                    "expected names of files after `ElementDataFile = LIST`",
                ));
            }
            return Ok(Some(names));
        }
        match text.contains('%') {
            true => numbered_names(text, "ElementDataFile = ").map(Some),
            false => Ok(Some(vec![text.into()])),
        }
    }

    /// The `expected` bytes of samples in a file from `at`.
    fn data(
        &self,
        content: Vec<u8>,
        at: usize,
        expected: usize,
        number: Number,
        files: &Files,
    ) -> Result<Data> {
        let text = self.get(&["HeaderSize"]).unwrap_or("0");
        let skip = text
            .parse::<i64>()
            .map_err(|_| Error::input(format!("expected a number, found `HeaderSize = {text}`")))?;
        // -1 means that the samples are at the very end.
        let from = usize::try_from(skip).ok();
        let from = from.map(|skip| at.saturating_add(skip));
        if self.is_true(&["CompressedData"]) {
            let packed = content.get(from.unwrap_or(at)..).unwrap_or_default();
            let packing = match packed.starts_with(&[0x1f, 0x8b]) {
                true => Packing::Gzip,
                false => Packing::Zlib,
            };
            return packing.unpack(packed, Some(0), expected, &files.cancel);
        }
        if self.get(&["BinaryData"]).is_some() && !self.is_true(&["BinaryData"]) {
            let text = content.get(from.unwrap_or(at)..).unwrap_or_default();
            return unpack::text(text, expected / number.size(), &files.cancel);
        }
        unpack::raw(content, from, at, expected)
    }

    /// From the index space to the world.
    fn world_from_index(&self) -> Result<DAffine3> {
        let vector = |names: &[&str], or: DVec3| match self.get(names) {
            Some(text) => numbers::<3>(text, names[0]).map(DVec3::from),
            None => Ok(or),
        };
        let spacing = vector(&["ElementSpacing", "ElementSize"], DVec3::ONE)?;
        let offset = vector(&["Offset", "Position", "Origin"], DVec3::ZERO)?;
        let matrix = match self.get(&["TransformMatrix", "Rotation", "Orientation"]) {
            Some(text) => DMat3::from_cols_array(&numbers::<9>(text, "TransformMatrix")?),
            None => DMat3::IDENTITY,
        };
        let map = DAffine3 {
            matrix3: matrix * DMat3::from_diagonal(spacing),
            translation: offset,
        };
        if is_singular(&map) {
            return Err(Error::input(
                "the placement by `TransformMatrix` and `ElementSpacing` is singular: \
                 it flattens space",
            ));
        }
        Ok(map)
    }
}

/// `N` finite numbers.
fn numbers<const N: usize>(text: &str, field: &str) -> Result<[f64; N]> {
    let numbers: Vec<f64> = text
        .split_whitespace()
        .filter_map(|n| n.parse().ok())
        .filter(|n: &f64| n.is_finite())
        .collect();
    numbers
        .try_into()
        .map_err(|_| Error::input(format!("expected {N} numbers, found `{field} = {text}`")))
}

#[cfg(test)]
mod tests;
