//! One choice of compiled code for a whole frame: whether there are media, and whether those have
//! colour.

use super::{ColoredMedia, Medium, NoMedia};
use crate::tree::{Media, OpenTree, SurfelStore};

/// Work on an open tree that is compiled with media and without.
pub trait TreeTask {
    /// What the work makes.
    type Output;

    /// Does the work.
    fn run<M: Medium>(self, pages: &SurfelStore, media: M) -> Self::Output;
}

/// Does work on a tree, whose lvoxels gathers pass if it has any.
pub fn with_tree<T: TreeTask>(tree: &OpenTree, task: T) -> T::Output {
    match (tree.media.is_empty(), tree.media.are_colored()) {
        (true, _) => with_surfels(tree, task),
        (false, false) => task.run(&tree.surfels, &tree.media),
        (false, true) => task.run(&tree.surfels, ColoredMedia(&tree.media)),
    }
}

/// Does work on the surfels of a tree alone.
pub fn with_surfels<T: TreeTask>(tree: &OpenTree, task: T) -> T::Output {
    match tree.media.are_colored() {
        false => task.run(&tree.surfels, NoMedia),
        true => task.run(&tree.surfels, ColoredMedia(&Media::default())),
    }
}
