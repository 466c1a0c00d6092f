//! Which cells of a lattice on a volume's grid hold any medium.

use crate::math::unflatten;
use crate::scene::Grid;
use crate::scene::grid::{BRICK_CELLS, Cell};
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
    let of_bricks: Vec<Vec<[usize; 3]>> = bricks
        .par_iter()
        .map(|&brick| of_brick(grid, brick, step, &matters))
        .collect();
    of_bricks.concat()
}

fn of_brick(
    grid: &Grid,
    brick: [usize; 3],
    step: usize,
    matters: &impl Fn(Cell) -> bool,
) -> Vec<[usize; 3]> {
    let Some(cells) = grid.brick(brick) else {
        return Vec::new();
    };
    // A cell of the volume begins half a voxel before its number.
    let first = brick.map(|b| (2 * b * BRICK_CELLS).saturating_sub(1) / (2 * step));
    let across = BRICK_CELLS / step + 2;
    let mut filled = vec![false; across * across * across];
    for i in 0..BRICK_CELLS.pow(3) {
        let c = unflatten(i, [BRICK_CELLS; 3]);
        if !matters(cells.cell(c)) {
            continue;
        }
        let ends: [[usize; 2]; 3] = std::array::from_fn(|a| {
            let twice = 2 * (brick[a] * BRICK_CELLS + c[a]);
            [twice.saturating_sub(1), twice + 1].map(|t| t / (2 * step) - first[a])
        });
        for i in 0..8 {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|a| ends[a][i >> a & 1]);
            filled[(z * across + y) * across + x] = true;
        }
    }
    let filled = filled
        .iter()
        .enumerate()
        .filter(|(_, is_filled)| **is_filled);
    filled
        .map(|(i, _)| {
            let [x, y, z] = unflatten(i, [across; 3]);
            [first[0] + x, first[1] + y, first[2] + z]
        })
        .collect()
}
