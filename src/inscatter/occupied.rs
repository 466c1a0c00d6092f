//! Which cells of a lattice on a volume's grid hold any medium.

use crate::scene::Grid;
use crate::scene::grid::{BRICK_CELLS, Brick, Cell};
use rayon::prelude::*;

/// Vertices along each axis of a lattice of cells `step` voxels wide.
pub fn vertices_along(grid: &Grid, step: usize) -> [usize; 3] {
    grid.dims().map(|n| n.div_ceil(step) + 1)
}

/// The vertices around a cell of a lattice that has `count` along each axis.
pub fn around(cell: [usize; 3], count: [usize; 3]) -> impl Iterator<Item = [usize; 3]> {
    (0..8).map(move |i| std::array::from_fn(|a| (cell[a] + (i >> a & 1)).min(count[a] - 1)))
}

/// The cells of a lattice, `step` voxels wide, in which bricks of the grid have a cell that
/// matters; some of them twice.
pub fn cells(
    grid: &Grid,
    bricks: &[[usize; 3]],
    step: usize,
    matters: impl Fn(Cell) -> bool + Sync,
) -> Vec<[usize; 3]> {
    around_cells(grid, bricks, step, |brick| brick.cells_that(&matters))
}

/// The same where every cell matters that is not empty.
pub fn filled_cells(grid: &Grid, bricks: &[[usize; 3]], step: usize) -> Vec<[usize; 3]> {
    around_cells(grid, bricks, step, |brick| brick.filled_cells())
}

/// The same of the cells of a brick that `chosen` has a bit for, by row.
fn around_cells(
    grid: &Grid,
    bricks: &[[usize; 3]],
    step: usize,
    chosen: impl Fn(Brick<'_>) -> [u8; BRICK_CELLS * BRICK_CELLS] + Sync,
) -> Vec<[usize; 3]> {
    let of_brick = |&b: &[usize; 3]| {
        let Some(brick) = grid.brick(b) else {
            return Vec::new();
        };
        let rows = chosen(brick);
        let mut filled = BrickCells::new(b, step);
        let ends = [0, 1, 2].map(|a| std::array::from_fn(|c| filled.ends(a, c)));
        let [xs, ys, zs]: [[[usize; 2]; BRICK_CELLS]; 3] = ends;
        // The cells along x that are in each cell of the lattice.
        let columns: Vec<u8> = (0..filled.across)
            .map(|column| {
                let is_in = |c: &usize| xs[*c].contains(&column);
                (0..BRICK_CELLS)
                    .filter(is_in)
                    .fold(0, |bits, c| bits | 1 << c)
            })
            .collect();
        for (i, &row) in rows.iter().enumerate().filter(|(_, row)| **row != 0) {
            let columns = columns.iter().enumerate();
            let found = columns.fold(0, |found, (column, bits)| {
                found | u16::from(row & bits != 0) << column
            });
            let [ys, zs] = [ys[i % BRICK_CELLS], zs[i / BRICK_CELLS]];
            for j in 0..4 {
                filled.rows[zs[j >> 1] * filled.across + ys[j & 1]] |= found;
            }
        }
        filled.list()
    };
    let of_bricks: Vec<Vec<[usize; 3]>> = bricks.par_iter().map(of_brick).collect();
    of_bricks.concat()
}

/// The cells of a lattice that a brick of a grid may touch.
struct BrickCells {
    brick: [usize; 3],
    step: usize,
    first: [usize; 3],
    across: usize,
    /// A bit for each cell along x that is filled, row by row along y, then z.
    rows: Vec<u16>,
}

impl BrickCells {
    /// None is filled yet.
    fn new(brick: [usize; 3], step: usize) -> Self {
        let across = BRICK_CELLS / step + 2;
        Self {
            brick,
            step,
            // A cell of the volume begins half a voxel before its number.
            first: brick.map(|b| (2 * b * BRICK_CELLS).saturating_sub(1) / (2 * step)),
            across,
            rows: vec![0; across * across],
        }
    }

    /// In which cells of the lattice, counted from the first, a cell of the brick begins and ends.
    fn ends(&self, axis: usize, cell: usize) -> [usize; 2] {
        let twice = 2 * (self.brick[axis] * BRICK_CELLS + cell);
        [twice.saturating_sub(1), twice + 1].map(|t| t / (2 * self.step) - self.first[axis])
    }

    fn list(&self) -> Vec<[usize; 3]> {
        let [first_x, first_y, first_z] = self.first;
        let of_row = |(i, row): (usize, &u16)| {
            let (row, [y, z]) = (*row, [i % self.across, i / self.across]);
            let columns = (0..self.across).filter(move |x| row >> x & 1 == 1);
            columns.map(move |x| [first_x + x, first_y + y, first_z + z])
        };
        self.rows.iter().enumerate().flat_map(of_row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::unflatten;
    use crate::scene::grid::{Allowed, VolumeGrid};
    use glam::Vec3A;
    use std::collections::BTreeSet;

    /// The cells of a lattice in which those of bricks lie that matter, voxel by voxel.
    fn one_by_one(
        grid: &Grid,
        bricks: &[[usize; 3]],
        step: usize,
        matters: impl Fn(Cell) -> bool,
    ) -> Vec<[usize; 3]> {
        let mut all = Vec::new();
        for b in bricks {
            let Some(brick) = grid.brick(*b) else {
                continue;
            };
            // z first, as they are listed.
            let mut found = BTreeSet::new();
            let voxels = (0..BRICK_CELLS.pow(3)).map(|i| unflatten(i, [BRICK_CELLS; 3]));
            for c in voxels.filter(|c| matters(brick.cell::<false>(c.map(|c| c >> brick.level)))) {
                for i in 0..8 {
                    let [x, y, z] = std::array::from_fn(|a| {
                        let twice = 2 * (b[a] * BRICK_CELLS + c[a]);
                        [twice.saturating_sub(1), twice + 1][i >> a & 1] / (2 * step)
                    });
                    found.insert([z, y, x]);
                }
            }
            all.extend(found.into_iter().map(|[z, y, x]| [x, y, z]));
        }
        all
    }

    #[test]
    fn filled_cells_are_those_in_which_any_cell_is_not_empty() {
        let value = |[i, j, k]: [usize; 3]| f32::from((i * 7 + j * 5 + k * 3).is_multiple_of(61));
        let grid = Grid::from_fn([37, 20, 45], value);
        let any = |b: [usize; 3]| Allowed {
            unseen: b[2] % 3 + 1,
            depth: f32::INFINITY,
            error: 0.0,
        };
        let adapted = VolumeGrid::from(grid.clone()).adapted(any).unwrap();
        for grid in [&grid, &adapted.unwrap()] {
            let bricks: Vec<_> = grid.bricks().collect();
            for step in [1, 2, 4, 8, 16, 64] {
                let plain = one_by_one(grid, &bricks, step, |cell| !cell.is_empty());
                assert_eq!(filled_cells(grid, &bricks, step), plain, "{step}");
                let matters = |cell: Cell| cell.value(Vec3A::splat(0.5)) > 0.2;
                let plain = one_by_one(grid, &bricks, step, matters);
                assert_eq!(cells(grid, &bricks, step, matters), plain, "{step}");
            }
        }
    }
}
