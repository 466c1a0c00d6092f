//! What a job tells its caller while it works: how far its tasks are, messages, and warnings.

use super::one_line;
use std::fmt;
use std::sync::{Mutex, PoisonError};

/// A caller that wants to hear how a job gets on. Called from many threads.
pub trait Observer: Send + Sync {
    /// A task of `total` units begins; 0 if that many are not known beforehand. The task ends when
    /// what is returned is dropped, before its total if the job fails.
    fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Box<dyn TaskObserver>;

    /// Something worth knowing that is neither progress nor a warning, as one line.
    fn message(&self, text: &str);

    /// Something is amiss that the job goes on with, as one line.
    fn warning(&self, text: &str);
}

/// A caller that wants to hear how one task gets on; it ends when this is dropped.
pub trait TaskObserver: Send + Sync {
    /// So many units more are done. Called for a row or a page, not for every sample.
    fn add(&self, units: u64);
}

/// Passes on what a job tells to its [`Observer`], if it has one, and keeps the warnings.
#[derive(Default)]
pub struct Progress {
    observer: Option<Box<dyn Observer>>,
    warnings: Mutex<Vec<String>>,
}

/// A piece of work whose observer, if there is one, hears how far it is; finished when dropped.
pub struct Task(Option<Box<dyn TaskObserver>>);

impl Progress {
    /// Progress that an observer hears of. The default has none.
    #[must_use]
    pub fn new(observer: impl Observer + 'static) -> Self {
        Self {
            observer: Some(Box::new(observer)),
            ..Self::default()
        }
    }

    /// Starts a task of `total` units (0 for unknown).
    #[must_use]
    pub fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Task {
        let observer = self.observer.as_ref();
        Task(observer.map(|o| o.task(name, total, unit)))
    }

    /// Says something that is not progress.
    pub fn say(&self, message: &str) {
        if let Some(observer) = &self.observer {
            observer.message(&one_line(message));
        }
    }

    /// Warns the observer, and keeps the warning.
    pub fn warn(&self, message: &str) {
        let message = one_line(message);
        if let Some(observer) = &self.observer {
            observer.warning(&message);
        }
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.push(message);
    }

    /// All warnings so far.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.clone()
    }
}

impl Task {
    /// So many units more are done; may be called from many threads.
    pub fn add(&self, units: u64) {
        if let Some(observer) = &self.0 {
            observer.add(units);
        }
    }
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut fields = f.debug_struct("Progress");
        fields.field("warnings", &self.warnings());
        fields.finish_non_exhaustive()
    }
}

impl fmt::Debug for Task {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Task").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;

    /// Writes down what it hears.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<String>>>);

    impl Log {
        fn note(&self, line: String) {
            self.0.lock().unwrap().push(line);
        }
    }

    impl Observer for Log {
        fn task(
            &self,
            name: &'static str,
            total: u64,
            unit: &'static str,
        ) -> Box<dyn TaskObserver> {
            self.note(format!("{name}: {total} {unit}"));
            Box::new(self.clone())
        }

        fn message(&self, text: &str) {
            self.note(text.to_owned());
        }

        fn warning(&self, text: &str) {
            self.note(format!("warning: {text}"));
        }
    }

    impl TaskObserver for Log {
        fn add(&self, units: u64) {
            self.note(format!("+{units}"));
        }
    }

    #[test]
    fn observers_hear_everything_and_warnings_are_kept() {
        let log = Log::default();
        let progress = Progress::new(log.clone());
        let task = progress.task("bake", 8, "points");
        task.add(3);
        progress.say("half of it");
        progress.warn("no light");
        task.add(5);
        let lines = [
            "bake: 8 points",
            "+3",
            "half of it",
            "warning: no light",
            "+5",
        ];
        assert_eq!(*log.0.lock().unwrap(), lines);
        assert_eq!(progress.warnings(), ["no light"]);
        let silent = Progress::default();
        silent.task("bake", 0, "points").add(1);
        silent.warn("heard by nobody");
        assert_eq!(silent.warnings(), ["heard by nobody"]);
    }
}
