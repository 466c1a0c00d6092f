//! Samples of a NRRD file: lines and bytes skipped, unpacked, cut to size.

use super::super::numbers::number;
use super::super::samples::Number;
use super::{Header, Lines};
use crate::run::{Cancel, memory};
use crate::{Error, Result};
use bzip2::bufread::MultiBzDecoder;
use flate2::bufread::MultiGzDecoder;
use std::io::Read;

/// No deflate stream grows by more than this on the way out.
const MAX_INFLATION: usize = 1100;
/// Nor does a bzip2 stream, by more than this: a block of 900 kB takes at least some 40 bytes.
const MAX_BZIP2_INFLATION: usize = 30_000;

/// Bytes that are unpacked between two looks at whether to stop.
const PIECE: usize = 16 << 20;

/// Samples in memory.
#[derive(Default)]
pub(super) struct Data {
    pub(super) bytes: Vec<u8>,
    /// Whether they are little-endian doubles, whatever the header says.
    pub(super) is_f64: bool,
    /// Whether there is more than there should be.
    pub(super) is_longer: bool,
}

impl Data {
    /// The `expected` bytes of samples of type `number` in a file from `at`.
    // Long because it is a list: one encoding after another.
    pub(super) fn of(
        header: &Header,
        mut content: Vec<u8>,
        at: usize,
        expected: usize,
        number: Number,
        cancel: &Cancel,
    ) -> Result<Self> {
        let count = |names: &[&str]| -> Result<i64> {
            let Some(text) = header.get(names) else {
                return Ok(0);
            };
            text.parse().map_err(|_| {
                Error::input(format!("expected a number, found `{}: {text}`", names[0]))
            })
        };
        let mut lines = Lines {
            content: &content,
            at,
        };
        for _ in 0..count(&["line skip", "lineskip"])? {
            if lines.next().is_none() {
                return Err(Error::input("`line skip` goes beyond the end of the file"));
            }
        }
        let at = lines.at;
        // -1 means that the samples are at the very end; so does any other negative number.
        let skip = usize::try_from(count(&["byte skip", "byteskip"])?).ok();
        let encoding = header.require("encoding")?.to_lowercase();
        match encoding.as_str() {
            "raw" => {
                let at = match skip {
                    Some(skip) => at.saturating_add(skip),
                    None => at.max(content.len().saturating_sub(expected)),
                };
                let found = content.len().saturating_sub(at);
                if found < expected {
                    return Err(too_short(expected, found));
                }
                content.drain(..at);
                content.truncate(expected);
                Ok(Self {
                    bytes: content,
                    is_f64: false,
                    is_longer: found > expected,
                })
            }
            "gzip" | "gz" => {
                let packed = &content[at..];
                let room = packed.len().saturating_mul(MAX_INFLATION);
                unpacked(
                    MultiGzDecoder::new(packed),
                    packed.len(),
                    room,
                    skip,
                    expected,
                    cancel,
                )
            }
            "bzip2" | "bz2" => {
                let packed = &content[at..];
                let room = packed.len().saturating_mul(MAX_BZIP2_INFLATION);
                unpacked(
                    MultiBzDecoder::new(packed),
                    packed.len(),
                    room,
                    skip,
                    expected,
                    cancel,
                )
            }
            "ascii" | "text" | "txt" => text(
                after(&content[at..], skip)?,
                expected / number.size(),
                cancel,
            ),
            "hex" => hex(after(&content[at..], skip)?, expected, cancel),
            other => Err(
                Error::input(format!("`encoding: {other}` is not supported"))
                    .hint("supported are raw, gzip, bzip2, ascii and hex"),
            ),
        }
    }

    /// Puts the samples of another file behind these.
    pub(super) fn append(&mut self, other: Self) -> Result<()> {
        memory::grow("a volume", &mut self.bytes, other.bytes.len())?;
        self.bytes.extend(other.bytes);
        self.is_f64 = other.is_f64;
        self.is_longer |= other.is_longer;
        Ok(())
    }
}

/// What follows the bytes to skip, of text.
fn after(content: &[u8], skip: Option<usize>) -> Result<&[u8]> {
    let skip = skip.ok_or_else(|| Error::input("`byte skip: -1` says nothing for text"))?;
    content
        .get(skip..)
        .ok_or_else(|| Error::input("`byte skip` goes beyond the end of the file"))
}

