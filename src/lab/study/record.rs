//! What a study has measured, and the file that keeps it.

use super::method::Method;
use super::plan::{Settings, Variant};
use super::sweep::Sweep;
use crate::run::Output;
use crate::{Error, Result};
use std::collections::{BTreeMap, BTreeSet};
use std::mem;
use std::path::Path;

/// Everything measured so far; the file `study.json`.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Study {
    /// Version of lvox.
    pub version: String,
    /// What all runs have in common and none can be compared without, by words for it: build of the
    /// program, scene, film, camera, reference and exposure.
    pub origin: BTreeMap<String, String>,
    /// Name of the scene.
    pub scene: String,
    /// Pixels across and down.
    pub film: [u32; 2],
    /// Whether there are any media in it.
    pub has_media: bool,
    /// The machine that the times of `clouds` and `runs` are of.
    pub machine: Machine,
    /// The settings of the last call, as JSON.
    pub settings: serde_json::Value,
    /// The image that all are compared with.
    pub reference: Reference,
    /// Clouds, in order of need.
    pub clouds: Vec<Cloud>,
    /// Runs, in order of the plan; those of earlier calls that are not in it last.
    pub runs: Vec<Run>,
    /// What was timed on other machines, or with other numbers of threads.
    pub others: Vec<Timed>,
    /// What `runs` say.
    pub findings: Findings,
    /// Pictures of other renderers, those of the last call.
    #[serde(default)]
    pub peers: Vec<Peer>,
}

/// A picture of another renderer.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Peer {
    /// Name of the renderer, or of a way to use it: points of one name belong together.
    pub name: String,
    /// CPU seconds of all threads.
    pub cpu_secs: f64,
    /// What is known of its differences from the reference.
    pub errors: Errors,
    /// Name of the file that told it.
    pub source: String,
}

/// What the numbers say.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Findings {
    /// Error against each setting, by least squares on logarithms.
    pub slopes: Vec<Slope>,
    /// Names of the runs that no other beats in both time of rendering and relMSE, fastest first.
    pub pareto: Vec<String>,
    /// The point-based runs beside Monte Carlo.
    pub versus: Vec<Versus>,
}

/// How the error goes along a sweep. Nothing is subtracted: what other settings and the reference's
/// own noise add stays in, so the exponent flattens as the error comes near the floor.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Slope {
    /// How the runs render.
    pub method: Method,
    /// What is varied.
    pub setting: Sweep,
    /// Exponent of relMSE over the setting, by all runs of the sweep.
    pub exponent: f64,
    /// The same by the two coarsest alone, where the setting rules the error most.
    pub coarse_exponent: f64,
    /// Runs that were used.
    pub runs: usize,
    /// The setting where it is coarsest, and relMSE there.
    pub coarsest: [f64; 2],
    /// The setting where it is finest, and relMSE there.
    pub finest: [f64; 2],
    /// The least relMSE of the sweep.
    pub floor: f64,
}

/// A run beside Monte Carlo, by one metric.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Versus {
    /// Name of the run.
    pub run: String,
    /// Name of the metric.
    pub metric: String,
    /// CPU seconds in which Monte Carlo reaches the run's error; none if the run is nearer to the
    /// reference than the reference's own noise allows.
    pub equal_error_secs: Option<f64>,
    /// That over the run's own time of rendering: for all images after the first of a tree.
    pub speed_up: Option<f64>,
    /// That over the run's time with baking and building: for one image.
    pub total_speed_up: Option<f64>,
    /// The error that Monte Carlo reaches in the run's time of rendering.
    pub equal_time_error: Option<f64>,
    /// Whether the CPU seconds at equal error are outside those of the Monte Carlo runs.
    pub extrapolated: bool,
    /// Whether they are [`super::findings::FARTHEST`] times the longest such run, and no more is
    /// known than that they are at least that.
    pub capped: bool,
    /// Whether the run's time of rendering is outside those of the Monte Carlo runs.
    pub time_extrapolated: bool,
}

/// What was timed on one machine.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Timed {
    /// Where all of these times were taken.
    pub machine: Machine,
    /// Clouds, in order of need.
    pub clouds: Vec<Cloud>,
    /// Runs, in order of the plan.
    pub runs: Vec<Run>,
}

/// What it ran on; times of different ones do not mix.
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
    /// relMSE against the truth, if that is known.
    pub relmse: Option<f64>,
    /// How that is known.
    #[serde(default)]
    pub noise: NoiseSource,
    /// Factor on radiance for the perceptual metrics.
    pub exposure: f32,
}

/// What tells the noise of a reference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseSource {
    /// The variance in its file, if there is any.
    #[default]
    Variance,
    /// Another image of as many samples: half the relMSE between both.
    Image,
    /// The user.
    Given,
}

