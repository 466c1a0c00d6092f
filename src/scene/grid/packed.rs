//! Grids to bricks of 8^3 samples, as files have them, and back.
//!
//! Such a brick has the samples at all corners of a brick's cells but the first along each axis,
//! which are those at the last corners of the bricks before it.

use super::adapted::BrickLevels;
use super::brick::{CoarseBricks, MAX_BRICK_LEVEL, largest, samples_at};
use super::{
    ABSENT, BRICK_CELLS, BRICK_EDGE, BRICK_SAMPLES, Brick, Grid, Known, brick_dims, flatten,
};
use crate::formats::{BRICK_VOXELS, BrickEntry, BrickSamples, PAGE_BRICKS};
use crate::math::unflatten;
use crate::run::{Lists, memory};
use crate::{Error, Result};
use rayon::prelude::*;

/// Corners of a brick's cells that are the first along any axis.
const SHARED: usize = BRICK_SAMPLES - BRICK_VOXELS;

/// What is told of memory that is not there.
const WHAT: &str = "the grid of a volume";

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

    /// The grid of a size with these bricks. `read` gives the samples of all bricks of a
    /// page, of which each but the last has [`PAGE_BRICKS`], by their numbers in it; they are as
    /// the entries say, and finite. All places are inside.
    ///
    /// # Errors
    /// Those of `read`, the first in the order of pages; a size that memory does not have.
    pub(in crate::scene) fn unpack(
        known: Known,
        lists: &Lists,
        entries: &[BrickEntry],
        read: impl Fn(usize, &mut dyn FnMut(usize, &BrickSamples)) -> Result<()> + Sync,
    ) -> Result<Self> {
        Self::unpack_on(&BrickLevels::default(), (known, lists), entries, read)
    }

    /// The same with bricks on levels of their own. Pages without a brick on voxels are not read.
    pub(super) fn unpack_on(
        levels: &BrickLevels,
        (known, lists): (Known, &Lists),
        entries: &[BrickEntry],
        read: impl Fn(usize, &mut dyn FnMut(usize, &BrickSamples)) -> Result<()> + Sync,
    ) -> Result<Self> {
        let bricks = brick_dims(known.dims);
        let place = |entry: &BrickEntry| flatten(entry.place.map(|c| c as usize), bricks);
        let marked = marked(levels, known, entries)?;
        let (mut grid, on_voxels) = Self::on_levels(levels, (known, lists), marked)?;
        let (samples, _) = grid.samples.split_at_mut(on_voxels.len() * BRICK_SAMPLES);
        let each = samples.chunks_exact_mut(BRICK_SAMPLES).map(Some);
        let mut each: Vec<_> = each.collect();
        let own = |entry: &BrickEntry| match levels.of(place(entry)) {
            0 => match each[grid.slots[place(entry)] as usize].take() {
                Some(samples) => Ok(Some(samples)),
                None => Err(Error::input("a brick of a volume is there twice")),
            },
            _ => Ok(None),
        };
        let own = entries.iter().map(own).collect::<Result<Vec<_>>>()?;
        read_own(own, read)?;
        for entry in entries.iter().filter(|e| levels.of(place(e)) == 0) {
            grid.maxima[grid.slots[place(entry)] as usize] = entry.max;
        }
        grid.share_corners(&on_voxels);
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
                .for_each(|((brick, max), shared)| *max = max.max(write_shared(brick, shared)));
        }
    }

    /// This grid, of which `known` is known, with bricks on levels of their own.
    pub(super) fn on_brick_levels(&self, levels: &BrickLevels, known: Known) -> Result<Self> {
        let count: usize = self.bricks.iter().product();
        memory::check(WHAT, (count * size_of::<u32>()) as u64)?;
        let mut marked = memory::filled(WHAT, ABSENT, count)?;
        marked.par_iter_mut().enumerate().for_each(|(b, slot)| {
            let brick = self.brick(unflatten(b, self.bricks));
            if brick.is_some_and(|brick| levels.of(b) == 0 || brick.has_own_samples()) {
                *slot = 0;
            }
        });
        let (mut grid, on_voxels) = Self::on_levels(levels, (known, self.lists()), marked)?;
        let bricks = grid.samples.par_chunks_exact_mut(BRICK_SAMPLES);
        let bricks = bricks.zip(&mut grid.maxima).zip(&on_voxels);
        bricks.for_each(|((samples, max), b)| {
            if let Some(brick) = self.brick(unflatten(*b, self.bricks)) {
                samples.copy_from_slice(brick.samples);
                *max = brick.max;
            }
        });
        let is_behind_coarse = |b: &usize| {
            let place = unflatten(*b, self.bricks);
            (1..8).any(|i| {
                let before = std::array::from_fn(|a| place[a] - (i >> a & 1).min(place[a]));
                levels.of(flatten(before, self.bricks)) > 0
            })
        };
        let behind: Vec<usize> = (on_voxels.into_par_iter())
            .filter(is_behind_coarse)
            .collect();
        for some in behind.chunks(AT_A_TIME) {
            let shared = some.par_iter().map(|b| {
                let mut shared = [0.0; SHARED];
                grid.shared_corners(unflatten(*b, grid.bricks), &mut shared);
                shared
            });
            let shared: Vec<_> = shared.collect();
            for (b, shared) in some.iter().zip(&shared) {
                let slot = grid.slots[*b] as usize;
                let brick = &mut grid.samples[slot * BRICK_SAMPLES..][..BRICK_SAMPLES];
                write_shared(brick, shared);
                grid.maxima[slot] = largest(brick);
            }
        }
        Ok(grid)
    }

    /// A grid of bricks on levels, those on voxels 0 yet, and the places of these, x fastest, as
    /// slots have them. Bricks that are `marked` are stored, and others on coarser levels that have
    /// samples there.
    fn on_levels(
        levels: &BrickLevels,
        (known, lists): (Known, &Lists),
        marked: Vec<u32>,
    ) -> Result<(Self, Vec<usize>)> {
        let bricks = brick_dims(known.dims);
        let has_samples = |level: usize, b: usize| {
            let mut samples = [0.0; samples_at(1)];
            let samples = &mut samples[..samples_at(level)];
            let grid = &levels.coarser[level - 1];
            grid.write_coarse(level, unflatten(b, bricks), known.max, samples) > 0.0
        };
        let stored: [Vec<usize>; MAX_BRICK_LEVEL + 1] = std::array::from_fn(|level| {
            let is_stored = |b: &usize| {
                let is_marked = marked[*b] != ABSENT;
                levels.of(*b) == level && (is_marked || level > 0 && has_samples(level, *b))
            };
            match level > levels.coarser.len() {
                true => Vec::new(),
                false => (0..marked.len())
                    .into_par_iter()
                    .filter(is_stored)
                    .collect(),
            }
        });
        let mut slots = marked;
        for (slot, b) in (0..).zip(stored.iter().flatten()) {
            slots[*b] = slot;
        }
        let counts = stored.each_ref().map(Vec::len);
        let sizes: [usize; MAX_BRICK_LEVEL + 1] =
            std::array::from_fn(|level| counts[level] * samples_at(level));
        let (all, all_bricks) = (sizes.iter().sum::<usize>(), counts.iter().sum::<usize>());
        let mut samples = lists.zeros(WHAT, all)?;
        let mut maxima = vec![0.0; all_bricks];
        let (_, mut samples_left) = samples.split_at_mut(sizes[0]);
        let (_, mut maxima_left) = maxima.split_at_mut(counts[0]);
        for (level, grid) in (1..).zip(&levels.coarser) {
            let (samples, left) = samples_left.split_at_mut(sizes[level]);
            let (maxima, left_of_maxima) = maxima_left.split_at_mut(counts[level]);
            (samples_left, maxima_left) = (left, left_of_maxima);
            let each = samples.par_chunks_exact_mut(samples_at(level)).zip(maxima);
            each.zip(&stored[level]).for_each(|((samples, max), b)| {
                *max = grid.write_coarse(level, unflatten(*b, bricks), known.max, samples);
            });
        }
        let grid = Self {
            dims: known.dims,
            size: known.size,
            bricks,
            slots,
            samples,
            maxima,
            coarse: match levels.coarser[..] {
                [] => CoarseBricks::NONE,
                _ => CoarseBricks::new(counts),
            },
        };
        let [on_voxels, ..] = stored;
        Ok((grid, on_voxels))
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
            *out = (brick.as_ref()).map_or(0.0, |brick| brick.at_corner([x, y, z]));
        }
    }
}

