//! Grids to bricks of 8^3 samples, as files have them, and back.
//!
//! Such a brick has the samples at all corners of a brick's cells but the first along each axis,
//! which are those at the last corners of the bricks before it.

use super::{ABSENT, BRICK_CELLS, BRICK_EDGE, BRICK_SAMPLES, Brick, Grid, Known, brick_dims};
use crate::formats::{BRICK_VOXELS, BrickEntry, BrickSamples, PAGE_BRICKS};
use crate::math::unflatten;
use crate::run::memory;
use crate::{Error, Result};
use rayon::prelude::*;

/// Corners of a brick's cells that are the first along any axis.
const SHARED: usize = BRICK_SAMPLES - BRICK_VOXELS;

/// Bricks whose shared corners are held at a time while they are copied.
const AT_A_TIME: usize = 4096;

/// The samples that a brick has in files, and may not share with others.
fn own(samples: &[f32]) -> BrickSamples {
    let mut own = [0.0; BRICK_VOXELS];
    for (row, out) in own.chunks_exact_mut(BRICK_CELLS).enumerate() {
        out.copy_from_slice(&samples[own_row(row)..][..BRICK_CELLS]);
    }
    // Zeros have no sign in files.
    own.map(|v| v + 0.0)
}

/// Where a row of a brick's own samples is among all of them.
fn own_row(row: usize) -> usize {
    let (y, z) = (row % BRICK_CELLS, row / BRICK_CELLS);
    ((z + 1) * BRICK_EDGE + y + 1) * BRICK_EDGE + 1
}

impl Grid {
    /// The samples of a brick as files have them; 0 if it is not stored.
    pub(in crate::scene) fn own_samples(&self, [x, y, z]: [u32; 3]) -> BrickSamples {
        let brick = self.brick([x as usize, y as usize, z as usize]);
        brick.map_or([0.0; BRICK_VOXELS], |brick| own(brick.samples))
    }

    /// What files say of its bricks, of those that have samples of their own other than 0.
    pub(in crate::scene) fn entries(&self) -> Vec<BrickEntry> {
        let bricks = (0..self.slots.len()).into_par_iter();
        let entry = |i: usize| {
            let place = unflatten(i, self.bricks).map(|c| c as u32);
            match self.slots[i] {
                ABSENT => None,
                _ => BrickEntry::of(place, &self.own_samples(place)),
            }
        };
        bricks.filter_map(entry).collect()
    }

    /// The grid of a size with these bricks. `read` gives the samples of all bricks of a
    /// page, of which each but the last has [`PAGE_BRICKS`], by their numbers in it; they are as
    /// the entries say, and finite. All places are inside.
    ///
    /// # Errors
    /// Those of `read`, the first in the order of pages; a size that memory does not have.
    /// Whether corners of cells beyond its outermost samples have the values of these.
    #[must_use]
    pub fn has_right_borders(&self) -> bool {
        let is_border = |b: &[usize; 3]| (0..3).any(|a| b[a] == 0 || b[a] + 1 == self.bricks[a]);
        let is_right = |b: [usize; 3]| {
            let Some(brick) = self.brick(b) else {
                return true;
            };
            (0..BRICK_SAMPLES)
                .map(|i| unflatten(i, [BRICK_EDGE; 3]))
                .all(|at| {
                    // Corner c of cell space is sample c - 1.
                    let inside: [usize; 3] = std::array::from_fn(|a| {
                        let base = b[a] * BRICK_CELLS;
                        (base + at[a]).clamp(1, self.dims[a]) - base
                    });
                    let sample = |[x, y, z]: [usize; 3]| {
                        brick.samples[(z * BRICK_EDGE + y) * BRICK_EDGE + x]
                    };
                    sample(at) == sample(inside)
                })
        };
        self.bricks().filter(is_border).all(is_right)
    }

