//! Bricks on the levels of a pyramid: their samples, and the error of these.

use super::brick::{Brick, edge_at, samples_at};
use super::{BRICK_CELLS, BRICK_EDGE, Grid, VoxelBox};
use wide::f32x8;

/// Weights of four samples of a level in a sample of a brick on it, along an axis, the second of
/// which is the nearest before.
///
/// Means over voxels, and what is interpolated in them, are blurred: a sample is the value there,
/// `3/4` of the second and `1/4` of the third for cells of two voxels, less a share of the second
/// difference, so that the variance of all together is that of the finest grid. Sums stay the same.
fn taps(level: usize) -> [f32; 4] {
    let width = (1 << level) as f32;
    let f = 0.5 - 0.5 / width;
    let sharpen = 0.25 - 0.25 / (width * width);
    let [near, far] = [1.0 - f, f];
    [
        -sharpen * near,
        near + sharpen * (2.0 * near - far),
        far + sharpen * (2.0 * far - near),
        -sharpen * far,
    ]
}

/// Samples of a level along an axis that those of a brick on it are made of, at most.
const WIDEST: usize = edge_at(1) + 3;
/// As many, for which eight samples begin at each of the first four.
const PADDED: usize = WIDEST + 4;

/// The samples of a level that those of a brick on it are made of: from the last before it along
/// each axis on, x innermost; those behind the last of a row are any.
type Around = [[[f32; PADDED]; WIDEST]; WIDEST];

/// Eight samples from a place of a list on, along x.
#[inline(always)]
fn row_at(samples: &[f32], at: usize) -> Option<f32x8> {
    let (eight, _) = samples.get(at..)?.split_first_chunk::<WIDEST>()?;
    Some(f32x8::new(*eight))
}

/// Eight samples, each of four.
#[inline(always)]
fn filtered_rows(taps: [f32x8; 4], rows: [f32x8; 4]) -> f32x8 {
    let [a, b, c, d] = std::array::from_fn(|i| taps[i] * rows[i]);
    (b + c) + (a + d)
}

/// Writes the samples of a brick on a level, none above `most`; returns the largest. Rows along x
/// are made whole, with any samples behind those of the brick.
fn write_filtered<const LEVEL: usize>(around: &Around, most: f32, out: &mut [f32]) -> f32 {
    let edge = const { edge_at(LEVEL) };
    let width = edge + 3;
    let taps = taps(LEVEL).map(f32x8::splat);
    let mut faces = [[f32x8::ZERO; edge_at(1)]; WIDEST];
    for (face, rows) in faces[..width].iter_mut().zip(around) {
        let mut along_x = [f32x8::ZERO; WIDEST];
        for (row, samples) in along_x[..width].iter_mut().zip(rows) {
            let from = |i| row_at(samples, i).unwrap_or_default();
            *row = filtered_rows(taps, [from(0), from(1), from(2), from(3)]);
        }
        for y in 0..edge {
            face[y] = filtered_rows(taps, [0, 1, 2, 3].map(|i| along_x[y + i]));
        }
    }
    let most = f32x8::splat(most);
    let mut largest = f32x8::ZERO;
    for (row, out) in out.chunks_exact_mut(edge).enumerate() {
        let (y, z) = (row % edge, row / edge);
        let values = filtered_rows(taps, [0, 1, 2, 3].map(|i| faces[z + i][y]));
        // Forged files may hold what overflows: no number is 0.
        let values = values.max(f32x8::ZERO).min(most);
        out.copy_from_slice(&values.as_array()[..edge]);
        largest = largest.max(values);
    }
    largest.as_array()[..edge]
        .iter()
        .copied()
        .fold(0.0, f32::max)
}

/// Rows of two bricks that are neighbours along x, as one.
struct Across {
    /// Where it begins in the first brick.
    first: usize,
    /// How many samples it has of that.
    count: usize,
    /// Which they are.
    is_first: f32x8,
}

impl Across {
    fn new(first: usize) -> Self {
        let count = BRICK_CELLS - first;
        let bits = |x: usize| if x < count { u32::MAX } else { 0 };
        Self {
            first,
            count,
            is_first: f32x8::new(std::array::from_fn(|x| f32::from_bits(bits(x)))),
        }
    }

