//! Scalar samples on a regular grid, stored in sparse bricks laid out for walking rays.
//!
//! Index space: voxel (i,j,k) of `dims` spans (i,j,k) to (i+1,j+1,k+1) and its sample sits at its centre. Between
//! centres the field is trilinear, in the outer half voxel it is clamped, outside the box it is zero.
//!
//! Cell space is index space plus 1/2: cell c lies between samples c-1 and c, so all knees of the field are at
//! integers. A brick holds 8^3 cells with their 9^3 corner samples, so a cell never needs a second brick; bricks whose
//! samples are all zero are not stored.

use crate::math::unflatten;
use glam::{Vec3, Vec3A, Vec4, Vec4Swizzles};
use rayon::prelude::*;
use std::convert::Infallible;

/// Cells along an edge of a brick.
pub const BRICK_CELLS: usize = 8;
const BRICK_EDGE: usize = BRICK_CELLS + 1;
const BRICK_SAMPLES: usize = BRICK_EDGE * BRICK_EDGE * BRICK_EDGE;
const ABSENT: u32 = u32::MAX;

/// A scalar field on a grid; see the module for its spaces.
#[derive(Debug)]
pub struct Grid {
    dims: [usize; 3],
    bricks: [usize; 3],
    slots: Vec<u32>,
    samples: Vec<f32>,
    maxima: Vec<f32>,
}

/// A stored brick: its corner samples and the largest of them.
#[derive(Clone, Copy)]
pub struct Brick<'a> {
    samples: &'a [f32],
    /// No sample of the brick is above this.
    pub max: f32,
}

impl Grid {
    /// Samples `value([i, j, k])` once or more for every voxel; values must be finite and not negative, and the same every
    /// time.
    pub fn from_fn(dims: [usize; 3], value: impl Fn([usize; 3]) -> f32 + Sync) -> Self {
        let go_on = || Ok::<_, Infallible>(());
        let Ok(layout) = Layout::of(dims, &value, go_on);
        let Ok(grid) = layout.fill(value, go_on);
        grid
    }

    /// The same field on half as many voxels along each axis, which are as much larger. Each has the mean of those that it
    /// stands for, sharpened by what linear interpolation over voxels of twice the size spreads further.
    #[must_use]
    pub fn halved(&self) -> Self {
        /// Variances along an axis, in squares of the finer edge: 4 of 12 by the mean and 4 of 6 by interpolation where 1 of 6
        /// were; six neighbours two edges away spread by 4 of 3.
        const SHARPEN: f32 = (1.0 / 3.0 + 2.0 / 3.0 - 1.0 / 6.0) / (4.0 / 3.0);
        let dims = self.dims.map(|n| n.div_ceil(2));
        let ratio = |a: usize| self.dims[a] as f32 / dims[a] as f32;
        let size = Vec3::new(ratio(0), ratio(1), ratio(2));
        let middle = |v: [usize; 3]| Vec3::from_array(v.map(|i| i as f32 + 0.5));
        // Where eight voxels meet, their mean.
        let means: Vec<f32> = (0..dims.iter().product())
            .into_par_iter()
            .map(|i| self.sample(middle(unflatten(i, dims)) * size))
            .collect();
        let index = |v: [usize; 3]| (v[2] * dims[1] + v[1]) * dims[0] + v[0];
        let sharpened = |v: [usize; 3]| {
            let around = (0..3).map(|a| {
                let [mut before, mut behind] = [v; 2];
                before[a] = v[a].saturating_sub(1);
                behind[a] = (v[a] + 1).min(dims[a] - 1);
                means[index(before)] + means[index(behind)]
            });
            let (mean, around) = (means[index(v)], around.sum::<f32>() / 6.0);
            (mean + SHARPEN * (mean - around)).max(0.0)
        };
        let sharp: Vec<f32> = (0..means.len())
            .into_par_iter()
            .map(|i| sharpened(unflatten(i, dims)))
            .collect();
        // Values that would be negative left too much of it.
        let [of_means, of_sharp] =
            [&means, &sharp].map(|v| v.iter().copied().map(f64::from).sum::<f64>());
        let scale = if of_sharp > 0.0 {
            (of_means / of_sharp) as f32
        } else {
            1.0
        };
        Self::from_fn(dims, |v| scale * sharp[index(v)])
    }