    pub(in crate::scene) fn unpack(
        known: Known,
        entries: &[BrickEntry],
        read: impl Fn(usize, &mut dyn FnMut(usize, &BrickSamples)) -> Result<()> + Sync,
    ) -> Result<Self> {
        const WHAT: &str = "the grid of a volume";
        let dims = known.dims;
        let bricks = brick_dims(dims);
        let count: usize = bricks.iter().product();
        memory::check(WHAT, (count * size_of::<u32>()) as u64)?;
        let mut slots = memory::filled(WHAT, ABSENT, count)?;
        let place = |[x, y, z]: [usize; 3]| (z * bricks[1] + y) * bricks[0] + x;
        let of = |entry: &BrickEntry| place(entry.place.map(|c| c as usize));
        for entry in entries {
            for i in (0..8_usize).filter(|i| *i == 0 || entry.ends >> (i - 1) & 1 == 1) {
                let at = std::array::from_fn(|a| entry.place[a] as usize + (i >> a & 1));
                if (0..3).all(|a| at[a] < bricks[a]) {
                    slots[place(at)] = 0;
                }
            }
        }
        let mut stored = Vec::new();
        for (b, slot) in slots.iter_mut().enumerate().filter(|(_, s)| **s != ABSENT) {
            *slot = stored.len() as u32;
            stored.push(b);
        }
        let bytes = stored.len() * (BRICK_SAMPLES + 1) * size_of::<f32>();
        memory::check(WHAT, bytes as u64)?;
        let mut samples = zeros(WHAT, stored.len() * BRICK_SAMPLES)?;
        let mut all: Vec<_> = samples.chunks_exact_mut(BRICK_SAMPLES).map(Some).collect();
        let own = |entry| {
            let taken = all[slots[of(entry)] as usize].take();
            taken.ok_or_else(|| Error::input("a brick of a volume is there twice"))
        };
        let mut own = entries.iter().map(own).collect::<Result<Vec<_>>>()?;
        let pages = own.par_chunks_mut(PAGE_BRICKS).enumerate();
        let read: Vec<Result<()>> = pages
            .map(|(page, bricks)| {
                read(page, &mut |i, samples| {
                    let rows = samples.chunks_exact(BRICK_CELLS).enumerate();
                    rows.for_each(|(row, from)| {
                        bricks[i][own_row(row)..][..BRICK_CELLS].copy_from_slice(from);
                    });
                })
            })
            .collect();
        read.into_iter().collect::<Result<()>>()?;
        let mut grid = Self {
            dims,
            size: known.size,
            bricks,
            slots,
            samples,
            maxima: vec![0.0; stored.len()],
        };
        for entry in entries {
            grid.maxima[grid.slots[of(entry)] as usize] = entry.max;
        }
        grid.share_corners(&stored);
        Ok(grid)
    }

    /// Fills the first corners along each axis of all bricks, whose numbers are `stored`, from the
    /// last of those before them.
    fn share_corners(&mut self, stored: &[usize]) {
        let mut shared = vec![[0.0; SHARED]; stored.len().min(AT_A_TIME)];
        for first in (0..stored.len()).step_by(AT_A_TIME) {
            let some = &stored[first..stored.len().min(first + AT_A_TIME)];
            let grid = &*self;
            let copied = some.par_iter().zip(&mut shared);
            copied.for_each(|(b, shared)| grid.shared_corners(unflatten(*b, grid.bricks), shared));
            let range = first * BRICK_SAMPLES..(first + some.len()) * BRICK_SAMPLES;
            let bricks = self.samples[range].par_chunks_exact_mut(BRICK_SAMPLES);
            let maxima = &mut self.maxima[first..first + some.len()];
            bricks
                .zip(maxima)
                .zip(&shared)
                .for_each(|((brick, max), shared)| {
                    for (corner, value) in SHARED_CORNERS.iter().zip(shared) {
                        let [x, y, z] = corner.map(usize::from);
                        brick[(z * BRICK_EDGE + y) * BRICK_EDGE + x] = *value;
                        *max = max.max(*value);
                    }
                });
        }
    }

    /// The samples at the first corners of brick `b`, in the order of [`SHARED_CORNERS`].
    fn shared_corners(&self, b: [usize; 3], out: &mut [f32; SHARED]) {
        // Bricks from which they come, by the axes along which these are before.
        let before: [Option<Brick<'_>>; 8] = std::array::from_fn(|i| {
            let at = std::array::from_fn(|a| b[a] - (i >> a & 1).min(b[a]));
            self.brick(at)
        });
        // Before the first sample the grid has that.
        let is_first = b.map(|b| b == 0);
        for (corner, out) in SHARED_CORNERS.iter().zip(out) {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|a| match corner[a] {
                0 if is_first[a] => 1,
                0 => BRICK_CELLS,
                i => i as usize,
            });
            let which = corner.map(|i| usize::from(i == 0));
            let brick = &before[which[0] | which[1] << 1 | which[2] << 2];
            let at = (z * BRICK_EDGE + y) * BRICK_EDGE + x;
            *out = brick.as_ref().map_or(0.0, |brick| brick.samples[at]);
        }
    }
}

