//! NRRD volumes: raw or gzip, attached or detached, any integer to 32 bits and floats, either byte
//! order.
//!
//! `space directions` and `space origin` place the file (the origin is the centre of the first
//! voxel). Without directions `spacings` scale it, or what lies between `axis mins` and `axis
//! maxs`; then the first voxel's centre is at `space origin`, or follows from `axis mins` or `axis
//! maxs` and `centers` (`cell` if not given), or is at the origin.

use super::field::{Array, Field, Number, Samples, byte_length};
use super::files::{Files, beside, text_start};
use crate::run::{Cancel, memory};
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use flate2::bufread::MultiGzDecoder;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::io::Read;
use std::path::Path;

/// No deflate stream grows by more than this on the way out.
const MOST_INFLATION: usize = 1100;

/// Bytes that are unpacked between two looks at whether to stop.
const PIECE: usize = 16 << 20;

/// Reads a NRRD file; `files` is asked for the data file of a detached header.
pub(super) fn read(content: Vec<u8>, path: &Path, files: &mut Files) -> Result<Field> {
    let (header, data_at) = Header::parse(&content)?;
    let dims = header.dims()?;
    let number = header.number()?;
    let world_from_file = header.world_from_index(dims)?;
    let big_endian = header.is_big_endian(number)?;
    let expected = byte_length(dims, number)?;
    let data = match header.get(&["data file", "datafile"]) {
        None => header.skip(content, data_at, expected, &files.cancel)?,
        Some(name) if name.starts_with("LIST") || name.contains('%') => {
            return Err(Error::input(format!(
                "data in several files (`data file: {name}`) is not supported"
            ))
            .hint("join them into one NRRD file"));
        }
        Some(name) => {
            let data_path = beside(path, name);
            let data = files.read("volume data", &data_path)?;
            header
                .skip(data, 0, expected, &files.cancel)
                .map_err(|e| e.at(data_path.display()))?
        }
    };
    Ok(Field {
        name: None,
        dims,
        first: [0; 3],
        padding: 0,
        world_from_file,
        samples: Samples::Array(Array {
            bytes: data,
            number,
            big_endian,
        }),
    })
}

/// The fields of the header, names in lower case.
struct Header {
    fields: HashMap<String, String>,
}

impl Header {
    /// The header and the offset of what follows it.
    fn parse(content: &[u8]) -> Result<(Self, usize)> {
        let at = content.len() - text_start(content)?.len();
        let mut lines = Lines { content, at };
        let magic = lines.next().unwrap_or_default();
        if !(magic.starts_with("NRRD000") && matches!(magic.as_bytes().get(7), Some(b'1'..=b'5'))) {
            let found: String = magic.chars().take(20).collect();
            return Err(Error::input(format!(
                "expected NRRD0001 to NRRD0005 in the first line, found \"{found}\""
            )));
        }
        let mut fields = HashMap::new();
        // A detached header may end with the file, an attached one ends with an empty line.
        for (number, line) in (2..).zip(lines.by_ref()) {
            if line.is_empty() {
                break;
            }
            if line.starts_with('#') || line.contains(":=") {
                continue;
            }
            let (name, value) = line.split_once(':').ok_or_else(|| {
                let found: String = line.chars().take(40).collect();
                Error::input(format!(
                    "line {number}: expected `field: value`, found \"{found}\""
                ))
            })?;
            fields.insert(name.trim().to_lowercase(), value.trim().to_string());
        }
        Ok((Self { fields }, lines.at))
    }

    fn get(&self, names: &[&str]) -> Option<&str> {
        names
            .iter()
            .find_map(|n| self.fields.get(*n).map(String::as_str))
    }

    fn require(&self, name: &str) -> Result<&str> {
        self.get(&[name])
            .ok_or_else(|| Error::input(format!("the header has no `{name}`")))
    }

    fn dims(&self) -> Result<[usize; 3]> {
        let dimension = self.require("dimension")?;
        if dimension != "3" {
            return Err(Error::input(format!(
                "expected `dimension: 3`, found {dimension}; only scalar volumes are supported"
            )));
        }
        let text = self.require("sizes")?;
        let sizes: Vec<usize> = text
            .split_whitespace()
            .filter_map(|s| s.parse().ok())
            .collect();
        match sizes[..] {
            [x, y, z] if x > 0 && y > 0 && z > 0 => Ok([x, y, z]),
            _ => Err(Error::input(format!(
                "expected three sizes of at least 1, found `sizes: {text}`"
            ))),
        }
    }

