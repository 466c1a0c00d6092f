//! Scalar samples on a regular grid, stored in sparse bricks laid out for walking rays.
//!
//! Index space: voxel (i,j,k) of `dims` spans (i,j,k) to (i+1,j+1,k+1) and its sample sits at its
//! centre. Between centres the field is trilinear, in the outer half voxel it is clamped, outside
//! the box it is zero.
//!
//! Cell space is index space plus 1/2: cell c lies between samples c-1 and c, so all knees of the
//! field are at integers. A brick holds 8^3 cells with their 9^3 corner samples, or fewer and wider
//! ones in grids that were adapted, so a cell never needs a second brick; bricks whose samples are
//! all zero are not stored.
//!
//! - `adapted`: grids whose bricks are on levels of their own
//! - `brick`: a brick and its cells
//! - `coarse`: bricks on the levels of a pyramid
//! - `layout`: which bricks are stored, and how they are filled
//! - `packed`: bricks as files have them
//! - `pyramid`: the same field on larger voxels
//! - `stored_errors`: what a file says of bricks, of which none is read
//! - `volume_grid`: the grid of a volume, which may be in a file until it is looked into

mod adapted;
mod brick;
mod coarse;
mod layout;
mod packed;
mod pyramid;
mod stored_errors;
mod volume_grid;

pub use adapted::{Allowed, Errors};
pub use brick::{Brick, Cell, largest};
pub(super) use layout::{Layout, Region, VoxelBox};
pub use pyramid::Pyramid;
pub use volume_grid::{Known, StoredBricks, StoredLevels, VolumeGrid};

use crate::math::unflatten;
use crate::run::{List, Lists};
use crate::{Error, Result};
use brick::CoarseBricks;
use glam::Vec3;
use rayon::prelude::*;
use std::convert::Infallible;
use std::ops::Range;

/// Cells along an edge of a brick.
pub const BRICK_CELLS: usize = 8;
const BRICK_EDGE: usize = BRICK_CELLS + 1;
const BRICK_SAMPLES: usize = BRICK_EDGE * BRICK_EDGE * BRICK_EDGE;
const ABSENT: u32 = u32::MAX;

/// A scalar field on a grid; see the module for its spaces.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    dims: [usize; 3],
    /// Of the box, in voxels.
    size: [f32; 3],
    bricks: [usize; 3],
    slots: Vec<u32>,
    samples: List<f32>,
    maxima: Vec<f32>,
    coarse: CoarseBricks,
}

impl Grid {
    /// A grid of `dims` voxels whose samples are `value([i, j, k])`. The function is called once or
    /// more for each voxel, from several threads, and must give the same finite number of at least
    /// 0 every time.
    pub fn from_fn(dims: [usize; 3], value: impl Fn([usize; 3]) -> f32 + Sync) -> Self {
        let may_hold =
            |voxels: &VoxelBox| Ok::<_, Infallible>(voxels.voxels().any(|v| value(v) != 0.0));
        let Ok(layout) = Layout::of(dims, may_hold);
        let samples = vec![0.0; layout.samples()].into();
        let Ok((grid, _)) = layout.fill(samples, |region, samples| {
            let voxels = region.voxels.voxels();
            samples
                .iter_mut()
                .zip(voxels)
                .for_each(|(s, v)| *s = value(v));
            Ok::<_, Infallible>(())
        });
        grid
    }

    /// A grid of `dims` voxels from all its samples, x fastest.
    ///
    /// # Errors
    /// A number of samples that is not the product of `dims`, dims of 0, or a sample that is not
    /// finite or is negative.
    pub fn dense(dims: [usize; 3], samples: &[f32]) -> Result<Self> {
        let count = voxel_count(dims)?;
        if samples.len() != count {
            return Err(Error::input(format!(
                "expected {count} samples for {dims:?} voxels, found {}",
                samples.len()
            )));
        }
        let grid = Self::from_fn(dims, |[i, j, k]| samples[(k * dims[1] + j) * dims[0] + i]);
        grid.checked()
    }

