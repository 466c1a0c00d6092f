//! NRRD volumes: attached or detached, in one file or in one for each slice; raw, gzip, bzip2, text
//! or hex; any integer to 64 bits and floats, either byte order.
//!
//! `space directions` and `space origin` place the file (the origin is the centre of the first
//! voxel). Without directions `spacings` scale it, or what lies between `axis mins` and `axis
//! maxs`; then the first voxel's centre is at `space origin`, or follows from `axis mins` or `axis
//! maxs` and `centers` (`cell` if not given), or is at the origin.
//!
//! A `space` that is that of a patient is turned to that of MetaImage and NIfTI.
//!
//! - `data`: from files to samples; here: the header

mod data;

use super::field::Field;
use super::files::{Files, text_start};
use super::patient::PatientSpace;
use super::samples::{Array, Number, Samples, byte_length};
use super::unpack::Data;
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use data::data;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::path::Path;

/// Reads a NRRD file; `files` is asked for the data files of a detached header.
pub(super) fn read(content: Vec<u8>, path: &Path, files: &mut Files) -> Result<Field> {
    let (header, data_at) = Header::parse(&content)?;
    let (dims, skipped_axis) = header.dims()?;
    header.check_kinds()?;
    let number = header.number()?;
    let patient = header.patient_space();
    let world_from_file = header.world_from_index(dims, skipped_axis)?;
    let world_from_file = match patient {
        Some(space) => world_from_file.map(|map| space.to_lps() * map),
        None => world_from_file,
    };
    let big_endian = header.is_big_endian(number)?;
    let expected = byte_length(dims, number)?;
    let data = match header.data_files()? {
        None => data(&header, content, data_at, expected, number, &files.cancel)?,
        Some(names) => Data::of_files(&names, path, expected, files, |content, share, files| {
            data(&header, content, 0, share, number, &files.cancel)
        })?,
    };
    if data.is_longer {
        files.warn(format!(
            "{}: there is more data than `sizes` says; the rest is left out",
            path.display()
        ));
    }
    Ok(Field {
        name: None,
        dims,
        first: [0; 3],
        padding: 0,
        world_from_file,
        patient: patient.filter(|_| world_from_file.is_some()),
        samples: Samples::Array(Array {
            dims,
            bytes: data.bytes.into(),
            number: if data.is_f64 { Number::F64 } else { number },
            big_endian: big_endian && !data.is_f64,
            rescale: None,
        })
        .into(),
        start: [0; 3],
    })
}

/// The fields of the header, names in lower case.
struct Header {
    fields: HashMap<String, String>,
    /// Names of data files that stand in the lines after `data file: LIST`.
    list: Vec<String>,
}

