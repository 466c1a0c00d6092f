//! What one frame of a range leaves to the next: the scene, if its files are those of all frames,
//! and the open tree.

use crate::Result;
use crate::formats::TemporaryFolder;
use crate::scene::Scene;
use crate::tree::OpenTree;
use std::path::{Path, PathBuf};

/// What the last frame left.
#[derive(Debug, Default)]
pub struct Kept {
    /// By how it was read.
    scene: Option<(String, Scene)>,
    tree: Option<KeptTree>,
}

/// A tree that is open, and the folder that it is in if it was made for this run alone.
#[derive(Debug)]
pub struct KeptTree {
    /// Where the tree is.
    pub path: PathBuf,
    /// The tree itself.
    pub store: OpenTree,
    /// Removed with it.
    _folder: Option<TemporaryFolder>,
}

impl KeptTree {
    /// An open tree; a folder that it alone is in goes with it.
    pub fn new(path: PathBuf, store: OpenTree, folder: Option<TemporaryFolder>) -> Self {
        Self {
            path,
            store,
            _folder: folder,
        }
    }
}

impl Kept {
    /// Leaves a scene that was read so to the next frame, if that has the same.
    pub fn leave_scene(&mut self, how: String, scene: Scene) {
        if scene.files_of_frame.is_none() {
            self.scene = Some((how, scene));
        }
    }

    /// The scene that was left, at this frame, if it is one that was read so.
    ///
    /// # Errors
    /// As [`Scene::go_to_frame`].
    pub fn take_scene(&mut self, how: &str, frame: Option<i32>) -> Result<Option<Scene>> {
        let left = self.scene.take().filter(|(other, _)| other == how);
        let (Some((_, mut scene)), Some(frame)) = (left, frame) else {
            return Ok(None);
        };
        scene.go_to_frame(frame)?;
        Ok(Some(scene))
    }

    /// Leaves a tree to the next frame.
    pub fn leave_tree(&mut self, tree: KeptTree) {
        self.tree = Some(tree);
    }

    /// Whether the tree of this file was left.
    pub fn has_tree(&self, path: &Path) -> bool {
        self.tree.as_ref().is_some_and(|tree| tree.path == path)
    }

    /// The tree that was left.
    pub fn take_tree(&mut self) -> Option<KeptTree> {
        self.tree.take()
    }
}
