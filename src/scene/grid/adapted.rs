//! Grids whose bricks are on levels of their own: where a field is smooth, or finer than anyone
//! looks at it, cells of a brick are 2, 4 or 8 voxels wide, and its samples are as many times
//! fewer.
//!
//! The samples of such a brick are values of its level of the pyramid at the corners of its cells,
//! and so are the same in all bricks of that level that share them. A brick on voxels takes the
//! samples that are of a coarse brick before it from there. Else fields have steps between bricks
//! on unlike levels, as small as their errors.

use super::brick::{MAX_BRICK_LEVEL, samples_at};
use super::stored_errors::StoredErrors;
use super::{Brick, Grid, Known, StoredBricks, VolumeGrid, brick_dims};
use crate::Result;
use crate::formats::BrickEntry;
use crate::math::unflatten;
use rayon::prelude::*;

/// The largest error of a sample of a brick whose cells are 2, 4 and 8 voxels wide.
pub type Errors = [f32; MAX_BRICK_LEVEL];

/// Levels that a brick may be on.
#[derive(Clone, Copy, Debug)]
pub struct Allowed {
    /// The coarsest whose cells are too small to be told.
    pub unseen: usize,
    /// The largest sample, times the voxels along an edge of a cell, of a brick that is coarse for
    /// that.
    pub depth: f32,
    /// The largest error of a sample, in the unit of samples, of a brick that is coarser.
    pub error: f32,
}

/// The levels of the bricks of a grid.
#[derive(Debug, Default)]
pub(super) struct BrickLevels {
    /// Of each brick, x fastest; none if all are 0.
    of: Vec<u8>,
    /// The grids of levels 1 and more.
    pub coarser: Vec<VolumeGrid>,
}

impl BrickLevels {
    /// The level of a brick, by its number.
    #[inline]
    pub fn of(&self, brick: usize) -> usize {
        self.of.get(brick).map_or(0, |level| usize::from(*level))
    }
}

/// What the levels of the bricks of a grid are chosen by.
struct Choice<'a, A, E> {
    bricks: [usize; 3],
    coarser: &'a [VolumeGrid],
    allowed: A,
    /// The error of a brick, by its place, on a coarser level, or any above the last number; `None`
    /// of bricks without samples of their own.
    error: E,
}

impl<A, E> Choice<'_, A, E>
where
    A: Fn([usize; 3]) -> Allowed + Sync,
    E: Fn([usize; 3], usize, f32) -> Option<f32> + Sync,
{
    /// The level of a brick.
    fn level(&self, place: [usize; 3]) -> usize {
        let last = self.coarser.len();
        // Most of a large grid may be empty.
        if self.coarser[last - 1].most_around(last, place) == 0.0 {
            return 0;
        }
        let allowed = (self.allowed)(place);
        let is_unseen = |level: &usize| {
            let most = self.coarser[level - 1].most_around(*level, place);
            most > 0.0 && most * (1 << level) as f32 <= allowed.depth
        };
        let unseen = (1..=allowed.unseen.min(last)).rev().find(is_unseen);
        let unseen = unseen.unwrap_or(0);
        let is_smooth = |level: &usize| {
            let error = (self.error)(place, *level, allowed.error);
            error.is_some_and(|error| error <= allowed.error)
        };
        let smooth = (unseen + 1..=last).take_while(is_smooth);
        smooth.last().unwrap_or(unseen)
    }

    /// The levels of all bricks, x fastest.
    fn levels(&self) -> Vec<u8> {
        let places = (0..self.bricks.iter().product()).into_par_iter();
        let level = |i: usize| self.level(unflatten(i, self.bricks)) as u8;
        places.map(level).collect()
    }
}

/// Whether more than three quarters of the bricks that have samples may be on coarser levels, by
/// one of 64: `found` tells the largest of a brick's own samples, and its error on level 1 as that
/// of [`Choice`].
fn pays(
    bricks: [usize; 3],
    allowed: impl Fn([usize; 3]) -> Allowed + Sync,
    found: impl Fn([usize; 3], f32) -> Option<[f32; 2]> + Sync,
) -> bool {
    const APART: usize = 4;
    let some = bricks.map(|n| ((n + 1) / APART).max(1));
    let of = |i: usize| {
        let some = unflatten(i, some);
        let place = std::array::from_fn(|a| (some[a] * APART + APART / 2).min(bricks[a] - 1));
        let allowed = allowed(place);
        let found = found(place, allowed.error);
        let may = |[max, error]: [f32; 2]| {
            (allowed.unseen > 0 && 2.0 * max <= allowed.depth) || error <= allowed.error
        };
        [found.is_some(), found.is_some_and(may)].map(usize::from)
    };
    let places = (0..some.iter().product::<usize>()).into_par_iter();
    let add = |a: [usize; 2], b: [usize; 2]| [a[0] + b[0], a[1] + b[1]];
    let [all, coarse] = places.map(of).reduce(|| [0; 2], add);
    4 * coarse > 3 * all
}

