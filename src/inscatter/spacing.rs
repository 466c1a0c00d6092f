//! How close a camera needs vertices to stand: light between pixels, or behind what is opaque
//! within a pixel, is nothing that a picture shows.

use super::bricks::BrickTable;
use super::density::Densities;
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use crate::view::{View, VisibleMedia};
use glam::Vec3;

/// Log2 of the voxels that vertices of each brick of a volume are apart at least.
#[derive(Debug)]
pub struct LeastSpacing(Option<BrickTable<u8>>);

impl LeastSpacing {
    /// Pixels between vertices: from this over the square root of two to this times it.
    const PIXELS: f32 = 2.0;

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
        let half_diagonal = 0.5 * 3.0_f32.sqrt() * BRICK_CELLS as f32 * voxel;
        let least = |b: [usize; 3]| {
            if grid.brick(b).is_none() {
                return 0;
            }
            let middle = Vec3::from(b.map(|c| (c * BRICK_CELLS + BRICK_CELLS / 2) as f32));
            let middle = volume.scene_from_index.transform_point3(middle.as_dvec3());
            let distance = middle.as_vec3().distance(view.camera.origin()) - half_diagonal;
            let pixels = view.pixel_angle * distance;
            let most = std::f32::consts::SQRT_2 * Self::PIXELS * pixels / voxel;
            let deepest = max_depth / (densities.of(b) * voxel);
            let fits = |&level: &usize| (1 << level) as f32 <= most.min(deepest);
            (1..=coarsest).rev().find(fits).unwrap_or(0) as u8
        };
        Self(Some(BrickTable::new(grid, least)))
    }

    /// None, for light that all cameras share.
    pub fn none() -> Self {
        Self(None)
    }

    /// That of a brick.
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
