//! Samples of volume files: bytes skipped, unpacked, cut to size.

use super::files::{Files, beside};
use super::numbers::number;
use crate::run::{Cancel, memory};
use crate::{Error, Result};
use bzip2::bufread::MultiBzDecoder;
use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use std::io::Read;
use std::path::Path;

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
    /// The `expected` bytes of several files beside another, each of which has an equal share:
    /// `read` takes what is in one, and that share.
    pub(super) fn of_files(
        names: &[String],
        path: &Path,
        expected: usize,
        files: &mut Files,
        read: impl Fn(Vec<u8>, usize, &Files) -> Result<Self>,
    ) -> Result<Self> {
        if !expected.is_multiple_of(names.len()) {
            return Err(Error::input(format!(
                "expected {expected} bytes of samples in {} files, which is no equal share",
                names.len()
            )));
        }
        let mut all = Self::default();
        for name in names {
            let content = files.read_beside("volume data", path, name)?;
            let data = read(content, expected / names.len(), files);
            all.append(data.map_err(|e| e.at(beside(path, name).display()))?)?;
        }
        Ok(all)
    }

    /// Puts the samples of another file behind these.
    fn append(&mut self, other: Self) -> Result<()> {
        memory::grow("a volume", &mut self.bytes, other.bytes.len())?;
        self.bytes.extend(other.bytes);
        self.is_f64 = other.is_f64;
        self.is_longer |= other.is_longer;
        Ok(())
    }
}

/// How bytes are packed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Packing {
    Gzip,
    Zlib,
    Bzip2,
}

impl Packing {
    /// What is packed, as it comes out.
    fn stream<'a>(self, packed: &'a [u8]) -> Box<dyn Read + 'a> {
        match self {
            Self::Gzip => Box::new(MultiGzDecoder::new(packed)),
            Self::Zlib => Box::new(ZlibDecoder::new(packed)),
            Self::Bzip2 => Box::new(MultiBzDecoder::new(packed)),
        }
    }

    /// The first bytes of what is packed, at most so many.
    pub(super) fn start(self, packed: &[u8], most: usize) -> Result<Vec<u8>> {
        let mut bytes = Vec::new();
        let read = (self.stream(packed).take(most as u64)).read_to_end(&mut bytes);
        read.map(|_| bytes).map_err(damaged)
    }

    /// The `expected` bytes behind `skip` of what is packed, or those at its end.
    pub(super) fn unpack(
        self,
        packed: &[u8],
        skip: Option<usize>,
        expected: usize,
        cancel: &Cancel,
    ) -> Result<Data> {
        let growth = match self {
            Self::Bzip2 => MAX_BZIP2_INFLATION,
            Self::Gzip | Self::Zlib => MAX_INFLATION,
        };
        let most = packed.len().saturating_mul(growth);
        let stream = self.stream(packed);
        unpacked(stream, packed.len(), most, skip, expected, cancel)
    }
}

fn damaged(error: std::io::Error) -> Error {
    Error::input(format!("the compressed data is damaged: {error}"))
}

/// The `expected` bytes from `at`, or with `None` those at the end, but from `least` on.
pub(super) fn raw(
    mut content: Vec<u8>,
    at: Option<usize>,
    least: usize,
    expected: usize,
) -> Result<Data> {
    let at = at.unwrap_or_else(|| least.max(content.len().saturating_sub(expected)));
    let found = content.len().saturating_sub(at);
    if found < expected {
        return Err(too_short(expected, found));
    }
    content.drain(..at);
    content.truncate(expected);
    Ok(Data {
        bytes: content,
        is_f64: false,
        is_longer: found > expected,
    })
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
            "the header promises {expected} bytes of samples, \
             more than {packed} compressed bytes can hold"
        )));
    }
    let mut bytes = memory::room("a volume", total.min(packed.saturating_mul(8)))?;
    let mut read_piece = |bytes: &mut Vec<u8>, length: usize| -> Result<usize> {
        cancel.check()?;
        memory::grow("a volume", bytes, length)?;
        let piece = (&mut stream).take(length as u64).read_to_end(bytes);
        piece.map_err(damaged)
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
pub(super) fn text(content: &[u8], count: usize, cancel: &Cancel) -> Result<Data> {
    if count > content.len() {
        return Err(Error::input(format!(
            "expected {count} numbers, found {} characters; \
             the file is truncated or its header is wrong",
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
pub(super) fn hex(content: &[u8], expected: usize, cancel: &Cancel) -> Result<Data> {
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

pub(super) fn too_short(expected: usize, found: usize) -> Error {
    Error::input(format!(
        "expected {expected} bytes of samples, found {found}; \
         the file is truncated or its header is wrong"
    ))
}