/// Which bricks have samples of their own or, on voxels, share any with those before them: 0 for
/// these, [`ABSENT`] for others.
fn marked(levels: &BrickLevels, known: Known, entries: &[BrickEntry]) -> Result<Vec<u32>> {
    let bricks = brick_dims(known.dims);
    let count: usize = bricks.iter().product();
    memory::check(WHAT, (count * size_of::<u32>()) as u64)?;
    let mut slots = memory::filled(WHAT, ABSENT, count)?;
    for entry in entries {
        let place = entry.place.map(|c| c as usize);
        slots[flatten(place, bricks)] = 0;
        for i in (1..8_usize).filter(|i| entry.ends >> (i - 1) & 1 == 1) {
            let behind: [usize; 3] = std::array::from_fn(|a| place[a] + (i >> a & 1));
            let is_inside = (0..3).all(|a| behind[a] < bricks[a]);
            if is_inside && levels.of(flatten(behind, bricks)) == 0 {
                slots[flatten(behind, bricks)] = 0;
            }
        }
    }
    Ok(slots)
}

/// Writes the first corners of a brick; returns the largest.
fn write_shared(brick: &mut [f32], shared: &[f32; SHARED]) -> f32 {
    let mut largest = 0.0_f32;
    for (corner, value) in SHARED_CORNERS.iter().zip(shared) {
        let [x, y, z] = corner.map(usize::from);
        brick[(z * BRICK_EDGE + y) * BRICK_EDGE + x] = *value;
        largest = largest.max(*value);
    }
    largest
}

