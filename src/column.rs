//! Lists that a scene owns, or that lie in a mapped file and are used there.

use crate::formats::MappedFile;
use bytemuck::Pod;
use std::fmt;
use std::ops::{Deref, DerefMut, Range};
use std::ptr::NonNull;

/// A list of rows: memory of its own, or a part of a mapped file. It reads as a slice; whoever
/// changes it first gets memory of its own.
pub struct Column<T>(Rows<T>);

enum Rows<T> {
    Owned(Vec<T>),
    Mapped(MappedRows<T>),
}

/// Rows in a file that stays mapped as long as they are there.
struct MappedRows<T> {
    first: NonNull<T>,
    len: usize,
    file: MappedFile,
}

// SAFETY: the rows are read-only memory that nobody owns apart; `file` may go and be read anywhere.
unsafe impl<T: Sync> Send for MappedRows<T> {}
// SAFETY: as above.
unsafe impl<T: Sync> Sync for MappedRows<T> {}

impl<T> MappedRows<T> {
    #[inline]
    fn rows(&self) -> &[T] {
        // SAFETY: `Column::mapped` took pointer and length of a slice of the file's map, which
        // stays where it is while `file` is there.
        unsafe { std::slice::from_raw_parts(self.first.as_ptr(), self.len) }
    }
}

impl<T: Clone> Clone for MappedRows<T> {
    fn clone(&self) -> Self {
        Self {
            first: self.first,
            len: self.len,
            file: self.file.clone(),
        }
    }
}

impl<T> Column<T> {
    /// An empty list.
    #[must_use]
    pub const fn new() -> Self {
        Self(Rows::Owned(Vec::new()))
    }

    /// Whether it lies in a mapped file.
    #[must_use]
    pub fn is_mapped(&self) -> bool {
        matches!(self.0, Rows::Mapped(_))
    }
}

impl<T: Pod> Column<T> {
    /// The rows that bytes of a file are on this machine; `None` where they are none: at a place
    /// that is no multiple of their alignment, or not of whole rows.
    #[must_use]
    pub fn mapped(file: &MappedFile, bytes: Range<usize>) -> Option<Self> {
        let rows: &[T] = bytemuck::try_cast_slice(file.as_ref().get(bytes)?).ok()?;
        Some(Self(Rows::Mapped(MappedRows {
            first: NonNull::from(rows).cast(),
            len: rows.len(),
            file: file.clone(),
        })))
    }
}

impl<T: Clone> Column<T> {
    /// The rows as a list of memory of its own.
    pub fn to_mut(&mut self) -> &mut Vec<T> {
        if let Rows::Mapped(mapped) = &self.0 {
            self.0 = Rows::Owned(mapped.rows().to_vec());
        }
        match &mut self.0 {
            Rows::Owned(rows) => rows,
            Rows::Mapped(_) => unreachable!("they were just copied"),
        }
    }

    /// Appends a row.
    pub fn push(&mut self, row: T) {
        self.to_mut().push(row);
    }
}

impl<T> Deref for Column<T> {
    type Target = [T];

    #[inline]
    fn deref(&self) -> &[T] {
        match &self.0 {
            Rows::Owned(rows) => rows,
            Rows::Mapped(mapped) => mapped.rows(),
        }
    }
}

impl<T: Clone> DerefMut for Column<T> {
    fn deref_mut(&mut self) -> &mut [T] {
        self.to_mut()
    }
}

impl<T> Default for Column<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Clone> Clone for Column<T> {
    fn clone(&self) -> Self {
        Self(match &self.0 {
            Rows::Owned(rows) => Rows::Owned(rows.clone()),
            Rows::Mapped(mapped) => Rows::Mapped(mapped.clone()),
        })
    }
}

impl<T: fmt::Debug> fmt::Debug for Column<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        (**self).fmt(f)
    }
}

impl<T> From<Vec<T>> for Column<T> {
    fn from(rows: Vec<T>) -> Self {
        Self(Rows::Owned(rows))
    }
}

impl<T> FromIterator<T> for Column<T> {
    fn from_iter<I: IntoIterator<Item = T>>(rows: I) -> Self {
        Vec::from_iter(rows).into()
    }
}

impl<T: Clone> Extend<T> for Column<T> {
    fn extend<I: IntoIterator<Item = T>>(&mut self, rows: I) {
        self.to_mut().extend(rows);
    }
}

impl<'a, T: Copy + 'a> Extend<&'a T> for Column<T> {
    fn extend<I: IntoIterator<Item = &'a T>>(&mut self, rows: I) {
        self.to_mut().extend(rows);
    }
}

impl<'a, T> IntoIterator for &'a Column<T> {
    type Item = &'a T;
    type IntoIter = std::slice::Iter<'a, T>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

impl<T: PartialEq, R: AsRef<[T]>> PartialEq<R> for Column<T> {
    fn eq(&self, other: &R) -> bool {
        **self == *other.as_ref()
    }
}

impl<T> AsRef<[T]> for Column<T> {
    fn as_ref(&self) -> &[T] {
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_file_are_used_there_until_they_change() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        let rows: Vec<u32> = (0..100).collect();
        let bytes: Vec<u8> = rows.iter().flat_map(|v| v.to_le_bytes()).collect();
        std::fs::write(&path, bytes).unwrap();
        let file = MappedFile::open(&path).unwrap();
        let mut column = Column::<u32>::mapped(&file, 0..400).unwrap();
        assert!(column.is_mapped());
        assert!(std::ptr::eq(&raw const *column, &raw const *column.clone()));
        drop(file);
        assert_eq!(column, rows);
        column[7] = 1;
        assert!(!column.is_mapped());
        column.push(3);
        column.extend([4, 5]);
        assert_eq!(column.len(), 103);
        assert_eq!((column[6], column[7], column[102]), (6, 1, 5));
    }

    #[test]
    fn bytes_that_are_no_rows_are_refused() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a");
        std::fs::write(&path, [0; 64]).unwrap();
        let file = MappedFile::open(&path).unwrap();
        for (bytes, is_right) in [
            (0..64, true),
            (0..66, false),
            (0..63, false),
            (2..62, false),
        ] {
            assert_eq!(Column::<u32>::mapped(&file, bytes).is_some(), is_right);
        }
        assert!(Column::<u32>::mapped(&file, 0..0).unwrap().is_empty());
    }
}
