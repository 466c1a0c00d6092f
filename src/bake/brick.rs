//! The samples that a volume's field depends on in one brick of voxels, and exact means over blocks
//! of these.

use crate::scene::Grid;
use crate::scene::grid::largest;
use glam::DVec3;
use lvox_formats::record::MAX_LEVEL;

/// Edge of the brick in which all blocks have one size, voxels.
pub const BRICK_EDGE: usize = 1 << MAX_LEVEL;

/// Samples along an edge: those of the brick's voxels and of one more on both sides.
const EDGE: usize = BRICK_EDGE + 2;

/// The samples in and around a brick, x fastest, clamped to the grid.
pub struct BrickField {
    samples: [f32; EDGE * EDGE * EDGE],
    /// The largest of them.
    pub max: f32,
}

/// A block of a brick: voxels that are inside the grid.
#[derive(Clone, Copy, Debug)]
pub struct Block {
    /// Its first voxel in the brick.
    pub first: [usize; 3],
    /// Voxels along each axis.
    pub dims: [usize; 3],
}

/// The field along an axis through a voxel; see [`BrickField::column`].
#[derive(Clone, Copy, Debug)]
pub struct Column([f32; 3]);

impl Column {
    /// The field at a place of the voxel, from 0 to 1.
    pub fn at(self, place: f32) -> f32 {
        let [before, middle, next] = self.0;
        if place < 0.5 {
            before + (middle - before) * (place + 0.5)
        } else {
            middle + (next - middle) * (place - 0.5)
        }
    }
}

impl BrickField {
    /// Copies the samples of the brick at brick coordinates `b`.
    pub fn new(grid: &Grid, b: [usize; 3]) -> Self {
        let mut samples = [0.0; EDGE * EDGE * EDGE];
        // The first sample is at the first corner of a brick of cells, which has all but the last.
        for part in 0..8 {
            let is_upper = [0, 1, 2].map(|a| part >> a & 1 == 1);
            let at = [0, 1, 2].map(|a| b[a] + usize::from(is_upper[a]));
            let mut along = is_upper.map(|upper| match upper {
                false => [0, EDGE - 1, 0],
                true => [EDGE - 1, EDGE, 1],
            });
            let mut from = at;
            for a in 0..3 {
                if at[a] >= grid.brick_dims()[a] {
                    // Behind the last brick of cells there is nothing but its last sample again.
                    from[a] = b[a];
                    along[a][2] = EDGE - 2;
                }
            }
            let Some(brick) = grid.brick(from) else {
                continue;
            };
            let [y, z] = [1, 2].map(|a| {
                let [first, end, from] = along[a];
                (first..end).zip(from..)
            });
            const CORNERS: usize = EDGE - 1;
            for (k, z) in z {
                for (j, y) in y.clone() {
                    let row = &brick.samples()[(z * CORNERS + y) * CORNERS..][..CORNERS];
                    let out = &mut samples[(k * EDGE + j) * EDGE..][..EDGE];
                    match is_upper[0] {
                        false => out[..CORNERS].copy_from_slice(row),
                        true => out[CORNERS] = row[along[0][2]],
                    }
                }
            }
        }
        Self {
            samples,
            max: largest(&samples),
        }
    }

    /// The mean of the field over a block.
    pub fn mean(&self, block: &Block) -> f32 {
        let weights = [0, 1, 2].map(|a| weights(block.dims[a], |_| 1.0));
        let count: usize = block.dims.iter().product();
        (self.sum(block, &weights) / count as f64) as f32
    }

    /// The field along an axis through a voxel, where `across` are the places on the other two, in
    /// their order: its values at the middles of the voxel before, of this and of the next.
    pub fn column(&self, voxel: [usize; 3], axis: usize, across: [f32; 2]) -> Column {
        const STRIDES: [usize; 3] = [1, EDGE, EDGE * EDGE];
        let others = [(axis + 1) % 3, (axis + 2) % 3];
        let mut first = voxel[axis] * STRIDES[axis];
        let mut part = [0.0; 2];
        for ((other, place), part) in others.into_iter().zip(across).zip(&mut part) {
            // Samples lie at middles of voxels; those of the brick begin with one before.
            let upper = usize::from(place >= 0.5);
            first += (voxel[other] + upper) * STRIDES[other];
            *part = place + 0.5 - upper as f32;
        }
        let [next_u, next_v] = others.map(|other| STRIDES[other]);
        let [u, v] = part;
        Column(std::array::from_fn(|k| {
            let at = first + k * STRIDES[axis];
            let along = |at: usize| self.samples[at] * (1.0 - u) + self.samples[at + next_u] * u;
            along(at) * (1.0 - v) + along(at + next_v) * v
        }))
    }

    /// The mean of a block's points, weighted by the field, from the brick's first corner in
    /// voxels; `None` if the field is 0 all over the block.
    pub fn centroid(&self, block: &Block) -> Option<DVec3> {
        let plain = [0, 1, 2].map(|a| weights(block.dims[a], |_| 1.0));
        let sum = self.sum(block, &plain);
        let along = |a: usize| {
            let mut all = plain;
            all[a] = weights(block.dims[a], |place| block.first[a] as f64 + place);
            self.sum(block, &all) / sum
        };
        (sum > 0.0).then(|| DVec3::new(along(0), along(1), along(2)))
    }

