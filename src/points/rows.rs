//! The rows of a file of points, some at a time.

use super::file::PointFile;
use super::numbers::{Encoding, value};
use crate::run::memory;
use crate::{Error, Result};
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read, Seek, SeekFrom};

/// Bytes of the longest number that is read as text.
const MAX_WORD: usize = 1024;

/// A file of points that is read row by row.
pub(super) struct Rows<'a> {
    of: &'a PointFile,
    file: BufReader<File>,
    /// Number of the next row.
    next: u64,
    bytes: Vec<u8>,
}

impl<'a> Rows<'a> {
    /// Opens a file at one of its rows.
    pub(super) fn open(of: &'a PointFile, first: u64) -> Result<Self> {
        let file = File::open(&of.path).map_err(|e| Error::io("read", &of.path, &e))?;
        let mut rows = Self {
            of,
            file: BufReader::with_capacity(1 << 18, file),
            next: 0,
            bytes: Vec::new(),
        };
        let skipped = match of.encoding {
            Encoding::Text => 0,
            _ => first * of.row_bytes() as u64,
        };
        let moved = rows.file.seek(SeekFrom::Start(of.start + skipped));
        moved.map_err(|e| rows.failed(&e))?;
        if of.encoding == Encoding::Text {
            while rows.next < first {
                for _ in 0..of.columns.len() {
                    rows.word()?;
                }
                rows.next += 1;
            }
        }
        rows.next = first;
        Ok(rows)
    }

    /// Reads so many rows, one after the other.
    pub(super) fn read(&mut self, count: usize) -> Result<Vec<f64>> {
        let columns = self.of.columns.len();
        let mut values = memory::room("a row of points", count * columns)?;
        if self.of.encoding == Encoding::Text {
            for _ in 0..count {
                for _ in 0..columns {
                    values.push(self.number()?);
                }
                self.next += 1;
            }
            return Ok(values);
        }
        self.bytes.resize(count * self.of.row_bytes(), 0);
        let read = self.file.read_exact(&mut self.bytes);
        read.map_err(|e| self.failed(&e))?;
        let is_little = self.of.encoding == Encoding::LittleEndian;
        let mut rest = self.bytes.as_slice();
        for _ in 0..count {
            for column in &self.of.columns {
                let (number, behind) = rest.split_at(column.scalar.size());
                values.push(value(number, column.scalar, is_little));
                rest = behind;
            }
        }
        self.next += count as u64;
        Ok(values)
    }

    fn number(&mut self) -> Result<f64> {
        self.word()?;
        let parsed = std::str::from_utf8(&self.bytes)
            .ok()
            .and_then(|w| w.parse().ok());
        parsed.ok_or_else(|| {
            let word = String::from_utf8_lossy(&self.bytes);
            let short: String = word.chars().take(40).collect();
            let found = short.escape_debug();
            (self.of).at(
                self.next,
                Error::input(format!("expected a number, found \"{found}\"")),
            )
        })
    }

    /// Reads the next word of text.
    fn word(&mut self) -> Result<()> {
        self.bytes.clear();
        loop {
            let ready = match self.file.fill_buf() {
                Ok(ready) => ready,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
                Err(e) => return Err(self.failed(&e)),
            };
            if ready.is_empty() {
                break;
            }
            let blank = match self.bytes.is_empty() {
                true => ready.iter().take_while(|b| b.is_ascii_whitespace()).count(),
                false => 0,
            };
            let word = ready[blank..].iter();
            let length = word.take_while(|b| !b.is_ascii_whitespace()).count();
            let end = blank + length;
            let is_whole = end < ready.len() && length + self.bytes.len() > 0;
            self.bytes.extend(&ready[blank..end]);
            self.file.consume(end);
            if self.bytes.len() > MAX_WORD {
                let wrong = Error::input("expected a number, found a word without an end");
                return Err(self.of.at(self.next, wrong));
            }
            if is_whole {
                break;
            }
        }
        if self.bytes.is_empty() {
            let end = io::ErrorKind::UnexpectedEof.into();
            return Err(self.failed(&end));
        }
        Ok(())
    }

    fn failed(&self, error: &io::Error) -> Error {
        if error.kind() == io::ErrorKind::UnexpectedEof {
            let cut = format!(
                "the file ends before its {} points do; it is truncated or damaged",
                self.of.count
            );
            return self.of.at(self.next, Error::input(cut));
        }
        Error::io("read", &self.of.path, error)
    }
}
