//! `lvox shade`

use super::options::{Context, Files, Memory, Seed};
use super::output;
use super::scene_input::SceneInput;
use super::shade_options::ShadeOptions;
use lvox::Result;
use lvox::gather::TreeStore;
use lvox::scene::Scene;
use std::path::PathBuf;

/// Shade an image, or a tile of it, from a scene and its tree
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    scene: SceneInput,

    /// Gather indirect light from this tree
    #[arg(short, long, value_name = "FILE")]
    tree: PathBuf,

    #[command(flatten)]
    shade: ShadeOptions,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    seed: Seed,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        self.shade
            .files(self.scene.files().reads("tree", &self.tree))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        self.shade.check()?;
        let store = TreeStore::open(&self.tree, context.job.memory_limit)?;
        let frame = store.tree().meta().cloud.world_from_scene;
        let scene = self.scene.load(context)?.in_frame(frame.into())?;
        self.shade.check_with(&scene, &context.job)?;
        if let Some(warning) = out_of_date(&scene, &store) {
            let place = self.tree.display();
            context.job.progress.warn(&format!("{place}: {warning}"));
        }
        context.job.heed_warnings()?;
        self.shade
            .run(&scene, &store, self.seed.seed, &context.job)?;
        output::say_times(&context.job, "shade", &["pilot"]);
        Ok(())
    }
}

/// What to say of a tree that was baked from another scene.
fn out_of_date(scene: &Scene, store: &TreeStore) -> Option<String> {
    let cloud = &store.tree().meta().cloud;
    if cloud.scene_hash == scene.hash {
        return None;
    }
    let Some(parts) = scene.parts_that_differ(&cloud.settings) else {
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
