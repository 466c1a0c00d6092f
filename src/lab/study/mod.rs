//! Error against run time: Monte Carlo and both point-based methods on one scene, over sweeps of
//! their settings.
//!
//! Every run is timed in rounds in which the methods take turns, and compared with one converged
//! image. What is measured is kept after each run, so a stop loses no more than one, and the same
//! call goes on from there. On another machine or with another number of threads it takes all times
//! anew, and keeps the others apart.
//!
//! | file | what it does |
//! | --- | --- |
//! | `method`, `sweep` | the ways to render, and the settings that are varied |
//! | `plan` | all runs of a study, from its settings |
//! | `rounds`, `measure` | the runs in turn; one of them: bake, build, shade, compare |
//! | `target` | what they are compared with |
//! | `record` | what was measured, and the file that keeps it |
//! | `findings` | slopes, speed-ups, the Pareto front |
//! | `others`, `peers` | images that a user names; tables of points of other renderers |
//! | `table`, `plots`, `html` | the same as text, curves and a report |
//! | `chart` | how curves are drawn |

mod chart;
pub mod findings;
mod html;
mod measure;
mod method;
pub mod others;
mod peers;
pub mod plan;
mod plots;
pub mod record;
mod rounds;
mod sweep;
mod table;
mod target;

pub use method::Method;
pub use plan::Settings;
pub use record::Study;
pub use sweep::Sweep;

use crate::bake;
use crate::image::Region;
use crate::image::subject::SHADED_SEGMENTS;
use crate::lab::reference::{self, Start};
use crate::run::{Job, Output, digest, hex};
use crate::scene::Scene;
use crate::{Error, Kind, Result};
use html::Shown;
use measure::Bench;
use plan::How;
use record::{Machine, Peer, Run};
use rounds::measure_all;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use target::{Others, Target, exposure};

/// Runs a study into a folder: `study.json`, `study.csv`, `table.md`, plots, images, and
/// `report.html` with all of them. Runs that are there are kept: a call with more rounds or with
/// more values of a sweep adds to them. [`Start::Afresh`] replaces them.
///
/// # Errors
/// Settings that make no sense, a folder of another study or build of the program, whatever
/// rendering and writing can give, or a stop on request; after that the reports hold what is
/// finished.
pub fn run(
    scene: &Scene,
    settings: &Settings,
    folder: &Path,
    start: Start,
    job: &Job,
) -> Result<Study> {
    settings.check()?;
    scene.camera(settings.camera.as_deref())?;
    if settings.max_depth != SHADED_SEGMENTS {
        job.progress.warn(&format!(
            "point-based methods compute direct light and one bounce, which is `max_depth` \
             {SHADED_SEGMENTS}: with `max_depth` {} their errors are those of other transport too",
            settings.max_depth
        ));
    }
    let origin = origin(scene, settings)?;
    let variants = settings.variants(has_media(scene));
    // What is wrong with a reference shows before the folder belongs to it.
    let given = settings.reference.as_ref();
    let given = given
        .map(|path| Target::read(path, scene, settings, job))
        .transpose()?;
    let tables = settings.peer_tables.iter();
    let told: Vec<Vec<Peer>> = tables
        .map(|path| peers::read(path))
        .collect::<Result<_>>()?;
    let others = Others::read(scene, settings, given)?;
    job.heed_warnings()?;
    let files = Files::new(folder)?;
    let found = match Study::read(&files.json(), &origin) {
        Ok(found) => found.filter(|_| start == Start::Resume),
        Err(_) if start == Start::Afresh => None,
        Err(e) => return Err(e),
    };
    if start == Start::Afresh {
        files.clear()?;
    }
    let mut study = found.unwrap_or_else(|| Study {
        version: env!("CARGO_PKG_VERSION").into(),
        origin,
        scene: scene.name.clone(),
        film: [scene.film.width, scene.film.height],
        has_media: has_media(scene),
        machine: machine(),
        ..Study::default()
    });
    study.check(&variants, settings, &files.json())?;
    study.settings = serde_json::to_value(settings).unwrap_or_default();
    if study.go_on_with(machine()) {
        let threads = study.machine.threads;
        job.progress.say(&format!(
            "times taken with another number of threads or on another machine are kept apart from \
             those with {threads}"
        ));
    }
    study.peers = told.concat();
    study.write(&files.json())?;
    let bench = Bench::new(scene, settings, files.trees(), job);
    let result = measure_all(&mut study, &variants, others, &bench, &files, start, job);
    match result {
        Err(e) if e.kind() != Kind::Cancelled => return Err(e),
        _ => {
            study.arrange(&variants);
            study.find();
        }
    }
    study.write(&files.json())?;
    if !study.runs.is_empty() {
        write_reports(&study, &files)?;
    }
    result.map(|()| study).map_err(|e| {
        e.hint("what is finished is kept in the folder; the same command goes on from there")
    })
}

