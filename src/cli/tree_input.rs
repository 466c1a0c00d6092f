//! The scene that a verb works on, and the tree that was made of it.

use super::files::Files;
use super::options::Context;
use super::out_of_date::warn_if_out_of_date;
use super::scene_input::SceneInput;
use crate::Result;
use crate::scene::Scene;
use crate::tree::OpenTree;
use std::path::PathBuf;

/// A scene, and the file of its tree.
#[derive(Debug, clap::Args)]
pub struct TreeInput {
    #[command(flatten)]
    scene: SceneInput,

    /// Gather indirect light from this tree [default: that of a packed scene]
    #[arg(short, long, value_name = "FILE")]
    tree: Option<PathBuf>,
}

impl TreeInput {
    /// What it reads; the files that the scene names are known once it is loaded.
    pub fn files(&self) -> Files {
        let files = self.scene.files();
        match &self.tree {
            Some(tree) => files.reads("tree", tree),
            None => files,
        }
    }

    /// Opens the tree and loads the scene in its frame, and warns if that was baked from another
    /// scene; says which file the tree is in, too.
    ///
    /// # Errors
    /// As [`SceneInput::load`], [`OpenTree::open`] and [`Scene::in_frame`], and without a tree.
    pub fn open(&self, context: &Context) -> Result<(Scene, OpenTree, PathBuf)> {
        let path = self.scene.tree(self.tree.as_ref())?;
        let store = OpenTree::open(&path, context.job.memory_limit)?;
        let scene = self.scene.load(context)?;
        let scene = scene.in_frame(store.world_from_scene())?;
        let cloud = &store.tree().meta().cloud;
        let origin = (&cloud.scene_hash, &cloud.settings[..]);
        warn_if_out_of_date(&scene, origin, &path, &context.job);
        Ok((scene, store, path))
    }

    /// The file of a packed scene that holds scattered light made of its own tree, if no other tree
    /// was named.
    pub fn packed_light(&self, scene: &Scene) -> Option<PathBuf> {
        match self.tree {
            None => self.scene.packed_light(scene),
            Some(_) => None,
        }
    }
}