impl Header {
    /// The header and the offset of what follows it.
    fn parse(content: &[u8]) -> Result<(Self, usize)> {
        let at = content.len() - text_start(content)?.len();
        let mut lines = Lines { content, at };
        let magic = lines.next().unwrap_or_default();
        if !(magic.starts_with("NRRD000") && matches!(magic.as_bytes().get(7), Some(b'1'..=b'5'))) {
            // What is no such file is not quoted.
            let found = match magic.starts_with("NRRD") {
                true => format!("\"{}\"", magic.chars().take(8).collect::<String>()),
                false => String::from("another kind of file"),
            };
            return Err(Error::input(format!(
                "expected NRRD0001 to NRRD0005 in the first line, found {found}"
            )));
        }
        let mut fields = HashMap::new();
        let mut list = Vec::new();
        let mut is_list = false;
        // A detached header may end with the file, an attached one ends with an empty line.
        for (number, line) in (2..).zip(lines.by_ref()) {
            if line.is_empty() {
                break;
            }
            if is_list {
                list.push(line.trim().to_owned());
                continue;
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
            let (name, value) = (name.trim().to_lowercase(), value.trim().to_string());
            // What follows a list of files is nothing but their names.
            is_list =
                ["data file", "datafile"].contains(&name.as_str()) && value.starts_with("LIST");
            fields.insert(name, value);
        }
        Ok((Self { fields, list }, lines.at))
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

    /// Voxels along three axes; of four axes one may have a length of one, and its number is given.
    fn dims(&self) -> Result<([usize; 3], Option<usize>)> {
        let dimension = self.require("dimension")?;
        let text = self.require("sizes")?;
        let mut sizes: Vec<usize> = text
            .split_whitespace()
            .filter_map(|s| s.parse().ok())
            .collect();
        let skipped = match (dimension, sizes.iter().position(|&n| n == 1)) {
            ("4", Some(axis)) if sizes.len() == 4 => {
                sizes.remove(axis);
                Some(axis)
            }
            ("3", _) => None,
            _ => {
                return Err(Error::input(format!(
                    "expected `dimension: 3`, found {dimension}; only scalar volumes are supported"
                )));
            }
        };
        match sizes[..] {
            [x, y, z] if x > 0 && y > 0 && z > 0 => Ok(([x, y, z], skipped)),
            _ => Err(Error::input(format!(
                "expected three sizes of at least 1, found `sizes: {text}`"
            ))),
        }
    }

    /// Refuses files whose axes are not all of space.
    fn check_kinds(&self) -> Result<()> {
        let Some(text) = self.get(&["kinds"]) else {
            return Ok(());
        };
        let sizes = self.require("sizes")?.split_whitespace();
        for (kind, size) in text.split_whitespace().zip(sizes) {
            if size != "1" && !["domain", "space", "none", "???"].contains(&kind) {
                return Err(Error::input(format!(
                    "expected axes of space, found one of the kind {kind} in `kinds: {text}`; \
                     only scalar volumes are supported"
                )));
            }
        }
        Ok(())
    }

    /// Names of the data files, `None` if the data follows the header.
    fn data_files(&self) -> Result<Option<Vec<String>>> {
        let Some(text) = self.get(&["data file", "datafile"]) else {
            return Ok(None);
        };
        if text.starts_with("LIST") {
            if self.list.is_empty() {
                return Err(Error::input(
                    "expected names of files after `data file: LIST`",
                ));
            }
            return Ok(Some(self.list.clone()));
        }
        if !text.contains('%') {
            return Ok(Some(vec![text.into()]));
        }
        numbered_names(text, "data file: ").map(Some)
    }

    /// The axes of a patient in which the file is placed, if it says so.
    fn patient_space(&self) -> Option<PatientSpace> {
        PatientSpace::named(self.get(&["space"])?)
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
            "uint64"
            | "uint64_t"
            | "ulonglong"
            | "unsigned long long"
            | "unsigned long long int" => Number::U64,
            "int64"
            | "int64_t"
            | "longlong"
            | "long long"
            | "long long int"
            | "signed long long"
            | "signed long long int" => Number::I64,
            "float" => Number::F32,
            "double" => Number::F64,
            _ => {
                return Err(Error::input(format!("`type: {name}` is not supported"))
                    .hint("supported are int8 to int64, uint8 to uint64, float and double"));
            }
        })
    }

    fn is_big_endian(&self, number: Number) -> Result<bool> {
        match self.get(&["endian"]) {
            Some("little") => Ok(false),
            Some("big") => Ok(true),
            None if number.size() == 1 || self.is_text() => Ok(false),
            None => Err(Error::input(
                "the header has no `endian`, which numbers of more than one byte need",
            )),
            Some(other) => Err(Error::input(format!(
                "expected `endian: little` or `big`, found {other}"
            ))),
        }
    }

    /// Whether samples are written as text.
    fn is_text(&self) -> bool {
        let encoding = self.get(&["encoding"]).unwrap_or_default().to_lowercase();
        ["ascii", "text", "txt"].contains(&encoding.as_str())
    }

