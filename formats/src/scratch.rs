//! Bytes in a file without a name, for what is too large for memory.

use crate::emergency::Mapped;
use crate::give_back::GiveBack;
use std::fs::File;
use std::io;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Weak};

/// Bytes that are read and written in place, of which the system keeps in memory what it can. They
/// lie in a file without a name, which ends with them.
#[derive(Debug)]
pub struct ScratchFile(Arc<Scratch>);

#[derive(Debug)]
struct Scratch {
    /// Whose bytes these are, for who handles the signal of a disk that fails.
    _mapped: Mapped,
    map: memmap2::MmapRaw,
}

impl Scratch {
    /// Gives the memory of whole pages in a range back to the system.
    #[allow(unsafe_code)]
    fn release(&self, range: Range<usize>) {
        #[cfg(unix)]
        {
            let page = rustix::param::page_size();
            let start = range.start.next_multiple_of(page);
            let end = match range.end < self.map.len() {
                true => range.end / page * page,
                false => self.map.len(),
            };
            if start >= end {
                return;
            }
            // SAFETY: the map is shared with its file, to which the system writes what pages hold
            // before it takes them; slices of it stay valid.
            let advised = unsafe {
                (self.map).unchecked_advise_range(
                    memmap2::UncheckedAdvice::DontNeed,
                    start,
                    end - start,
                )
            };
            // Advice that is not taken costs memory and nothing else.
            drop(advised);
        }
    }
}

impl GiveBack for Scratch {
    fn give_back(&self) {
        self.release(0..self.map.len());
    }
}

/// Some of the memory of a [`ScratchFile`], for those that use its bytes piece by piece.
#[derive(Clone, Debug)]
pub struct ScratchPages(Arc<Scratch>);

impl ScratchPages {
    /// Gives the memory of these bytes, as far as they are whole pages, back to the system.
    pub fn release(&self, bytes: Range<usize>) {
        self.0.release(bytes);
    }
}

impl ScratchFile {
    /// So many zeros, more than none, in a folder, whose disk has room for all of them or is asked
    /// for none.
    ///
    /// # Errors
    /// That of the system: above all a disk that is full.
    pub fn zeros_in(folder: &Path, bytes: usize) -> io::Result<Self> {
        let file = tempfile::tempfile_in(folder)?;
        reserve(&file, bytes as u64)?;
        let map = memmap2::MmapRaw::map_raw(&file)?;
        // It is read here and there: what comes with it would take the place of what is used.
        #[cfg(unix)]
        drop(map.advise(memmap2::Advice::Random));
        let start = map.as_ptr().addr();
        Ok(Self(Arc::new(Scratch {
            _mapped: Mapped::new(folder, start..start + map.len()),
            map,
        })))
    }

    /// Its memory, to give it back piece by piece.
    #[must_use]
    pub fn pages(&self) -> ScratchPages {
        ScratchPages(self.0.clone())
    }

    /// What gives its memory back as long as it is there.
    #[must_use]
    pub fn to_give_back(&self) -> Weak<dyn GiveBack> {
        let scratch: Arc<dyn GiveBack> = self.0.clone();
        Arc::downgrade(&scratch)
    }
}

impl AsRef<[u8]> for ScratchFile {
    #[allow(unsafe_code)]
    #[inline]
    fn as_ref(&self) -> &[u8] {
        // SAFETY: nobody else has the file, which has no name, nor makes slices of its map, which
        // is written to through `as_mut` alone.
        unsafe { std::slice::from_raw_parts(self.0.map.as_ptr(), self.0.map.len()) }
    }
}

impl AsMut<[u8]> for ScratchFile {
    #[allow(unsafe_code)]
    fn as_mut(&mut self) -> &mut [u8] {
        // SAFETY: as above; whoever has this borrow has the only one.
        unsafe { std::slice::from_raw_parts_mut(self.0.map.as_mut_ptr(), self.0.map.len()) }
    }
}

/// Makes a file so long, with room on its disk: a page without would end the process.
fn reserve(file: &File, bytes: u64) -> io::Result<()> {
    #[cfg(unix)]
    match rustix::fs::fallocate(file, rustix::fs::FallocateFlags::empty(), 0, bytes) {
        Err(rustix::io::Errno::OPNOTSUPP | rustix::io::Errno::NOSYS) => {}
        done => return Ok(done?),
    }
    // A disk that cannot tell: what is written there has room.
    io::copy(&mut io::Read::take(io::repeat(0), bytes), &mut &*file)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_stay_when_their_memory_is_given_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut scratch = ScratchFile::zeros_in(folder.path(), 1 << 20).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
        assert!(scratch.as_ref().iter().all(|b| *b == 0));
        for (i, byte) in scratch.as_mut().iter_mut().enumerate() {
            *byte = (i % 251) as u8;
        }
        let given_back = scratch.to_give_back();
        given_back.upgrade().unwrap().give_back();
        scratch.pages().release(5..70_000);
        scratch.pages().release(4097..1 << 20);
        let is_right = |(i, byte): (usize, &u8)| *byte == (i % 251) as u8;
        assert!(scratch.as_ref().iter().enumerate().all(is_right));
        drop(scratch);
        assert!(given_back.upgrade().is_none());
    }

    #[cfg(unix)]
    #[test]
    fn what_no_disk_holds_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        ScratchFile::zeros_in(folder.path(), 1 << 50).unwrap_err();
    }
}