impl VolumeGrid {
    /// The same grid with each brick on a level that `allowed` says of its place; `None` if that
    /// makes too few coarser to pay. Its coarser levels are those of this one. Of one that is
    /// stored with the errors of its bricks no more is read than that takes.
    ///
    /// # Errors
    /// Damage of the file, no memory for the grid, or a stop on request.
    pub fn adapted(&self, allowed: impl Fn([usize; 3]) -> Allowed + Sync) -> Result<Option<Self>> {
        if self.is_adapted() {
            return Ok(None);
        }
        let grid = match self.in_file() {
            Some(stored) => self.adapted_in_file(stored, allowed),
            None => self.adapted_in_memory(allowed),
        };
        Ok(grid?.map(|grid| self.with_bricks(grid)))
    }

    fn adapted_in_file(
        &self,
        stored: StoredBricks<'_>,
        allowed: impl Fn([usize; 3]) -> Allowed + Sync,
    ) -> Result<Option<Grid>> {
        let known = self.known();
        let errors = StoredErrors::new(&stored, known.dims)?;
        if !pays(errors.bricks, &allowed, |place, _| errors.first(place)) {
            return Ok(None);
        }
        let error = |place, level, _| errors.of(place, level);
        let levels = self.levels_of_bricks(self.coarser_levels(), allowed, error)?;
        Grid::unpack_on(&levels, (known, stored.lists), stored.entries, stored.read).map(Some)
    }

    /// Bytes that it takes as [`VolumeGrid::adapted`] makes it, about; `None` if it is not stored
    /// with the errors of its bricks, or they are not worth it. None is read for it.
    pub fn adapted_bytes(&self, allowed: impl Fn([usize; 3]) -> Allowed + Sync) -> Option<usize> {
        let stored = self.in_file().filter(|_| !self.is_adapted())?;
        let errors = StoredErrors::new(&stored, self.dims()).ok()?;
        if !pays(errors.bricks, &allowed, |place, _| errors.first(place)) {
            return None;
        }
        let most = [1, 2, 3].map(|level| errors.most(level));
        let samples = |entry: &BrickEntry| {
            let place = entry.place.map(|c| c as usize);
            let allowed = allowed(place);
            let is_unseen = |level: &usize| {
                let most = &most[level - 1];
                most.around(place) * (1 << level) as f32 <= allowed.depth
            };
            let unseen = (1..=allowed.unseen.min(MAX_BRICK_LEVEL))
                .rev()
                .find(is_unseen);
            let is_smooth = |level: &usize| {
                let error = errors.of(place, *level);
                error.is_some_and(|error| error <= allowed.error)
            };
            let unseen = unseen.unwrap_or(0);
            let smooth = (unseen + 1..=MAX_BRICK_LEVEL).take_while(is_smooth);
            samples_at(smooth.last().unwrap_or(unseen))
        };
        let samples: usize = stored.entries.par_iter().map(samples).sum();
        let slots: usize = errors.bricks.iter().product();
        Some((samples + stored.entries.len() + slots) * size_of::<f32>())
    }

    fn adapted_in_memory(
        &self,
        allowed: impl Fn([usize; 3]) -> Allowed + Sync,
    ) -> Result<Option<Grid>> {
        self.ready()?;
        let (grid, known): (&Grid, Known) = (self, self.known());
        let first = |place, most| grid.error_on_first(place, [known.max, most]);
        if !pays(grid.bricks, &allowed, first) {
            return Ok(None);
        }
        let coarser = self.coarser_levels();
        let levels = self.levels_of_bricks(coarser.clone(), allowed, |place, level, most| {
            let brick = grid.brick(place).filter(Brick::has_own_samples)?;
            Some(brick.error_on(&coarser[level - 1], level, place, [known.max, most]))
        })?;
        grid.on_brick_levels(&levels, known).map(Some)
    }