    fn world_from_index(
        &self,
        dims: [usize; 3],
        skipped_axis: Option<usize>,
    ) -> Result<Option<DAffine3>> {
        let origin = self.get(&["space origin"]);
        let origin = origin.map(|t| vector(t, "space origin")).transpose()?;
        if let Some(text) = self.get(&["space directions"]) {
            // An axis that is none of space has no direction.
            let text = match skipped_axis {
                Some(_) => &text.replace("none", ""),
                None => text,
            };
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
        let (low, high) = (
            self.numbers("axis mins", skipped_axis)?,
            self.numbers("axis maxs", skipped_axis)?,
        );
        // Samples are in the middle of cells, or the first and last lie on the ends of the axis.
        let (mut first, mut cells) = (DVec3::ZERO, DVec3::ZERO);
        for (a, is_cell) in self.cell_centred(skipped_axis)?.into_iter().enumerate() {
            first[a] = if is_cell { 0.5 } else { 0.0 };
            cells[a] = dims[a] as f64 - 1.0 + 2.0 * first[a];
        }
        let spacings = match (self.numbers("spacings", skipped_axis)?, low, high) {
            (Some(spacings), ..) => spacings,
            (None, Some(low), Some(high)) => (high - low) / cells,
            _ => return Ok(None),
        };
        if !spacings.is_finite() || spacings.cmpeq(DVec3::ZERO).any() {
            return Err(Error::input(format!(
                "expected three spacings other than 0, found {} {} {} from `spacings`, or from \
                 `axis mins` and `axis maxs`",
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
    fn numbers(&self, field: &str, skipped_axis: Option<usize>) -> Result<Option<DVec3>> {
        let Some(text) = self.get(&[field]) else {
            return Ok(None);
        };
        let wrong = || Error::input(format!("expected three numbers, found `{field}: {text}`"));
        let mut numbers: Vec<f64> = text
            .split_whitespace()
            .map(|t| t.parse().map_err(|_| wrong()))
            .collect::<Result<_>>()?;
        skip_axis(&mut numbers, skipped_axis);
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
    fn cell_centred(&self, skipped_axis: Option<usize>) -> Result<[bool; 3]> {
        let Some(text) = self.get(&["centers", "centerings"]) else {
            return Ok([true; 3]);
        };
        let mut words: Vec<&str> = text.split_whitespace().collect();
        skip_axis(&mut words, skipped_axis);
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
}

/// The names of files with numbers in them that `a%03d.raw 1 9 2` stands for, as a header says it
/// behind `field`.
pub(super) fn numbered_names(text: &str, field: &str) -> Result<Vec<String>> {
    let wrong = || {
        Error::input(format!(
            "expected a name such as a%03d.raw, a first and a last number and a step, \
             found `{field}{text}`"
        ))
    };
    let words: Vec<&str> = text.split_whitespace().collect();
    let number = |i: usize| {
        words
            .get(i)
            .and_then(|w| w.parse::<i64>().ok())
            .ok_or_else(wrong)
    };
    let (first, last, step) = (number(1)?, number(2)?, number(3)?);
    let (before, rest) = words[0].split_once('%').ok_or_else(wrong)?;
    let (width, after) = rest.split_once('d').ok_or_else(wrong)?;
    let places: usize = match width {
        "" => 0,
        width => width.parse().map_err(|_| wrong())?,
    };
    let count = last
        .checked_sub(first)
        .and_then(|length| length.checked_div(step))
        .filter(|n| (0..1 << 20).contains(n));
    let count = count.filter(|_| places < 32).ok_or_else(wrong)?;
    let name = |i: i64| format!("{before}{:0places$}{after}", first + i * step);
    Ok((0..=count).map(name).collect())
}

/// Takes the entry of the axis that is not read out of those of all four axes.
fn skip_axis<T>(entries: &mut Vec<T>, skipped_axis: Option<usize>) {
    if let Some(axis) = skipped_axis
        && entries.len() == 4
    {
        entries.remove(axis);
    }
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
pub(super) struct Lines<'a> {
    pub(super) content: &'a [u8],
    pub(super) at: usize,
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

#[cfg(test)]
mod tests;
