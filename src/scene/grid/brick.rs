//! A brick of a grid, on voxels or on a coarser level, and its cells.

use super::{BRICK_CELLS, BRICK_EDGE, BRICK_SAMPLES};
use crate::math::unflatten;
use glam::{Vec3A, Vec4, Vec4Swizzles};
use std::ops::Range;

/// Log2 of the voxels along an edge of a brick's cells, at most.
pub const MAX_BRICK_LEVEL: usize = 3;

/// A stored brick: the samples at the corners of its cells, and the largest of them.
#[derive(Clone, Copy)]
pub struct Brick<'a> {
    pub(super) samples: &'a [f32],
    /// No sample of the brick is above this.
    pub max: f32,
    /// Log2 of the voxels along an edge of its cells: 0 but in grids that were adapted.
    pub level: usize,
}

/// Samples along an edge of a brick.
pub(super) const fn edge_at(level: usize) -> usize {
    (BRICK_CELLS >> level) + 1
}

/// The cell of a brick around a corner of a voxel's cell, along an axis, and where in that it is.
#[inline]
fn around<const LEVEL: usize>(corner: usize) -> (usize, f32) {
    let cell = (corner >> LEVEL).min((BRICK_CELLS >> LEVEL) - 1);
    let beyond = corner - (cell << LEVEL);
    (cell, beyond as f32 / (1 << LEVEL) as f32)
}

/// The largest of samples that are at least 0.
pub fn largest(samples: &[f32]) -> f32 {
    // Eight at a time: one after the other would wait for each other.
    let mut eight = [0.0_f32; 8];
    let chunks = samples.chunks_exact(8);
    let rest = chunks.remainder();
    for chunk in chunks {
        eight = std::array::from_fn(|i| eight[i].max(chunk[i]));
    }
    eight.iter().chain(rest).copied().fold(0.0, f32::max)
}

/// Samples of a brick.
pub(super) const fn samples_at(level: usize) -> usize {
    edge_at(level).pow(3)
}

/// Where the bricks of levels 1 to 3 begin among those that a grid stores, by level.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CoarseBricks {
    slots: [u32; MAX_BRICK_LEVEL],
    samples: [usize; MAX_BRICK_LEVEL],
}

impl CoarseBricks {
    pub const NONE: Self = Self {
        slots: [u32::MAX; MAX_BRICK_LEVEL],
        samples: [0; MAX_BRICK_LEVEL],
    };

    /// Of so many bricks of each level, 0 first.
    pub fn new(counts: [usize; MAX_BRICK_LEVEL + 1]) -> Self {
        let mut starts = Self::NONE;
        let (mut slot, mut sample) = (0, 0);
        for (level, count) in counts[..MAX_BRICK_LEVEL].iter().enumerate() {
            slot += count;
            sample += count * samples_at(level);
            starts.slots[level] = slot as u32;
            starts.samples[level] = sample;
        }
        starts
    }

    /// The level of a brick, and where its samples are.
    #[inline]
    pub fn place(&self, slot: u32) -> (usize, Range<usize>) {
        if slot < self.slots[0] {
            let first = slot as usize * BRICK_SAMPLES;
            return (0, first..first + BRICK_SAMPLES);
        }
        let [_, second, third] = self.slots;
        let level = 1 + usize::from(slot >= second) + usize::from(slot >= third);
        let before = (slot - self.slots[level - 1]) as usize;
        let first = self.samples[level - 1] + before * samples_at(level);
        (level, first..first + samples_at(level))
    }
}

/// The eight corner samples of a cell: those of its lower and its upper face, x fastest.
#[derive(Clone, Copy, Debug)]
pub struct Cell([Vec4; 2]);

