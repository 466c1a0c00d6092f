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
            // SAFETY: the map is private and read-only, and lives as long as the slices borrowed from it. What cannot
            // be ruled out is another process that changes the file meanwhile. A shortened file then ends this process
            // with SIGBUS. Overwritten bytes change under a shared slice, which Rust does not define; the readers here
            // bounds-check every number they read at the moment they use it, copy and validate what they hand out, and
            // never reinterpret mapped bytes as types with invalid values, so the practical outcome is a checksum
            // error. Our own writers only ever replace files by rename, which leaves a mapped one intact.
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
