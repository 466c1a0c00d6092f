//! `lvox shade`

use super::options::Context;
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
}

impl Args {
    pub fn run(self, context: &Context) -> Result<()> {
        self.shade.check()?;
        let store = TreeStore::open(&self.tree, context.job.memory_limit)?;
        let frame = store.tree().meta().cloud.world_from_scene;
        let scene = self.scene.load(&context.job)?.in_frame(frame.into())?;
        self.shade.check_with(&scene)?;
        if store.tree().meta().cloud.scene_hash != scene.hash {
            context.job.progress.warn(&format!(
                "{}: baked from another version of the scene; its indirect light may be out of date",
                self.tree.display()
            ));
        }
        self.shade.run(&scene, &store, context.seed, &context.job)
    }
}