    fn number(&self) -> Result<Number> {
        let name = self.require("type")?;
        Ok(match name {
            "uint8" | "uint8_t" | "uchar" | "unsigned char" => Number::U8,
            "int8" | "int8_t" | "signed char" => Number::I8,
            "uint16" | "uint16_t" | "ushort" | "unsigned short" | "unsigned short int" => {
                Number::U16
            }
            "int16" | "int16_t" | "short" | "short int" | "signed short" | "signed short int" => {
                Number::I16
            }
            "uint32" | "uint32_t" | "uint" | "unsigned int" => Number::U32,
            "int32" | "int32_t" | "int" | "signed int" => Number::I32,
            "float" => Number::F32,
            "double" => Number::F64,
            _ => {
                return Err(
                    Error::input(format!("`type: {name}` is not supported")).hint(
                        "supported are int8, uint8, int16, uint16, int32, uint32, float, double",
                    ),
                );
            }
        })
    }

    fn is_big_endian(&self, number: Number) -> Result<bool> {
        match self.get(&["endian"]) {
            Some("little") => Ok(false),
            Some("big") => Ok(true),
            None if number.size() == 1 => Ok(false),
            None => Err(Error::input(
                "the header has no `endian`, which numbers of more than one byte need",
            )),
            Some(other) => Err(Error::input(format!(
                "expected `endian: little` or `big`, found {other}"
            ))),
        }
    }

    fn world_from_index(&self, dims: [usize; 3]) -> Result<Option<DAffine3>> {
        let origin = self.get(&["space origin"]);
        let origin = origin.map(|t| vector(t, "space origin")).transpose()?;
        if let Some(text) = self.get(&["space directions"]) {
            let axes: Vec<&str> = text.split(')').map(str::trim).collect();
            if axes.len() != 4 || !axes[3].is_empty() {
                return Err(Error::input(format!(
                    "expected three vectors, found `space directions: {text}`"
                )));
            }
            let axis = |i: usize| vector(&format!("{})", axes[i]), "space directions");
            let map = DAffine3 {
                matrix3: DMat3::from_cols(axis(0)?, axis(1)?, axis(2)?),
                translation: origin.unwrap_or(DVec3::ZERO),
            };
            if is_singular(&map) {
                return Err(Error::input(format!(
                    "`space directions: {text}` are singular: they lie in one plane"
                )));
            }
            return Ok(Some(map));
        }
        let (low, high) = (self.numbers("axis mins")?, self.numbers("axis maxs")?);
        // Samples are in the middle of cells, or the first and last lie on the ends of the axis.
        let (mut first, mut cells) = (DVec3::ZERO, DVec3::ZERO);
        for (a, is_cell) in self.cell_centred()?.into_iter().enumerate() {
            first[a] = if is_cell { 0.5 } else { 0.0 };
            cells[a] = dims[a] as f64 - 1.0 + 2.0 * first[a];
        }
        let spacings = match (self.numbers("spacings")?, low, high) {
            (Some(spacings), ..) => spacings,
            (None, Some(low), Some(high)) => (high - low) / cells,
            _ => return Ok(None),
        };
        if !spacings.is_finite() || spacings.cmpeq(DVec3::ZERO).any() {
            return Err(Error::input(format!(
                "expected three spacings other than 0, found {} {} {} from `spacings`, or from `axis mins` and `axis maxs`",
                spacings.x, spacings.y, spacings.z
            )));
        }
        let low = low.or(high.map(|high| high - spacings * cells));
        let from_ends = low.map(|low| low + spacings * first);
        Ok(Some(DAffine3 {
            matrix3: DMat3::from_diagonal(spacings),
            translation: origin.or(from_ends).unwrap_or(DVec3::ZERO),
        }))
    }

    /// A number for each axis, if the field is there and knows any.
    fn numbers(&self, field: &str) -> Result<Option<DVec3>> {
        let Some(text) = self.get(&[field]) else {
            return Ok(None);
        };
        let wrong = || Error::input(format!("expected three numbers, found `{field}: {text}`"));
        let numbers: Vec<f64> = text
            .split_whitespace()
            .map(|t| t.parse().map_err(|_| wrong()))
            .collect::<Result<_>>()?;
        let [x, y, z] = numbers[..] else {
            return Err(wrong());
        };
        // NaN stands for what is not known.
        let numbers = DVec3::new(x, y, z);
        match [x, y, z].map(f64::is_nan) {
            [true, true, true] => Ok(None),
            _ if numbers.is_finite() => Ok(Some(numbers)),
            _ => Err(wrong()),
        }
    }

