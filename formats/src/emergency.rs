//! What a process must know to end at once and leave nothing: which mapped file an address belongs
//! to, and which temporary files and folders are its own.
//!
//! The library itself ends no process and installs no handlers. A program that does so, in a signal
//! handler or where memory has run out, calls [`mapped_path`] and [`remove_temporaries`]: both are
//! async-signal-safe. They neither wait nor allocate, and read nothing but atomics of fixed number.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::Ordering::{Acquire, Relaxed, Release};
use std::sync::atomic::{AtomicU8, AtomicUsize, fence};

/// Longest path that is kept, and the size of the buffer that [`mapped_path`] takes.
pub const PATH_BYTES: usize = 1024;

/// Mapped files, and temporary files and folders, that are known at a time; more are not told, and
/// not removed before the next run sweeps them.
const SLOTS: usize = 256;

/// A place for a path and the addresses that belong to it.
struct Slot {
    /// Free, being filled and full are 0, 1 and 2 modulo 4: who reads the same number of a full
    /// slot before and after has read one entry.
    sequence: AtomicUsize,
    start: AtomicUsize,
    end: AtomicUsize,
    len: AtomicUsize,
    path: [AtomicU8; PATH_BYTES],
}

type Slots = [Slot; SLOTS];

static MAPS: Slots = [const { Slot::new() }; SLOTS];
static FILES: Slots = [const { Slot::new() }; SLOTS];
static FOLDERS: Slots = [const { Slot::new() }; SLOTS];

impl Slot {
    const fn new() -> Self {
        Self {
            sequence: AtomicUsize::new(0),
            start: AtomicUsize::new(0),
            end: AtomicUsize::new(0),
            len: AtomicUsize::new(0),
            path: [const { AtomicU8::new(0) }; PATH_BYTES],
        }
    }

    /// Takes the slot if it is free.
    fn fill(&self, path: &[u8], addresses: &Range<usize>) -> bool {
        let sequence = self.sequence.load(Relaxed);
        let is_free = sequence.is_multiple_of(4);
        if !is_free
            || self
                .sequence
                .compare_exchange(sequence, sequence.wrapping_add(1), Acquire, Relaxed)
                .is_err()
        {
            return false;
        }
        // No reader may see what follows under the number before.
        fence(Release);
        self.start.store(addresses.start, Relaxed);
        self.end.store(addresses.end, Relaxed);
        let len = path.len().min(PATH_BYTES);
        self.len.store(len, Relaxed);
        for (to, byte) in self.path.iter().zip(&path[..len]) {
            to.store(*byte, Relaxed);
        }
        self.sequence.store(sequence.wrapping_add(2), Release);
        true
    }

    fn free(&self) {
        let sequence = self.sequence.load(Relaxed);
        self.sequence.store(sequence.wrapping_add(2), Release);
    }

    /// Copies the path of a full slot whose addresses hold this one, and gives its length.
    fn read(&self, address: usize, path: &mut [u8; PATH_BYTES]) -> Option<usize> {
        let before = self.sequence.load(Acquire);
        let range = self.start.load(Relaxed)..self.end.load(Relaxed);
        if before % 4 != 2 || !range.contains(&address) {
            return None;
        }
        let len = self.len.load(Relaxed).min(PATH_BYTES);
        for (to, byte) in path.iter_mut().zip(&self.path[..len]) {
            *to = byte.load(Relaxed);
        }
        fence(Acquire);
        (self.sequence.load(Relaxed) == before).then_some(len)
    }

    /// The path of a full slot as the system takes it.
    #[cfg(unix)]
    fn c_path<'a>(&self, path: &'a mut [u8; PATH_BYTES]) -> Option<&'a std::ffi::CStr> {
        let len = self.read(0, path)?;
        *path.get_mut(len)? = 0;
        std::ffi::CStr::from_bytes_until_nul(path).ok()
    }
}

/// An entry, until it is dropped.
#[derive(Debug)]
struct Entry(Option<&'static Slot>);

impl Entry {
    fn new(slots: &'static Slots, path: &Path, addresses: &Range<usize>) -> Self {
        let path = path.as_os_str().as_encoded_bytes();
        Self(slots.iter().find(|slot| slot.fill(path, addresses)))
    }
}

impl Drop for Entry {
    fn drop(&mut self) {
        if let Some(slot) = self.0 {
            slot.free();
        }
    }
}

impl std::fmt::Debug for Slot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Slot").finish_non_exhaustive()
    }
}