    /// Its levels 1 to 3, as far as there are any.
    fn coarser_levels(&self) -> Vec<Self> {
        let mut levels = vec![self.coarser()];
        while let Some(last) = levels.last()
            && levels.len() < MAX_BRICK_LEVEL
            && last.dims() != [1; 3]
        {
            levels.push(last.coarser());
        }
        levels
    }

    /// The levels of its bricks; [`Choice`] has the parameters.
    fn levels_of_bricks(
        &self,
        coarser: Vec<Self>,
        allowed: impl Fn([usize; 3]) -> Allowed + Sync,
        error: impl Fn([usize; 3], usize, f32) -> Option<f32> + Sync,
    ) -> Result<BrickLevels> {
        coarser.iter().try_for_each(Self::ready)?;
        let choice = Choice {
            bricks: brick_dims(self.dims()),
            coarser: &coarser,
            allowed,
            error,
        };
        let of = choice.levels();
        Ok(BrickLevels { of, coarser })
    }

    /// The errors of bricks on its three coarser levels, in the order of their entries. All are
    /// read.
    ///
    /// # Errors
    /// As [`VolumeGrid::ready`].
    pub(in crate::scene) fn errors_of_bricks(
        &self,
        coarser: [&Self; MAX_BRICK_LEVEL],
        entries: &[BrickEntry],
    ) -> Result<Vec<Errors>> {
        self.ready()?;
        coarser.into_iter().try_for_each(Self::ready)?;
        let of = |entry: &BrickEntry| {
            let place = entry.place.map(|c| c as usize);
            let brick = self.brick(place);
            let error = |level: usize| {
                let grid = coarser[level - 1];
                Some(brick?.error_on(grid, level, place, [self.max(), f32::INFINITY]))
            };
            [1, 2, 3].map(|level| error(level).unwrap_or(0.0))
        };
        Ok(entries.par_iter().map(of).collect())
    }

    /// Whether the errors that are stored with it, if they are, are those of its bricks.
    ///
    /// # Errors
    /// As [`VolumeGrid::ready`].
    pub(in crate::scene) fn has_right_errors(
        &self,
        coarser: [&Self; MAX_BRICK_LEVEL],
    ) -> Result<bool> {
        match self.in_file() {
            Some(stored) => Ok(self.errors_of_bricks(coarser, stored.entries)? == stored.errors),
            None => Ok(true),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BRICK_CELLS, BRICK_SAMPLES, StoredLevels};
    use super::*;
    use crate::formats::{BrickTable, PAGE_BRICKS};
    use crate::math::sampling;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicUsize, Ordering};

    const DIMS: [usize; 3] = [75, 50, 61];
    const ERROR: f32 = 0.02;

    /// Waves, beside which there is noise from `noise_from` on along x; nothing above `empty_from`
    /// along y.
    fn field(noise_from: usize, empty_from: usize) -> VolumeGrid {
        let value = |[i, j, k]: [usize; 3]| {
            if j >= empty_from {
                0.0
            } else if i >= noise_from {
                sampling::unit(sampling::hash(&[i as u64, j as u64, k as u64]))
            } else {
                2.0 + 0.5 * (0.04 * i as f32).sin() * (0.03 * (j + k) as f32).cos()
            }
        };
        Grid::from_fn(DIMS, value).into()
    }

    fn smooth(_: [usize; 3]) -> Allowed {
        Allowed {
            unseen: 0,
            depth: 0.0,
            error: ERROR,
        }
    }

    fn adapted(grid: &VolumeGrid) -> VolumeGrid {
        grid.adapted(smooth).unwrap().unwrap()
    }

    #[test]
    fn bricks_are_coarse_where_their_error_is_small() {
        let fine = field(60, 37);
        let coarse = adapted(&fine);
        let mut levels = [0; MAX_BRICK_LEVEL + 1];
        for b in fine.bricks() {
            let (Some(fine), Some(coarse)) = (fine.brick(b), coarse.brick(b)) else {
                assert!(
                    fine.brick(b).is_none() && coarse.brick(b).is_none(),
                    "{b:?}"
                );
                continue;
            };
            levels[coarse.level] += 1;
            let mut buffer = [0.0; BRICK_SAMPLES];
            let both = fine.samples().iter().zip(coarse.on_voxels(&mut buffer));
            let error = both.fold(0.0, |e: f32, (a, b)| e.max((a - b).abs()));
            assert!(error <= ERROR, "{b:?} on {}: {error}", coarse.level);
            assert!(coarse.max <= fine.max + ERROR);
            // Where noise begins, and where there is nothing, nothing is smooth.
            let is_noise = (b[0] + 1) * BRICK_CELLS >= 60 || b[1] == 37 / BRICK_CELLS;
            assert!(!is_noise || coarse.level == 0, "{b:?}");
        }
        assert!(levels.iter().all(|count| *count > 0), "{levels:?}");
        let mean = |grid: &Grid| grid.means(DIMS)[0];
        let (expected, found) = (mean(&fine), mean(&coarse));
        assert!(
            (found / expected - 1.0).abs() < 1e-3,
            "{found} for {expected}"
        );
    }

