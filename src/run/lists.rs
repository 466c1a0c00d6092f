//! Where large lists are: in memory, or in temporary files beyond what a limit leaves them.

use super::{Job, List, Mapped, memory};
use crate::formats::{MappedFile, ScratchFile};
use crate::{Error, Result};
use bytemuck::Pod;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// The share of a memory limit that large lists have in memory together.
const SHARE: u64 = 4;

/// Large lists: in memory, and within a limit no more than a quarter of it; those beyond lie in
/// temporary files, of which the system keeps in memory what it can. Clones share the quarter.
#[derive(Clone, Debug, Default)]
pub struct Lists(Option<Arc<Limited>>);

#[derive(Debug)]
struct Limited {
    /// Bytes that lists have in memory, at most, and those that they have now.
    most: u64,
    in_memory: AtomicU64,
    folder: PathBuf,
    mapped: Mapped,
}

/// Bytes of a list that count, until it is gone.
#[derive(Debug)]
pub(super) struct Granted {
    of: Arc<Limited>,
    bytes: u64,
}

impl Granted {
    /// Lowers them to so many.
    pub(super) fn lower(&mut self, bytes: u64) {
        let less = self.bytes.saturating_sub(bytes);
        self.of.in_memory.fetch_sub(less, Ordering::Relaxed);
        self.bytes -= less;
    }
}

impl Drop for Granted {
    fn drop(&mut self) {
        self.lower(0);
    }
}

impl Lists {
    /// Bytes of a list below which it is in memory whatever the limit: too few for a file.
    pub const SMALL: u64 = 1 << 16;

    /// Those of a job.
    #[must_use]
    pub fn of(job: &Job) -> Self {
        Self(job.memory_limit.map(|limit| {
            Arc::new(Limited {
                most: limit / SHARE,
                in_memory: AtomicU64::new(0),
                folder: job.temp_dir.clone().unwrap_or_else(std::env::temp_dir),
                mapped: job.mapped.clone(),
            })
        }))
    }

    /// Bytes of so many of lists that are in memory within a limit.
    #[must_use]
    pub(super) fn in_memory(bytes: u64, limit: Option<u64>) -> u64 {
        limit.map_or(bytes, |limit| bytes.min(limit / SHARE))
    }

    /// A list of zeros, which takes no memory before they are touched; `what` needs it.
    ///
    /// # Errors
    /// No memory for it, or no file: above all a disk that is full.
    pub fn zeros<T: Pod>(&self, what: &str, count: usize) -> Result<List<T>> {
        let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
        let granted = match &self.0 {
            None => None,
            Some(limited) => match limited.grant(bytes) {
                None if bytes >= Self::SMALL => {
                    return self.in_file(what, limited, bytes, count);
                }
                granted => granted,
            },
        };
        memory::check(what, bytes)?;
        // Asked for first, as there is no fallible way to get zeros that are not written.
        drop(memory::room::<T>(what, count)?);
        Ok(List::in_memory(
            vec![T::zeroed(); count],
            granted,
            self.clone(),
        ))
    }

    /// The same where an error cannot be told: what no file has room for is in memory, whatever the
    /// limit.
    pub fn zeros_surely<T: Pod>(&self, count: usize) -> List<T> {
        let zeros = self.zeros("a list", count);
        zeros.unwrap_or_else(|_| List::in_memory(vec![T::zeroed(); count], None, self.clone()))
    }

    /// Has the memory of a mapped file given back where a limit asks for it.
    pub fn watch(&self, file: &MappedFile) {
        if let Some(limited) = &self.0 {
            limited.mapped.add(file.to_give_back());
        }
    }

    /// Tells the system of a mapped file whose rows are used where they lie, and may not fit into a
    /// limit.
    pub fn expect_random_access(&self, file: &MappedFile) {
        if let Some(limited) = &self.0
            && file.as_ref().len() as u64 > limited.most
        {
            file.expect_random_access();
        }
    }

    fn in_file<T: Pod>(
        &self,
        what: &str,
        limited: &Limited,
        bytes: u64,
        count: usize,
    ) -> Result<List<T>> {
        let file = usize::try_from(bytes).map_err(|_| memory::refused::<T>(what, count))?;
        let file = ScratchFile::zeros_in(&limited.folder, file).map_err(|e| {
            let deed = format!("keep {what} in a temporary file in");
            Error::io(&deed, &limited.folder, &e).hint(
                "free some of that disk, choose another folder (`temp_dir`), or raise \
                 `memory_limit`",
            )
        })?;
        limited.mapped.add([file.to_give_back()]);
        Ok(List::in_file(file, count, self.clone()))
    }
}

impl Limited {
    /// So many bytes of memory, if they are left.
    fn grant(self: &Arc<Self>, bytes: u64) -> Option<Granted> {
        let add = |now: u64| now.checked_add(bytes).filter(|all| *all <= self.most);
        let all = &self.in_memory;
        all.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add)
            .ok()?;
        Some(Granted {
            of: Arc::clone(self),
            bytes,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_beyond_a_quarter_of_a_limit_are_in_files() {
        let folder = tempfile::tempdir().unwrap();
        let job = Job {
            memory_limit: Some(16 << 20),
            temp_dir: Some(folder.path().into()),
            ..Job::default()
        };
        let lists = Lists::of(&job);
        const COUNT: usize = 768 << 10;
        let mut first = lists.zeros::<f32>("a test", COUNT).unwrap();
        let mut second = lists.zeros::<f32>("a test", COUNT).unwrap();
        let small = lists.zeros::<u8>("a test", 100).unwrap();
        let in_files = [&first, &second].map(List::is_in_file);
        assert_eq!((in_files, small.is_in_file()), ([false, true], false));
        for list in [&mut first, &mut second] {
            assert!(list.iter().all(|v| *v == 0.0));
            list.iter_mut().enumerate().for_each(|(i, v)| *v = i as f32);
        }
        job.mapped.give_back();
        assert!(first == second);
        let copy = second.clone();
        assert!(copy == first && copy.is_in_file());
        first.truncate(100);
        second.truncate(100);
        assert!(first == second && first.len() == 100);
        assert!(!copy.clone().is_in_file());
        assert!(
            !Lists::default()
                .zeros::<f32>("a test", COUNT)
                .unwrap()
                .is_in_file()
        );
    }

    #[test]
    fn a_folder_that_has_no_room_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let job = Job {
            memory_limit: Some(1 << 20),
            temp_dir: Some(folder.path().join("none")),
            ..Job::default()
        };
        let error = Lists::of(&job)
            .zeros::<f32>("a volume", 1 << 20)
            .unwrap_err();
        let text = error.to_string();
        assert!(
            text.starts_with("cannot keep a volume in a temporary file in"),
            "{text}"
        );
        assert!(error.hint_text().unwrap().contains("`temp_dir`"));
    }
}
