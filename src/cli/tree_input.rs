//! The scene that a verb works on, and the tree that was made of it.

use super::files::Files;
use super::kept::KeptTree;
use super::options::Context;
use super::out_of_date::warn_if_out_of_date;
use super::scene_input::SceneInput;
use crate::Result;
use crate::scene::Scene;
use crate::tree::OpenTree;
use std::path::{Path, PathBuf};

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
    /// As [`SceneInput::load`], [`OpenTree::open`] and [`Scene::in_frame`], without a tree, and
    /// with that of another scene where it has to be the same.
    pub fn open(&self, context: &Context) -> Result<(Scene, OpenTree, PathBuf)> {
        let path = self.scene.tree(self.tree.as_ref(), context.frame)?;
        if let Some((scene, store)) = self.take_kept(&path, context)? {
            return Ok((scene, store, path));
        }
        let store = OpenTree::open(&path, context.job.memory_limit)?;
        let scene = self.scene.load(context)?;
        let scene = scene.in_frame(store.world_from_scene())?;
        let cloud = &store.tree().meta().cloud;
        let origin = (&cloud.scene_hash, &cloud.settings[..]);
        warn_if_out_of_date(&scene, origin, &path, context)?;
        Ok((scene, store, path))
    }

    /// Scene and tree as the frame before has left them, if they are the same in this one. Within a
    /// memory limit a tree is opened anew: what its cache may take depends on the frame.
    fn take_kept(&self, path: &Path, context: &Context) -> Result<Option<(Scene, OpenTree)>> {
        let mut kept = context.kept.borrow_mut();
        let is_same = |tree: &KeptTree| tree.path == path;
        let tree = kept.take_tree().filter(is_same);
        let Some(tree) = tree.filter(|_| context.job.memory_limit.is_none()) else {
            return Ok(None);
        };
        let scene = kept.take_scene(&self.scene.how(), context.frame)?;
        Ok(scene.map(|scene| (scene, tree.store)))
    }

    /// Leaves scene and tree to the next frame.
    pub fn leave(&self, scene: Scene, store: OpenTree, path: PathBuf, context: &Context) {
        self.scene.leave(scene, context);
        if context.frame.is_some() {
            let tree = KeptTree::new(path, store, None);
            context.kept.borrow_mut().leave_tree(tree);
        }
    }

    /// The file of a packed scene that holds scattered light made of its own tree, if no other tree
    /// was named.
    pub fn packed_light(&self, scene: &Scene) -> Option<PathBuf> {
        match self.tree {
            None => scene.packed_light().map(Into::into),
            Some(_) => None,
        }
    }
}
