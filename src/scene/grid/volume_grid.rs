//! The grid of a volume: in memory, or in a file until it is first looked into.

use super::adapted::Errors;
use super::brick::CoarseBricks;
use super::{ABSENT, BRICK_SAMPLES, Grid, brick_dims};
use crate::formats::{BrickEntry, BrickSamples};
use crate::run::Lists;
use crate::{Error, Result};
use std::fmt::Debug;
use std::ops::Deref;
use std::sync::{Arc, OnceLock};

/// The levels of a volume in a file.
pub trait StoredLevels: Debug + Send + Sync {
    /// What is known of a level without its samples; `None` if it is not stored.
    fn known(&self, level: usize) -> Option<Known>;

    /// Reads a level that is stored.
    ///
    /// # Errors
    /// Damage, no memory for it, or a stop on request.
    fn read(&self, level: usize) -> Result<Grid>;

    /// The bricks of a level whose errors on coarser ones are known.
    fn bricks(&self, level: usize) -> Option<StoredBricks<'_>>;
}

/// Gives the samples of all bricks of a page to another, with their numbers in it.
type ReadPage<'a> =
    Box<dyn Fn(usize, &mut dyn FnMut(usize, &BrickSamples)) -> Result<()> + Sync + 'a>;

/// The bricks of a stored level.
pub struct StoredBricks<'a> {
    /// Where samples that are read go.
    pub lists: &'a Lists,
    /// What the file says of each.
    pub entries: &'a [BrickEntry],
    /// Their errors on coarser levels.
    pub errors: &'a [Errors],
    /// Reads a page of them.
    pub read: ReadPage<'a>,
}

/// What is known of a grid without its samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Known {
    /// Voxels along x, y, z.
    pub dims: [usize; 3],
    /// Extents of its box, in voxels.
    pub size: [f32; 3],
    /// The largest sample.
    pub max: f32,
    /// Bricks that have samples of their own, which are nearly all.
    pub bricks: usize,
}

impl Known {
    fn bytes(&self) -> usize {
        let slots: usize = brick_dims(self.dims).iter().product();
        (slots + self.bricks * (BRICK_SAMPLES + 1)) * size_of::<f32>()
    }
}

/// The grid of a volume. One that is stored in a file is read when its samples are first asked for;
/// [`VolumeGrid::ready`] asks for them, and tells what is wrong with the file. Without that a grid
/// that cannot be read is empty. Clones are the same grid.
#[derive(Clone, Debug)]
pub struct VolumeGrid(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    known: Known,
    stored: Option<(Arc<dyn StoredLevels>, usize)>,
    /// The grid on voxels of which this one has bricks on levels of their own.
    whole: Option<VolumeGrid>,
    /// The grid once it was asked for; an empty one, and why, if it cannot be read.
    read: OnceLock<(Grid, Option<Error>)>,
}

impl From<Grid> for VolumeGrid {
    fn from(grid: Grid) -> Self {
        let known = Known {
            dims: grid.dims,
            size: grid.size,
            max: grid.max(),
            bricks: grid.maxima.len(),
        };
        Self(Arc::new(Shared {
            known,
            stored: None,
            whole: None,
            read: OnceLock::from((grid, None)),
        }))
    }
}

impl VolumeGrid {
    /// A level that is stored; `None` if it is not.
    #[must_use]
    pub fn stored(levels: &Arc<dyn StoredLevels>, level: usize) -> Option<Self> {
        Some(Self(Arc::new(Shared {
            known: levels.known(level)?,
            stored: Some((Arc::clone(levels), level)),
            whole: None,
            read: OnceLock::new(),
        })))
    }

    /// The same field on voxels of twice the edge.
    #[must_use]
    pub fn coarser(&self) -> Self {
        if let Some(whole) = &self.0.whole {
            return whole.coarser();
        }
        let next = self.0.stored.as_ref();
        let stored = next.and_then(|(levels, level)| Self::stored(levels, level + 1));
        stored.unwrap_or_else(|| {
            let Err(error) = self.ready() else {
                return Grid::coarser(self).into();
            };
            let known = Known {
                dims: self.dims().map(|n| n.div_ceil(2)),
                size: self.size().map(|n| 0.5 * n),
                max: 0.0,
                bricks: 0,
            };
            Self(Arc::new(Shared {
                known,
                stored: None,
                whole: None,
                read: OnceLock::from((Grid::empty(known), Some(error))),
            }))
        })
    }

