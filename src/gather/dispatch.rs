//! One choice of compiled code for a whole frame: where pages are kept, and whether there are
//! media.

use super::{Medium, NoMedia};
use crate::tree::{OpenTree, Pages, SurfelStore};

/// Work on an open tree that is compiled for each kind of pages, with media and without.
pub trait TreeTask {
    /// What the work makes.
    type Output;

    /// Does the work.
    fn run<P: Pages, M: Medium>(self, pages: &P, media: M) -> Self::Output;
}

/// Does work on a tree, whose lvoxels gathers pass if it has any.
pub fn with_tree<T: TreeTask>(tree: &OpenTree, task: T) -> T::Output {
    if tree.media.is_empty() {
        return with_surfels(tree, task);
    }
    match &tree.surfels {
        SurfelStore::Resident(pages) => task.run(pages, &tree.media),
        SurfelStore::Cached(pages) => task.run(pages, &tree.media),
    }
}

/// Does work on the surfels of a tree alone.
pub fn with_surfels<T: TreeTask>(tree: &OpenTree, task: T) -> T::Output {
    match &tree.surfels {
        SurfelStore::Resident(pages) => task.run(pages, NoMedia),
        SurfelStore::Cached(pages) => task.run(pages, NoMedia),
    }
}