impl Brick<'_> {
    /// The samples at the corners of its cells, x fastest.
    #[must_use]
    pub fn samples(&self) -> &[f32] {
        self.samples
    }

    /// Its cells that are not empty, voxel by voxel: a bit for each along x, row by row along y,
    /// then z.
    #[must_use]
    pub fn filled_cells(&self) -> [u8; BRICK_CELLS * BRICK_CELLS] {
        if self.level > 0 {
            return self.coarse_cells_that(|cell| !cell.is_empty());
        }
        // By row of samples, a bit for each that is not 0, and one for each pair of these.
        let mut pairs = [0_u16; BRICK_EDGE * BRICK_EDGE];
        for (pair, row) in pairs.iter_mut().zip(self.samples.chunks_exact(BRICK_EDGE)) {
            let bits = row.iter().enumerate();
            let bits = bits.fold(0, |bits, (i, v)| bits | u16::from(*v != 0.0) << i);
            *pair = bits | bits >> 1;
        }
        std::array::from_fn(|i| {
            let first = i / BRICK_CELLS * BRICK_EDGE + i % BRICK_CELLS;
            let faces = [first, first + BRICK_EDGE];
            faces
                .iter()
                .fold(0, |all, &at| all | pairs[at] | pairs[at + 1]) as u8
        })
    }

    /// A cell of the brick, by coordinates below [`BRICK_CELLS`] over 2^`level`; faster for who
    /// knows that the level is 0.
    #[must_use]
    #[inline(always)]
    pub fn cell<const ON_VOXELS: bool>(&self, c: [usize; 3]) -> Cell {
        let edge = match ON_VOXELS {
            true => BRICK_EDGE,
            false => (BRICK_CELLS >> self.level) + 1,
        };
        let first = (c[2] * edge + c[1]) * edge + c[0];
        let face = |at: usize| {
            let row = |at: usize| [self.samples[at], self.samples[at + 1]];
            let ([a, b], [c, d]) = (row(at), row(at + edge));
            Vec4::new(a, b, c, d)
        };
        Cell([face(first), face(first + edge * edge)])
    }

    /// The values at a layer of corners of voxels' cells, x fastest.
    pub(super) fn layer<'b>(
        &'b self,
        z: usize,
        out: &'b mut [f32; BRICK_EDGE * BRICK_EDGE],
    ) -> &'b [f32] {
        match self.level {
            0 => return &self.samples[z * BRICK_EDGE * BRICK_EDGE..][..BRICK_EDGE * BRICK_EDGE],
            1 => self.write_layer::<1>(z, out),
            2 => self.write_layer::<2>(z, out),
            _ => self.write_layer::<3>(z, out),
        }
        out
    }

    fn write_layer<const LEVEL: usize>(&self, z: usize, out: &mut [f32; BRICK_EDGE * BRICK_EDGE]) {
        let edge = const { edge_at(LEVEL) };
        let face = edge * edge;
        let lerp = |a: f32, b: f32, f: f32| a + (b - a) * f;
        let (cell, f) = around::<LEVEL>(z);
        let [lower, upper] = [cell, cell + 1].map(|z| &self.samples[z * face..][..face]);
        let mut between = [0.0; edge_at(1) * edge_at(1)];
        for i in 0..face {
            between[i] = lerp(lower[i], upper[i], f);
        }
        for y in 0..BRICK_EDGE {
            let (cell, f) = around::<LEVEL>(y);
            let mut row = [0.0; edge_at(1)];
            for x in 0..edge {
                row[x] = lerp(between[cell * edge + x], between[(cell + 1) * edge + x], f);
            }
            for x in 0..BRICK_EDGE {
                let (cell, f) = around::<LEVEL>(x);
                out[y * BRICK_EDGE + x] = lerp(row[cell], row[cell + 1], f);
            }
        }
    }

    /// The values at all corners of voxels' cells, x fastest.
    pub(super) fn on_voxels<'b>(&'b self, out: &'b mut [f32; BRICK_SAMPLES]) -> &'b [f32] {
        if self.level == 0 {
            return self.samples;
        }
        let (layers, _) = out.as_chunks_mut::<{ BRICK_EDGE * BRICK_EDGE }>();
        for (z, layer) in layers.iter_mut().enumerate() {
            self.layer(z, layer);
        }
        out
    }

    /// The value at a corner of voxels' cells.
    pub(super) fn at_corner(&self, corner: [usize; 3]) -> f32 {
        if self.level == 0 {
            let [x, y, z] = corner;
            return self.samples[(z * BRICK_EDGE + y) * BRICK_EDGE + x];
        }
        let around = |corner| match self.level {
            1 => around::<1>(corner),
            2 => around::<2>(corner),
            _ => around::<3>(corner),
        };
        let [x, y, z] = corner.map(around);
        let cell = self.cell::<false>([x.0, y.0, z.0]);
        cell.value(Vec3A::new(x.1, y.1, z.1))
    }

    /// The cells of which `is_one` is true, as [`Brick::filled_cells`] has them.
    #[must_use]
    pub fn cells_that(&self, is_one: impl Fn(Cell) -> bool) -> [u8; BRICK_CELLS * BRICK_CELLS] {
        if self.level > 0 {
            return self.coarse_cells_that(is_one);
        }
        std::array::from_fn(|row| {
            let [y, z] = [row % BRICK_CELLS, row / BRICK_CELLS];
            let bit = |x: usize| u8::from(is_one(self.cell::<true>([x, y, z]))) << x;
            (0..BRICK_CELLS).fold(0, |bits, x| bits | bit(x))
        })
    }

    fn coarse_cells_that(&self, is_one: impl Fn(Cell) -> bool) -> [u8; BRICK_CELLS * BRICK_CELLS] {
        let mut rows = [0; BRICK_CELLS * BRICK_CELLS];
        let across = BRICK_CELLS >> self.level;
        let width = 1 << self.level;
        for cell in (0..across.pow(3)).map(|i| unflatten(i, [across; 3])) {
            if !is_one(self.cell::<false>(cell)) {
                continue;
            }
            let [x, y, z] = cell.map(|c| c * width);
            let bits = (u8::MAX >> (BRICK_CELLS - width)) << x;
            for row in 0..width * width {
                rows[(z + row / width) * BRICK_CELLS + y + row % width] |= bits;
            }
        }
        rows
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

    /// The smallest of its samples.
    #[must_use]
    pub fn least(&self) -> f32 {
        let [lower, upper] = self.0;
        lower.min(upper).min_element()
    }

    /// Whether the field is zero all over the cell.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        let [lower, upper] = self.0;
        (lower.cmpeq(Vec4::ZERO) & upper.cmpeq(Vec4::ZERO)).all()
    }
}
