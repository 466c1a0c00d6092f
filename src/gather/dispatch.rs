//! One choice of compiled code for a whole frame: where pages are kept, and whether there are
//! media.

use super::{ColoredMedia, Medium, NoMedia};
use crate::tree::{Media, OpenTree, Pages, SurfelStore};

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
    match (&tree.surfels, tree.media.are_colored()) {
        (SurfelStore::Resident(pages), false) => task.run(pages, &tree.media),
        (SurfelStore::Cached(pages), false) => task.run(pages, &tree.media),
        (SurfelStore::Resident(pages), true) => task.run(pages, ColoredMedia(&tree.media)),
        (SurfelStore::Cached(pages), true) => task.run(pages, ColoredMedia(&tree.media)),
    }
}

/// Does work on the surfels of a tree alone.
pub fn with_surfels<T: TreeTask>(tree: &OpenTree, task: T) -> T::Output {
    if tree.media.are_colored() {
        let none = Media::default();
        return match &tree.surfels {
            SurfelStore::Resident(pages) => task.run(pages, ColoredMedia(&none)),
            SurfelStore::Cached(pages) => task.run(pages, ColoredMedia(&none)),
        };
    }
    match &tree.surfels {
        SurfelStore::Resident(pages) => task.run(pages, NoMedia),
        SurfelStore::Cached(pages) => task.run(pages, NoMedia),
    }
}