/// A cloud and its tree.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Cloud {
    /// Name, from [`super::plan::Points::cloud`].
    pub name: String,
    /// Surfels that were baked; about as many as asked for.
    pub surfels: u64,
    /// Radius of a disk of the mean area, clips left out, scene units.
    pub surfel_radius: f64,
    /// Lvoxels that were baked, of all volumes.
    pub lvoxels: u64,
    /// Bytes of the tree's file.
    pub tree_bytes: u64,
    /// Bytes of the lvoxels in it.
    pub lvoxel_bytes: u64,
    /// Time of baking, the median over the rounds.
    pub bake: Timing,
    /// Time of building, and of making light of media beforehand, the median over the rounds.
    pub build: Timing,
    /// Both, once for each round.
    pub rounds: Vec<Making>,
}

/// Times of a cloud and its tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Making {
    /// Time of baking.
    pub bake: Timing,
    /// Time of building, and of making light of media beforehand.
    pub build: Timing,
}

impl Cloud {
    /// Adds the times of a round.
    pub fn add(&mut self, making: Making) {
        self.rounds.push(making);
        self.bake = median(self.rounds.iter().map(|r| r.bake));
        self.build = median(self.rounds.iter().map(|r| r.build));
    }

    /// Bytes of the lvoxels over those of the tree without them, as the paper counts them.
    #[must_use]
    pub fn lvoxel_share(&self) -> f64 {
        let surfels = self.tree_bytes.saturating_sub(self.lvoxel_bytes);
        self.lvoxel_bytes as f64 / surfels.max(1) as f64
    }
}

/// A time, in seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Timing {
    /// Seconds by the clock.
    pub wall_secs: f64,
    /// Of all threads together.
    pub cpu_secs: f64,
}

impl std::ops::AddAssign for Timing {
    fn add_assign(&mut self, other: Self) {
        self.wall_secs += other.wall_secs;
        self.cpu_secs += other.cpu_secs;
    }
}

/// Differences from the reference; none where a metric has no value.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Errors {
    /// Mean of `(x-r)^2 / (r^2 + 0.01)`.
    pub relmse: Option<f64>,
    /// The same without the worst 0.1 % of pixels.
    pub relmse_trimmed: Option<f64>,
    /// Mean of LDR-FLIP over the pixels, 0 to 1.
    pub flip: Option<f64>,
    /// Structural similarity; 1 for equal images.
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
    /// Digest of all settings that it depends on, from [`super::plan::Variant::key`].
    pub key: String,
    /// How it renders.
    pub method: Method,
    /// The setting that is varied.
    pub sweep: Sweep,
    /// All settings that any run varies.
    pub values: BTreeMap<Sweep, f64>,
    /// Name of the cloud, if it needs one.
    pub cloud: Option<String>,
    /// Time of rendering, loading, baking and building excluded, once for each round.
    pub rounds: Vec<Timing>,
    /// Largest resident memory of the process while it rendered, the least of the rounds: the
    /// scene, the reference image and what the allocator keeps of earlier runs are in it. None
    /// where the system does not tell.
    pub peak_memory_bytes: Option<u64>,
    /// What came out; the same in every round.
    pub errors: Errors,
    /// What came out of further seeds, for which clouds were baked anew, too.
    #[serde(default)]
    pub seeds: BTreeMap<u64, Errors>,
}

/// relMSE over several seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverSeeds {
    /// The mean.
    pub mean: f64,
    /// The least.
    pub least: f64,
    /// The largest.
    pub most: f64,
    /// How many there are.
    pub seeds: usize,
}

impl Run {
    /// Median over the rounds.
    #[must_use]
    pub fn time(&self) -> Timing {
        median(self.rounds.iter().copied())
    }

    /// relMSE over its own and further seeds; `None` if it has no value for one.
    #[must_use]
    pub fn relmse_over_seeds(&self) -> Option<OverSeeds> {
        let all = std::iter::once(&self.errors).chain(self.seeds.values());
        let all: Vec<f64> = all.map(|e| e.relmse).collect::<Option<_>>()?;
        Some(OverSeeds {
            mean: all.iter().sum::<f64>() / all.len() as f64,
            least: all.iter().copied().fold(f64::INFINITY, f64::min),
            most: all.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            seeds: all.len(),
        })
    }

    /// Adds a round.
    pub fn add(&mut self, timing: Timing, peak_memory_bytes: Option<u64>) {
        self.rounds.push(timing);
        self.peak_memory_bytes = match (self.peak_memory_bytes, peak_memory_bytes) {
            (Some(a), Some(b)) => Some(a.min(b)),
            (a, b) => a.or(b),
        };
    }
}