    /// This grid with its bricks on levels of their own; the coarser ones stay those of this.
    pub(super) fn with_bricks(&self, grid: Grid) -> Self {
        let known = Known {
            bricks: grid.maxima.len(),
            ..self.0.known
        };
        Self(Arc::new(Shared {
            known,
            stored: None,
            whole: Some(self.clone()),
            read: OnceLock::from((grid, None)),
        }))
    }

    /// Whether its bricks are on levels of their own.
    pub(super) fn is_adapted(&self) -> bool {
        self.0.whole.is_some()
    }

    /// What is known of it without its samples.
    pub(super) fn known(&self) -> Known {
        self.0.known
    }

    /// Its bricks where they are stored, if their errors on coarser levels are.
    pub(super) fn in_file(&self) -> Option<StoredBricks<'_>> {
        let (levels, level) = self.0.stored.as_ref()?;
        levels.bricks(*level)
    }

    /// Reads it if that has not been done.
    ///
    /// # Errors
    /// A page of the file that cannot be read.
    pub fn ready(&self) -> Result<()> {
        let Shared { stored, read, .. } = &*self.0;
        if let (None, Some((levels, level))) = (read.get(), stored) {
            // An error is not kept, as what comes later may be heard: a stop, memory that is short.
            let grid = levels.read(*level)?;
            read.get_or_init(|| (grid, None));
        }
        match &self.read().1 {
            None => Ok(()),
            Some(error) => Err(error.clone()),
        }
    }

    /// Whether its samples are in memory.
    #[must_use]
    pub fn is_read(&self) -> bool {
        self.0.read.get().is_some()
    }

    fn read(&self) -> &(Grid, Option<Error>) {
        let Shared {
            known,
            stored,
            read,
            ..
        } = &*self.0;
        if let Some(read) = read.get() {
            return read;
        }
        // Nobody waits for another who reads: who waits may be below that on the stack of a thread
        // that helps while it waits. Whoever comes first, the grid is the same.
        let grid = match stored {
            Some((levels, level)) => levels.read(*level),
            None => Ok(Grid::empty(*known)),
        };
        let grid = match grid {
            Ok(grid) => (grid, None),
            Err(error) => (Grid::empty(*known), Some(error)),
        };
        read.get_or_init(|| grid)
    }

    /// Voxels along x, y, z, of which none is read.
    #[must_use]
    pub fn dims(&self) -> [usize; 3] {
        self.0.known.dims
    }

    /// Extents of its box, in voxels, of which none is read.
    #[must_use]
    pub fn size(&self) -> [f32; 3] {
        self.0.known.size
    }

    /// Bricks along x, y, z, stored or not, of which none is read.
    #[must_use]
    pub fn brick_dims(&self) -> [usize; 3] {
        brick_dims(self.0.known.dims)
    }

    /// Bricks that have samples of their own, nearly, for which none is read.
    #[must_use]
    pub fn stored_bricks(&self) -> usize {
        self.0.known.bricks
    }

    /// The largest sample, for which none is read.
    #[must_use]
    pub fn max(&self) -> f32 {
        self.0.known.max
    }

    /// Bytes of memory that it takes or, unread, will take, nearly.
    #[must_use]
    pub fn bytes(&self) -> usize {
        match self.0.read.get() {
            Some((grid, _)) => grid.bytes(),
            None => self.0.known.bytes(),
        }
    }

    /// Bytes of it that are in memory whatever a limit says, of which none is read: its tables, and
    /// samples that are few.
    #[must_use]
    pub fn bytes_in_memory(&self) -> usize {
        let Known { dims, bricks, .. } = self.0.known;
        let tables = brick_dims(dims).iter().product::<usize>() + bricks;
        let samples = bricks * BRICK_SAMPLES * size_of::<f32>();
        let few = if (samples as u64) < Lists::SMALL {
            samples
        } else {
            0
        };
        tables * size_of::<u32>() + few
    }

    /// Bytes of memory that a coarser level takes, nearly, of a grid in a file that has it; none is
    /// read.
    #[must_use]
    pub fn bytes_in_file(&self, coarser: usize) -> Option<usize> {
        let (levels, level) = self.0.stored.as_ref()?;
        levels.known(level + coarser).map(|known| known.bytes())
    }

    /// Lowers what is above `most` to that; where others have the same grid, in one of its own.
    pub fn limit(&mut self, most: f32) {
        if self.max() <= most {
            return;
        }
        let own = Arc::get_mut(&mut self.0).filter(|shared| shared.read.get().is_some());
        if let Some(shared) = own
            && let Some((grid, _)) = shared.read.get_mut()
        {
            grid.limit(most);
            shared.known.max = grid.max();
            return;
        }
        let mut grid = Grid::clone(self);
        grid.limit(most);
        *self = grid.into();
    }

    /// Whether two are the same grid, in the same place in memory.
    #[cfg(test)]
    pub(in crate::scene) fn is(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Deref for VolumeGrid {
    type Target = Grid;

    #[inline]
    fn deref(&self) -> &Grid {
        match self.0.read.get() {
            Some((grid, _)) => grid,
            None => &self.read().0,
        }
    }
}

impl Grid {
    /// A grid of zeros.
    fn empty(known: Known) -> Self {
        let bricks = brick_dims(known.dims);
        Self {
            dims: known.dims,
            size: known.size,
            bricks,
            slots: vec![ABSENT; bricks.iter().product()],
            samples: Vec::new().into(),
            maxima: Vec::new(),
            coarse: CoarseBricks::NONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Two levels, the second of which cannot be read, and how many were.
    #[derive(Debug, Default)]
    struct Two(AtomicUsize);

    impl StoredLevels for Two {
        fn known(&self, level: usize) -> Option<Known> {
            (level < 2).then_some(Known {
                dims: [4 >> level; 3],
                size: [(4 >> level) as f32; 3],
                max: 7.0,
                bricks: 1,
            })
        }

        fn read(&self, level: usize) -> Result<Grid> {
            self.0.fetch_add(1, Ordering::Relaxed);
            match level {
                0 => Ok(Grid::from_fn([4; 3], |_| 7.0)),
                _ => Err(Error::input("page 3")),
            }
        }

        fn bricks(&self, _: usize) -> Option<StoredBricks<'_>> {
            None
        }
    }

    #[test]
    fn a_grid_that_others_have_is_limited_in_a_copy() {
        let mut alone = VolumeGrid::from(Grid::from_fn([4; 3], |_| 7.0));
        alone.limit(5.0);
        let mut other = alone.clone();
        other.limit(2.0);
        let levels: Arc<dyn StoredLevels> = Arc::new(Two::default());
        let mut stored = VolumeGrid::stored(&levels, 0).unwrap();
        stored.limit(3.0);
        for (grid, most) in [(&alone, 5.0), (&other, 2.0), (&stored, 3.0)] {
            assert_eq!((grid.max(), Grid::max(grid)), (most, most));
        }
    }

    #[test]
    fn stored_grids_are_read_when_they_are_looked_into() {
        let two = Arc::new(Two::default());
        let levels: Arc<dyn StoredLevels> = two.clone();
        let grid = VolumeGrid::stored(&levels, 0).unwrap();
        assert_eq!(
            (grid.dims(), grid.size(), grid.max()),
            ([4; 3], [4.0; 3], 7.0)
        );
        assert_eq!(grid.brick_dims(), [1; 3]);
        let coarser = grid.coarser();
        assert_eq!(coarser.dims(), [2; 3]);
        assert!(!grid.is_read() && two.0.load(Ordering::Relaxed) == 0);
        let same = grid.clone();
        grid.ready().unwrap();
        assert_eq!(same.sample(glam::Vec3::splat(2.0)), 7.0);
        assert_eq!(two.0.load(Ordering::Relaxed), 1);
        assert_eq!(coarser.ready().unwrap_err().to_string(), "page 3");
        assert_eq!(coarser.sample(glam::Vec3::splat(1.0)), 0.0);
        // A level that is not stored is made of the one before.
        let coarsest = coarser.coarser();
        assert_eq!(coarsest.dims(), [1; 3]);
        assert_eq!(coarsest.ready().unwrap_err().to_string(), "page 3");
        // Asked for, it may be read the next time; a look into it keeps what it found.
        assert_eq!(two.0.load(Ordering::Relaxed), 3);
    }
}
