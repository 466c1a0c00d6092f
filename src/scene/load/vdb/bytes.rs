//! Little-endian numbers off the front of a slice.

use crate::{Error, Result};

/// What to do where a file ends too early.
const CUT_SHORT: &str = "the file is cut short or damaged: copy it again, or export it again";

/// A slice and how far it has been read.
pub(super) struct Bytes<'a> {
    content: &'a [u8],
    at: usize,
}

impl<'a> Bytes<'a> {
    /// Reads `content` from its start.
    pub(super) fn new(content: &'a [u8]) -> Self {
        Self { content, at: 0 }
    }

    /// Offset of the next byte.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    /// Goes on at an offset from the start.
    pub(super) fn seek(&mut self, offset: i64) -> Result<()> {
        match usize::try_from(offset) {
            Ok(at) if at <= self.content.len() => {
                self.at = at;
                Ok(())
            }
            _ => Err(Error::input(format!(
                "an offset of {offset} is beyond the {} bytes of the file",
                self.content.len()
            ))
            .hint(CUT_SHORT)),
        }
    }

    /// The next `n` bytes.
    pub(super) fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        let rest = &self.content[self.at..];
        let taken = rest.get(..n).ok_or_else(|| {
            Error::input(format!(
                "expected {n} more bytes at offset {}, found {}",
                self.at,
                rest.len()
            ))
            .hint(CUT_SHORT)
        })?;
        self.at += n;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    pub(super) fn u8(&mut self) -> Result<u8> {
        Ok(self.array::<1>()?[0])
    }

    pub(super) fn u32(&mut self) -> Result<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn i32(&mut self) -> Result<i32> {
        self.array().map(i32::from_le_bytes)
    }

    pub(super) fn i64(&mut self) -> Result<i64> {
        self.array().map(i64::from_le_bytes)
    }

    pub(super) fn f32(&mut self) -> Result<f32> {
        self.array().map(f32::from_le_bytes)
    }

    pub(super) fn f16(&mut self) -> Result<f32> {
        self.array()
            .map(|bytes| half::f16::from_le_bytes(bytes).to_f32())
    }

    pub(super) fn f64(&mut self) -> Result<f64> {
        self.array().map(f64::from_le_bytes)
    }

    /// Three doubles.
    pub(super) fn vector(&mut self) -> Result<glam::DVec3> {
        Ok(glam::DVec3::new(self.f64()?, self.f64()?, self.f64()?))
    }

    /// Text after its length.
    pub(super) fn text(&mut self) -> Result<String> {
        let length = self.u32()? as usize;
        Ok(String::from_utf8_lossy(self.take(length)?).into_owned())
    }

    /// `N` words of 64 bits.
    pub(super) fn mask(&mut self, words: usize) -> Result<Vec<u64>> {
        let bytes = self.take(words * 8)?;
        Ok(bytes
            .chunks_exact(8)
            .map(|c| c.iter().rev().fold(0, |word, &b| word << 8 | u64::from(b)))
            .collect())
    }
}
