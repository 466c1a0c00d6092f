//! Blocks of a cloud or a tree, behind room for the header.

use crate::{AtomicFile, FormatError, Result};
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// Bytes appended behind room for a header, which is written last. Dropped unfinished, it leaves
/// nothing behind.
pub struct Output {
    file: BufWriter<AtomicFile>,
    position: u64,
}

impl Output {
    /// Opens a temporary file beside `path` and leaves room for a header.
    pub fn create(path: &Path, force: bool, header_len: usize) -> Result<Self> {
        let file = AtomicFile::create(path, force)?;
        let mut output = Self {
            file: BufWriter::with_capacity(1 << 20, file),
            position: 0,
        };
        output.append(&vec![0; header_len])?;
        Ok(output)
    }

    /// The final name.
    pub fn path(&self) -> &Path {
        self.file.get_ref().path()
    }

    /// Bytes so far, the header's room included: where the next byte goes.
    pub fn position(&self) -> u64 {
        self.position
    }

    /// Writes at the end.
    pub fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file
            .write_all(bytes)
            .map_err(|e| FormatError::io("cannot write")(e).at(self.path()))?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    /// Writes the header, syncs, and gives the file its name.
    pub fn finish(mut self, header: &[u8]) -> Result<()> {
        self.file
            .seek(SeekFrom::Start(0))
            .and_then(|_| self.file.write_all(header))
            .and_then(|()| self.file.flush())
            .map_err(|e| FormatError::io("cannot write")(e).at(self.path()))?;
        // Nothing is left in the buffer.
        self.file.into_parts().0.commit()
    }
}
