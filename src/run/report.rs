//! Seconds, memory and counts of a run, and the file that tells them.

use super::watch::{Peak, Resident, watched};
use super::{Output, usage};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

/// Seconds, memory and counts of one stage.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct StageReport {
    /// Name of the stage: that of the verb, or of a part of it.
    pub stage: String,
    /// Seconds by the clock, from its start to its end.
    pub wall_secs: f64,
    /// CPU seconds of the process over the stage, all threads.
    pub cpu_secs: f64,
    /// Largest resident size of the process up to the end of the stage, where the system tells.
    pub peak_memory_bytes: Option<u64>,
    /// The most of memory that was seen while the stage ran, where the system tells.
    pub peak: Option<Peak>,
    /// Named counts and figures.
    pub counts: BTreeMap<String, f64>,
}

/// Collects the seconds, memory and counts of stages.
#[derive(Debug)]
pub struct Report {
    started: Instant,
    stages: Mutex<Vec<StageReport>>,
}

impl Default for Report {
    fn default() -> Self {
        Self {
            started: Instant::now(),
            stages: Mutex::default(),
        }
    }
}

/// The file that a report is written to.
#[derive(serde::Serialize)]
struct Summary<'a> {
    version: &'a str,
    verb: &'a str,
    ok: bool,
    error: Option<String>,
    wall_secs: f64,
    cpu_secs: f64,
    peak_memory_bytes: Option<u64>,
    stages: Vec<StageReport>,
}

impl Report {
    /// Runs a stage and notes its wall and CPU time; `run` gets the stage's counts to fill.
    pub fn stage<T>(&self, name: &str, run: impl FnOnce(&mut BTreeMap<String, f64>) -> T) -> T {
        self.watched_stage(name, |_| (), None::<fn(Resident)>, run)
    }

    /// Runs a stage as [`Report::stage`] does; `seen` hears again and again what memory the process
    /// has meanwhile, where the system tells, and `often`, if it is there, more often.
    pub(super) fn watched_stage<T>(
        &self,
        name: &str,
        seen: impl Fn(Resident) + Sync,
        often: Option<impl Fn(Resident) + Sync>,
        run: impl FnOnce(&mut BTreeMap<String, f64>) -> T,
    ) -> T {
        let (started, cpu_before) = (Instant::now(), usage::cpu_secs());
        let mut counts = BTreeMap::new();
        let (result, peak) = watched(seen, often, || run(&mut counts));
        let stage = StageReport {
            stage: name.into(),
            wall_secs: started.elapsed().as_secs_f64(),
            cpu_secs: usage::cpu_secs() - cpu_before,
            peak_memory_bytes: usage::peak_memory_bytes(),
            peak,
            counts,
        };
        self.lock().push(stage);
        result
    }

    /// Returns what was noted so far, in order of completion.
    #[must_use]
    pub fn stages(&self) -> Vec<StageReport> {
        self.lock().clone()
    }

    /// How many stages were noted so far.
    #[must_use]
    pub fn count(&self) -> usize {
        self.lock().len()
    }

    /// Writes all that was noted as JSON, with the outcome of the run.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path, verb: &str, error: Option<&Error>) -> Result<()> {
        let summary = Summary {
            version: env!("CARGO_PKG_VERSION"),
            verb,
            ok: error.is_none(),
            error: error.map(ToString::to_string),
            wall_secs: self.started.elapsed().as_secs_f64(),
            cpu_secs: usage::cpu_secs(),
            peak_memory_bytes: usage::peak_memory_bytes(),
            stages: self.stages(),
        };
        Output::write_json_to(path, &summary)
    }

    fn lock(&self) -> MutexGuard<'_, Vec<StageReport>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stages_are_written_with_their_counts() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("report.json");
        let report = Report::default();
        let result = report.stage("bake", |counts| {
            counts.insert("surfels".into(), 3.0);
            7
        });
        assert_eq!(result, 7);
        report
            .write(&path, "bake", Some(&Error::cancelled()))
            .unwrap();
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(json["stages"][0]["counts"]["surfels"], 3.0);
        assert_eq!(json["ok"], false);
        assert_eq!(json["error"], "stopped on request");
        assert!(json["wall_secs"].as_f64().unwrap() >= 0.0);
    }
}