    /// The row that begins at a place of the samples of both bricks; those that are not there are
    /// 0.
    #[inline(always)]
    fn row(&self, bricks: [Option<&[f32]>; 2], from: usize) -> f32x8 {
        let [first, second] = bricks;
        let first = first.and_then(|samples| row_at(samples, from + self.first));
        let second = second.map(|samples| match from.checked_sub(self.count) {
            // As if its samples began so much before.
            Some(at) => row_at(samples, at).unwrap_or_default(),
            None => {
                let mut row = [0.0; WIDEST];
                row[self.count..].copy_from_slice(&samples[from..from + WIDEST - self.count]);
                f32x8::new(row)
            }
        });
        let [first, second] = [first, second].map(Option::unwrap_or_default);
        self.is_first.select(first, second)
    }
}

impl Grid {
    /// Writes the samples of the brick at `b` of a grid of which this one is the level `level`,
    /// none above `most`; returns the largest.
    pub(super) fn write_coarse(
        &self,
        level: usize,
        b: [usize; 3],
        most: f32,
        out: &mut [f32],
    ) -> f32 {
        match level {
            1 => self.write_coarse_on::<1>(b, most, out),
            2 => self.write_coarse_on::<2>(b, most, out),
            _ => self.write_coarse_on::<3>(b, most, out),
        }
    }

    fn write_coarse_on<const LEVEL: usize>(
        &self,
        b: [usize; 3],
        most: f32,
        out: &mut [f32],
    ) -> f32 {
        let width = const { edge_at(LEVEL) + 3 };
        // Corners of cells of this grid, from the one before the first of the brick on.
        let first = b.map(|b| ((b * BRICK_CELLS) >> LEVEL) as isize - 1);
        let base = first.map(|c| c.max(0) as usize / BRICK_CELLS);
        let bricks: [Option<Brick<'_>>; 8] = std::array::from_fn(|i| {
            let at: [usize; 3] = std::array::from_fn(|a| base[a] + (i >> a & 1));
            (0..3)
                .all(|a| at[a] < self.bricks[a])
                .then(|| self.brick(at))?
        });
        if bricks.iter().all(Option::is_none) {
            out.fill(0.0);
            return 0.0;
        }
        // Along each axis, which of the bricks has a corner, and where in that it is.
        let along: [[(usize, usize); WIDEST]; 3] = std::array::from_fn(|a| {
            std::array::from_fn(|i| {
                let corner = (first[a] + i as isize).max(0) as usize;
                let corner = corner.min(self.dims[a]);
                (corner / BRICK_CELLS - base[a], corner % BRICK_CELLS)
            })
        });
        let [xs, ys, zs] = along.each_ref().map(|along| &along[..width]);
        let is_inside = first[0] >= 0 && first[0] as usize + width <= self.dims[0];
        let across = Across::new(xs[0].1);
        let mut around = [[[0.0; PADDED]; WIDEST]; WIDEST];
        for (rows, (bz, kz)) in around.iter_mut().zip(zs) {
            for (row, (by, ky)) in rows.iter_mut().zip(ys) {
                let from = (kz * BRICK_EDGE + ky) * BRICK_EDGE;
                let samples = [0, 1].map(|bx| {
                    let brick = bricks[bz << 2 | by << 1 | bx].as_ref();
                    brick.map(|brick| brick.samples)
                });
                if is_inside {
                    let samples = across.row(samples, from);
                    row[..WIDEST].copy_from_slice(samples.as_array());
                    continue;
                }
                for ((bx, kx), sample) in xs.iter().zip(row) {
                    *sample = samples[*bx].map_or(0.0, |samples| samples[from + *kx]);
                }
            }
        }
        write_filtered::<LEVEL>(&around, most, out)
    }

    /// The largest of the own samples of the brick at `b`, and its largest error on level 1, or any
    /// above `most`, without that level, none of whose samples is above `most_of_all`. `None` if it
    /// has no samples of its own.
    pub(super) fn error_on_first(
        &self,
        b: [usize; 3],
        [most_of_all, most]: [f32; 2],
    ) -> Option<[f32; 2]> {
        let brick = self.brick(b).filter(Brick::has_own_samples)?;
        let own_max = brick.own_samples().fold(0.0, f32::max);
        let last = self.dims.map(|n| (n.div_ceil(2) - 1) as isize);
        // Corner c of cells is sample c - 1.
        let first = b.map(|b| (b * BRICK_CELLS / 2) as isize - 2);
        let sample = |a: usize, i: usize| (first[a] + i as isize).clamp(0, last[a]) as usize;
        let from: [usize; 3] = std::array::from_fn(|a| sample(a, 0));
        let dims: [usize; 3] = std::array::from_fn(|a| sample(a, WIDEST - 1) + 1 - from[a]);
        let voxels = VoxelBox { first: from, dims };
        let mut means = vec![0.0; voxels.count()];
        self.write_halved(&voxels, &mut means);
        let mean = |at: [usize; 3]| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|a| sample(a, at[a]) - from[a]);
            means[(z * dims[1] + y) * dims[0] + x]
        };
        let mut around: Around = [[[0.0; PADDED]; WIDEST]; WIDEST];
        for (z, rows) in around.iter_mut().enumerate() {
            for (y, row) in rows.iter_mut().enumerate() {
                row[..WIDEST]
                    .copy_from_slice(&std::array::from_fn::<_, WIDEST, _>(|x| mean([x, y, z])));
            }
        }
        let mut samples = [0.0; samples_at(1)];
        let coarse = Brick {
            max: write_filtered::<1>(&around, most_of_all, &mut samples),
            samples: &samples,
            level: 1,
        };
        Some([own_max, brick.error_of(&coarse, most)])
    }

    /// The largest sample around the brick at `b` of a grid of which this one is the level `level`.
    pub(super) fn most_around(&self, level: usize, b: [usize; 3]) -> f32 {
        let first = b.map(|b| (b * BRICK_CELLS) >> level);
        let around = (0..8).filter_map(|i| {
            let cell: [usize; 3] = std::array::from_fn(|a| {
                let last = first[a] + (i >> a & 1) * (BRICK_CELLS >> level);
                last.min(self.dims[a])
            });
            self.brick(cell.map(|c| c / BRICK_CELLS))
        });
        around.fold(0.0, |most, brick| most.max(brick.max))
    }
}

