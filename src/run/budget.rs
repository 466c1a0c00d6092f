//! What a stage holds of its memory limit whatever its caches do.

use super::{Lists, Resident, size};
use crate::Result;
use std::fmt::{Display, Write};
use std::sync::atomic::{AtomicU64, Ordering};

/// What a stage holds in memory whatever its caches do, holder by holder; caches get what a limit
/// leaves.
#[derive(Clone, Debug, Default)]
pub struct Budget(Vec<(&'static str, u64)>);

impl Budget {
    /// And this: `what` is the holder, as in "the scene".
    #[must_use]
    pub fn with(mut self, what: &'static str, bytes: u64) -> Self {
        if bytes > 0 {
            self.0.push((what, bytes));
        }
        self
    }

    /// And what of large lists and of mapped files is in memory within a limit: of lists as much as
    /// [`Lists`] keeps there, and of files, which hold the rest, what the limit leaves for them.
    #[must_use]
    pub fn with_lists(
        self,
        what: &'static str,
        bytes: u64,
        mapped_bytes: u64,
        limit: Option<u64>,
    ) -> Self {
        let in_memory = Lists::in_memory(bytes, limit);
        let in_files = mapped_bytes.saturating_add(bytes - in_memory);
        let given = limit.map_or(0, |limit| in_files.min(limit / Resident::MAPPED_SHARE));
        self.with(what, in_memory).with("files in memory", given)
    }

    /// All of it together.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.0
            .iter()
            .fold(0, |sum, (_, bytes)| sum.saturating_add(*bytes))
    }

    /// Refuses a deed that holds more than the limit, if there is one, before it is begun.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] with both sizes. The hint names the largest holders, and ends with
    /// `advice`.
    pub fn within(&self, deed: impl Display, limit: Option<u64>, advice: &str) -> Result<()> {
        const NAMED: usize = 3;
        size::within(deed, self.bytes(), limit).map_err(|e| {
            let mut largest = self.0.clone();
            largest.sort_by_key(|(_, bytes)| std::cmp::Reverse(*bytes));
            let mut hint = String::new();
            for (what, bytes) in largest.iter().take(NAMED) {
                let _ = write!(hint, "{what} {}, ", size::format(*bytes));
            }
            e.hint(format!("it holds {hint}and more; {advice}"))
        })
    }
}

/// Bytes that the stage at work holds whatever its caches do; none before the first.
#[derive(Debug, Default)]
pub struct Held {
    all_along: AtomicU64,
    for_now: AtomicU64,
}

impl Held {
    pub(super) fn bytes(&self) -> u64 {
        self.all_along.load(Ordering::Relaxed)
    }

    /// The same with what a part of it holds for now; 0 where none has told.
    pub(crate) fn bytes_for_now(&self) -> u64 {
        self.for_now.load(Ordering::Relaxed)
    }

    pub(super) fn set(&self, budget: &Budget) {
        self.all_along.store(budget.bytes(), Ordering::Relaxed);
        self.set_for_now(0);
    }

    /// Tells caches what the stage is about to hold, all together and for a while, before they
    /// could see it; 0 when that is over.
    pub(crate) fn set_for_now(&self, bytes: u64) {
        self.for_now.store(bytes, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_held_is_added_up_and_the_largest_are_named() {
        let budget = Budget::default()
            .with("the scene", 3 << 20)
            .with("nothing", 0)
            .with("pixels", 1 << 20)
            .with("threads", 1 << 10)
            .with("the film", 5 << 20);
        assert_eq!(budget.bytes(), (9 << 20) + (1 << 10));
        budget.within("x", None, "y").unwrap();
        budget.within("x", Some(budget.bytes()), "y").unwrap();
        let error = budget.within("shading", Some(1 << 20), "raise it");
        let error = error.unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        let told = "shading needs 9.00 MiB, `memory_limit` is 1.00 MiB";
        assert_eq!(error.to_string(), told);
        let hint =
            "it holds the film 5.00 MiB, the scene 3.00 MiB, pixels 1.00 MiB, and more; raise it";
        assert_eq!(error.hint_text(), Some(hint));
    }
}