/// The `expected` bytes of a stream behind `skip`, or at its end. It comes from `packed` bytes and
/// has no more than `most`.
fn unpacked(
    mut stream: impl Read,
    packed: usize,
    most: usize,
    skip: Option<usize>,
    expected: usize,
    cancel: &Cancel,
) -> Result<Data> {
    let total = expected.saturating_add(skip.unwrap_or(0));
    if total > most {
        return Err(Error::input(format!(
            "the header promises {expected} bytes of samples, more than {packed} compressed bytes can hold"
        )));
    }
    let mut bytes = memory::room("a volume", total.min(packed.saturating_mul(8)))?;
    let mut read_piece = |bytes: &mut Vec<u8>, length: usize| -> Result<usize> {
        cancel.check()?;
        memory::grow("a volume", bytes, length)?;
        let piece = (&mut stream).take(length as u64).read_to_end(bytes);
        piece.map_err(|e| Error::input(format!("the compressed data is damaged: {e}")))
    };
    let Some(skip) = skip else {
        // Of all before the end no more is kept than is needed.
        while read_piece(&mut bytes, PIECE)? > 0 {
            if bytes.len() > expected + 4 * PIECE {
                bytes.drain(..bytes.len() - expected);
            }
        }
        let found = bytes.len();
        if found < expected {
            return Err(too_short(expected, found));
        }
        bytes.drain(..found - expected);
        return Ok(Data {
            bytes,
            ..Data::default()
        });
    };
    while bytes.len() < total {
        let piece = (total - bytes.len()).min(PIECE);
        if read_piece(&mut bytes, piece)? == 0 {
            return Err(too_short(expected, bytes.len().saturating_sub(skip)));
        }
    }
    // What follows may be damaged, and does not matter.
    let is_longer = read_piece(&mut bytes, 1).is_ok_and(|n| n > 0);
    bytes.truncate(total);
    bytes.drain(..skip);
    Ok(Data {
        bytes,
        is_f64: false,
        is_longer,
    })
}

/// Numbers that are written as text, of which there should be `count`.
fn text(content: &[u8], count: usize, cancel: &Cancel) -> Result<Data> {
    if count > content.len() {
        return Err(Error::input(format!(
            "expected {count} numbers, found {} characters; the file is truncated or its header is wrong",
            content.len()
        )));
    }
    let is_between = |b: &u8| b.is_ascii_whitespace() || *b == b',';
    let mut words = content.split(is_between).filter(|w| !w.is_empty());
    let mut bytes = memory::room("a volume", count * size_of::<f64>())?;
    for i in 0..count {
        if i & 0xffff == 0 {
            cancel.check()?;
        }
        let word = words.next().ok_or_else(|| {
            Error::input(format!(
                "expected {count} numbers, found {i}; the file is truncated or its header is wrong"
            ))
        })?;
        let value = std::str::from_utf8(word).ok().and_then(number);
        // A file of data is any file: what it holds is not quoted.
        let value = value.ok_or_else(|| {
            let length = word.len();
            Error::input(format!(
                "number {i} of {count}: expected a number, found a word of {length} characters"
            ))
        })?;
        bytes.extend(value.to_le_bytes());
    }
    Ok(Data {
        bytes,
        is_f64: true,
        is_longer: words.next().is_some(),
    })
}

/// Bytes of two hexadecimal digits each.
fn hex(content: &[u8], expected: usize, cancel: &Cancel) -> Result<Data> {
    let mut digits = content.iter().filter(|b| !b.is_ascii_whitespace());
    let mut bytes = memory::room("a volume", expected.min(content.len()))?;
    let digit = |b: &u8| {
        char::from(*b)
            .to_digit(16)
            .ok_or_else(|| Error::input("expected hexadecimal digits, found another character"))
    };
    while bytes.len() < expected {
        if bytes.len() & 0xffff == 0 {
            cancel.check()?;
        }
        let (Some(high), Some(low)) = (digits.next(), digits.next()) else {
            return Err(too_short(expected, bytes.len()));
        };
        bytes.push((digit(high)? << 4 | digit(low)?) as u8);
    }
    Ok(Data {
        bytes,
        is_f64: false,
        is_longer: digits.next().is_some(),
    })
}

fn too_short(expected: usize, found: usize) -> Error {
    Error::input(format!(
        "expected {expected} bytes of samples, found {found}; the file is truncated or its header is wrong"
    ))
}