    /// A grid of `dims` voxels from those whose samples are not 0, in any order; of two samples of
    /// one voxel the last counts. Memory and time are those of the bricks of 8^3 cells that hold
    /// samples, and 4 bytes for each brick that does not.
    ///
    /// # Errors
    /// Dims of 0, a voxel outside of them, or a sample that is not finite or is negative.
    pub fn sparse(
        dims: [usize; 3],
        voxels: impl IntoIterator<Item = ([usize; 3], f32)>,
    ) -> Result<Self> {
        voxel_count(dims)?;
        let bricks = brick_dims(dims);
        let mut grid = Self {
            dims,
            size: dims.map(|n| n as f32),
            bricks,
            slots: vec![ABSENT; bricks.iter().product()],
            samples: Vec::new().into(),
            maxima: Vec::new(),
            coarse: CoarseBricks::NONE,
        };
        let mut samples = Vec::new();
        for (voxel, sample) in voxels {
            if (0..3).any(|a| voxel[a] >= dims[a]) {
                return Err(Error::input(format!(
                    "the voxel {voxel:?} is not one of {dims:?}"
                )));
            }
            grid.set(&mut samples, voxel, sample);
        }
        let maximum = |brick: &[f32]| brick.iter().copied().fold(0.0, f32::max);
        grid.maxima = samples.chunks(BRICK_SAMPLES).map(maximum).collect();
        grid.samples = samples.into();
        grid.checked()
    }

    /// Sets the sample of a voxel among those of all bricks that have it at a corner of their cells,
    /// and stores those that are not stored.
    fn set(&mut self, samples: &mut Vec<f32>, voxel: [usize; 3], sample: f32) {
        let along: [Vec<(usize, usize)>; 3] = std::array::from_fn(|a| {
            // Corner c of cell space is sample c - 1, clamped to the grid.
            let first = if voxel[a] == 0 { 0 } else { voxel[a] + 1 };
            let last = match voxel[a] + 1 == self.dims[a] {
                true => self.bricks[a] * BRICK_CELLS,
                false => voxel[a] + 1,
            };
            let bricks = first.saturating_sub(1) / BRICK_CELLS..=last / BRICK_CELLS;
            let bricks = bricks.take_while(|b| *b < self.bricks[a]);
            let in_brick = |b: usize| {
                let base = b * BRICK_CELLS;
                let corners = first.max(base)..=last.min(base + BRICK_CELLS);
                corners.map(move |c| (b, c - base))
            };
            bricks.flat_map(in_brick).collect()
        });
        for &(bz, z) in &along[2] {
            for &(by, y) in &along[1] {
                for &(bx, x) in &along[0] {
                    let slot = &mut self.slots[(bz * self.bricks[1] + by) * self.bricks[0] + bx];
                    if *slot == ABSENT {
                        *slot = (samples.len() / BRICK_SAMPLES) as u32;
                        samples.resize(samples.len() + BRICK_SAMPLES, 0.0);
                    }
                    let at = (z * BRICK_EDGE + y) * BRICK_EDGE + x;
                    samples[*slot as usize * BRICK_SAMPLES + at] = sample;
                }
            }
        }
    }

    /// Another grid of as many voxels, with samples in the bricks that this one stores. `read` is
    /// as for [`Layout::fill`].
    pub(super) fn on_its_bricks<T: Send, E: Send>(
        &self,
        read: impl Fn(&Region, &mut [f32]) -> Result<T, E> + Sync,
    ) -> Result<(Self, Vec<T>), E> {
        let layout = Layout::of_stored(self);
        let samples = self.lists().zeros_surely(layout.samples());
        let (mut grid, told) = layout.fill(samples, read)?;
        grid.size = self.size;
        Ok((grid, told))
    }

    fn checked(self) -> Result<Self> {
        match self.first_invalid() {
            None => Ok(self),
            Some(value) => Err(Error::input(format!(
                "expected finite samples of at least 0, found {value}"
            ))),
        }
    }

    /// A stored sample that is not finite, or negative, if there is any.
    pub(super) fn first_invalid(&self) -> Option<f32> {
        let is_wrong = |v: &&f32| !(v.is_finite() && **v >= 0.0);
        self.samples.iter().find(is_wrong).copied()
    }