    fn sum(&self, block: &Block, weights: &[[f64; EDGE]; 3]) -> f64 {
        let [nx, ny, nz] = block.dims.map(|n| n + 2);
        let [x, y, z] = block.first;
        let mut sum = 0.0;
        for k in 0..nz {
            let mut face = 0.0;
            for j in 0..ny {
                let first = ((z + k) * EDGE + y + j) * EDGE + x;
                let samples = self.samples[first..first + nx].iter().zip(&weights[0]);
                let row: f64 = samples.map(|(s, w)| f64::from(*s) * w).sum();
                face += weights[1][j] * row;
            }
            sum += weights[2][k] * face;
        }
        sum
    }
}

/// Weights of the samples along one axis, from the one before a row of `count` voxels on, in the
/// sum over these of the voxels' means of the field times `factor` of the place in the row.
///
/// Two points a voxel tell all: between them and the knees at voxel centres and borders the field
/// is linear.
fn weights(count: usize, factor: impl Fn(f64) -> f64) -> [f64; EDGE] {
    let mut weights = [0.0; EDGE];
    for voxel in 0..count {
        let [lower, upper] = [0.25, 0.75].map(|place| 0.5 * factor(voxel as f64 + place));
        weights[voxel] += 0.25 * lower;
        weights[voxel + 1] += 0.75 * (lower + upper);
        weights[voxel + 2] += 0.25 * upper;
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{sampling, unflatten};
    use glam::Vec3;

    #[test]
    fn means_are_those_of_points_all_over_a_block() {
        // With a whole last brick of cells, and without; empty parts; few voxels along an axis.
        for dims in [[21, 16, 9], [23, 7, 1], [1, 2, 30]] {
            let value = |v: [usize; 3]| {
                let random = sampling::unit(sampling::hash(&v.map(|i| i as u64)));
                if v[0] < 12 && v[2] < 3 {
                    0.0
                } else {
                    random * random
                }
            };
            let grid = Grid::from_fn(dims, value);
            let bricks = dims.map(|n| n.div_ceil(BRICK_EDGE));
            for b in (0..bricks.iter().product()).map(|i| unflatten(i, bricks)) {
                let field = BrickField::new(&grid, b);
                for edge in [1, 2, 4, 8] {
                    for i in 0..(BRICK_EDGE / edge).pow(3) {
                        let first = unflatten(i, [BRICK_EDGE / edge; 3]).map(|n| n * edge);
                        let base = [0, 1, 2].map(|a| b[a] * BRICK_EDGE + first[a]);
                        if (0..3).any(|a| base[a] >= dims[a]) {
                            continue;
                        }
                        let inside = [0, 1, 2].map(|a| edge.min(dims[a] - base[a]));
                        let block = Block {
                            first,
                            dims: inside,
                        };
                        let points = inside.map(|n| 2 * n);
                        let count: usize = points.iter().product();
                        let (mut sum, mut moment) = (0.0, DVec3::ZERO);
                        for p in (0..count).map(|i| unflatten(i, points)) {
                            let local = DVec3::from(p.map(|k| (k as f64 + 0.5) * 0.5));
                            let at = DVec3::from(base.map(|n| n as f64)) + local;
                            let sigma = f64::from(grid.sample(at.as_vec3()));
                            sum += sigma;
                            moment += (local + DVec3::from(first.map(|n| n as f64))) * sigma;
                        }
                        let mean = sum / count as f64;
                        assert!(
                            (f64::from(field.mean(&block)) - mean).abs() < 1e-6 * mean.max(1e-3)
                        );
                        match field.centroid(&block) {
                            None => assert_eq!(sum, 0.0),
                            Some(centroid) => {
                                assert!((centroid - moment / sum).length() < 1e-5);
                            }
                        }
                    }
                }
                for i in 0..60 {
                    let voxel = [0, 1, 2].map(|a| (i * (7 + a) + a) % BRICK_EDGE);
                    let [u, v, w] = [3, 5, 7].map(|n| (n * i) as f32 / 60.0 % 1.0);
                    let axis = i % 3;
                    let mut at = [0.0; 3];
                    for (a, place) in [axis, (axis + 1) % 3, (axis + 2) % 3]
                        .into_iter()
                        .zip([w, u, v])
                    {
                        at[a] = (b[a] * BRICK_EDGE + voxel[a]) as f32 + place;
                    }
                    if (0..3).all(|a| at[a] <= dims[a] as f32) {
                        let found = field.column(voxel, axis, [u, v]).at(w);
                        assert!((found - grid.sample(at.into())).abs() < 1e-5, "{at:?}");
                    }
                }
                let near = (0..EDGE.pow(3)).map(|i| unflatten(i, [EDGE; 3])).map(|at| {
                    let voxel = [0, 1, 2].map(|a| {
                        let voxel = (b[a] * BRICK_EDGE + at[a]).saturating_sub(1);
                        voxel.min(dims[a] - 1) as f32 + 0.5
                    });
                    grid.sample(Vec3::from(voxel))
                });
                assert_eq!(field.max, near.fold(0.0, f32::max));
            }
        }
    }
}