/// What a study of a scene has to do, each with the unit that its name says.
#[must_use]
pub fn work(scene: &Scene, settings: &Settings) -> Vec<(&'static str, u64)> {
    let variants = settings.variants(has_media(scene));
    let clouds = variants.iter().filter_map(|v| match &v.how {
        How::Points(points) => Some(points.cloud()),
        How::MonteCarlo { .. } => None,
    });
    let clouds = clouds.collect::<BTreeSet<_>>().len() as u64;
    let (runs, seeds) = (variants.len() as u64, u64::from(settings.seeds));
    let pixels = u64::from(scene.film.width) * u64::from(scene.film.height);
    let paths = match settings.reference {
        Some(_) => 0,
        None => pixels * u64::from(settings.reference_spp),
    };
    vec![
        ("pixels", pixels),
        ("paths", paths),
        ("clouds", clouds * (u64::from(settings.rounds) + seeds - 1)),
        ("runs", runs * (u64::from(settings.rounds) + seeds - 1)),
    ]
}

/// Bytes that a study holds at least: those of its reference or of the largest of its bakes.
///
/// # Errors
/// More than the memory limit.
pub fn check_memory(scene: &Scene, settings: &Settings, job: &Job) -> Result<u64> {
    let traced = reference::Settings {
        camera: settings.camera.clone(),
        ..reference::Settings::default()
    };
    let region = Region::full(scene.film.width, scene.film.height);
    let mut most = reference::check_memory(scene, &traced, region, job)?;
    for variant in settings.variants(has_media(scene)) {
        if let How::Points(points) = variant.how {
            most = most.max(bake::check_memory(scene, &points.bake(settings.seed), job)?);
        }
    }
    Ok(most)
}

/// The files that [`run`] writes into a folder under names that do not depend on settings; the
/// reference if it renders it.
#[must_use]
pub fn written(folder: &Path, renders_reference: bool) -> Vec<PathBuf> {
    let reference = renders_reference.then_some(REFERENCE);
    let names = [STUDY, CSV, TABLE, REPORT].into_iter().chain(reference);
    names.map(|name| folder.join(name)).collect()
}

const STUDY: &str = "study.json";
const CSV: &str = "study.csv";
const TABLE: &str = "table.md";
const REPORT: &str = "report.html";
const REFERENCE: &str = "reference.exr";

/// Names in the folder of a study.
struct Files(PathBuf);

impl Files {
    fn new(folder: &Path) -> Result<Self> {
        let files = Self(folder.to_path_buf());
        for dir in [files.images(), files.trees()] {
            fs::create_dir_all(&dir).map_err(|e| Error::io("create", &dir, &e))?;
        }
        Ok(files)
    }

    /// Removes what an earlier study has left, its reference and the reports that are written anew
    /// excepted; nothing in a folder without a study.
    fn clear(&self) -> Result<()> {
        if !self.json().is_file() {
            return Ok(());
        }
        let plots = plots::NAMES.map(|name| self.0.join(format!("{name}.svg")));
        let mut old: Vec<PathBuf> = plots.into_iter().filter(|p| p.is_file()).collect();
        for (dir, kinds) in [
            (self.images(), &["png"][..]),
            (self.trees(), &["lvt", "lvc", "lvs"]),
            (self.trees_of_seed(), &["lvt", "lvc", "lvs"]),
        ] {
            if !dir.is_dir() {
                continue;
            }
            let entries = fs::read_dir(&dir).map_err(|e| Error::io("read", &dir, &e))?;
            for entry in entries {
                let path = entry.map_err(|e| Error::io("read", &dir, &e))?.path();
                let is_own = |e: &std::ffi::OsStr| kinds.iter().any(|kind| e == *kind);
                if path.extension().is_some_and(is_own) && path.is_file() {
                    old.push(path);
                }
            }
        }
        for path in old {
            fs::remove_file(&path).map_err(|e| Error::io("remove", &path, &e))?;
        }
        Ok(())
    }

    fn json(&self) -> PathBuf {
        self.0.join(STUDY)
    }

    fn reference(&self) -> PathBuf {
        self.0.join(REFERENCE)
    }

    fn images(&self) -> PathBuf {
        self.0.join("images")
    }

    fn trees(&self) -> PathBuf {
        self.0.join("trees")
    }

    /// Trees of one further seed, while it is measured.
    fn trees_of_seed(&self) -> PathBuf {
        self.trees().join("of-a-seed")
    }

    fn image(&self, name: &str) -> PathBuf {
        self.images().join(format!("{name}.png"))
    }

    fn heat(&self, name: &str) -> PathBuf {
        self.images().join(format!("{name}.flip.png"))
    }
}

