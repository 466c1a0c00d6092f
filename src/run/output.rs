//! A file that appears under its name only when it is complete.

use crate::formats::{AtomicFile, Overwrite};
use crate::{Error, Result};
use std::io::{self, Seek, SeekFrom, Write};
use std::path::Path;

/// An [`AtomicFile`] that replaces what is there.
#[derive(Debug)]
pub struct Output(AtomicFile);

impl Output {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// As [`AtomicFile::create`].
    pub fn create(path: &Path) -> Result<Self> {
        Ok(Self(AtomicFile::create(path, Overwrite::Replace)?))
    }

    /// Makes the bytes durable and gives the file its name.
    ///
    /// # Errors
    /// As [`AtomicFile::commit`].
    pub fn commit(self) -> Result<()> {
        Ok(self.0.commit()?)
    }

    /// Turns an error of writing into one that names the file.
    #[must_use]
    pub fn failed(&self, error: &io::Error) -> Error {
        Error::io("write", self.0.path(), error)
    }

    /// Writes a whole file at once.
    ///
    /// # Errors
    /// As [`Output::create`] and [`Output::commit`].
    pub fn write_all_to(path: &Path, bytes: &[u8]) -> Result<()> {
        let mut output = Self::create(path)?;
        output.write_all(bytes).map_err(|e| output.failed(&e))?;
        output.commit()
    }

    /// Writes a value as JSON that people can read too.
    ///
    /// # Errors
    /// As [`Output::write_all_to`], and for what JSON cannot hold.
    pub fn write_json_to(path: &Path, value: &impl serde::Serialize) -> Result<()> {
        let mut json = serde_json::to_vec_pretty(value).map_err(|e| {
            Error::failed(format!("cannot encode it as JSON: {e}")).at(path.display())
        })?;
        json.push(b'\n');
        Self::write_all_to(path, &json)
    }
}

impl Write for Output {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Seek for Output {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}
