//! Cells of several sizes, the coarsest of which serves that a few hundred exact rays find near
//! enough.

use super::coarse::CoarseVolume;
use super::kept_rays::{KeptRays, lattice};
use crate::Result;
use crate::math::exp::exp_neg;
use crate::math::{Ray, sampling};
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use crate::trace::Cells;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::OnceLock;

/// A volume on cells of several sizes.
#[derive(Debug)]
pub struct Levels<'a> {
    /// The finest first.
    coarse: Vec<CoarseVolume<'a>>,
    /// Cells of half a voxel, made when first asked for; `None` if they are too many.
    halves: OnceLock<Option<CoarseVolume<'a>>>,
    /// Cells, at most.
    most: usize,
}

impl<'a> Levels<'a> {
    /// Cells for each voxel of stored bricks, at most: what stands alone in a large box has few
    /// points that ask for light.
    const MOST_CELLS_PER_VOXEL: usize = 16;
    /// Levels that are tried.
    const TRIED: usize = 4;
    /// Bytes for each cell of the finest level, about: cells of all sizes and in layers.
    pub const CELL_BYTES: usize = 9;

    /// Levels of a volume of at most `most` cells.
    pub fn new(volume: &'a Volume, most: usize) -> Self {
        let grid = &volume.sigma_t;
        let bricks = grid.bricks().filter(|b| grid.brick(*b).is_some()).count();
        let most = most.min(Self::MOST_CELLS_PER_VOXEL * bricks * BRICK_CELLS.pow(3));
        Self {
            coarse: CoarseVolume::levels(volume, most, Self::TRIED),
            halves: OnceLock::new(),
            most,
        }
    }

    /// Cells of the finest level of a volume, about, for which none is made nor read.
    #[must_use]
    pub fn cells(volume: &Volume, most: usize) -> usize {
        let voxels = volume.sigma_t.stored_bricks() * BRICK_CELLS.pow(3);
        CoarseVolume::most_cells(volume, most.min(Self::MOST_CELLS_PER_VOXEL * voxels))
    }

    /// The coarsest first; the finest are made when it comes to them.
    pub fn coarse_to_fine(&self) -> impl Iterator<Item = &CoarseVolume<'a>> {
        let finest = std::iter::once_with(|| {
            let volume = self.coarse.first()?.volume;
            let halves = || CoarseVolume::in_halves(volume, self.most);
            self.halves.get_or_init(halves).as_ref()
        });
        self.coarse.iter().rev().chain(finest.flatten())
    }
}

/// Points of a volume, and the share of light that gets to each from some directions, exactly.
pub struct Checks(pub(super) Vec<(Vec3, f32)>);

impl Checks {
    /// Root mean square by which shares may differ at the points that light gets to: far below what
    /// few rays to a sky would. Pictures show means of many points.
    pub const MAX_ERROR: f64 = 0.012;
    /// Of all light.
    const MAX_BIAS: f64 = 0.005;
    /// Shares below count as no light.
    const LIT: f32 = 0.01;

    /// So many points where there is a medium.
    pub fn new(volume: &Volume, count: usize, to_lights: &[Vec3]) -> Self {
        Self::where_lit(volume, count, to_lights, |_, _| true)
    }

    /// The same where no light gets to a point from a direction but where `is_open` says so.
    pub fn where_lit(
        volume: &Volume,
        count: usize,
        to_lights: &[Vec3],
        is_open: impl Fn(Vec3, Vec3) -> bool + Sync,
    ) -> Self {
        const EDGE: f64 = BRICK_CELLS as f64;
        let grid = &volume.sigma_t;
        let bricks: Vec<_> = grid.bricks().filter(|b| grid.brick(*b).is_some()).collect();
        if bricks.is_empty() {
            return Self(Vec::new());
        }
        let point = |i: u64| {
            let unit = |n: u64| f64::from(sampling::unit(sampling::hash(&[i, n])));
            let brick = bricks[(unit(0) * bricks.len() as f64) as usize];
            let within = DVec3::new(unit(1), unit(2), unit(3));
            // Cells begin half a voxel before the voxels.
            let at = (DVec3::from(brick.map(|b| b as f64)) + within) * EDGE - 0.5;
            (grid.sample(at.as_vec3()) > 0.0)
                .then(|| volume.scene_from_index.transform_point3(at).as_vec3())
        };
        // Most of a brick may be empty.
        let points: Vec<_> = (0..64 * count as u64)
            .filter_map(point)
            .take(count)
            .collect();
        let share = |point: Vec3| {
            let open = to_lights.iter().filter(|d| is_open(point, **d));
            let through = open.map(|&to_light| {
                let cells = Cells::new(volume, &Ray::endless(point, to_light));
                exp_neg(cells.map_or(0.0, |c| c.optical_depth() as f32))
            });
            through.sum::<f32>() / to_lights.len() as f32
        };
        let all = points.into_par_iter().map(|p| (p, share(p)));
        Self(all.collect())
    }

    /// Rays to a light in a direction through the coarsest level that is near enough; `None` if
    /// none is.
    ///
    /// # Errors
    /// That of `go_on`, or no room for the rays.
    pub fn coarsest_rays(
        &self,
        max_error: f64,
        levels: &Levels,
        go_on: &impl Fn() -> Result<()>,
        to_light: Vec3,
    ) -> Result<Option<KeptRays>> {
        let rays = |coarse: &CoarseVolume| {
            let lattice = lattice(coarse, to_light);
            KeptRays::new(coarse, &coarse.layers(lattice.axes), lattice)
        };
        let share = |rays: &KeptRays, point| exp_neg(rays.depth(point));
        self.coarsest(max_error, levels, go_on, rays, share)
    }

    /// What `make` makes of the coarsest level whose `share` at the points differs by no more than
    /// that in the root mean square; `None` if all do.
    ///
    /// # Errors
    /// Those of `go_on` and `make`.
    pub fn coarsest<T>(
        &self,
        max_error: f64,
        levels: &Levels,
        go_on: &impl Fn() -> Result<()>,
        make: impl Fn(&CoarseVolume) -> Result<T>,
        share: impl Fn(&T, Vec3) -> f32,
    ) -> Result<Option<T>> {
        for level in levels.coarse_to_fine() {
            go_on()?;
            let made = make(level)?;
            if self.are_met(max_error, |point| share(&made, point)) {
                return Ok(Some(made));
            }
        }
        Ok(None)
    }

    /// Whether a share differs little enough at all points together.
    pub fn are_met(&self, max_error: f64, share: impl Fn(Vec3) -> f32) -> bool {
        let (mut squares, mut lit) = (0.0, 0_u32);
        let (mut differences, mut sum) = (0.0, 0.0);
        for &(point, exact) in &self.0 {
            let found = share(point);
            let difference = f64::from(found) - f64::from(exact);
            if found > Self::LIT || exact > Self::LIT {
                squares += difference * difference;
                lit += 1;
            }
            differences += difference;
            sum += f64::from(exact);
        }
        let error = (squares / f64::from(lit.max(1))).sqrt();
        error <= max_error && differences.abs() <= Self::MAX_BIAS * sum
    }
}
