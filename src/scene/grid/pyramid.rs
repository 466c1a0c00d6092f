//! Levels of a grid: each the means of the one before over cubes of two voxels an edge.
//!
//! The mean of a cube is that of its voxels inside the grid, as f32, summed two and two: along x,
//! then y, then z, `((a + b) + (c + d)) + ((e + f) + (g + h))`, times one over their number. A
//! voxel that is not in the grid adds 0. So a level is the same whatever made it and in whatever
//! order.

use super::{BRICK_CELLS, BRICK_EDGE, BRICK_SAMPLES, Brick, Grid, Layout, VolumeGrid, VoxelBox};
use std::convert::Infallible;
use std::sync::OnceLock;

/// Levels beyond the first that a grid may have.
const MAX_LEVELS: usize = 16;

/// The levels of a grid above the finest, made when first asked for.
#[derive(Debug, Default)]
pub struct Pyramid([OnceLock<VolumeGrid>; MAX_LEVELS]);

impl Pyramid {
    /// A level: 0 is the grid itself, and each further one has voxels of twice the edge. Above the
    /// one of a single voxel there is no other. Of levels that are stored none is read for it.
    pub fn level<'a>(&'a self, finest: &'a VolumeGrid, level: usize) -> &'a VolumeGrid {
        let mut grid = finest;
        for coarser in self.0.iter().take(level) {
            if grid.dims() == [1; 3] {
                break;
            }
            grid = match coarser.get() {
                Some(coarser) => coarser,
                // Nobody waits for another who makes it, who may wait for him.
                None => {
                    let made = grid.coarser();
                    coarser.get_or_init(|| made)
                }
            };
        }
        grid
    }
}

impl Grid {
    /// The same field on voxels of twice the edge, each the mean of those inside it. The box stays
    /// where it is: the last voxels reach beyond it where the number of voxels is odd.
    #[must_use]
    pub fn coarser(&self) -> Self {
        let dims = self.dims.map(|n| n.div_ceil(2));
        let finer = |voxels: &VoxelBox| {
            let first = voxels.first.map(|v| 2 * v);
            let end = |a: usize| (first[a] + 2 * voxels.dims[a]).min(self.dims[a]);
            VoxelBox {
                first,
                dims: std::array::from_fn(|a| end(a) - first[a]),
            }
        };
        let may_hold = |voxels: &VoxelBox| {
            let mut any = false;
            self.each_brick_of(&finer(voxels), |_, _| any = true);
            Ok::<_, Infallible>(any)
        };
        let Ok(layout) = Layout::of(dims, may_hold);
        let samples = self.lists().zeros_surely(layout.samples());
        let Ok((mut grid, _)) = layout.fill(samples, |region, means| {
            self.write_halved(&region.voxels, means);
            Ok::<_, Infallible>(())
        });
        grid.size = self.size.map(|n| 0.5 * n);
        grid
    }

    /// Writes a box of voxels of the next level, x fastest. The samples of each lie in one brick,
    /// as this has those of its first corners, too, which are shared.
    pub(super) fn write_halved(&self, voxels: &VoxelBox, means: &mut [f32]) {
        const CELLS: usize = BRICK_CELLS / 2;
        means.fill(0.0);
        let [nx, ny, _] = voxels.dims;
        let along =
            |a: usize| voxels.first[a] / CELLS..=(voxels.first[a] + voxels.dims[a] - 1) / CELLS;
        let mut buffer = [0.0; BRICK_SAMPLES];
        for b in along(2).flat_map(|z| along(1).flat_map(move |y| along(0).map(move |x| [x, y, z])))
        {
            let Some(brick) = self.brick(b) else {
                continue;
            };
            let samples = brick.on_voxels(&mut buffer);
            let own: [_; 3] = std::array::from_fn(|a| {
                let end = (voxels.first[a] + voxels.dims[a]).min((b[a] + 1) * CELLS);
                voxels.first[a].max(b[a] * CELLS)..end
            });
            // Of a voxel of the next level, by axis, how many of two are in the grid.
            let count = |a: usize, v: usize| (self.dims[a] - 2 * v).min(2);
            let [xs, ys, zs] = own;
            for z in zs {
                for y in ys.clone() {
                    let to = ((z - voxels.first[2]) * ny + y - voxels.first[1]) * nx;
                    let to = to + xs.start - voxels.first[0];
                    let means = &mut means[to..to + xs.len()];
                    // Sample s of a brick is that of the voxel at its first corner minus one.
                    let [ky, kz] = [y, z].map(|v| v % CELLS * 2 + 1);
                    let row = |y: usize, z: usize| {
                        let first = (z * BRICK_EDGE + y) * BRICK_EDGE + 1;
                        &samples[first..first + BRICK_CELLS]
                    };
                    let rows = [
                        row(ky, kz),
                        row(ky + 1, kz),
                        row(ky, kz + 1),
                        row(ky + 1, kz + 1),
                    ];
                    let counts = [count(1, y), count(2, z)];
                    if counts == [2; 2] && xs.len() == CELLS && count(0, xs.end - 1) == 2 {
                        means.copy_from_slice(&mean_row(rows));
                        continue;
                    }
                    for (mean, x) in means.iter_mut().zip(xs.clone()) {
                        let (kx, nx) = (x % CELLS * 2, count(0, x));
                        let pair = |i: usize| {
                            let is_inside = i % 2 < counts[0] && i / 2 < counts[1];
                            let row = rows[i];
                            match (is_inside, nx) {
                                (false, _) => 0.0,
                                (true, 1) => row[kx],
                                (true, _) => row[kx] + row[kx + 1],
                            }
                        };
                        let sum = (pair(0) + pair(1)) + (pair(2) + pair(3));
                        *mean = sum * (1.0 / (nx * counts[0] * counts[1]) as f32);
                    }
                }
            }
        }
    }

