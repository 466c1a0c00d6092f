//! What a file says of the bricks of a grid, of which no sample is read: their errors on coarser
//! levels, and the largest samples.

use super::{StoredBricks, brick_dims, flatten};
use crate::Result;
use crate::run::memory;

/// The errors of bricks that are stored, by their places.
pub struct StoredErrors<'a> {
    stored: &'a StoredBricks<'a>,
    /// Bricks along x, y, z, stored or not.
    pub bricks: [usize; 3],
    /// Numbers of entries, of all bricks; beyond the last of those that have none.
    entry_of: Vec<u32>,
}

impl<'a> StoredErrors<'a> {
    pub fn new(stored: &'a StoredBricks<'a>, dims: [usize; 3]) -> Result<Self> {
        let bricks = brick_dims(dims);
        let count = bricks.iter().product();
        let mut entry_of = memory::filled("the grid of a volume", u32::MAX, count)?;
        for (i, entry) in (0..).zip(stored.entries) {
            entry_of[flatten(entry.place.map(|c| c as usize), bricks)] = i;
        }
        Ok(Self {
            stored,
            bricks,
            entry_of,
        })
    }

    /// The error of a brick on a coarser level.
    pub fn of(&self, place: [usize; 3], level: usize) -> Option<f32> {
        let entry = self.entry_of[flatten(place, self.bricks)];
        Some(self.stored.errors.get(entry as usize)?[level - 1])
    }

    /// The largest of a brick's own samples, and its error on level 1.
    pub fn first(&self, place: [usize; 3]) -> Option<[f32; 2]> {
        let entry = self.entry_of[flatten(place, self.bricks)];
        let max = self.stored.entries.get(entry as usize)?.max;
        Some([max, self.of(place, 1)?])
    }

    /// What no sample of a level is above, which is not read.
    pub fn most(&self, level: usize) -> MostOfLevel {
        let bricks = self.bricks.map(|n| (n >> level) + 1);
        let mut most = vec![0.0_f32; bricks.iter().product()];
        for entry in self.stored.entries {
            let brick = flatten(entry.place.map(|c| c as usize >> level), bricks);
            most[brick] = most[brick].max(entry.max);
        }
        MostOfLevel {
            level,
            bricks,
            most,
        }
    }
}

/// The largest of the samples that each brick of a level is made of.
pub struct MostOfLevel {
    level: usize,
    bricks: [usize; 3],
    most: Vec<f32>,
}

impl MostOfLevel {
    /// The largest around a brick on voxels, nearly as [`Grid::most_around`] has it.
    pub fn around(&self, place: [usize; 3]) -> f32 {
        let bricks =
            (0..8).map(|i| std::array::from_fn(|a| (place[a] + (i >> a & 1)) >> self.level));
        bricks.fold(0.0, |most, brick| {
            most.max(self.most[flatten(brick, self.bricks)])
        })
    }
}
