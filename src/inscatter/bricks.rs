//! A value for each brick of a volume.

use crate::scene::Grid;
use crate::scene::grid::BRICK_CELLS;
use glam::Vec3;

/// Values by brick.
#[derive(Debug)]
pub struct BrickTable<T> {
    dims: [usize; 3],
    values: Vec<T>,
}

impl<T> BrickTable<T> {
    /// One for each brick of a grid, empty or not.
    pub fn new(grid: &Grid, value: impl FnMut([usize; 3]) -> T) -> Self {
        Self {
            dims: grid.brick_dims(),
            values: grid.bricks().map(value).collect(),
        }
    }

    /// Those of all bricks.
    pub fn values(&self) -> impl Iterator<Item = &T> {
        self.values.iter()
    }

    /// The value of a brick.
    #[inline]
    pub fn of(&self, [x, y, z]: [usize; 3]) -> &T {
        let [nx, ny, _] = self.dims;
        &self.values[(z * ny + y) * nx + x]
    }

    /// The value of the brick around a point of index space, or of the nearest.
    #[inline]
    pub fn at(&self, point_in_index: Vec3) -> &T {
        self.of(brick_around(point_in_index, self.dims))
    }
}

/// The brick around a point of index space, or the nearest, of so many along each axis.
#[inline]
pub fn brick_around(point_in_index: Vec3, dims: [usize; 3]) -> [usize; 3] {
    let p = point_in_index.to_array();
    // A brick's samples stand half a voxel from its cells' corners.
    let brick = |a: usize| (p[a] + 0.5).max(0.0) as usize / BRICK_CELLS;
    std::array::from_fn(|a| brick(a).min(dims[a] - 1))
}