/// Corners of a brick's cells that are the first along any axis.
const SHARED_CORNERS: [[u8; 3]; SHARED] = {
    let mut corners = [[0; 3]; SHARED];
    let (mut found, mut i) = (0, 0);
    while i < BRICK_SAMPLES {
        let at = [
            i % BRICK_EDGE,
            i / BRICK_EDGE % BRICK_EDGE,
            i / BRICK_EDGE / BRICK_EDGE,
        ];
        if at[0] == 0 || at[1] == 0 || at[2] == 0 {
            corners[found] = [at[0] as u8, at[1] as u8, at[2] as u8];
            found += 1;
        }
        i += 1;
    }
    corners
};

/// So many zeros, which take no memory before they are touched.
fn zeros(what: &str, count: usize) -> Result<Vec<f32>> {
    // Asked for first, as there is no fallible way to get zeros that are not written.
    drop(memory::room::<f32>(what, count)?);
    Ok(vec![0.0; count])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::BrickTable;

    fn known(grid: &Grid) -> Known {
        Known {
            dims: grid.dims,
            size: grid.size,
            max: grid.max(),
            bricks: grid.maxima.len(),
        }
    }

    /// The grid of the bricks of another.
    fn again(grid: &Grid) -> Grid {
        let table = BrickTable::new(grid.entries());
        let pages: Vec<_> = table.entries().chunks(PAGE_BRICKS).collect();
        let read = |page: usize, take: &mut dyn FnMut(usize, &BrickSamples)| {
            let bricks = pages[page].iter().enumerate();
            bricks.for_each(|(i, e)| take(i, &grid.own_samples(e.place)));
            Ok(())
        };
        Grid::unpack(known(grid), table.entries(), read).unwrap()
    }

    #[test]
    fn grids_come_back_from_their_bricks() {
        for dims in [
            [1, 1, 1],
            [7, 8, 9],
            [37, 16, 23],
            [15, 3, 64],
            [80, 70, 61],
        ] {
            let dense = |v: [usize; 3]| (1 + v[0] + 100 * v[1] + 7 * v[2]) as f32;
            let sparse = |v: [usize; 3]| f32::from(dense(v) as usize % 997 == 3) * dense(v);
            let lump = |v: [usize; 3]| if v[0] < 8 && v[2] > 15 { dense(v) } else { 0.0 };
            let speck = |v: [usize; 3]| f32::from((0..3).all(|a| v[a] + 1 == dims[a].min(16)));
            let empty = |_: [usize; 3]| 0.0;
            let fields: [&(dyn Fn([usize; 3]) -> f32 + Sync); 5] =
                [&dense, &sparse, &lump, &speck, &empty];
            for (i, field) in fields.into_iter().enumerate() {
                let grid = Grid::from_fn(dims, field);
                assert!(again(&grid) == grid, "{dims:?}, field {i}");
                assert!(grid.has_right_borders(), "{dims:?}, field {i}");
            }
        }
    }

    #[test]
    fn samples_beyond_a_border_are_those_at_it() {
        for at in [0, BRICK_SAMPLES - 1] {
            let mut grid = Grid::from_fn([5; 3], |_| 1.0);
            assert!(grid.has_right_borders());
            grid.samples[at] = 2.0;
            assert!(!grid.has_right_borders());
        }
    }

    #[test]
    fn bricks_of_samples_that_are_only_shared_are_not_in_files() {
        let grid = Grid::from_fn([64; 3], |v| f32::from(v == [39, 39, 39]));
        assert_eq!((grid.maxima.len(), grid.entries().len()), (8, 1));
    }

    #[test]
    fn errors_of_pages_and_bricks_that_are_there_twice_are_told() {
        let grid = Grid::from_fn([20; 3], |_| 1.0);
        let entries = grid.entries();
        let unpack = |entries: &[BrickEntry], works: bool| {
            Grid::unpack(known(&grid), entries, |_, _| match works {
                true => Ok(()),
                false => Err(Error::input("a page")),
            })
        };
        assert_eq!(unpack(&entries, false).unwrap_err().to_string(), "a page");
        let twice = [&entries[..], &entries[..1]].concat();
        assert!(unpack(&twice, true).is_err());
    }
}