    /// Whether samples are in the middle of cells, for each axis.
    fn cell_centred(&self) -> Result<[bool; 3]> {
        let Some(text) = self.get(&["centers", "centerings"]) else {
            return Ok([true; 3]);
        };
        let words: Vec<&str> = text.split_whitespace().collect();
        let known = ["cell", "node", "none", "???"];
        match words[..] {
            [x, y, z] if words.iter().all(|w| known.contains(w)) => {
                Ok([x, y, z].map(|w| w != "node"))
            }
            _ => Err(Error::input(format!(
                "expected `cell` or `node` for each of three axes, found `centers: {text}`"
            ))),
        }
    }

    /// The `expected` bytes of samples in `data` from `at`: lines and bytes skipped, decompressed,
    /// cut to size.
    fn skip(
        &self,
        mut data: Vec<u8>,
        mut at: usize,
        expected: usize,
        cancel: &Cancel,
    ) -> Result<Vec<u8>> {
        let count = |names: &[&str]| -> Result<i64> {
            let Some(text) = self.get(names) else {
                return Ok(0);
            };
            text.parse().map_err(|_| {
                Error::input(format!("expected a number, found `{}: {text}`", names[0]))
            })
        };
        let mut lines = Lines { content: &data, at };
        for _ in 0..count(&["line skip", "lineskip"])? {
            if lines.next().is_none() {
                return Err(Error::input("`line skip` goes beyond the end of the file"));
            }
        }
        at = lines.at;
        let skip = count(&["byte skip", "byteskip"])?;
        let encoding = self.require("encoding")?.to_lowercase();
        match encoding.as_str() {
            "raw" => {
                // -1 means that the samples are at the very end of the file.
                at = match usize::try_from(skip) {
                    Ok(skip) => at.saturating_add(skip),
                    Err(_) => at.max(data.len().saturating_sub(expected)),
                };
                let found = data.len().saturating_sub(at);
                if found < expected {
                    return Err(too_short(expected, found));
                }
                data.drain(..at);
                data.truncate(expected);
                Ok(data)
            }
            "gzip" | "gz" => {
                let packed = &data[at..];
                let skip = usize::try_from(skip).unwrap_or(0);
                let total = expected.saturating_add(skip);
                if total > packed.len().saturating_mul(MOST_INFLATION) {
                    return Err(Error::input(format!(
                        "the header promises {expected} bytes of samples, more than {} compressed bytes can hold",
                        packed.len()
                    )));
                }
                let mut samples =
                    memory::room("a volume", total.min(packed.len().saturating_mul(8)))?;
                let mut unpacked = MultiGzDecoder::new(packed);
                while samples.len() < total {
                    cancel.check()?;
                    let piece = (total - samples.len()).min(PIECE);
                    let read = (&mut unpacked)
                        .take(piece as u64)
                        .read_to_end(&mut samples)
                        .map_err(|e| Error::input(format!("the gzip data is damaged: {e}")))?;
                    if read == 0 {
                        break;
                    }
                }
                if samples.len() < total {
                    return Err(too_short(expected, samples.len().saturating_sub(skip)));
                }
                samples.drain(..skip);
                Ok(samples)
            }
            other => Err(
                Error::input(format!("`encoding: {other}` is not supported"))
                    .hint("supported are raw and gzip"),
            ),
        }
    }
}

fn too_short(expected: usize, found: usize) -> Error {
    Error::input(format!(
        "expected {expected} bytes of samples, found {found}; the file is truncated or its header is wrong"
    ))
}

fn vector(text: &str, field: &str) -> Result<DVec3> {
    let wrong = || Error::input(format!("expected (x,y,z) in `{field}`, found {text}"));
    let inner = text
        .trim()
        .strip_prefix('(')
        .and_then(|t| t.strip_suffix(')'))
        .ok_or_else(wrong)?;
    let numbers: Vec<f64> = inner
        .split(',')
        .filter_map(|n| n.trim().parse().ok())
        .filter(|n: &f64| n.is_finite())
        .collect();
    match numbers[..] {
        [x, y, z] => Ok(DVec3::new(x, y, z)),
        _ => Err(wrong()),
    }
}

/// Lines of text at the head of a file of bytes.
struct Lines<'a> {
    content: &'a [u8],
    at: usize,
}

impl<'a> Iterator for Lines<'a> {
    type Item = std::borrow::Cow<'a, str>;

    fn next(&mut self) -> Option<Self::Item> {
        let rest = &self.content[self.at..];
        if rest.is_empty() {
            return None;
        }
        let end = rest.iter().position(|&b| b == b'\n');
        let line = &rest[..end.unwrap_or(rest.len())];
        self.at += end.map_or(rest.len(), |e| e + 1);
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        Some(String::from_utf8_lossy(line))
    }
}