    /// Means over blocks of so many voxels along each axis, x fastest; blocks at the far ends may
    /// have fewer.
    #[must_use]
    pub fn means(&self, block: [usize; 3]) -> Vec<f32> {
        let mut means = vec![0.0; self.blocks(block).iter().product()];
        self.write_means(block, &mut means);
        means
    }

    /// Writes the same where there is room for all of them.
    pub fn write_means(&self, block: [usize; 3], means: &mut [f32]) {
        let [nx, ny, _] = self.blocks(block);
        let size = |axis: usize, at: usize| {
            let first = at * block[axis];
            (first + block[axis]).min(self.dims[axis]) - first
        };
        let layers = means.par_chunks_mut(nx * ny).enumerate();
        layers.for_each(|(k, layer)| {
            // Memory that is read before it is written to is mapped twice.
            layer.fill(0.0);
            let first = k * block[2];
            for z in first..first + size(2, k) {
                self.each_row_in_layer(z, |mut x, y, mut row| {
                    let sums = &mut layer[y / block[1] * nx..][..nx];
                    while !row.is_empty() {
                        let column = x / block[0];
                        let own = ((column + 1) * block[0] - x).min(row.len());
                        let (values, rest) = row.split_at(own);
                        sums[column] = values.iter().fold(sums[column], |sum, v| sum + v);
                        (x, row) = (x + own, rest);
                    }
                });
            }
            for (i, mean) in layer.iter_mut().enumerate() {
                *mean /= (size(0, i % nx) * size(1, i / nx) * size(2, k)) as f32;
            }
            self.give_back_layers(
                (first + 1) / BRICK_CELLS..(first + size(2, k)) / BRICK_CELLS + 1,
            );
        });
    }

    /// Gives the memory of layers of bricks back to the system, if they lie in a file.
    fn give_back_layers(&self, layers: Range<usize>) {
        if !self.samples.is_in_file() {
            return;
        }
        let layer = self.bricks[0] * self.bricks[1];
        let slots = self.slots.get(layers.start * layer..layers.end * layer);
        let stored = slots.into_iter().flatten().filter(|slot| **slot != ABSENT);
        let [first, last] = stored.fold([u32::MAX, 0], |[first, last], slot| {
            [first.min(*slot), last.max(*slot)]
        });
        if first <= last {
            let [(_, first), (_, last)] = [first, last].map(|slot| self.coarse.place(slot));
            self.samples.give_back(first.start..last.end);
        }
    }

    /// Blocks of so many voxels along each axis, the last of which may have fewer.
    #[must_use]
    pub fn blocks(&self, block: [usize; 3]) -> [usize; 3] {
        std::array::from_fn(|a| self.dims[a].div_ceil(block[a]))
    }

    /// Gives the samples of one layer in stored bricks to `take`, each once: those of a row from a
    /// voxel on.
    fn each_row_in_layer(&self, z: usize, mut take: impl FnMut(usize, usize, &[f32])) {
        let [width, height, _] = self.dims;
        let corner = z + 1;
        for j in 0..self.bricks[1] {
            for i in 0..self.bricks[0] {
                let Some(brick) = self.brick([i, j, corner / BRICK_CELLS]) else {
                    continue;
                };
                let mut layer = [0.0; BRICK_EDGE * BRICK_EDGE];
                let layer = brick.layer(corner % BRICK_CELLS, &mut layer);
                // Corner c of cell space is sample c - 1; those of the first cell are of the brick
                // before, or are clamped.
                let samples = |b: usize, n: usize| {
                    (b * BRICK_CELLS).max(1)..(b * BRICK_CELLS + BRICK_CELLS).min(n + 1)
                };
                let xs = samples(i, width);
                for y in samples(j, height) {
                    let row = &layer[y % BRICK_CELLS * BRICK_EDGE + xs.start % BRICK_CELLS..];
                    take(xs.start - 1, y - 1, &row[..xs.len()]);
                }
            }
        }
    }

    /// Voxels along x, y, z of index space.
    #[must_use]
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Size of the box in voxels: their number, or less where the last reach beyond the box, as
    /// those of [`Self::coarser`] may.
    #[must_use]
    pub fn size(&self) -> [f32; 3] {
        self.size
    }

    /// Bricks along x, y, z, stored or not.
    #[must_use]
    pub fn brick_dims(&self) -> [usize; 3] {
        self.bricks
    }

