//! Gathers at points from an open tree alone, whatever store its pages are in.

use super::{Gathered, Gatherer, Medium, NoMedia, SampleRange, Settings};
use crate::Result;
use crate::tree::{OpenTree, Pages, SurfelStore};
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
        match &self.tree.surfels {
            SurfelStore::Resident(pages) => self.gather_from(pages, receiver, seed),
            SurfelStore::Cached(pages) => self.gather_from(pages, receiver, seed),
        }
    }

    fn gather_from(&self, pages: &impl Pages, receiver: Receiver, seed: u64) -> Result<Gathered> {
        let settings = self.settings;
        let gathered = if self.tree.media.is_empty() {
            let media = NoMedia;
            receiver.gather(
                &Gatherer {
                    pages,
                    media,
                    settings,
                },
                seed,
            )
        } else {
            let media = &self.tree.media;
            receiver.gather(
                &Gatherer {
                    pages,
                    media,
                    settings,
                },
                seed,
            )
        };
        pages.check()?;
        Ok(gathered)
    }
}

/// The point that light is gathered for.
#[derive(Clone, Copy, Debug)]
enum Receiver {
    Surface { point: Vec3, normal: Vec3 },
    Medium { point: Vec3 },
}

impl Receiver {
    fn gather<P: Pages, M: Medium>(self, gatherer: &Gatherer<'_, P, M>, seed: u64) -> Gathered {
        let range = SampleRange::first(seed);
        match self {
            Self::Surface { point, normal } => gatherer.irradiance(point, normal, normal, range),
            Self::Medium { point } => gatherer.mean_radiance(point, range),
        }
    }
}
