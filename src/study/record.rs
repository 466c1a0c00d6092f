//! What a study has measured, and the file that keeps it.

use crate::run::Output;
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::path::Path;

/// Everything measured so far; the file `study.json`.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Study {
    /// Version of lvox.
    pub version: String,
    /// What the measurements belong to: scene and settings, hashed.
    pub key: String,
    /// Name of the scene.
    pub scene: String,
    /// Pixels across and down.
    pub film: [u32; 2],
    /// The machine.
    pub machine: Machine,
    /// The settings, as JSON.
    pub settings: serde_json::Value,
    /// The image that all are compared with.
    pub reference: Reference,
    /// Clouds, in order of need.
    pub clouds: Vec<Cloud>,
    /// Runs, in order of the plan.
    pub runs: Vec<Run>,
    /// Fitted exponents of error over settings, and the runs that no other beats in both time and error.
    pub findings: Findings,
}

/// What it ran on.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Machine {
    /// Operating system and processor family.
    pub system: String,
    /// Name of the processor, if the system tells.
    pub processor: String,
    /// Threads that were used.
    pub threads: usize,
}

/// A converged image.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Reference {
    /// Where it came from.
    pub source: String,
    /// relMSE against the truth that its own variance tells, if it has any.
    pub relmse: Option<f64>,
    /// Factor on radiance for the perceptual metrics.
    pub exposure: f32,
}

/// A cloud and its tree.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Cloud {
    /// Name, from [`super::plan::Points::cloud`].
    pub name: String,
    /// Surfels in it.
    pub surfels: u64,
    /// Lvoxels in it.
    pub lvoxels: u64,
    /// Bytes of the tree's file.
    pub tree_bytes: u64,
    /// Bytes of the lvoxels in it.
    pub lvoxel_bytes: u64,
    /// Time of baking.
    pub bake: Timing,
    /// Time of building.
    pub build: Timing,
}

/// A time, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Timing {
    /// By the clock.
    pub wall_secs: f64,
    /// Of all threads together.
    pub cpu_secs: f64,
}

/// Differences from the reference; none where a metric has no value.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Errors {
    /// Mean of `(x-r)^2 / (r^2 + 0.01)`.
    pub relmse: Option<f64>,
    /// The same without the worst 0.1 % of pixels.
    pub relmse_trimmed: Option<f64>,
    /// Mean LDR-FLIP.
    pub flip: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// Fraction of pixels that a viewer can tell apart.
    pub pdiff: Option<f64>,
    /// Mean over that of the reference, less 1.
    pub bias: Option<f64>,
}

/// A run, timed once or more.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Run {
    /// Name of the variant.
    pub name: String,
    /// `monte carlo`, `traditional` or `extended`.
    pub method: String,
    /// The setting that is varied; `base` for none.
    pub sweep: String,
    /// All settings that any run varies, by name.
    pub values: BTreeMap<String, f64>,
    /// Name of the cloud, if it needs one.
    pub cloud: Option<String>,
    /// Time of rendering, loading, baking and building excluded, once for each round.
    pub rounds: Vec<Timing>,
    /// What came out; the same in every round.
    pub errors: Errors,
}

/// What the numbers say.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Findings {
    /// Error goes as the setting to this power, by least squares on logarithms.
    pub slopes: Vec<Slope>,
    /// Names of runs, fastest first.
    pub pareto: Vec<String>,
}

/// How fast the error falls along a sweep.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Slope {
    /// Method.
    pub method: String,
    /// Setting.
    pub sweep: String,
    /// Exponent of relMSE over the setting.
    pub exponent: f64,
    /// Runs that were used.
    pub runs: usize,
}

impl Run {
    /// Median over the rounds.
    #[must_use]
    pub fn time(&self) -> Timing {
        let median = |pick: fn(&Timing) -> f64| {
            let mut secs: Vec<f64> = self.rounds.iter().map(pick).collect();
            secs.sort_by(f64::total_cmp);
            match secs.len() {
                0 => 0.0,
                n if n % 2 == 1 => secs[n / 2],
                n => 0.5 * (secs[n / 2 - 1] + secs[n / 2]),
            }
        };
        Timing {
            wall_secs: median(|t| t.wall_secs),
            cpu_secs: median(|t| t.cpu_secs),
        }
    }
}

impl Study {
    /// The cloud of a run.
    #[must_use]
    pub fn cloud_of(&self, run: &Run) -> Option<&Cloud> {
        let name = run.cloud.as_ref()?;
        self.clouds.iter().find(|c| c.name == *name)
    }

    /// CPU seconds of a run with all that had to be done before: baking and building too.
    #[must_use]
    pub fn total_secs(&self, run: &Run) -> f64 {
        let before = self
            .cloud_of(run)
            .map_or(0.0, |c| c.bake.cpu_secs + c.build.cpu_secs);
        run.time().cpu_secs + before
    }

    /// CPU seconds that Monte Carlo would need for an error, by a line through its runs in logarithms.
    #[must_use]
    pub fn monte_carlo_secs(&self, relmse: f64) -> Option<f64> {
        let points: Vec<(f64, f64)> = self
            .runs
            .iter()
            .filter(|r| r.method == "monte carlo")
            .filter_map(|r| Some((r.errors.relmse?, r.time().cpu_secs)))
            .collect();
        let (exponent, offset) = fit(&points)?;
        Some((offset + exponent * relmse.ln()).exp())
    }