    /// All bricks, x fastest, empty or not.
    pub fn bricks(&self) -> impl Iterator<Item = [usize; 3]> + use<> {
        let dims = self.brick_dims();
        (0..dims.iter().product()).map(move |i| unflatten(i, dims))
    }

    /// The brick at brick coordinates, if any of its samples is not zero; in grids that were
    /// adapted some may be there of which all are.
    #[must_use]
    #[inline]
    pub fn brick(&self, b: [usize; 3]) -> Option<Brick<'_>> {
        let slot = self.slots[(b[2] * self.bricks[1] + b[1]) * self.bricks[0] + b[0]];
        (slot != ABSENT).then(|| {
            let (level, samples) = self.coarse.place(slot);
            Brick {
                samples: &self.samples[samples],
                max: self.maxima[slot as usize],
                level,
            }
        })
    }

    /// The largest sample.
    #[must_use]
    pub fn max(&self) -> f32 {
        self.maxima.iter().copied().fold(0.0, f32::max)
    }

    /// Lowers what is above `most` to that.
    pub fn limit(&mut self, most: f32) {
        if self.max() > most {
            let limited = |v: &mut f32| *v = v.min(most);
            self.samples.iter_mut().for_each(limited);
            self.maxima.iter_mut().for_each(limited);
        }
    }

    /// Where its samples are, and those that are made of them go.
    #[must_use]
    pub fn lists(&self) -> &Lists {
        self.samples.lists()
    }

    /// Bytes that bricks and their table take, in memory or in a temporary file.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.slots.len() * 4 + self.samples.len() * 4 + self.maxima.len() * 4
    }

    /// Trilinear value at a point of index space; zero outside the box.
    #[must_use]
    pub fn sample(&self, point_in_index: Vec3) -> f32 {
        let p = point_in_index.to_array();
        if !(0..3).all(|a| p[a] >= 0.0 && p[a] <= self.size[a]) {
            return 0.0;
        }
        let cell: [usize; 3] = std::array::from_fn(|a| ((p[a] + 0.5) as usize).min(self.dims[a]));
        match self.brick(cell.map(|c| c / BRICK_CELLS)) {
            None => 0.0,
            Some(brick) if brick.level == 0 => {
                let f: [f32; 3] = std::array::from_fn(|a| p[a] + 0.5 - cell[a] as f32);
                let cell = brick.cell::<true>(cell.map(|c| c % BRICK_CELLS));
                cell.value(f.into())
            }
            Some(brick) => {
                let edge = (1 << brick.level) as f32;
                let first = cell.map(|c| c >> brick.level << brick.level);
                let f: [f32; 3] = std::array::from_fn(|a| (p[a] + 0.5 - first[a] as f32) / edge);
                let cell = brick.cell::<false>(first.map(|c| (c % BRICK_CELLS) >> brick.level));
                cell.value(f.into())
            }
        }
    }
}

/// The number of a place among so many along each axis, x fastest.
fn flatten([x, y, z]: [usize; 3], [nx, ny, _]: [usize; 3]) -> usize {
    (z * ny + y) * nx + x
}

/// Bricks along each axis: there is a cell before the first sample and one behind the last.
fn brick_dims(dims: [usize; 3]) -> [usize; 3] {
    dims.map(|n| (n + 1).div_ceil(BRICK_CELLS))
}

