//! Lists whose memory is used again: what is new to a process costs as much as filling it.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, PoisonError};

/// The memory of lists that are done with, for those to come: as many as were in use at one time.
#[derive(Debug)]
pub struct Spare<T>(Mutex<Vec<Vec<T>>>);

/// A list whose memory goes back when it is dropped.
#[derive(Debug)]
pub struct Lent<'a, T> {
    list: Vec<T>,
    spare: &'a Spare<T>,
}

impl<T> Default for Spare<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Spare<T> {
    /// An empty list.
    #[must_use]
    pub fn list(&self) -> Lent<'_, T> {
        let mut lists = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        Lent {
            list: lists.pop().unwrap_or_default(),
            spare: self,
        }
    }
}

impl<T> Deref for Lent<'_, T> {
    type Target = Vec<T>;

    #[inline]
    fn deref(&self) -> &Vec<T> {
        &self.list
    }
}

impl<T> DerefMut for Lent<'_, T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut Vec<T> {
        &mut self.list
    }
}

impl<T> Drop for Lent<'_, T> {
    fn drop(&mut self) {
        let mut list = std::mem::take(&mut self.list);
        list.clear();
        let mut lists = self.spare.0.lock().unwrap_or_else(PoisonError::into_inner);
        lists.push(list);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_comes_back_empty() {
        let spare = Spare::default();
        let mut first = spare.list();
        first.extend([1, 2, 3]);
        let (room, at) = (first.capacity(), first.as_ptr());
        let second = spare.list();
        assert_eq!(second.capacity(), 0);
        drop(first);
        let third = spare.list();
        assert!(third.is_empty());
        assert_eq!((third.capacity(), third.as_ptr()), (room, at));
    }
}
