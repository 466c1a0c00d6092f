//! A file as a slice of bytes, paged in by the operating system.

use crate::{FormatError, Result};
use std::fs::File;
use std::path::Path;

/// A read-only memory map of a whole file.
#[derive(Debug)]
pub struct MappedFile {
    // None for an empty file, which cannot be mapped.
    map: Option<memmap2::Mmap>,
}

impl MappedFile {
    /// Maps a file.
    ///
    /// # Errors
    /// [`FormatError::Io`], with the path.
    #[allow(unsafe_code)]
    pub fn open(path: &Path) -> Result<Self> {
        let open = || {
            let file = File::open(path).map_err(FormatError::io("cannot open"))?;
            let meta = file.metadata().map_err(FormatError::io("cannot read"))?;
            if !meta.is_file() {
                return Err(FormatError::Io {
                    doing: "cannot open",
                    error: std::io::Error::new(
                        std::io::ErrorKind::InvalidInput,
                        "not a regular file",
                    ),
                });
            }
            if meta.len() == 0 {
                return Ok(Self { map: None });
            }
            // SAFETY: the map is private, read-only, and outlives what is borrowed from it. Readers check each number and copy
            // it, should another process change the file; one that shortens it ends this process (SIGBUS). Ours replace files
            // by rename only.
            let map = unsafe { memmap2::Mmap::map(&file) }
                .map_err(FormatError::io("cannot map into memory"))?;
            Ok(Self { map: Some(map) })
        };
        open().map_err(|e| e.at(path))
    }
}

impl AsRef<[u8]> for MappedFile {
    fn as_ref(&self) -> &[u8] {
        self.map.as_deref().unwrap_or_default()
    }
}