fn voxel_count(dims: [usize; 3]) -> Result<usize> {
    let count = dims.iter().try_fold(1_usize, |n, &d| n.checked_mul(d));
    count
        .filter(|&n| n > 0 && n <= isize::MAX as usize)
        .ok_or_else(|| {
            Error::input(format!(
                "expected a grid of at least one voxel that memory can hold, found {dims:?}"
            ))
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_linear_field_is_reproduced_between_centres_and_clamped_at_the_border() {
        let grid = Grid::from_fn([20, 9, 4], |[i, j, k]| {
            1.0 + i as f32 + 100.0 * j as f32 + 0.25 * k as f32
        });
        let expected = |p: Vec3| {
            let q = (p - 0.5).clamp(Vec3::ZERO, Vec3::new(19.0, 8.0, 3.0));
            1.0 + q.x + 100.0 * q.y + 0.25 * q.z
        };
        for p in [
            [0.0; 3],
            [0.2, 0.1, 0.3],
            [7.5, 4.0, 2.0],
            [8.49, 8.51, 3.9],
            [20.0, 9.0, 4.0],
        ]
        .map(Vec3::from)
        {
            assert!((grid.sample(p) - expected(p)).abs() < 1e-3, "{p}");
        }
        assert_eq!(grid.sample(Vec3::new(-0.01, 1.0, 1.0)), 0.0);
        assert_eq!(grid.sample(Vec3::new(1.0, 9.01, 1.0)), 0.0);
    }

    #[test]
    fn a_sparse_grid_is_the_dense_one_of_its_voxels() {
        for dims in [[1, 1, 1], [7, 8, 9], [37, 16, 23], [15, 3, 17]] {
            let voxel = |i: usize| unflatten(i, dims);
            let value = |i: usize| ((i * 7919) % 97 < 3) as u8 as f32 * (i + 1) as f32;
            let count = dims.iter().product();
            let dense = Grid::dense(dims, &(0..count).map(value).collect::<Vec<_>>()).unwrap();
            let stored = (0..count).rev().filter(|&i| value(i) != 0.0);
            let sparse = Grid::sparse(dims, stored.map(|i| (voxel(i), value(i)))).unwrap();
            for b in dense.bricks() {
                let samples = |grid: &Grid| grid.brick(b).map(|b| b.samples().to_vec());
                assert_eq!(samples(&dense), samples(&sparse), "{dims:?} {b:?}");
                assert_eq!(
                    dense.brick(b).map(|b| b.max),
                    sparse.brick(b).map(|b| b.max)
                );
            }
        }
    }

    #[test]
    fn grids_of_wrong_values_are_refused() {
        let wrong = |grid: Result<Grid>, says: &str| {
            let message = grid.unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        };
        wrong(Grid::dense([2, 1, 1], &[1.0]), "expected 2 samples");
        wrong(Grid::dense([2, 0, 1], &[]), "at least one voxel");
        wrong(Grid::dense([2, 1, 1], &[1.0, f32::NAN]), "found NaN");
        wrong(Grid::sparse([2, 1, 1], [([2, 0, 0], 1.0)]), "[2, 0, 0]");
        wrong(Grid::sparse([2, 1, 1], [([1, 0, 0], -1.0)]), "found -1");
        wrong(Grid::sparse([usize::MAX, 2, 1], []), "memory can hold");
    }

    #[test]
    fn means_are_those_of_the_voxels_in_each_block() {
        let value = |[i, j, k]: [usize; 3]| {
            let is_empty = i < 16 && j < 16;
            if is_empty {
                0.0
            } else {
                (1 + i + 100 * j + 7 * k) as f32
            }
        };
        let dims = [37, 19, 10];
        let grid = Grid::from_fn(dims, value);
        for block in [[1, 1, 1], [2, 3, 1], [8, 4, 16]] {
            let blocks = grid.blocks(block);
            let means = grid.means(block);
            assert_eq!(means.len(), blocks.iter().product::<usize>());
            for (i, &mean) in means.iter().enumerate() {
                let at = unflatten(i, blocks);
                let along = |a: usize| {
                    let first = at[a] * block[a];
                    first..(first + block[a]).min(dims[a])
                };
                let mut sum = 0.0;
                for (x, y) in along(0).flat_map(|x| along(1).map(move |y| (x, y))) {
                    sum += along(2).map(|z| value([x, y, z])).sum::<f32>();
                }
                let expected = sum / (along(0).len() * along(1).len() * along(2).len()) as f32;
                assert!(
                    (mean - expected).abs() <= 1e-5 * expected,
                    "{block:?} {at:?}"
                );
            }
        }
    }

    #[test]
    fn empty_bricks_are_not_stored() {
        let grid = Grid::from_fn([64, 64, 64], |v| f32::from(v == [39, 39, 39]));
        assert_eq!(
            grid.maxima.len(),
            8,
            "corner 40 is shared by the bricks of cells 39 and 40"
        );
        assert_eq!(grid.sample(Vec3::splat(39.5)), 1.0);
    }
}