    /// Works out the findings anew.
    pub fn find(&mut self) {
        let mut slopes = Vec::new();
        for method in ["monte carlo", "traditional", "extended"] {
            let of_method: Vec<&Run> = self.runs.iter().filter(|r| r.method == method).collect();
            let mut sweeps: Vec<&str> = of_method.iter().map(|r| r.sweep.as_str()).collect();
            sweeps.retain(|s| *s != "base");
            sweeps.sort_unstable();
            sweeps.dedup();
            for sweep in sweeps {
                let points: Vec<(f64, f64)> = of_method
                    .iter()
                    .filter(|r| r.sweep == sweep || r.sweep == "base")
                    .filter_map(|r| Some((*r.values.get(sweep)?, r.errors.relmse?)))
                    .collect();
                if let Some((exponent, _)) = fit(&points) {
                    slopes.push(Slope {
                        method: method.into(),
                        sweep: sweep.into(),
                        exponent,
                        runs: points.len(),
                    });
                }
            }
        }
        let mut order: Vec<(f64, f64, &str)> = self
            .runs
            .iter()
            .filter_map(|r| Some((r.time().cpu_secs, r.errors.relmse?, r.name.as_str())))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut least = f64::INFINITY;
        let mut pareto = Vec::new();
        for (_, error, name) in order {
            if error < least {
                least = error;
                pareto.push(name.to_owned());
            }
        }
        self.findings = Findings { slopes, pareto };
    }

    /// What an earlier study of the same key has measured; `None` if there is none.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the file is damaged or belongs to another scene or other settings.
    pub fn read(path: &Path, key: &str) -> Result<Option<Self>> {
        let bytes = match std::fs::read(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(|e| Error::io("read", path, &e))?,
        };
        let refused = |what: String| {
            Error::input(format!("{} {what}", path.display()))
                .hint("choose another folder, or begin anew with --force")
        };
        let study: Self = serde_json::from_slice(&bytes)
            .map_err(|e| refused(format!("is no study of this version: {e}")))?;
        if study.key == key {
            Ok(Some(study))
        } else {
            Err(refused(
                "belongs to another scene, version or settings".into(),
            ))
        }
    }

    /// Writes `study.json`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut json = serde_json::to_vec_pretty(self)
            .map_err(|e| Error::failed(format!("cannot encode the study: {e}")))?;
        json.push(b'\n');
        Output::write_all_to(path, &json)
    }
}

/// Exponent and offset of the line through points in logarithms; `None` for fewer than two.
fn fit(points: &[(f64, f64)]) -> Option<(f64, f64)> {
    let logs: Vec<(f64, f64)> = points
        .iter()
        .filter(|(x, y)| *x > 0.0 && *y > 0.0)
        .map(|(x, y)| (x.ln(), y.ln()))
        .collect();
    let n = logs.len() as f64;
    let mean_x = logs.iter().map(|p| p.0).sum::<f64>() / n;
    let mean_y = logs.iter().map(|p| p.1).sum::<f64>() / n;
    let xx: f64 = logs.iter().map(|p| (p.0 - mean_x).powi(2)).sum();
    let xy: f64 = logs.iter().map(|p| (p.0 - mean_x) * (p.1 - mean_y)).sum();
    (logs.len() >= 2 && xx > 0.0).then(|| (xy / xx, mean_y - xy / xx * mean_x))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(method: &str, sweep: &str, value: f64, secs: f64, relmse: f64) -> Run {
        let round = |f: f64| Timing {
            wall_secs: secs * f,
            cpu_secs: secs * f,
        };
        Run {
            name: format!("{method}-{value}"),
            method: method.into(),
            sweep: sweep.into(),
            values: [(sweep.to_owned(), value)].into(),
            rounds: vec![round(9.0), round(1.0), round(0.5)],
            errors: Errors {
                relmse: Some(relmse),
                ..Errors::default()
            },
            ..Run::default()
        }
    }

    #[test]
    fn slopes_equal_error_times_and_the_front_are_right() {
        let mut study = Study {
            runs: vec![
                run("monte carlo", "spp", 1.0, 1.0, 1.0),
                run("monte carlo", "spp", 4.0, 4.0, 0.25),
                run("monte carlo", "spp", 16.0, 16.0, 0.0625),
                run("extended", "base", 0.0, 2.0, 0.01),
            ],
            ..Study::default()
        };
        study.find();
        let slope = &study.findings.slopes[0];
        assert!((slope.exponent + 1.0).abs() < 1e-9 && slope.runs == 3);
        assert_eq!(study.findings.slopes.len(), 1);
        assert!((study.monte_carlo_secs(0.01).unwrap() - 100.0).abs() < 1e-6);
        assert_eq!(study.findings.pareto, ["monte carlo-1", "extended-0"]);
        assert_eq!(study.runs[3].time().cpu_secs, 2.0);
    }

    #[test]
    fn studies_survive_a_round_trip_and_do_not_mix() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("study.json");
        assert!(Study::read(&path, "k").unwrap().is_none());
        let mut study = Study {
            key: "k".into(),
            runs: vec![run("extended", "base", 0.0, 2.0, 0.01)],
            ..Study::default()
        };
        study.find();
        study.write(&path).unwrap();
        assert_eq!(Study::read(&path, "k").unwrap(), Some(study));
        assert!(Study::read(&path, "other").is_err());
        std::fs::write(&path, "{").unwrap();
        assert!(
            Study::read(&path, "k")
                .unwrap_err()
                .hint_text()
                .unwrap()
                .contains("--force")
        );
    }
}
