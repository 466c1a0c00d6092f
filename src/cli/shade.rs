//! `lvox shade`

use super::files::Files;
use super::options::{Context, Memory, Seed};
use super::output;
use super::scene_input::SceneInput;
use super::shade_options::ShadeOptions;
use crate::Result;
use crate::run::Job;
use crate::scene::Scene;
use crate::tree::OpenTree;
use std::path::{Path, PathBuf};

/// Shade an image, or a tile of it, from a scene and its tree
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Gather indirect light from this tree [default: that of a packed scene]
    #[arg(short, long, value_name = "FILE")]
    tree: Option<PathBuf>,

    /// Take light inside media from this file of `lvox scatter`, which was made from the tree
    /// [default: that of a packed scene, without --tree]
    #[arg(long, value_name = "FILE")]
    scatter: Option<PathBuf>,

    #[command(flatten)]
    shade: ShadeOptions,

    /// Keep the light of surfaces in this file, and take from it what other frames and tiles of the
    /// same scene, tree and quality have put there, also while they run. Pictures are the same
    /// without; on one machine many tiles together are then little slower than their frame
    #[arg(long, value_name = "FILE")]
    pub radiance_cache: Option<PathBuf>,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    seed: Seed,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let files = self.scene.files();
        let files = match &self.tree {
            Some(tree) => files.reads("tree", tree),
            None => files,
        };
        self.shade.files(match &self.scatter {
            Some(scatter) => files.reads("--scatter", scatter),
            None => files,
        })
    }

    pub fn run(self, context: &Context) -> Result<()> {
        self.shade.check()?;
        let job = &context.job;
        let tree = self.scene.tree(self.tree.as_ref())?;
        let mut store = OpenTree::open(&tree, job.memory_limit)?;
        let loaded = self.scene.load(context)?;
        let packed = || {
            let is_own = self.tree.is_none();
            is_own.then(|| self.scene.packed_light(&loaded)).flatten()
        };
        let light = self.scatter.clone().or_else(packed);
        if let Some(light) = &light {
            store = store.with_scatter(light)?;
        }
        let scene = loaded.in_frame(store.world_from_scene())?;
        let others = self.shade.check_with(&scene, store.least_bytes(), job)?;
        store = store.beside(others)?;
        let cloud = &store.tree().meta().cloud;
        warn_if_out_of_date(&scene, (&cloud.scene_hash, &cloud.settings), &tree, job);
        if let Some((scatter, path)) = store.scatter.as_ref().zip(light.as_ref()) {
            let meta = scatter.meta();
            warn_if_out_of_date(&scene, (&meta.scene_hash, &meta.settings), path, job);
        }
        context.job.heed_warnings()?;
        self.shade
            .run(&scene, &store, self.seed.seed, &context.job)?;
        output::say_times(&context.job, "shade", &["pilot"]);
        Ok(())
    }
}

/// Warns of a file that was made from another scene, of which it has the hash and, among its
/// settings, digests of the parts.
pub fn warn_if_out_of_date(
    scene: &Scene,
    origin: (&[u8; 32], &[(String, String)]),
    path: &Path,
    job: &Job,
) {
    if let Some(warning) = out_of_date(scene, origin) {
        job.progress.warn(&format!("{}: {warning}", path.display()));
    }
}

fn out_of_date(
    scene: &Scene,
    (hash, settings): (&[u8; 32], &[(String, String)]),
) -> Option<String> {
    if *hash == scene.hash {
        return None;
    }
    let Some(parts) = scene.parts_that_differ(settings) else {
        return Some(
            "baked from another version of the scene's files; unless only cameras and film have changed, its indirect \
             light is out of date"
                .into(),
        );
    };
    let (last, rest) = parts.split_last()?;
    let other = match rest {
        [] => last.clone(),
        _ => format!("{} and {last}", rest.join(", ")),
    };
    Some(format!(
        "baked from a scene of other {other}; its indirect light is not that of this scene. Bake and build it again"
    ))
}
