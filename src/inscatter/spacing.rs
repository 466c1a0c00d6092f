//! How close a camera needs vertices to stand: light between pixels, or behind what is opaque
//! within a pixel, is nothing that a picture shows.

use super::bricks::BrickTable;
use super::density::Densities;
use super::direct::DIRECT_LEVELS;
use crate::math::unflatten;
use crate::scene::grid::BRICK_CELLS;
use crate::scene::{Grid, Volume};
use crate::view::{View, VisibleMedia};
use glam::Vec3;

/// Log2 of the voxels that vertices of each brick of a volume are apart at least.
#[derive(Debug)]
pub struct LeastSpacing(Option<BrickTable<u8>>);

impl LeastSpacing {
    /// Pixels between vertices: from this over the square root of two to this times it.
    const PIXELS: f32 = 2.0;
    /// Optical depth of a voxel from which on a brick has a front: a few of them hide the rest.
    const FRONT_DEPTH: f32 = 0.5;
    /// Gather rays of a vertex with which two pixels are close enough at a front.
    const FRONT_SAMPLES: f32 = 6.0;
    /// The least spacing at a front: where pixels ask for finer ones, vertices are few enough.
    const LEAST_FRONT: u8 = 2;

    /// Spacings for a camera, of at most `coarsest`, and of at most an optical depth between
    /// vertices; none are too close for light that all cameras share.
    pub fn new(
        view: &View,
        visible: VisibleMedia,
        volume: &Volume,
        densities: &Densities,
        max_depth: f32,
        coarsest: usize,
    ) -> Self {
        if let VisibleMedia::All = visible {
            return Self::none();
        }
        let voxel = volume.longest_voxel_edge();
        let grid = &volume.sigma_t;
        let least = |b: [usize; 3]| {
            if grid.brick(b).is_none() {
                return 0;
            }
            let most = Self::voxels(view, volume, b);
            let deepest = max_depth / (densities.of(b) * voxel);
            coarsest_of(coarsest, most.min(deepest))
        };
        Self(Some(BrickTable::new(grid, least)))
    }

    /// Spacings for a camera by pixels alone, in bricks so deep that it sees no more than their
    /// fronts, and around those, where pixels are wider than voxels; 0 elsewhere. More gather rays
    /// of a vertex ask for vertices that are as much closer.
    pub fn of_fronts(
        view: &View,
        visible: VisibleMedia,
        volume: &Volume,
        densities: &Densities,
        samples: u32,
    ) -> Self {
        if let VisibleMedia::All = visible {
            return Self::none();
        }
        let grid = &volume.sigma_t;
        let voxel = volume.longest_voxel_edge();
        let dims = grid.brick_dims();
        let closer = (Self::FRONT_SAMPLES / samples as f32).sqrt().min(1.0);
        let is_deep = |b: [usize; 3]| densities.of(b) * voxel >= Self::FRONT_DEPTH;
        // With the rim around: few vertices would be swept there, by rays through all of the
        // volume.
        let is_near = |b: [usize; 3]| {
            let around = |i| {
                let beside = unflatten(i, [3; 3]);
                std::array::from_fn(|a| (b[a] + beside[a]).saturating_sub(1).min(dims[a] - 1))
            };
            grid.brick(b).is_some() && (0..27).any(|i| is_deep(around(i)))
        };
        let least = |b: [usize; 3]| {
            let level = match is_near(b) {
                true => coarsest_of(DIRECT_LEVELS - 1, closer * Self::voxels(view, volume, b)),
                false => 0,
            };
            if level < Self::LEAST_FRONT { 0 } else { level }
        };
        let table = BrickTable::new(grid, least);
        let are_any = table.values().any(|level| *level > 0);
        Self(are_any.then_some(table))
    }

    /// Whether there may be any.
    pub fn are_any(&self) -> bool {
        self.0.is_some()
    }

    /// The most voxels between vertices of a brick, by pixels alone.
    fn voxels(view: &View, volume: &Volume, brick: [usize; 3]) -> f32 {
        let voxel = volume.longest_voxel_edge();
        let half_diagonal = 0.5 * 3.0_f32.sqrt() * BRICK_CELLS as f32 * voxel;
        let middle = volume.middle_of_brick(brick);
        let distance = middle.distance(view.camera.origin()) - half_diagonal;
        let pixels = view.pixel_angle * distance;
        std::f32::consts::SQRT_2 * Self::PIXELS * pixels / voxel
    }

    /// None, for light that all cameras share.
    pub fn none() -> Self {
        Self(None)
    }

    /// The least of all bricks that hold any medium.
    pub fn least(&self, grid: &Grid) -> usize {
        let filled = grid.bricks().filter(|b| grid.brick(*b).is_some());
        filled.map(|b| self.of(b)).min().unwrap_or(0)
    }

    /// That of a brick.
    #[inline]
    pub fn of(&self, brick: [usize; 3]) -> usize {
        let table = self.0.as_ref();
        table.map_or(0, |table| usize::from(*table.of(brick)))
    }

    /// That of the brick around a point of index space, or of the nearest.
    #[inline]
    pub fn at(&self, point_in_index: Vec3) -> usize {
        let table = self.0.as_ref();
        table.map_or(0, |table| usize::from(*table.at(point_in_index)))
    }
}

/// The coarsest spacing of at most so many voxels.
fn coarsest_of(coarsest: usize, most: f32) -> u8 {
    let fits = |&level: &usize| (1 << level) as f32 <= most;
    (1..=coarsest).rev().find(fits).unwrap_or(0) as u8
}
