//! What a run has beside its data: progress, cancellation, a memory limit, and a report of what it
//! took.
//!
//! Every stage gets a [`Job`]. Of the files, `progress`, `cancel` and `report` are its parts;
//! `budget` is what a stage holds of its limit; `memory`, `size`, `usage` and `watch` know what the
//! machine has and what is taken of it; `mapped` are files in memory; `lists` are large, and each
//! `list` of them is in memory or in a file; `output` writes files that appear whole; `part` divides
//! work among processes; `walked` counts what rays pass; `frames` are ranges of frames, and names
//! with their numbers; `words` are shared by threads and processes; `digest` and `hex` name the
//! program and what it read.

mod budget;
mod cancel;
#[cfg(feature = "lab")]
pub(crate) mod digest;
pub(crate) mod frames;
mod hex;
mod list;
mod lists;
mod mapped;
pub(crate) mod memory;
pub(crate) mod output;
mod part;
mod progress;
mod report;
pub(crate) mod size;
pub(crate) mod usage;
pub(crate) mod walked;
mod watch;
pub(crate) mod words;

pub(crate) use crate::formats::one_line;
pub(crate) use budget::Budget;
pub use budget::Held;
pub use cancel::Cancel;
pub use frames::Frames;
pub(crate) use hex::hex;
pub(crate) use list::List;
pub(crate) use lists::Lists;
pub use mapped::Mapped;
pub(crate) use output::Output;
pub use part::Part;
pub use progress::{Observer, Progress, Task, TaskObserver};
pub use report::{Report, StageReport};
pub(crate) use walked::Walked;
pub use watch::{Peak, Resident};

use crate::formats::TemporaryFolder;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The means of a run that every stage gets beside its data.
#[derive(Debug, Default)]
pub struct Job {
    /// Passes on progress, messages and warnings to the caller.
    pub progress: Progress,
    /// Stops the job: stages look at it often and end with [`crate::Error::cancelled`].
    pub cancel: Cancel,
    /// Collects times, memory and counts of the stages.
    pub report: Report,
    /// Most bytes that a stage may hold; `None` for no limit.
    pub memory_limit: Option<u64>,
    /// Bytes of that limit which the process takes before any stage does: the program itself, and
    /// what its threads need. Applications, which hold more than lvox, may leave it at 0 and give
    /// what is left for lvox as the limit.
    pub process_bytes: u64,
    /// What the stage at work holds whatever its caches do, which it tells itself.
    pub held: Held,
    /// Files that are in memory, whose memory is given back where the limit asks for it.
    pub mapped: Mapped,
    /// Whether work goes on after a warning.
    pub on_warning: OnWarning,
    /// Folder for temporary files; the system's if `None`.
    pub temp_dir: Option<PathBuf>,
    /// File in which frames and tiles of one scene and tree keep the radiance of surfaces for each
    /// other, also while they run; `None` to keep it to one frame.
    pub radiance_cache: Option<PathBuf>,
    /// File in which the tiles of one frame keep its gathers on surfaces for each other, also while
    /// they run; `None` for each to gather its own.
    pub gather_cache: Option<PathBuf>,
}

/// The course of a job after a warning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum OnWarning {
    /// Warnings are told, and the work goes on.
    #[default]
    GoOn,
    /// A warning ends the job as an error.
    Fail,
}

impl Job {
    /// Bytes that the stage at work holds whatever its caches do.
    pub(crate) fn held_bytes(&self) -> u64 {
        self.held.bytes()
    }

    /// Notes what a stage holds from now on, in place of the one before.
    pub(crate) fn hold(&self, budget: &Budget) {
        self.held.set(budget);
    }

    /// Runs a stage, and notes its wall and CPU time; `run` gets the stage's counts to fill. Memory
    /// of mapped files is given back where the process comes near its limit.
    pub(crate) fn stage<T>(
        &self,
        name: &str,
        run: impl FnOnce(&mut BTreeMap<String, f64>) -> T,
    ) -> T {
        self.watched_stage(name, |_| (), run)
    }

    /// The same; `seen` hears again and again what memory the process has meanwhile, where the
    /// system tells.
    pub(crate) fn watched_stage<T>(
        &self,
        name: &str,
        seen: impl Fn(Resident) + Sync,
        run: impl FnOnce(&mut BTreeMap<String, f64>) -> T,
    ) -> T {
        // A limit that is not for this process alone says nothing of what that has.
        let limit = self.memory_limit.filter(|_| self.process_bytes > 0);
        let keep = limit.map(|limit| {
            move |now: Resident| {
                if now.is_near(limit) {
                    self.mapped.give_back();
                }
            }
        });
        self.report.watched_stage(name, seen, keep, run)
    }

    /// Makes a folder for temporary files, and removes those that killed processes left beside it.
    ///
    /// # Errors
    /// That of the system, with the folder that it was to be in.
    pub(crate) fn temporary_folder(&self) -> Result<TemporaryFolder> {
        let parent = self.temp_dir.clone().unwrap_or_else(std::env::temp_dir);
        TemporaryFolder::create_in(&parent).map_err(|e| {
            Error::io("create a temporary folder in", &parent, &e)
                .hint("choose another folder for temporary files (`temp_dir`)")
        })
    }

    /// Ends a job that fails on warnings if something was warned of. Stages call this before long
    /// work and before they write.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] with all warnings so far.
    pub fn heed_warnings(&self) -> Result<()> {
        let warnings = self.progress.warnings();
        if self.on_warning == OnWarning::GoOn || warnings.is_empty() {
            return Ok(());
        }
        let count = match warnings.len() {
            1 => "a warning".into(),
            n => format!("{n} warnings"),
        };
        let message = format!("{count} with `strict`: {}", warnings.join("; "));
        Err(Error::input(message).hint("mend what is warned of, or do without `strict`"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_end_strict_jobs_alone() {
        let job = |on_warning| Job {
            on_warning,
            ..Job::default()
        };
        let (strict, lenient) = (job(OnWarning::Fail), job(OnWarning::GoOn));
        strict.heed_warnings().unwrap();
        for job in [&strict, &lenient] {
            job.progress.warn("one");
            job.progress.warn("two");
        }
        lenient.heed_warnings().unwrap();
        let error = strict.heed_warnings().unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        assert_eq!(error.to_string(), "2 warnings with `strict`: one; two");
    }
}
