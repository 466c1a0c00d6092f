//! Gathers at points from an open tree alone, whatever store its pages are in.

use super::dispatch::{TreeTask, with_tree};
use super::{Gathered, Gatherer, Medium, SampleRange, Settings};
use crate::Result;
use crate::tree::{OpenTree, Pages};
use glam::Vec3;

/// Gathers light at any points from a tree, for which no scene is needed.
///
/// Points are in the tree's scene space: world space less [`OpenTree::world_from_scene`].
#[derive(Clone, Copy, Debug)]
pub struct PointGatherer<'a> {
    tree: &'a OpenTree,
    settings: Settings<'a>,
}

impl<'a> PointGatherer<'a> {
    /// Prepares gathers from an open tree.
    #[must_use]
    pub fn new(tree: &'a OpenTree, settings: Settings<'a>) -> Self {
        Self { tree, settings }
    }

    /// Gathers the irradiance at a point of a surface with a unit normal.
    ///
    /// The point must be a little off its own surface, on the side of the normal: more than the
    /// rounding of its coordinates. `seed` chooses the directions of the rays; the same seed gives
    /// the same result.
    ///
    /// # Errors
    /// A page of the tree that cannot be read.
    pub fn irradiance(&self, point: Vec3, normal: Vec3, seed: u64) -> Result<Gathered> {
        self.gather(Receiver::Surface { point, normal }, seed)
    }

    /// Gathers the mean radiance over the sphere of directions at a point, as of a medium that
    /// scatters in all directions alike. `seed` is as in [`Self::irradiance`].
    ///
    /// # Errors
    /// A page of the tree that cannot be read.
    pub fn mean_radiance(&self, point: Vec3, seed: u64) -> Result<Gathered> {
        self.gather(Receiver::Medium { point }, seed)
    }

    fn gather(&self, receiver: Receiver, seed: u64) -> Result<Gathered> {
        let settings = self.settings;
        let task = PointGather {
            settings,
            receiver,
            seed,
        };
        with_tree(self.tree, task)
    }
}

/// The point that light is gathered for.
#[derive(Clone, Copy, Debug)]
enum Receiver {
    Surface { point: Vec3, normal: Vec3 },
    Medium { point: Vec3 },
}

/// One gather.
struct PointGather<'a> {
    settings: Settings<'a>,
    receiver: Receiver,
    seed: u64,
}

impl TreeTask for PointGather<'_> {
    type Output = Result<Gathered>;

    fn run<P: Pages, M: Medium>(self, pages: &P, media: M) -> Result<Gathered> {
        let settings = self.settings;
        let gatherer = Gatherer {
            pages,
            media,
            settings,
        };
        let range = SampleRange::first(self.seed);
        let gathered = match self.receiver {
            Receiver::Surface { point, normal } => {
                gatherer.irradiance(point, normal, normal, range)
            }
            Receiver::Medium { point } => gatherer.mean_radiance(point, range),
        };
        pages.check()?;
        Ok(gathered)
    }
}