/// Medians of both times apart.
fn median(timings: impl Iterator<Item = Timing> + Clone) -> Timing {
    let of = |pick: fn(&Timing) -> f64| {
        let mut secs: Vec<f64> = timings.clone().map(|t| pick(&t)).collect();
        secs.sort_by(f64::total_cmp);
        match secs.len() {
            0 => 0.0,
            n if n % 2 == 1 => secs[n / 2],
            n => 0.5 * (secs[n / 2 - 1] + secs[n / 2]),
        }
    };
    Timing {
        wall_secs: of(|t| t.wall_secs),
        cpu_secs: of(|t| t.cpu_secs),
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

    /// The noise of the reference as relMSE, if it is known and not zero.
    #[must_use]
    pub fn noise(&self) -> Option<f64> {
        (self.reference.relmse).filter(|v| v.is_finite() && *v > 0.0)
    }

    /// relMSE less the noise of the reference, and whether less than a tenth of that is left, which
    /// is then in its place: what is lost in noise is not known.
    #[must_use]
    pub fn less_noise(&self, relmse: f64) -> (f64, bool) {
        let Some(noise) = self.noise() else {
            return (relmse, false);
        };
        let (rest, least) = (relmse - noise, 0.1 * noise);
        match rest < least {
            true => (least, true),
            false => (rest, false),
        }
    }

    /// Puts what was timed on another machine, or with another number of threads, aside, and what
    /// was timed on this one before in its place. Whether anything was put aside.
    pub fn go_on_with(&mut self, machine: Machine) -> bool {
        if self.machine == machine {
            return false;
        }
        let at = self.others.iter().position(|o| o.machine == machine);
        let mut timed = at.map_or_else(Timed::default, |i| self.others.remove(i));
        timed.machine = machine;
        mem::swap(&mut self.machine, &mut timed.machine);
        mem::swap(&mut self.clouds, &mut timed.clouds);
        mem::swap(&mut self.runs, &mut timed.runs);
        let is_kept = !timed.clouds.is_empty() || !timed.runs.is_empty();
        if is_kept {
            self.others.push(timed);
        }
        is_kept
    }

    /// The errors of a run, wherever it was timed: images are the same on all machines, with any
    /// number of threads.
    #[must_use]
    pub fn errors_of(&self, name: &str) -> Option<Errors> {
        self.run_anywhere(name).map(|r| r.errors)
    }

    /// The same for further seeds of it.
    #[must_use]
    pub fn seeds_of(&self, name: &str) -> BTreeMap<u64, Errors> {
        self.run_anywhere(name)
            .map(|r| r.seeds.clone())
            .unwrap_or_default()
    }

    fn run_anywhere(&self, name: &str) -> Option<&Run> {
        let mut runs = self.others.iter().flat_map(|o| &o.runs).chain(&self.runs);
        runs.find(|r| r.name == name)
    }

    /// What an earlier study of the same origin has measured; `None` if there is none, or nothing
    /// in it.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the file is damaged or belongs to something else; the message says
    /// in what it differs.
    pub fn read(path: &Path, origin: &BTreeMap<String, String>) -> Result<Option<Self>> {
        let bytes = match std::fs::read(path) {
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            other => other.map_err(|e| Error::io("read", path, &e))?,
        };
        let refused = |what: String| {
            Error::input(format!("{} {what}", path.display()))
                .hint("choose another folder, or begin anew with `overwrite`")
        };
        let study: Self = serde_json::from_slice(&bytes)
            .map_err(|e| refused(format!("is no study of this version: {e}")))?;
        // One that has measured nothing binds nobody.
        if study.runs.is_empty() && study.others.is_empty() {
            return Ok(None);
        }
        let names = origin.keys().chain(study.origin.keys());
        let other: BTreeSet<&str> = names
            .filter(|name| origin.get(*name) != study.origin.get(*name))
            .map(String::as_str)
            .collect();
        if !other.is_empty() {
            let other: Vec<&str> = other.into_iter().collect();
            return Err(refused(format!("belongs to another {}", other.join(", "))));
        }
        Ok(Some(study))
    }

    /// Refuses runs of the same names and other settings: a folder has one base, which its sweeps
    /// vary.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] with the names.
    pub fn check(&self, variants: &[Variant], settings: &Settings, path: &Path) -> Result<()> {
        let other: Vec<&str> = variants
            .iter()
            .filter(|v| {
                let others = self.others.iter().flat_map(|o| &o.runs);
                let mut same_name = self.runs.iter().chain(others).filter(|r| r.name == v.name);
                same_name.any(|r| r.key != v.key(settings))
            })
            .map(|v| v.name.as_str())
            .collect();
        if other.is_empty() {
            return Ok(());
        }
        Err(Error::input(format!(
            "{} has runs of other settings: {}",
            path.display(),
            other.join(", ")
        ))
        .hint(
            "more `rounds` and more values of sweeps go into the same folder; for another base \
             (`quality`, `seed`, `max_depth`, the last of `surfels`, the first of `block_depth`) \
             choose another folder, or begin anew with `overwrite`",
        ))
    }

    /// Puts the runs in order of the plan, the others last.
    pub fn arrange(&mut self, variants: &[Variant]) {
        let place = |run: &Run| variants.iter().position(|v| v.name == run.name);
        self.runs
            .sort_by_key(|run| place(run).unwrap_or(variants.len()));
    }

    /// Writes `study.json`.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        Output::write_json_to(path, self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::hash;

    #[test]
    fn rounds_give_medians_and_the_least_peak() {
        let secs = |cpu_secs| Timing {
            cpu_secs,
            wall_secs: 1.0,
        };
        let mut cloud = Cloud {
            tree_bytes: 710,
            lvoxel_bytes: 31,
            ..Cloud::default()
        };
        for bake in [3.0, 9.0, 4.0] {
            cloud.add(Making {
                bake: secs(bake),
                build: secs(10.0 - bake),
            });
        }
        assert_eq!((cloud.bake.cpu_secs, cloud.build.cpu_secs), (4.0, 6.0));
        assert!((cloud.lvoxel_share() - 31.0 / 679.0).abs() < 1e-12);
        let mut run = Run::default();
        for (cpu, peak) in [(1.0, None), (2.0, Some(7)), (4.0, Some(5)), (8.0, Some(6))] {
            run.add(secs(cpu), peak);
        }
        assert_eq!(run.time().cpu_secs, 3.0);
        assert_eq!(run.peak_memory_bytes, Some(5));
    }

    #[test]
    fn times_of_other_machines_do_not_mix_and_are_not_lost() {
        let with = |threads| Machine {
            threads,
            ..Machine::default()
        };
        let run = |name: &str, relmse| Run {
            name: name.into(),
            rounds: vec![Timing::default()],
            errors: Errors {
                relmse: Some(relmse),
                ..Errors::default()
            },
            ..Run::default()
        };
        let mut study = Study {
            machine: with(2),
            ..Study::default()
        };
        // Nothing is measured yet.
        assert!(!study.go_on_with(with(1)) && study.others.is_empty());
        assert!(!study.go_on_with(with(2)));
        study.runs.push(run("a", 0.5));
        study.clouds.push(Cloud::default());
        let two = study.clone();
        assert!(!study.go_on_with(with(2)));
        assert_eq!(study, two);
        assert!(study.go_on_with(with(1)));
        assert!(study.runs.is_empty() && study.clouds.is_empty());
        assert_eq!(study.errors_of("a"), Some(two.runs[0].errors));
        assert_eq!(study.errors_of("b"), None);
        study.runs.push(run("a", 0.5));
        assert!(study.go_on_with(with(2)));
        assert_eq!((&study.runs, &study.clouds), (&two.runs, &two.clouds));
        assert_eq!(study.machine, with(2));
        assert_eq!(study.others.len(), 1);
    }

    #[test]
    fn studies_come_back_with_every_bit_and_do_not_mix() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("study.json");
        let origin = |scene: &str| BTreeMap::from([("scene".to_owned(), scene.to_owned())]);
        let read = |scene: &str| Study::read(&path, &origin(scene));
        assert!(read("k").unwrap().is_none());
        // Times as clocks give them: no short decimals.
        let secs = |i: u64| f64::from_bits(0x3ff0_0000_0000_0000 + hash(&[i]) % (1 << 54));
        let mut study = Study {
            origin: origin("k"),
            runs: vec![Run {
                name: "a".into(),
                rounds: (0..1000)
                    .map(|i| Timing {
                        wall_secs: secs(2 * i),
                        cpu_secs: secs(2 * i + 1),
                    })
                    .collect(),
                ..Run::default()
            }],
            ..Study::default()
        };
        study.find();
        study.write(&path).unwrap();
        assert_eq!(read("k").unwrap(), Some(study));
        let error = read("other").unwrap_err().to_string();
        assert!(error.contains("another scene"), "{error}");
        Study::default().write(&path).unwrap();
        assert_eq!(read("k").unwrap(), None);
        std::fs::write(&path, "{").unwrap();
        let error = read("k").unwrap_err();
        assert!(error.hint_text().unwrap().contains("`overwrite`"));
    }
}
