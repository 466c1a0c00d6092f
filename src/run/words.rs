//! Words that threads share without waiting, and, in a mapped file, processes too.

use crate::formats::emergency::Mapped;
use crate::formats::{AtomicFile, FormatError, Overwrite};
use crate::run::size;
use crate::{Error, Result};
use memmap2::{MmapMut, MmapOptions, MmapRaw};
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::path::Path;
use std::sync::atomic::AtomicU64;

/// Eight words: a line of the processor's cache.
pub type Line = [AtomicU64; 8];

/// Lines of words, in memory of this process or in a file that processes share. Words are read and
/// written one at a time; what belongs together is for the user to check.
#[derive(Debug)]
pub struct AtomicLines {
    /// The file, for who handles the signal of one that was cut; `None` for memory.
    _mapped: Option<Mapped>,
    map: MmapRaw,
    /// Bytes before the first line.
    offset: usize,
    lines: usize,
}

/// Bytes of a file before its lines: a page, so that lines are aligned.
const HEADER_BYTES: usize = 4096;
const MAGIC: [u8; 8] = *b"\x89LVXW\r\n\x1a";

impl AtomicLines {
    /// Lines of zeros in memory.
    ///
    /// # Errors
    /// Failed if the system has no such memory.
    pub fn in_memory(lines: usize) -> Result<Self> {
        let bytes = lines * size_of::<Line>();
        let map = MmapMut::map_anon(bytes).map_err(|e| {
            Error::failed(format!("no memory for {}: {e}", size::format(bytes as u64)))
                .hint("lower the memory limit, or use a machine with more memory")
        })?;
        Ok(Self {
            _mapped: None,
            map: map.into(),
            offset: 0,
            lines,
        })
    }

    /// Lines in a file that other processes may have open. Where there is none, it is made, of
    /// zeros. `identity` says what they hold: a file of another identity is refused.
    ///
    /// # Errors
    /// Wrong input for a file that is none of ours or has another identity or size; failed for one
    /// that cannot be made or mapped.
    pub fn in_file(path: &Path, identity: [u8; 32], lines: usize) -> Result<Self> {
        if !path.exists() {
            create(path, identity, lines)?;
        }
        let failed = |doing: &str, e: &std::io::Error| Error::io(doing, path, e);
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .open(path)
            .map_err(|e| failed("open", &e))?;
        check(&mut file, path, identity, lines)?;
        let map = MmapOptions::new()
            .len(HEADER_BYTES + lines * size_of::<Line>())
            .map_raw(&file)
            .map_err(|e| failed("map into memory", &e))?;
        let start = map.as_ptr() as usize;
        Ok(Self {
            _mapped: Some(Mapped::new(path, start..start + map.len())),
            map,
            offset: HEADER_BYTES,
            lines,
        })
    }

    /// All lines.
    #[inline]
    #[allow(unsafe_code)]
    pub fn lines(&self) -> &[Line] {
        // The map starts at a page and the offset is a page or none, so that words are aligned.
        // Every pattern of bits is a word. Whoever writes to them, in this process or in others,
        // does so one whole word at a time. SAFETY: the map holds `offset` bytes and then so many
        // lines, which both constructors saw to, and lives as long as the slice.
        unsafe {
            let first = self.map.as_mut_ptr().add(self.offset);
            std::slice::from_raw_parts(first.cast(), self.lines)
        }
    }
}

fn create(path: &Path, identity: [u8; 32], lines: usize) -> Result<()> {
    let write = || {
        let mut file = AtomicFile::create(path, Overwrite::Refuse)?;
        let mut header = Vec::with_capacity(HEADER_BYTES);
        header.extend(MAGIC);
        header.extend(identity);
        header.extend((lines as u64).to_le_bytes());
        header.resize(HEADER_BYTES, 0);
        // All of it is written, not left as a hole: a full disk is told here, and not by a signal.
        let zeros = [0; 1 << 16];
        let mut rest = lines * size_of::<Line>();
        let mut put = || {
            file.write_all(&header)?;
            while rest > 0 {
                let some = rest.min(zeros.len());
                file.write_all(&zeros[..some])?;
                rest -= some;
            }
            Ok(())
        };
        put().map_err(|error| {
            let doing = "cannot write";
            FormatError::Io { doing, error }.at(path)
        })?;
        file.commit()
    };
    match write() {
        // Another process was faster, and a file that has its name is complete.
        Err(_) if path.exists() => Ok(()),
        written => Ok(written?),
    }
}

fn check(file: &mut File, path: &Path, identity: [u8; 32], lines: usize) -> Result<()> {
    let wrong = |expected: &str, found: &str| {
        Err(Error::input(format!("expected {expected}, found {found}"))
            .hint("name another file, or remove this one")
            .at(path.display()))
    };
    let mut header = [0; 48];
    let read = file.read_exact(&mut header);
    let len = file.metadata().map_or(0, |m| m.len());
    let (magic, rest) = header.split_at(MAGIC.len());
    let (found, count) = rest.split_at(identity.len());
    if read.is_err() || *magic != MAGIC {
        return wrong("a cache of lvox", "another file");
    }
    if *found != identity {
        return wrong("a cache of this scene, tree and quality", "one of others");
    }
    let bytes = (HEADER_BYTES + lines * size_of::<Line>()) as u64;
    if *count != (lines as u64).to_le_bytes() || len != bytes {
        return wrong(
            &format!("a cache of {bytes} bytes"),
            &format!("one of {len}"),
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::Ordering;

    #[test]
    fn a_file_is_shared_and_known_by_its_identity() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.cache");
        let one = AtomicLines::in_file(&path, [1; 32], 64).unwrap();
        let two = AtomicLines::in_file(&path, [1; 32], 64).unwrap();
        assert_eq!((one.lines().len(), two.lines().len()), (64, 64));
        one.lines()[63][7].store(5, Ordering::Relaxed);
        assert_eq!(two.lines()[63][7].load(Ordering::Relaxed), 5);
        drop((one, two));
        let again = AtomicLines::in_file(&path, [1; 32], 64).unwrap();
        assert_eq!(again.lines()[63][7].load(Ordering::Relaxed), 5);
        for (identity, lines, words) in [
            ([2; 32], 64, "one of others"),
            ([1; 32], 128, "one of 8192"),
        ] {
            let error = AtomicLines::in_file(&path, identity, lines).unwrap_err();
            assert!(error.to_string().contains(words), "{error}");
        }
        std::fs::write(&path, "something else").unwrap();
        let error = AtomicLines::in_file(&path, [1; 32], 64).unwrap_err();
        assert!(error.to_string().contains("another file"), "{error}");
    }
}