    #[test]
    fn straight_fields_are_the_same_on_all_levels() {
        let value = |[i, j, k]: [usize; 3]| 1.0 + 0.5 * i as f32 + 0.25 * j as f32 + 2.0 * k as f32;
        let fine = VolumeGrid::from(Grid::from_fn([64; 3], value));
        for unseen in 1..=MAX_BRICK_LEVEL {
            let allowed = |_| Allowed {
                unseen,
                depth: f32::INFINITY,
                error: -1.0,
            };
            let coarse = fine.adapted(allowed).unwrap().unwrap();
            let inside = |b: &[usize; 3]| b.iter().all(|c| (2..6).contains(c));
            for b in fine.bricks().filter(inside) {
                let (fine, coarse) = (fine.brick(b).unwrap(), coarse.brick(b).unwrap());
                assert_eq!(coarse.level, unseen);
                let mut buffer = [0.0; BRICK_SAMPLES];
                for (a, b) in fine.samples().iter().zip(coarse.on_voxels(&mut buffer)) {
                    assert!((a - b).abs() < 1e-3, "{a} and {b} on {unseen}");
                }
            }
        }
    }

    #[test]
    fn bricks_that_nobody_tells_are_coarse_unless_they_are_deep() {
        let fine = field(0, 37);
        assert!(fine.adapted(smooth).unwrap().is_none());
        let allowed = |depth: f32| {
            move |b: [usize; 3]| Allowed {
                unseen: if b[2] < 7 { 2 } else { 0 },
                depth,
                error: 0.0,
            }
        };
        let coarse = fine.adapted(allowed(4.0)).unwrap().unwrap();
        for b in fine.bricks() {
            let level = coarse.brick(b).map(|b| b.level);
            match level {
                // What is smeared over a border is where it was smeared to.
                None => assert!(fine.brick(b).is_none()),
                Some(level) => assert_eq!(level, if b[2] < 7 { 2 } else { 0 }, "{b:?}"),
            }
        }
        let (expected, found) = (fine.means(DIMS)[0], coarse.means(DIMS)[0]);
        assert!(
            (found / expected - 1.0).abs() < 0.01,
            "{found} for {expected}"
        );
        // On level 1 cells are half as wide.
        let coarse = fine.adapted(allowed(2.0)).unwrap().unwrap();
        assert_eq!(coarse.brick([2; 3]).unwrap().level, 1);
        assert!(fine.adapted(allowed(0.1)).unwrap().is_none());
    }

    #[test]
    fn bricks_on_voxels_begin_with_what_those_before_end_with() {
        let coarse = adapted(&field(60, 37));
        let mut beside = 0;
        for b in coarse.bricks().filter(|b| b[0] > 0) {
            let before = coarse.brick([b[0] - 1, b[1], b[2]]);
            let (Some(before), Some(brick)) = (before, coarse.brick(b)) else {
                continue;
            };
            if before.level > 0 && brick.level == 0 {
                beside += 1;
                for (y, z) in (1..=BRICK_CELLS).flat_map(|y| (1..=BRICK_CELLS).map(move |z| (y, z)))
                {
                    let ends = before.at_corner([BRICK_CELLS, y, z]);
                    assert_eq!(brick.at_corner([0, y, z]), ends, "{b:?}");
                }
            }
        }
        assert!(beside > 0);
    }

    /// Levels as a file has them, and how many pages were read.
    #[derive(Debug)]
    struct Stored {
        levels: Vec<(VolumeGrid, BrickTable, Vec<Errors>)>,
        pages: AtomicUsize,
    }

