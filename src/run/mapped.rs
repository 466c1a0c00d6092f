//! Files that the process has in memory.

use crate::formats::GiveBack;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Files that a job has mapped, whose memory it gives back where its limit asks for that. Clones
/// are the same list.
#[derive(Clone, Debug, Default)]
pub struct Mapped(Arc<Mutex<Vec<Weak<dyn GiveBack>>>>);

impl Mapped {
    /// And this one, until it is gone.
    pub(crate) fn add(&self, file: impl IntoIterator<Item = Weak<dyn GiveBack>>) {
        let mut files = self.lock();
        files.retain(|file| file.strong_count() > 0);
        files.extend(file);
    }

    /// Gives the memory of all of them back to the system.
    pub(crate) fn give_back(&self) {
        // Whoever ends one meanwhile ends it here, and not under the lock.
        let files: Vec<_> = self.lock().iter().filter_map(Weak::upgrade).collect();
        files.iter().for_each(|file| file.give_back());
    }

    fn lock(&self) -> MutexGuard<'_, Vec<Weak<dyn GiveBack>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[derive(Debug, Default)]
    struct Times(AtomicU32);

    impl GiveBack for Times {
        fn give_back(&self) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }
    }

    #[test]
    fn files_give_back_while_they_are_there() {
        let mapped = Mapped::default();
        let [first, second] = [0, 1].map(|_| Arc::new(Times::default()));
        for file in [&first, &second] {
            let file: Arc<dyn GiveBack> = file.clone();
            mapped.clone().add([Arc::downgrade(&file)]);
        }
        mapped.give_back();
        drop(second);
        mapped.give_back();
        assert_eq!(first.0.load(Ordering::Relaxed), 2);
        mapped.add(None);
        assert_eq!(mapped.lock().len(), 1);
    }
}
