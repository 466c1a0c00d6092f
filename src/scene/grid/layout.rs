//! Which bricks a grid stores, before it stores any, and how they are filled: a region of bricks at
//! a time, so that what samples come from is read in boxes and on all threads.

use super::brick::{CoarseBricks, largest};
use super::{ABSENT, BRICK_CELLS, BRICK_EDGE, BRICK_SAMPLES, Grid, brick_dims};
use crate::Result;
use crate::math::unflatten;
use crate::run::List;
use rayon::prelude::*;

/// Bricks along an edge of a region. A region needs the samples of one more layer of voxels than it
/// has to itself, which large ones share among more bricks.
const REGION_BRICKS: usize = 8;

/// A box of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::scene) struct VoxelBox {
    /// Its first voxel.
    pub first: [usize; 3],
    /// Voxels along each axis.
    pub dims: [usize; 3],
}

impl VoxelBox {
    /// One voxel.
    pub fn one(voxel: [usize; 3]) -> Self {
        Self {
            first: voxel,
            dims: [1; 3],
        }
    }

    /// Number of its voxels.
    pub fn count(&self) -> usize {
        self.dims.iter().product()
    }

    /// All its voxels, x fastest.
    pub fn voxels(self) -> impl Iterator<Item = [usize; 3]> {
        let along = move |a: usize| self.first[a]..self.first[a] + self.dims[a];
        along(2).flat_map(move |k| along(1).flat_map(move |j| along(0).map(move |i| [i, j, k])))
    }

    /// The first voxel of each row, and where the row's samples start among those of the box.
    pub fn rows(self) -> impl Iterator<Item = ([usize; 3], usize)> {
        let [nx, ny, nz] = self.dims;
        (0..ny * nz).map(move |row| {
            let [x, y, z] = self.first;
            ([x, y + row % ny, z + row / ny], row * nx)
        })
    }
}

/// The voxels at the corners of the cells of some bricks.
#[derive(Clone, Copy, Debug)]
pub(in crate::scene) struct Region {
    /// All of them.
    pub voxels: VoxelBox,
    /// How many along each axis, from the first on, are of no other region.
    pub own: [usize; 3],
}

/// Which bricks a grid has to store, before it stores any.
pub(in crate::scene) struct Layout {
    dims: [usize; 3],
    bricks: [usize; 3],
    /// Numbers of the bricks that may have to be stored, in order.
    stored: Vec<usize>,
}

impl Layout {
    /// Finds the bricks that a grid of `dims` voxels may have to store: those of whose voxels
    /// `may_hold` says that a sample may not be 0. Its error ends the search.
    pub(in crate::scene) fn of<E: Send>(
        dims: [usize; 3],
        may_hold: impl Fn(&VoxelBox) -> Result<bool, E> + Sync,
    ) -> Result<Self, E> {
        let mut layout = Self {
            dims,
            bricks: brick_dims(dims),
            stored: Vec::new(),
        };
        let bricks = (0..layout.bricks.iter().product()).into_par_iter();
        let stored = bricks.filter_map(|b| {
            let voxels = layout.voxels(unflatten(b, layout.bricks), 1);
            match may_hold(&voxels) {
                Ok(holds) => holds.then_some(Ok(b)),
                Err(e) => Some(Err(e)),
            }
        });
        layout.stored = stored.collect::<Result<_, E>>()?;
        Ok(layout)
    }

    /// The bricks that a grid stores.
    pub(super) fn of_stored(grid: &Grid) -> Self {
        let stored = grid.slots.iter().enumerate();
        let stored = stored.filter(|(_, slot)| **slot != ABSENT);
        Self {
            dims: grid.dims,
            bricks: grid.bricks,
            stored: stored.map(|(b, _)| b).collect(),
        }
    }

    /// Bytes that the grid will hold, at most.
    pub(in crate::scene) fn bytes(&self) -> u64 {
        let brick = (BRICK_SAMPLES + 1) * size_of::<f32>();
        let slots = self.bricks.iter().product::<usize>() * size_of::<u32>();
        (self.stored.len() * brick + slots) as u64
    }

    /// Samples that the grid will have, at most.
    pub(in crate::scene) fn samples(&self) -> usize {
        self.stored.len() * BRICK_SAMPLES
    }