    /// Voxels along x, y, z of index space.
    #[must_use]
    pub fn dims(&self) -> [usize; 3] {
        self.dims
    }

    /// Bricks along x, y, z, stored or not.
    #[must_use]
    pub fn brick_dims(&self) -> [usize; 3] {
        self.bricks
    }

    /// The brick at brick coordinates, if any of its samples is not zero.
    #[must_use]
    pub fn brick(&self, b: [usize; 3]) -> Option<Brick<'_>> {
        let slot = self.slots[(b[2] * self.bricks[1] + b[1]) * self.bricks[0] + b[0]];
        (slot != ABSENT).then(|| {
            let first = slot as usize * BRICK_SAMPLES;
            Brick {
                samples: &self.samples[first..first + BRICK_SAMPLES],
                max: self.maxima[slot as usize],
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

    /// Bytes of memory that bricks and their table take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.slots.len() * 4 + self.samples.len() * 4 + self.maxima.len() * 4
    }

    /// Trilinear value at a point of index space; zero outside the box.
    #[must_use]
    pub fn sample(&self, point_in_index: Vec3) -> f32 {
        let p = point_in_index.to_array();
        if !(0..3).all(|a| p[a] >= 0.0 && p[a] <= self.dims[a] as f32) {
            return 0.0;
        }
        let cell: [usize; 3] = std::array::from_fn(|a| ((p[a] + 0.5) as usize).min(self.dims[a]));
        match self.brick(cell.map(|c| c / BRICK_CELLS)) {
            None => 0.0,
            Some(brick) => {
                let f: [f32; 3] = std::array::from_fn(|a| p[a] + 0.5 - cell[a] as f32);
                brick.cell(cell.map(|c| c % BRICK_CELLS)).value(f.into())
            }
        }
    }
}

/// Which bricks a grid has to store, before it stores any.
pub(super) struct Layout {
    dims: [usize; 3],
    bricks: [usize; 3],
    /// Numbers of the bricks that are stored, in order.
    stored: Vec<usize>,
}

impl Layout {
    /// Finds the bricks in which `value` is not zero everywhere. `go_on` is asked at each brick, and ends it with its error.
    pub(super) fn of<E: Send>(
        dims: [usize; 3],
        value: impl Fn([usize; 3]) -> f32 + Sync,
        go_on: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, E> {
        let mut layout = Self {
            dims,
            bricks: dims.map(|n| (n + 1).div_ceil(BRICK_CELLS)),
            stored: Vec::new(),
        };
        layout.stored = (0..layout.count())
            .into_par_iter()
            .filter_map(|b| match go_on() {
                Ok(()) => (layout.voxels(b).any(|v| value(v) != 0.0)).then_some(Ok(b)),
                Err(e) => Some(Err(e)),
            })
            .collect::<Result<_, E>>()?;
        Ok(layout)
    }

    /// Bytes that the grid will hold.
    pub(super) fn bytes(&self) -> u64 {
        let brick = (BRICK_SAMPLES + 1) * size_of::<f32>();
        self.stored.len() as u64 * brick as u64 + self.count() as u64 * size_of::<u32>() as u64
    }

    /// The grid. `value` must be as before, and `go_on` is asked as before.
    pub(super) fn fill<E: Send>(
        self,
        value: impl Fn([usize; 3]) -> f32 + Sync,
        go_on: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Grid, E> {
        let mut slots = vec![ABSENT; self.count()];
        for (slot, &b) in self.stored.iter().enumerate() {
            slots[b] = slot as u32;
        }
        let mut samples = vec![0.0; self.stored.len() * BRICK_SAMPLES];
        let maxima = samples
            .par_chunks_mut(BRICK_SAMPLES)
            .zip(&self.stored)
            .map(|(brick, &b)| {
                go_on()?;
                for (sample, voxel) in brick.iter_mut().zip(self.voxels(b)) {
                    *sample = value(voxel);
                }
                Ok(brick.iter().copied().fold(0.0, f32::max))
            })
            .collect::<Result<_, E>>()?;
        Ok(Grid {
            dims: self.dims,
            bricks: self.bricks,
            slots,
            samples,
            maxima,
        })
    }

    fn count(&self) -> usize {
        self.bricks.iter().product()
    }

    /// The voxels at the corners of a brick's cells, x fastest.
    fn voxels(&self, b: usize) -> impl Iterator<Item = [usize; 3]> + use<> {
        let dims = self.dims;
        let base = unflatten(b, self.bricks).map(|i| i * BRICK_CELLS);
        let along = move |a: usize| {
            // Corner c of cell space is sample c - 1, clamped to the grid.
            (0..BRICK_EDGE).map(move |i| (base[a] + i).saturating_sub(1).min(dims[a] - 1))
        };
        along(2).flat_map(move |k| along(1).flat_map(move |j| along(0).map(move |i| [i, j, k])))
    }
}

/// The eight corner samples of a cell: those of its lower and its upper face, x fastest.
#[derive(Clone, Copy, Debug)]
pub struct Cell([Vec4; 2]);

impl Brick<'_> {
    /// Its corner samples, x fastest.
    #[must_use]
    pub fn samples(&self) -> &[f32] {
        self.samples
    }

    /// A cell of the brick, by coordinates below [`BRICK_CELLS`].
    #[must_use]
    #[inline]
    pub fn cell(&self, c: [usize; 3]) -> Cell {
        let first = (c[2] * BRICK_EDGE + c[1]) * BRICK_EDGE + c[0];
        let face = |at: usize| {
            let row = |at: usize| [self.samples[at], self.samples[at + 1]];
            let ([a, b], [c, d]) = (row(at), row(at + BRICK_EDGE));
            Vec4::new(a, b, c, d)
        };
        Cell([face(first), face(first + BRICK_EDGE * BRICK_EDGE)])
    }
}

impl Cell {
    /// Trilinear value at `f`, from 0 to 1 on each axis of the cell.
    #[must_use]
    #[inline]
    pub fn value(&self, f: Vec3A) -> f32 {
        let [lower, upper] = self.0;
        let face = lower + (upper - lower) * f.z;
        let row = face.xy() + (face.zw() - face.xy()) * f.y;
        row.x + (row.y - row.x) * f.x
    }

    /// Whether the field is zero all over the cell.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        let [lower, upper] = self.0;
        (lower.cmpeq(Vec4::ZERO) & upper.cmpeq(Vec4::ZERO)).all()
    }
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
    fn half_as_many_voxels_hold_the_same_field_and_as_much_of_it() {
        let linear = |p: Vec3| 1.0 + p.x + 2.0 * p.y + 0.5 * p.z;
        for dims in [[20, 8, 12], [21, 8, 11]] {
            let grid = Grid::from_fn(dims, |v| linear(Vec3::from_array(v.map(|i| i as f32))));
            let halved = grid.halved();
            let half = halved.dims();
            assert_eq!(half, dims.map(|n| n.div_ceil(2)));
            let size = |a: usize| half[a] as f32 / dims[a] as f32;
            let size = Vec3::new(size(0), size(1), size(2));
            // Neighbours of the voxels around it are inside.
            for p in [[8.0, 4.0, 6.0], [10.3, 3.7, 5.2]].map(Vec3::from) {
                let (got, expected) = (halved.sample(p * size), grid.sample(p));
                assert!((got - expected).abs() < 1e-4, "{p}: {got} {expected}");
            }
        }
        // A ball with a soft border, away from the box.
        let ball = Grid::from_fn([32; 3], |v| {
            let off = Vec3::from_array(v.map(|i| i as f32 - 15.5)).length();
            ((10.0 - off) / 4.0).clamp(0.0, 1.0)
        });
        let sum = |g: &Grid| {
            let n = g.dims()[0];
            let voxel = |i| Vec3::from_array(unflatten(i, [n; 3]).map(|v| v as f32 + 0.5));
            (0..n.pow(3)).map(|i| g.sample(voxel(i))).sum::<f32>()
        };
        let ratio = 8.0 * sum(&ball.halved()) / sum(&ball);
        assert!((ratio - 1.0).abs() < 1e-4, "{ratio}");
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