    /// Writes the samples of a box of voxels, x fastest, over what is 0.
    pub(in crate::scene) fn read(&self, voxels: &VoxelBox, samples: &mut [f32]) {
        let [nx, ny, _] = voxels.dims;
        let mut buffer = [0.0; BRICK_SAMPLES];
        self.each_brick_of(voxels, |b, brick| {
            let brick = brick.on_voxels(&mut buffer);
            // Sample s of a brick is that of the voxel at its first corner minus one.
            let along: [_; 3] = std::array::from_fn(|a| {
                let first = (b[a] * BRICK_CELLS).max(voxels.first[a] + 1);
                let end =
                    (b[a] * BRICK_CELLS + BRICK_CELLS).min(voxels.first[a] + voxels.dims[a] + 1);
                first..end
            });
            let [xs, ys, zs] = along;
            for z in zs {
                for y in ys.clone() {
                    let from = (z % BRICK_CELLS * BRICK_EDGE + y % BRICK_CELLS) * BRICK_EDGE
                        + xs.start % BRICK_CELLS;
                    let to = ((z - 1 - voxels.first[2]) * ny + y - 1 - voxels.first[1]) * nx
                        + (xs.start - 1 - voxels.first[0]);
                    samples[to..to + xs.len()].copy_from_slice(&brick[from..from + xs.len()]);
                }
            }
        });
    }

    /// Gives the stored bricks to which the samples of a box of voxels belong, each of one brick
    /// alone, and their samples to `take`.
    fn each_brick_of(&self, voxels: &VoxelBox, mut take: impl FnMut([usize; 3], Brick<'_>)) {
        // Corner c of cell space is sample c - 1.
        let along = |a: usize| {
            let first = voxels.first[a] + 1;
            first / BRICK_CELLS..=(first + voxels.dims[a] - 1) / BRICK_CELLS
        };
        for z in along(2) {
            for y in along(1) {
                for x in along(0) {
                    if let Some(brick) = self.brick([x, y, z]) {
                        take([x, y, z], brick);
                    }
                }
            }
        }
    }
}

/// Means over cubes of two an edge of four rows of a brick's own samples.
#[inline]
fn mean_row([a, b, c, d]: [&[f32]; 4]) -> [f32; BRICK_CELLS / 2] {
    let pair = |row: &[f32], i: usize| row[2 * i] + row[2 * i + 1];
    std::array::from_fn(|i| {
        let sum = (pair(a, i) + pair(b, i)) + (pair(c, i) + pair(d, i));
        sum * 0.125
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use glam::Vec3;

    fn noise([i, j, k]: [usize; 3]) -> f32 {
        let empty = (i / 9 + j / 7 + k / 8).is_multiple_of(2);
        let v = sampling::unit(sampling::hash(&[i as u64, j as u64, k as u64]));
        if empty { 0.0 } else { v }
    }

    /// A sample of a grid, by its voxel.
    fn sample(grid: &Grid, v: [usize; 3]) -> f32 {
        let corner = v.map(|c| c + 1);
        let Some(brick) = grid.brick(corner.map(|c| c / BRICK_CELLS)) else {
            return 0.0;
        };
        let [x, y, z] = corner.map(|c| c % BRICK_CELLS);
        brick.samples[(z * BRICK_EDGE + y) * BRICK_EDGE + x]
    }

    #[test]
    fn a_level_has_the_means_of_the_voxels_of_the_one_before() {
        for dims in [[1, 1, 1], [7, 8, 9], [62, 33, 64], [131, 20, 17]] {
            let grid = Grid::from_fn(dims, noise);
            let coarser = grid.coarser();
            assert_eq!(coarser.dims(), dims.map(|n| n.div_ceil(2)));
            assert_eq!(coarser.size(), dims.map(|n| 0.5 * n as f32));
            for i in 0..coarser.dims().iter().product() {
                let v = crate::math::unflatten(i, coarser.dims());
                let parts: [_; 8] = std::array::from_fn(|i| {
                    let at: [usize; 3] = std::array::from_fn(|a| 2 * v[a] + (i >> a & 1));
                    (0..3).all(|a| at[a] < dims[a]).then(|| noise(at))
                });
                let [a, b, c, d, e, f, g, h] = parts.map(|p| p.unwrap_or(0.0));
                let sum = ((a + b) + (c + d)) + ((e + f) + (g + h));
                let count = parts.iter().flatten().count();
                assert_eq!(
                    sample(&coarser, v),
                    sum * (1.0 / count as f32),
                    "{dims:?} {v:?}"
                );
            }
        }
    }

    #[test]
    fn levels_have_the_box_of_the_grid_and_end_at_one_voxel() {
        let finest = VolumeGrid::from(Grid::from_fn([37, 5, 18], |_| 2.0));
        let pyramid = Pyramid::default();
        assert!(pyramid.level(&finest, 0).is(&finest));
        let level = pyramid.level(&finest, 2);
        assert_eq!(
            (level.dims(), level.size()),
            ([10, 2, 5], [9.25, 1.25, 4.5])
        );
        assert!(level.is(pyramid.level(&finest, 2)));
        // What is constant stays so up to the border of the box, and is nothing beyond it.
        assert_eq!(level.sample(Vec3::new(9.25, 1.25, 4.5)), 2.0);
        assert_eq!(level.sample(Vec3::new(9.26, 1.0, 1.0)), 0.0);
        let last = pyramid.level(&finest, 6);
        assert_eq!(last.dims(), [1; 3]);
        assert!(last.is(pyramid.level(&finest, MAX_LEVELS)));
    }
}