    /// The grid, and what `read` returns of each region with bricks to store, in order. `samples`
    /// are as many zeros as it will have at most, for its own. `read`
    /// writes the samples of a region, x fastest; all of them are to be finite and at least 0. Its
    /// error ends the filling: the first, in the order of regions.
    pub(in crate::scene) fn fill<T: Send, E: Send>(
        self,
        mut samples: List<f32>,
        read: impl Fn(&Region, &mut [f32]) -> Result<T, E> + Sync,
    ) -> Result<(Grid, Vec<T>), E> {
        let regions_dims = self.bricks.map(|n| n.div_ceil(REGION_BRICKS));
        let mut maxima = vec![None; self.stored.len()];
        let mut regions: Vec<Vec<_>> = Vec::new();
        regions.resize_with(regions_dims.iter().product(), Vec::new);
        let places = samples.chunks_mut(BRICK_SAMPLES).zip(&mut maxima);
        for (&b, (brick, max)) in self.stored.iter().zip(places) {
            let at = unflatten(b, self.bricks);
            let [x, y, z] = at.map(|i| i / REGION_BRICKS);
            let region = (z * regions_dims[1] + y) * regions_dims[0] + x;
            regions[region].push((at, brick, max));
        }
        let filled = regions
            .into_par_iter()
            .enumerate()
            .filter(|(_, bricks)| !bricks.is_empty())
            .map_init(Vec::new, |buffer, (r, bricks)| {
                let first = unflatten(r, regions_dims).map(|i| i * REGION_BRICKS);
                let region = self.region(first);
                buffer.resize(region.voxels.count(), 0.0);
                let told = read(&region, buffer)?;
                for (at, brick, max) in bricks {
                    self.cut(at, &region.voxels, buffer, brick);
                    // Not the maximum: there may be samples that are no numbers.
                    let is_empty = brick.iter().all(|v| *v == 0.0);
                    *max = (!is_empty).then(|| largest(brick));
                }
                Ok(told)
            });
        let filled: Vec<Result<T, E>> = filled.collect();
        let told = filled.into_iter().collect::<Result<_, E>>()?;
        Ok((self.packed(samples, &maxima), told))
    }

    /// The grid of bricks that have a maximum, those that are empty after all left out.
    fn packed(self, mut samples: List<f32>, maxima: &[Option<f32>]) -> Grid {
        let mut slots = vec![ABSENT; self.bricks.iter().product()];
        let mut kept = 0;
        for (from, (&b, max)) in self.stored.iter().zip(maxima).enumerate() {
            if max.is_some() {
                if kept < from {
                    let brick = from * BRICK_SAMPLES..(from + 1) * BRICK_SAMPLES;
                    samples.copy_within(brick, kept * BRICK_SAMPLES);
                }
                slots[b] = kept as u32;
                kept += 1;
            }
        }
        samples.truncate(kept * BRICK_SAMPLES);
        Grid {
            dims: self.dims,
            size: self.dims.map(|n| n as f32),
            bricks: self.bricks,
            slots,
            samples,
            maxima: maxima.iter().flatten().copied().collect(),
            coarse: CoarseBricks::NONE,
        }
    }

    /// The voxels at the corners of the cells of `count` bricks along each axis from brick `b` on.
    fn voxels(&self, b: [usize; 3], count: usize) -> VoxelBox {
        // Corner c of cell space is sample c - 1, clamped to the grid.
        let first = b.map(|i| (i * BRICK_CELLS).saturating_sub(1));
        let end = |a: usize| ((b[a] + count) * BRICK_CELLS).min(self.dims[a]);
        VoxelBox {
            first: std::array::from_fn(|a| first[a].min(self.dims[a] - 1)),
            dims: std::array::from_fn(|a| end(a) - first[a].min(self.dims[a] - 1)),
        }
    }

    fn region(&self, first_brick: [usize; 3]) -> Region {
        let voxels = self.voxels(first_brick, REGION_BRICKS);
        let own = std::array::from_fn(|a| {
            let is_last = first_brick[a] + REGION_BRICKS >= self.bricks[a];
            voxels.dims[a] - usize::from(!is_last)
        });
        Region { voxels, own }
    }

    /// Copies the samples of one brick out of those of a region.
    fn cut(&self, b: [usize; 3], region: &VoxelBox, samples: &[f32], brick: &mut [f32]) {
        let at: [[usize; BRICK_EDGE]; 3] = std::array::from_fn(|a| {
            std::array::from_fn(|i| {
                let voxel = (b[a] * BRICK_CELLS + i).saturating_sub(1);
                voxel.min(self.dims[a] - 1) - region.first[a]
            })
        });
        let [nx, ny, _] = region.dims;
        let rows = at[2].iter().flat_map(|z| at[1].map(|y| (z * ny + y) * nx));
        let is_inside = at[0][BRICK_CELLS] - at[0][0] == BRICK_CELLS;
        for (out, row) in brick.chunks_exact_mut(BRICK_EDGE).zip(rows) {
            let row = &samples[row..row + nx];
            if is_inside {
                out.copy_from_slice(&row[at[0][0]..][..BRICK_EDGE]);
                continue;
            }
            for (sample, &x) in out.iter_mut().zip(&at[0]) {
                *sample = row[x];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_voxel_is_of_one_region_alone() {
        for dims in [[1, 1, 1], [7, 8, 9], [62, 63, 64], [65, 127, 200]] {
            let layout = Layout::of(dims, |_| Ok::<_, ()>(true)).unwrap();
            let samples = vec![0.0; layout.samples()].into();
            let (_, regions) = layout
                .fill(samples, |region, samples| {
                    samples.fill(1.0);
                    Ok::<_, ()>(*region)
                })
                .unwrap();
            let mut times = vec![0; dims.iter().product()];
            for region in regions {
                let own = VoxelBox {
                    first: region.voxels.first,
                    dims: region.own,
                };
                for [i, j, k] in own.voxels() {
                    times[(k * dims[1] + j) * dims[0] + i] += 1;
                }
            }
            assert!(times.iter().all(|n| *n == 1), "{dims:?}");
        }
    }
}
