//! Large lists, wherever there is room for them.

use super::Lists;
use super::lists::Granted;
use crate::formats::ScratchFile;
use bytemuck::Pod;
use rayon::prelude::*;
use std::fmt;
use std::ops::{Deref, DerefMut, Range};

/// A list in memory, or in a temporary file that is used where it lies. It reads and writes as a
/// slice.
pub struct List<T> {
    rows: Rows<T>,
    lists: Lists,
}

enum Rows<T> {
    InMemory(Vec<T>, Option<Granted>),
    InFile(ScratchFile, usize),
}

impl<T> List<T> {
    pub(super) fn in_memory(rows: Vec<T>, granted: Option<Granted>, lists: Lists) -> Self {
        Self {
            rows: Rows::InMemory(rows, granted),
            lists,
        }
    }

    pub(super) fn in_file(file: ScratchFile, count: usize, lists: Lists) -> Self {
        Self {
            rows: Rows::InFile(file, count),
            lists,
        }
    }

    /// Whether it lies in a file.
    #[must_use]
    pub fn is_in_file(&self) -> bool {
        matches!(self.rows, Rows::InFile(..))
    }

    /// Those that it is one of, as lists that are made of it are to be.
    #[must_use]
    pub fn lists(&self) -> &Lists {
        &self.lists
    }

    /// Has `write` write pieces of `count` rows each, the last of which may have fewer, on all
    /// threads. The memory of those in a file is given back as they are done.
    pub fn write_pieces(&mut self, count: usize, write: impl Fn(usize, &mut [T]) + Sync)
    where
        T: Pod + Send,
    {
        /// Bytes that are given back together.
        const TOGETHER: usize = 1 << 20;
        let pages = match &self.rows {
            Rows::InMemory(..) => None,
            Rows::InFile(file, _) => Some(file.pages()),
        };
        let together = match &pages {
            None => 1,
            Some(_) => (TOGETHER / (count * size_of::<T>()).max(1)).max(1),
        };
        let some = self.par_chunks_mut(count * together).enumerate();
        some.for_each(|(i, rows)| {
            let bytes = size_of_val(rows);
            let pieces = rows.chunks_mut(count).enumerate();
            pieces.for_each(|(j, rows)| write(i * together + j, rows));
            if let Some(pages) = &pages {
                let first = i * together * count * size_of::<T>();
                pages.release(first..first + bytes);
            }
        });
    }

    /// Gives the memory of rows in a file back to the system, which reads them again for who asks.
    pub fn give_back(&self, rows: Range<usize>) {
        if let Rows::InFile(file, _) = &self.rows {
            let size = size_of::<T>();
            file.pages().release(rows.start * size..rows.end * size);
        }
    }

    /// Leaves out all rows from the `count`th on.
    pub fn truncate(&mut self, count: usize) {
        match &mut self.rows {
            Rows::InMemory(rows, granted) => {
                rows.truncate(count);
                rows.shrink_to_fit();
                if let Some(granted) = granted {
                    granted.lower((count * size_of::<T>()) as u64);
                }
            }
            Rows::InFile(_, all) => *all = count.min(*all),
        }
    }
}

impl<T: Pod> Deref for List<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.rows {
            Rows::InMemory(rows, _) => rows,
            Rows::InFile(file, count) => &bytemuck::cast_slice(file.as_ref())[..*count],
        }
    }
}

impl<T: Pod> DerefMut for List<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        match &mut self.rows {
            Rows::InMemory(rows, _) => rows,
            Rows::InFile(file, count) => &mut bytemuck::cast_slice_mut(file.as_mut())[..*count],
        }
    }
}

impl<T> From<Vec<T>> for List<T> {
    fn from(rows: Vec<T>) -> Self {
        Self::in_memory(rows, None, Lists::default())
    }
}

impl<T: Pod> Clone for List<T> {
    fn clone(&self) -> Self {
        let mut copy = self.lists.zeros_surely(self.len());
        copy.copy_from_slice(self);
        copy
    }
}

impl<T: Pod + fmt::Debug> fmt::Debug for List<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

impl<T: Pod + PartialEq> PartialEq for List<T> {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}