/// Has the samples of bricks read, in the order of pages, but for those that are `None`.
fn read_own(
    mut own: Vec<Option<&mut [f32]>>,
    read: impl Fn(usize, &mut dyn FnMut(usize, &BrickSamples)) -> Result<()> + Sync,
) -> Result<()> {
    let pages = own.par_chunks_mut(PAGE_BRICKS).enumerate();
    let needed = pages.filter(|(_, bricks)| bricks.iter().any(Option::is_some));
    let read: Vec<Result<()>> = needed
        .map(|(page, bricks)| {
            read(page, &mut |i, samples| {
                let rows = samples.chunks_exact(BRICK_CELLS).enumerate();
                if let Some(own) = &mut bricks[i] {
                    rows.for_each(|(row, from)| {
                        own[own_row(row)..][..BRICK_CELLS].copy_from_slice(from);
                    });
                }
            })
        })
        .collect();
    read.into_iter().collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::formats::BrickTable;
    use crate::math::sampling;

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
        Grid::unpack(known(grid), &Lists::default(), table.entries(), read).unwrap()
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
            let noise = |v: [usize; 3]| sampling::unit(sampling::hash(&v.map(|c| c as u64)));
            let empty = |_: [usize; 3]| 0.0;
            let fields: [&(dyn Fn([usize; 3]) -> f32 + Sync); 6] =
                [&dense, &sparse, &lump, &speck, &noise, &empty];
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
            Grid::unpack(
                known(&grid),
                &Lists::default(),
                entries,
                |_, _| match works {
                    true => Ok(()),
                    false => Err(Error::input("a page")),
                },
            )
        };
        assert_eq!(unpack(&entries, false).unwrap_err().to_string(), "a page");
        let twice = [&entries[..], &entries[..1]].concat();
        assert!(unpack(&twice, true).is_err());
    }
}