/// Addresses that are known to be a mapped file, as long as this lives.
#[derive(Debug)]
pub struct Mapped {
    _entry: Entry,
}

impl Mapped {
    /// Remembers that these addresses are the file of this path.
    #[must_use]
    pub fn new(path: &Path, addresses: Range<usize>) -> Self {
        Self {
            _entry: Entry::new(&MAPS, path, &addresses),
        }
    }
}

/// A temporary file or folder that [`remove_temporaries`] removes, as long as this lives.
#[derive(Debug)]
pub(crate) struct Temporary {
    _entry: Entry,
}

impl Temporary {
    pub(crate) fn file(path: &Path) -> Self {
        Self::new(&FILES, path)
    }

    pub(crate) fn folder(path: &Path) -> Self {
        Self::new(&FOLDERS, path)
    }

    fn new(slots: &'static Slots, path: &Path) -> Self {
        // A part of a path names another file; the next run finds this one.
        let is_whole = path.as_os_str().len() < PATH_BYTES;
        let entry = is_whole.then(|| Entry::new(slots, path, &(0..1)));
        Self {
            _entry: entry.unwrap_or(Entry(None)),
        }
    }
}

/// The path of the mapped file that an address belongs to, as it was given to whoever mapped it.
///
/// Async-signal-safe.
pub fn mapped_path(address: usize, path: &mut [u8; PATH_BYTES]) -> Option<&[u8]> {
    let len = MAPS.iter().find_map(|slot| slot.read(address, path))?;
    Some(&path[..len])
}

/// Removes all temporary files and folders of this process, also those that are being written: for
/// a process that ends next. Where a call fails, the next run sweeps what is left.
///
/// Async-signal-safe. Does nothing but on Unix, and leaves folders but on Linux.
pub fn remove_temporaries() {
    #[cfg(unix)]
    {
        let mut path = [0; PATH_BYTES];
        for slot in &FILES {
            if let Some(path) = slot.c_path(&mut path) {
                let _ = rustix::fs::unlink(path);
            }
        }
        #[cfg(target_os = "linux")]
        for slot in &FOLDERS {
            if let Some(path) = slot.c_path(&mut path) {
                let _ = remove_folder(path);
            }
        }
    }
}

/// Removes a folder of files.
#[cfg(target_os = "linux")]
fn remove_folder(path: &std::ffi::CStr) -> rustix::io::Result<()> {
    use rustix::fs::{AtFlags, CWD, Mode, OFlags, RawDir, openat, unlinkat};
    use std::mem::MaybeUninit;

    let flags = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::NOFOLLOW | OFlags::CLOEXEC;
    let folder = openat(CWD, path, flags, Mode::empty())?;
    let mut buffer = [MaybeUninit::uninit(); 1024];
    let mut entries = RawDir::new(&folder, &mut buffer);
    while let Some(entry) = entries.next() {
        // Of "." and ".." the system says that they are folders.
        let _ = unlinkat(&folder, entry?.file_name(), AtFlags::empty());
    }
    unlinkat(CWD, path, AtFlags::REMOVEDIR)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Removal is of all that the process has, other tests' too: tests/faults tests it with the
    // program.
    #[test]
    fn addresses_are_told_while_the_entry_lives() {
        let mut buffer = [0; PATH_BYTES];
        let one = Mapped::new(Path::new("one.lvt"), 16..32);
        let two = Mapped::new(Path::new("two.lvt"), 32..64);
        let mut path_at = |address| mapped_path(address, &mut buffer).map(<[u8]>::to_vec);
        assert_eq!(path_at(16).unwrap(), b"one.lvt");
        assert_eq!(path_at(32).unwrap(), b"two.lvt");
        assert_eq!(path_at(64), None);
        drop(one);
        assert_eq!(path_at(31), None);
        let three = Mapped::new(Path::new(&"x".repeat(2 * PATH_BYTES)), 16..17);
        assert_eq!(path_at(16).unwrap(), vec![b'x'; PATH_BYTES]);
        drop((two, three));
        assert_eq!(path_at(33), None);
    }

    #[test]
    fn more_entries_than_slots_are_left_out() {
        let entries = || (0..2 * SLOTS).map(|_| Mapped::new(Path::new("many"), 5..6));
        let all: Vec<Mapped> = entries().collect();
        assert!(all.iter().any(|mapped| mapped._entry.0.is_none()));
        drop(all);
        assert!(Mapped::new(Path::new("many"), 5..6)._entry.0.is_some());
    }
}
