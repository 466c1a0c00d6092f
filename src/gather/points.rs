//! Gathers at points from an open tree alone, whatever store its pages are in.

use super::dispatch::{TreeTask, with_tree};
use super::{Gathered, Gatherer, Medium, RayKernel, RaySettings, SampleRange};
use crate::Result;
use crate::math::{Environment, Rgb};
use crate::tree::{OpenTree, SurfelStore};
use glam::Vec3;

/// How a [`PointGatherer`] gathers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Rays of each gather, at least one.
    pub samples: u32,
    /// A node seen under less than this solid angle, in steradians, may stand for all below it; 0
    /// for disks only.
    pub max_solid_angle: f32,
    /// Surfaces and media beyond this distance, in scene units, send nothing, but still hide the
    /// environment; infinite for no limit.
    pub max_dist: f32,
    /// The way in which the surface that ends a ray is found.
    pub kernel: Kernel,
    /// Radiance where a ray meets nothing.
    pub environment: Rgb,
}

/// How the surface that ends a ray is found in a tree.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Kernel {
    /// Surfels, and nodes whole below the solid angle.
    #[default]
    Cone,
    /// Every surfel, one node at a time, as in the paper of Gibson & Wood (2011).
    Plain,
}

impl Default for Settings {
    /// Cones of 256 rays with a cut of 0.01 steradians, however far, in the dark.
    fn default() -> Self {
        Self {
            samples: 256,
            max_solid_angle: 0.01,
            max_dist: f32::INFINITY,
            kernel: Kernel::Cone,
            environment: Rgb::BLACK,
        }
    }
}

impl Settings {
    fn of_rays(&self) -> RaySettings<'static> {
        RaySettings {
            samples: self.samples,
            max_solid_angle: self.max_solid_angle,
            max_dist: self.max_dist,
            kernel: match self.kernel {
                Kernel::Cone => RayKernel::Cone,
                Kernel::Plain => RayKernel::Plain,
            },
            environment: Environment::even(self.environment),
            leave_out_bright: false,
        }
    }
}

/// Gathers light at any points from a tree, for which no scene is needed.
///
/// Points are in the tree's scene space: world space less [`OpenTree::world_from_scene`].
#[derive(Clone, Copy, Debug)]
pub struct PointGatherer<'a> {
    tree: &'a OpenTree,
    settings: Settings,
}

impl<'a> PointGatherer<'a> {
    /// Prepares gathers from an open tree.
    #[must_use]
    pub fn new(tree: &'a OpenTree, settings: Settings) -> Self {
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
        let task = PointGather {
            settings: self.settings,
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
struct PointGather {
    settings: Settings,
    receiver: Receiver,
    seed: u64,
}

impl TreeTask for PointGather {
    type Output = Result<Gathered>;

    fn run<M: Medium>(self, pages: &SurfelStore, media: M) -> Result<Gathered> {
        let gatherer = Gatherer {
            pages,
            media,
            settings: self.settings.of_rays(),
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
