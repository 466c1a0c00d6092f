//! tree + points → light at each of them; surfels that others baked → cloud.
//!
//! A [`PointFile`], an open tree, [`Settings`] and, if it is at hand, the scene whose triangles end
//! rays enter; a file with one row for each point leaves. No camera takes part.
//!
//! | file | what it does |
//! | --- | --- |
//! | `file` | what is in a file of points: PLY, `.npy` |
//! | `npy` | the header of `.npy` |
//! | `numbers` | numbers as files have them |
//! | `rows` | the rows of a file, some at a time |
//! | `receivers` | points as they gather |
//! | `gathers` | the gathers themselves, in an order that keeps memory near |
//! | `write` | results, row by row |
//! | `import` | surfels of other programs, as a cloud |
//! | `settings` | what is gathered, and how |
//!
//! What a point gets depends on its position, its normal, the tree and the settings alone, so that
//! threads, memory limits, parts and the order of points change no bit of it.

mod file;
mod gathers;
mod import;
mod npy;
mod numbers;
mod receivers;
mod rows;
mod settings;
mod write;

pub use file::PointFile;
pub use import::{ImportSettings, import};
pub use settings::{Over, Settings};

use crate::Result;
use crate::formats::Overwrite;
use crate::gather::{self, PatchRadiance};
use crate::run::{Budget, Job};
use crate::scene::Scene;
use crate::trace::Tracer;
use crate::tree::OpenTree;
use gathers::Gathers;
use receivers::Receivers;
use std::path::Path;
use write::{Results, Writer};

/// Bytes that some points and what is around them take while they gather.
const CHUNK_BYTES: u64 = 8 << 20;
/// Bytes of rays and patches that are found before they are evaluated.
const RAY_BYTES: u64 = 8 << 20;
/// Most points that gather before they are written.
const MAX_CHUNK: usize = 1 << 17;
/// Rays for whose patches there is room.
const PATCH_RAYS: usize = 4_000_000;

/// What became of the points of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Summary {
    /// Points that were gathered at.
    pub points: u64,
    /// Numbers of each, by column.
    pub columns: Vec<String>,
}

/// Refuses, before anything is opened, what cannot be gathered.
///
/// # Errors
/// Settings that make no sense, an output of another kind, a hemisphere of points without normals,
/// and points that have a number of the name of a result.
pub fn check(points: &PointFile, output: &Path, settings: &Settings) -> Result<()> {
    settings.check()?;
    Results::of(points, output, settings).map(drop)
}

/// Refuses a gather that would take more than the job's limit whatever the caches of the tree do.
/// Returns the bytes that it holds beside the tree, for [`OpenTree::beside`].
///
/// # Errors
/// [`crate::Kind::Input`] with both sizes.
pub fn check_memory(scene: Option<&Scene>, least_of_tree: u64, job: &Job) -> Result<u64> {
    let budget = budget(scene, job);
    let with_tree = budget.clone().with("the tree", least_of_tree);
    with_tree.within("gathering", job.memory_limit, "raise `memory_limit`")?;
    Ok(budget.bytes())
}

fn budget(scene: Option<&Scene>, job: &Job) -> Budget {
    let budget = match scene {
        None => Budget::default().with("the program and its threads", job.process_bytes),
        Some(scene) => scene.budget(scene.bytes_of_grids(), job),
    };
    let budget = budget.with("points", CHUNK_BYTES + RAY_BYTES);
    match scene {
        None => budget,
        Some(scene) => budget
            .with("what rays need of it", Tracer::bytes_for(scene))
            .with(
                "light of surfaces",
                PatchRadiance::bytes_for(scene.mesh.triangles.len(), PATCH_RAYS),
            ),
    }
}

/// Gathers at the points of a file and writes what arrives: irradiance, or mean radiance, without
/// what comes straight from lights and from the environment. With a scene, which is in the tree's
/// frame ([`Scene::in_frame`]), its triangles end rays, else surfels and nodes do.
///
/// # Errors
/// What [`check`] refuses, a point whose position or normal is none, a page of the tree that cannot
/// be read, a file that cannot be written, or a stop on request; then no file is left.
pub fn run(
    tree: &OpenTree,
    scene: Option<&Scene>,
    points: &PointFile,
    output: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<Summary> {
    settings.check()?;
    let results = Results::of(points, output, settings)?;
    let receivers = Receivers::new(points, tree.world_from_scene(), settings.bias)?;
    let part = settings.part.of(points.count);
    let least = tree.needs_within_limit().least_bytes;
    job.hold(&budget(scene, job).with("the tree", least));
    job.watched_stage("gather", tree.fitter(job), |counts| {
        let gathers = Gathers {
            points,
            receivers: &receivers,
            part: part.clone(),
            settings,
            over: results.over,
            job,
        };
        gathers.check_points()?;
        let tracer = scene
            .map(|s| Tracer::new_until(s, &job.cancel))
            .transpose()?;
        let is_first = settings.part.index() == 0;
        let mut writer = Writer::create(&results, output, is_first, overwrite)?;
        let task = gathers.into_task(tree, tracer.as_ref(), &mut writer);
        let not_finite = gather::with_tree(tree, task)?;
        if let Some(scene) = scene {
            scene.check_file()?;
        }
        if not_finite > 0 {
            job.progress.warn(&format!(
                "{}: {not_finite} points got light that is infinite or not a number",
                output.display()
            ));
        }
        job.heed_warnings()?;
        writer.finish()?;
        let count = part.end - part.start;
        counts.insert("points".into(), count as f64);
        counts.insert("rays".into(), count as f64 * f64::from(settings.samples));
        Ok(Summary {
            points: count,
            columns: results.names.clone(),
        })
    })
}