/// What all runs of a study have in common and depend on: the build of the program, the scene, its
/// film, the camera, and the reference: of one that was given its content, wherever it lies, and
/// the exposure that it is looked at with.
fn origin(scene: &Scene, settings: &Settings) -> Result<BTreeMap<String, String>> {
    let (reference, exposure) = match &settings.reference {
        Some(path) => {
            let mut content = blake3::Hasher::new();
            fs::File::open(path)
                .and_then(|file| content.update_reader(file).map(drop))
                .map_err(|e| Error::io("read", path, &e))?;
            let digest = content.finalize().to_hex().to_string();
            (digest, exposure(scene, path)?)
        }
        None => (
            format!(
                "{} samples per pixel, depth {}, seed {}",
                settings.reference_spp, settings.max_depth, settings.seed
            ),
            scene.film.exposure,
        ),
    };
    let camera = scene.camera(settings.camera.as_deref())?.name.clone();
    let mut parts = vec![
        ("build of lvox", hex(&digest::of_program())),
        ("scene", hex(&scene.hash)),
        (
            "film",
            format!("{}x{}", scene.film.width, scene.film.height),
        ),
        ("camera", camera),
        ("reference", reference),
        ("exposure", exposure.to_string()),
    ];
    if settings.scatter {
        parts.push(("light of media", "made beforehand".into()));
    }
    let named = parts
        .into_iter()
        .map(|(name, part)| (name.to_owned(), part));
    Ok(named.collect())
}

fn has_media(scene: &Scene) -> bool {
    !scene.volumes.is_empty()
}

fn machine() -> Machine {
    let processor = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let processor = processor
        .lines()
        .find(|l| l.starts_with("model name"))
        .and_then(|l| l.split_once(':'))
        .map_or("a processor of unknown name", |(_, name)| name.trim());
    Machine {
        system: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
        processor: processor.into(),
        threads: rayon::current_num_threads(),
    }
}

fn write_reports(study: &Study, files: &Files) -> Result<()> {
    let text = |name: &str, text: &str| Output::write_all_to(&files.0.join(name), text.as_bytes());
    text(CSV, &table::csv(study))?;
    text(TABLE, &table::markdown(study))?;
    let plots = plots::all(study)?;
    for plot in &plots {
        text(&format!("{}.svg", plot.name), &plot.svg)?;
    }
    let mut images = vec![Shown {
        caption: format!("reference: {}", study.reference.source),
        png: read(&files.image("reference"))?,
        heat: None,
    }];
    let mut chosen: Vec<&Run> = study.runs.iter().filter(|r| table::is_chief(r)).collect();
    chosen.sort_by_key(|r| r.sweep == Sweep::Spp);
    for run in chosen {
        let errors = [("relMSE", run.errors.relmse), ("FLIP", run.errors.flip)];
        let errors = errors.map(|(name, value)| {
            value.map_or(String::new(), |v| format!(", {name} {}", table::figure(v)))
        });
        images.push(Shown {
            caption: format!(
                "{}: {} s{}",
                run.name,
                table::figure(run.time().cpu_secs),
                errors.concat()
            ),
            png: read(&files.image(&run.name))?,
            heat: Some(read(&files.heat(&run.name))?),
        });
    }
    text(REPORT, &html::report(study, &plots, &images))
}

fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|e| Error::io("read", path, &e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Serialize;
    use serde::de::DeserializeOwned;
    use std::fmt::{Debug, Display};

    /// Holds values to the names that files and reports have for them.
    #[track_caller]
    pub(super) fn assert_names<T, const N: usize>(names: [(T, &str); N])
    where
        T: Debug + Display + PartialEq + Serialize + DeserializeOwned,
    {
        for (value, name) in names {
            let json = serde_json::to_value(&value).unwrap();
            assert_eq!(json, name);
            assert_eq!(format!("{value:>20}"), format!("{name:>20}"));
            assert_eq!(serde_json::from_value::<T>(json).unwrap(), value);
        }
    }

    #[test]
    fn the_origin_knows_a_reference_by_content_and_exposure() {
        let dir = tempfile::tempdir().unwrap();
        let mut scene = Scene::without_picture();
        let of = |scene: &Scene, name: &str| {
            let settings = Settings {
                reference: Some(dir.path().join(name)),
                ..Settings::default()
            };
            origin(scene, &settings)
        };
        let put = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
        assert!(of(&scene, "a.exr").is_err());
        put("a.exr", "one");
        put("b.exr", "one");
        let one = of(&scene, "a.exr").unwrap();
        assert_eq!(of(&scene, "b.exr").unwrap(), one);
        put("a.exr", "two");
        assert_ne!(of(&scene, "a.exr").unwrap(), one);
        put("b.json", r#"{"scene": "s.json"}"#);
        put("s.json", r#"{"tonemap": {"exposure": 2.5}}"#);
        assert_ne!(of(&scene, "b.exr").unwrap(), one);
        scene.film.exposure = 3.0;
        put("a.exr", "one");
        assert_ne!(of(&scene, "a.exr").unwrap(), one);
        assert_ne!(origin(&scene, &Settings::default()).unwrap(), one);
    }

    #[test]
    fn the_first_camera_is_the_same_by_name() {
        let mut scene = Scene::without_picture();
        scene.cameras[0].name = "front".into();
        let of = |camera: Option<&str>| {
            let settings = Settings {
                camera: camera.map(Into::into),
                ..Settings::default()
            };
            origin(&scene, &settings)
        };
        assert_eq!(of(None).unwrap(), of(Some("front")).unwrap());
        assert!(of(Some("back")).is_err());
    }
}
