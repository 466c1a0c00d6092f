//! What rays pass, counted: steadier than seconds, and held by tests.

use std::cell::Cell;
use std::ops::{Add, Sub};

/// Rays, and cells of media that they passed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Walked {
    /// Rays that were traced through triangles.
    pub rays: u64,
    /// Cells of media that rays passed one by one, empty ones in filled bricks among them.
    pub cells: u64,
    /// Lvoxels that rays passed.
    pub lvoxels: u64,
    /// Vertices of media that camera rays asked for their light, each ray for itself.
    pub asked: u64,
    /// Those among them that gather it.
    pub asked_to_gather: u64,
}

thread_local! {
    /// By thread: threads that count together would wait for each other.
    static WALKED: Cell<Walked> = const { Cell::new(Walked {
        rays: 0,
        cells: 0,
        lvoxels: 0,
        asked: 0,
        asked_to_gather: 0,
    }) };
}

impl Walked {
    /// What this thread has counted so far.
    #[must_use]
    pub fn of_thread() -> Self {
        WALKED.get()
    }

    /// What all threads that work together here have counted so far. Runs at the same time mix
    /// their counts.
    #[must_use]
    pub fn so_far() -> Self {
        let mut sum = Self::default();
        let mut add = |part: Self| {
            sum.rays += part.rays;
            sum.cells += part.cells;
            sum.lvoxels += part.lvoxels;
            sum.asked += part.asked;
            sum.asked_to_gather += part.asked_to_gather;
        };
        if rayon::current_thread_index().is_none() {
            add(WALKED.get());
        }
        rayon::broadcast(|_| WALKED.get())
            .into_iter()
            .for_each(&mut add);
        sum
    }
}

impl Add for Walked {
    type Output = Self;

    fn add(self, more: Self) -> Self {
        Self {
            rays: self.rays + more.rays,
            cells: self.cells + more.cells,
            lvoxels: self.lvoxels + more.lvoxels,
            asked: self.asked + more.asked,
            asked_to_gather: self.asked_to_gather + more.asked_to_gather,
        }
    }
}

impl Sub for Walked {
    type Output = Self;

    fn sub(self, before: Self) -> Self {
        Self {
            rays: self.rays - before.rays,
            cells: self.cells - before.cells,
            lvoxels: self.lvoxels - before.lvoxels,
            asked: self.asked - before.asked,
            asked_to_gather: self.asked_to_gather - before.asked_to_gather,
        }
    }
}

/// Notes rays that were traced.
#[inline]
pub fn note_rays(rays: u64) {
    let all = WALKED.get();
    WALKED.set(Walked {
        rays: all.rays + rays,
        ..all
    });
}

/// Notes cells that were passed.
#[inline]
pub fn note_cells(cells: u64) {
    let all = WALKED.get();
    WALKED.set(Walked {
        cells: all.cells + cells,
        ..all
    });
}

/// Notes lvoxels that were passed.
#[inline]
pub fn note_lvoxels(lvoxels: u64) {
    let all = WALKED.get();
    WALKED.set(Walked {
        lvoxels: all.lvoxels + lvoxels,
        ..all
    });
}

/// Notes a vertex of a medium that was asked for its light.
#[inline]
pub fn note_asked(to_gather: bool) {
    let all = WALKED.get();
    WALKED.set(Walked {
        asked: all.asked + 1,
        asked_to_gather: all.asked_to_gather + u64::from(to_gather),
        ..all
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_all_threads_count_is_added_up() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3);
        pool.build().unwrap().install(|| {
            let before = Walked::so_far();
            rayon::broadcast(|_| {
                note_rays(2);
                note_cells(5);
                note_lvoxels(7);
            });
            let found = Walked::so_far() - before;
            assert_eq!((found.rays, found.cells, found.lvoxels), (6, 15, 21));
        });
    }
}