impl Brick<'_> {
    /// The samples that it does not share with a brick before it, on voxels.
    fn own_samples(&self) -> impl Iterator<Item = f32> {
        debug_assert_eq!(self.level, 0);
        let layers = self.samples.chunks_exact(BRICK_EDGE * BRICK_EDGE).skip(1);
        let rows = layers.flat_map(|layer| layer.chunks_exact(BRICK_EDGE).skip(1));
        rows.flat_map(|row| row[1..].iter().copied())
    }

    /// Whether any of these is not 0.
    pub(super) fn has_own_samples(&self) -> bool {
        self.own_samples().any(|v| v != 0.0)
    }

    /// The largest error of the brick at `b` on a coarser level, of which `coarser` is the grid, or
    /// any above `most`.
    pub(super) fn error_on(
        &self,
        coarser: &Grid,
        level: usize,
        b: [usize; 3],
        [most_of_all, most]: [f32; 2],
    ) -> f32 {
        let mut samples = [0.0; samples_at(1)];
        let samples = &mut samples[..samples_at(level)];
        let max = coarser.write_coarse(level, b, most_of_all, samples);
        self.error_of(
            &Brick {
                samples,
                max,
                level,
            },
            most,
        )
    }

    /// The largest error of another brick in its place, or any above `most`.
    fn error_of(&self, coarse: &Brick<'_>, most: f32) -> f32 {
        let mut layer = [0.0; BRICK_EDGE * BRICK_EDGE];
        let mut error = 0.0_f32;
        // Those between the layers of a coarse brick first, which are off by most.
        for z in [3, 5, 1, 7, 4, 2, 6, 0, 8] {
            let fine = &self.samples[z * BRICK_EDGE * BRICK_EDGE..][..BRICK_EDGE * BRICK_EDGE];
            // Eight at a time: one after the other would wait for each other.
            let coarse = coarse.layer(z, &mut layer);
            let mut errors = [0.0_f32; 8];
            let both = fine.chunks_exact(8).zip(coarse.chunks_exact(8));
            for (fine, coarse) in both {
                for i in 0..8 {
                    errors[i] = errors[i].max((fine[i] - coarse[i]).abs());
                }
            }
            let last = (fine[fine.len() - 1] - coarse[fine.len() - 1]).abs();
            error = errors.into_iter().fold(error.max(last), f32::max);
            if error > most {
                break;
            }
        }
        error
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    /// The samples of a brick on a level, one by one.
    fn plain(around: &Around, level: usize, most: f32) -> Vec<f32> {
        let taps = taps(level);
        let edge = edge_at(level);
        let filtered = |samples: [f32; 4]| {
            let [a, b, c, d] = std::array::from_fn(|i| taps[i] * samples[i]);
            (b + c) + (a + d)
        };
        let four = [0, 1, 2, 3];
        let along_x = |x: usize, y: usize, z: usize| filtered(four.map(|i| around[z][y][x + i]));
        let along_y = |x, y, z| filtered(four.map(|i| along_x(x, y + i, z)));
        let along_z = |x, y, z| filtered(four.map(|i| along_y(x, y, z + i)));
        let places = (0..edge.pow(3)).map(|i| crate::math::unflatten(i, [edge; 3]));
        let values = places.map(|[x, y, z]| along_z(x, y, z).max(0.0).min(most));
        values.collect()
    }

    #[test]
    fn samples_of_coarse_bricks_are_those_that_are_made_one_by_one() {
        let unit = |i: usize| sampling::unit(sampling::hash(&[i as u64])) - 0.2;
        let around: Around = std::array::from_fn(|z| {
            std::array::from_fn(|y| std::array::from_fn(|x| unit((z * WIDEST + y) * PADDED + x)))
        });
        for most in [f32::INFINITY, 0.5] {
            let check = |level: usize, write: fn(&Around, f32, &mut [f32]) -> f32| {
                let mut found = vec![0.0; samples_at(level)];
                let largest = write(&around, most, &mut found);
                assert_eq!(found, plain(&around, level, most), "{level}");
                assert_eq!(largest, found.iter().copied().fold(0.0, f32::max));
            };
            check(1, write_filtered::<1>);
            check(2, write_filtered::<2>);
            check(3, write_filtered::<3>);
        }
    }

    #[test]
    fn no_number_becomes_nothing() {
        let mut around: Around = [[[1.0; PADDED]; WIDEST]; WIDEST];
        around[3][3][3] = f32::NAN;
        let mut found = [2.0; samples_at(1)];
        let largest = write_filtered::<1>(&around, 9.0, &mut found);
        assert!(largest <= 9.0 && found.iter().all(|v| (0.0..=9.0).contains(v)));
        assert!(found.contains(&0.0));
    }

    #[test]
    fn rows_go_across_bricks() {
        let bricks = [0, 1000].map(|first| {
            let numbers = (first..).take(super::super::BRICK_SAMPLES);
            numbers.map(|i| i as f32).collect::<Vec<_>>()
        });
        let [a, b] = bricks.each_ref().map(|b| Some(&b[..]));
        for first in [1, 3, 5, 7] {
            let across = Across::new(first);
            for from in [0, BRICK_EDGE, 70 * BRICK_EDGE] {
                for (bricks, has) in [
                    ([a, b], [1.0, 1.0]),
                    ([None, b], [0.0, 1.0]),
                    ([a, None], [1.0, 0.0]),
                ] {
                    let row = across.row(bricks, from);
                    let count = BRICK_CELLS - first;
                    let expected: [f32; WIDEST] = std::array::from_fn(|x| match x < count {
                        true => has[0] * (from + first + x) as f32,
                        false => has[1] * (1000 + from + x - count) as f32,
                    });
                    assert_eq!(*row.as_array(), expected);
                }
            }
        }
    }
}