    impl Stored {
        fn of(finest: &VolumeGrid) -> Self {
            let mut levels = Vec::new();
            let mut grid = finest.clone();
            while grid.dims() != [1; 3] {
                let table = BrickTable::new(grid.entries());
                let mut coarser = vec![grid.coarser()];
                while coarser.len() < MAX_BRICK_LEVEL {
                    coarser.push(coarser[coarser.len() - 1].coarser());
                }
                let three = std::array::from_fn(|i| &coarser[i]);
                let errors = grid.errors_of_bricks(three, table.entries()).unwrap();
                levels.push((grid, table, errors));
                grid = coarser.swap_remove(0);
            }
            Self {
                levels,
                pages: AtomicUsize::new(0),
            }
        }

        fn page(
            &self,
            level: usize,
            page: usize,
            take: &mut dyn FnMut(usize, &crate::formats::BrickSamples),
        ) -> Result<()> {
            let (grid, table, _) = &self.levels[level];
            let entries = table.entries().chunks(PAGE_BRICKS).nth(page).unwrap();
            for (i, entry) in entries.iter().enumerate() {
                take(i, &grid.own_samples(entry.place));
            }
            if level == 0 {
                self.pages.fetch_add(1, Ordering::Relaxed);
            }
            Ok(())
        }
    }

    impl StoredLevels for Stored {
        fn known(&self, level: usize) -> Option<Known> {
            Some(self.levels.get(level)?.0.known())
        }

        fn read(&self, level: usize) -> Result<Grid> {
            let (grid, table, _) = &self.levels[level];
            let read = |page, take: &mut dyn FnMut(_, &_)| self.page(level, page, take);
            Grid::unpack(grid.known(), grid.lists(), table.entries(), read)
        }

        fn bricks(&self, level: usize) -> Option<StoredBricks<'_>> {
            let (grid, table, errors) = &self.levels[level];
            Some(StoredBricks {
                lists: grid.lists(),
                entries: table.entries(),
                errors,
                read: Box::new(move |page, take| self.page(level, page, take)),
            })
        }
    }

    #[test]
    fn stored_bricks_are_adapted_as_those_in_memory_and_no_others_are_read() {
        let allowed = |b: [usize; 3]| Allowed {
            unseen: usize::from(b[2] > 5),
            depth: 3.0,
            error: ERROR,
        };
        for finest in [field(60, 37), field(70, 40), field(64, 44)] {
            let stored = Arc::new(Stored::of(&finest));
            let levels: Arc<dyn StoredLevels> = stored.clone();
            let in_file = VolumeGrid::stored(&levels, 0).unwrap();
            let expected = finest.adapted(allowed).unwrap().unwrap();
            let found = in_file.adapted(allowed).unwrap().unwrap();
            assert!(*found == *expected);
            let pages = stored.levels[0].1.entries().len().div_ceil(PAGE_BRICKS);
            let read = stored.pages.load(Ordering::Relaxed);
            assert!(read < pages && !in_file.is_read(), "{read} of {pages}");
            // What it takes is known before, but for bricks that only share samples: many here.
            let expected = in_file.adapted_bytes(allowed).unwrap();
            let has_own = |b: &[usize; 3]| finest.brick(*b).is_some_and(|b| b.has_own_samples());
            let shared = (found.bricks()).filter(|b| found.brick(*b).is_some() && !has_own(b));
            let shared = shared.count() * (BRICK_SAMPLES + 1) * size_of::<f32>();
            let share = (found.bytes() - shared) as f32 / expected as f32;
            assert!((0.9..1.1).contains(&share), "{share} of {expected}");
            // Coarser levels are those of the whole field.
            assert!(*found.coarser() == *finest.coarser());
            let coarser = in_file.coarser_levels();
            let coarser = std::array::from_fn(|i| &coarser[i]);
            assert!(in_file.has_right_errors(coarser).unwrap());
            // They are the same before level 1 is made.
            let (_, table, errors) = &stored.levels[0];
            for (entry, errors) in table.entries().iter().zip(errors) {
                let place = entry.place.map(|c| c as usize);
                let first = finest.error_on_first(place, [finest.max(), f32::INFINITY]);
                assert_eq!(first, Some([entry.max, errors[0]]), "{place:?}");
            }
        }
    }

    #[test]
    fn errors_that_are_not_those_of_the_samples_are_found() {
        let mut stored = Stored::of(&field(60, 37));
        stored.levels[0].2[3][1] += 1e-3;
        let levels: Arc<dyn StoredLevels> = Arc::new(stored);
        let grid = VolumeGrid::stored(&levels, 0).unwrap();
        let coarser = grid.coarser_levels();
        let coarser = std::array::from_fn(|i| &coarser[i]);
        assert!(!grid.has_right_errors(coarser).unwrap());
    }
}
