//! `lvox shade`

use super::options::{Context, Files, Memory, Seed};
use super::scene_input::SceneInput;
use super::shade_options::ShadeOptions;
use lvox::Result;
use lvox::gather::TreeStore;
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
        let scene = self.scene.load(context)?;
        self.shade.check_with(&scene)?;
        if store.tree().meta().cloud.scene_hash != scene.hash {
            context.job.progress.warn(&format!(
                "{}: baked from another version of the scene; its indirect light may be out of date",
                self.tree.display()
            ));
        }
        self.shade.run(&scene, &store, self.seed.seed, &context.job)
    }
}
