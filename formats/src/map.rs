//! A file as a slice of bytes, paged in by the operating system.

use crate::emergency::Mapped;
use crate::give_back::GiveBack;
use crate::{FormatError, Result};
use std::fs::File;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Weak};

/// A read-only memory map of a whole file.
///
/// The map is shared with every process that has the file open: what one of them writes shows here.
/// So the file must not be written in place or cut while it is mapped; see [`MappedFile::open`].
///
/// Clones are the same map, which ends with the last of them.
#[derive(Clone, Debug)]
pub struct MappedFile {
    // None for an empty file, which cannot be mapped.
    map: Option<Arc<Map>>,
}

#[derive(Debug)]
struct Map {
    /// Whose bytes these are, for who handles the signal of a file that was cut; until the map
    /// ends.
    _mapped: Mapped,
    map: memmap2::Mmap,
    /// The file, and where the map ends in it.
    file: File,
    end: u64,
}

impl MappedFile {
    /// Maps a file.
    ///
    /// The caller must keep other processes from changing the file in place. What lvox writes is
    /// safe to replace at any time: a rename leaves the mapped file as it was. If a file is
    /// overwritten all the same, readers may take altered values for true, as bytes can change
    /// after their checksum was found right; and Rust promises nothing of bytes that change under a
    /// slice. If it is cut, touching what is gone ends the process (SIGBUS on Unix);
    /// [`crate::emergency`] lets a program say then which file that was.
    ///
    /// No system that we run on can enforce that (advisory locks bind only who asks, and a copy
    /// takes the memory that mapping saves). Readers do not build on bytes that stay the same:
    /// lengths and offsets are copied out and checked against the slice, whose own length is fixed,
    /// and every access is bounds-checked.
    ///
    /// # Errors
    /// [`FormatError::Io`], with the path.
    pub fn open(path: &Path) -> Result<Self> {
        Self::map(path, None)
    }

    /// Maps a range of bytes of a file, as [`Self::open`] maps all; it is the file's whole content
    /// to whoever reads it.
    ///
    /// # Errors
    /// [`FormatError::Truncated`] if the file ends before, [`FormatError::Io`], with the path.
    pub fn open_range(path: &Path, range: Range<usize>) -> Result<Self> {
        Self::map(path, Some(range))
    }

    #[allow(unsafe_code)]
    fn map(path: &Path, range: Option<Range<usize>>) -> Result<Self> {
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
            let range = range.unwrap_or(0..usize::try_from(meta.len()).unwrap_or(usize::MAX));
            if range.end as u64 > meta.len() {
                return Err(FormatError::Truncated {
                    expected: range.end as u64,
                    found: meta.len(),
                });
            }
            if range.is_empty() {
                return Ok(Self { map: None });
            }
            let mut options = memmap2::MmapOptions::new();
            options.offset(range.start as u64).len(range.len());
            // If a process changes or cuts the file all the same, what remains is what the compiler
            // may assume of a slice, zstd's input while it decompresses, and the signal for a file
            // that was cut.
            // SAFETY: the map is read-only and lives as long as what is borrowed from it. That the
            // file stays is the caller's part, stated above; our own writers rename.
            let map = unsafe { options.map(&file) };
            let map = map.map_err(FormatError::io("cannot map into memory"))?;
            let addresses = map.as_ptr_range();
            let mapped = Mapped::new(path, addresses.start as usize..addresses.end as usize);
            let map = Map {
                _mapped: mapped,
                map,
                end: range.end as u64,
                file,
            };
            Ok(Self {
                map: Some(Arc::new(map)),
            })
        };
        open().map_err(|e| e.at(path))
    }

    /// Refuses a file that has been cut since it was mapped: bytes behind its new end may have been
    /// read as zeros, as far as the page goes.
    ///
    /// # Errors
    /// [`FormatError::Truncated`], [`FormatError::Io`].
    pub fn check_length(&self) -> Result<()> {
        let Some(map) = &self.map else { return Ok(()) };
        let meta = map
            .file
            .metadata()
            .map_err(FormatError::io("cannot read"))?;
        match meta.len() < map.end {
            false => Ok(()),
            true => Err(FormatError::Truncated {
                expected: map.end,
                found: meta.len(),
            }),
        }
    }

    /// Gives the memory behind a range of bytes back to the system, where the system has a call for
    /// it; the bytes stay what they are, and come from the file again when they are next read.
    pub fn release(&self, range: Range<usize>) {
        if let Some(map) = &self.map {
            map.release(range);
        }
    }

    /// What gives all of its memory back as long as it is mapped; none of an empty file.
    #[must_use]
    pub fn to_give_back(&self) -> Option<Weak<dyn GiveBack>> {
        let map: Arc<dyn GiveBack> = self.map.clone()?;
        Some(Arc::downgrade(&map))
    }
}

impl MappedFile {
    /// Tells the system that the file is read here and there, so that no more of it comes from the
    /// disk than is asked for: what comes with it would take the place of what is used.
    pub fn expect_random_access(&self) {
        #[cfg(unix)]
        if let Some(map) = &self.map {
            // Advice that is not taken costs memory and nothing else.
            drop(map.map.advise(memmap2::Advice::Random));
        }
    }
}

impl Map {
    #[allow(unsafe_code)]
    fn release(&self, range: Range<usize>) {
        let range = range.start..range.end.min(self.map.len());
        #[cfg(unix)]
        if !range.is_empty() {
            // SAFETY: the map is read-only and backed by the file, so pages that are dropped hold
            // nothing that the file does not. Slices of the map stay valid.
            let advised = unsafe {
                self.map.unchecked_advise_range(
                    memmap2::UncheckedAdvice::DontNeed,
                    range.start,
                    range.len(),
                )
            };
            // Advice that is not taken costs memory and nothing else.
            drop(advised);
        }
    }
}

impl GiveBack for Map {
    fn give_back(&self) {
        self.release(0..self.map.len());
    }
}

impl AsRef<[u8]> for MappedFile {
    fn as_ref(&self) -> &[u8] {
        self.map.as_ref().map_or(&[], |map| &map.map)
    }
}
