//! What a run has beside its data: progress, cancellation, a memory limit, and a report of what it took.

pub mod build;
mod cancel;
mod hex;
pub mod output;
mod progress;
mod report;
pub mod size;
pub mod usage;

pub use cancel::Cancel;
pub use hex::hex;
pub use output::Output;
pub use progress::{Progress, ProgressMode, Task};
pub use report::{Report, StageReport};

use std::path::PathBuf;

/// Handed to every stage.
#[derive(Debug, Default)]
pub struct Job {
    /// Where progress goes.
    pub progress: Progress,
    /// Set by a signal; stages look at it often and stop with [`crate::Error::cancelled`].
    pub cancel: Cancel,
    /// What stages note about themselves.
    pub report: Report,
    /// Bytes that a stage may hold; `None` for no limit.
    pub memory_limit: Option<u64>,
    /// Folder for temporary files; the system's if `None`.
    pub temp_dir: Option<PathBuf>,
}
