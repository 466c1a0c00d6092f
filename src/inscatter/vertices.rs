//! A lattice of values on a volume's own grid, made on demand.

use crate::scene::Volume;
use glam::Vec3;
use std::ops::{AddAssign, Mul};
use std::sync::OnceLock;
use wide::{f32x4, f32x8};

const BRICK_EDGE: usize = 8;

/// Voxels that vertices and probes keep from the border of their volume: there may be a floor or a
/// emitter in its plane, of which they would see either side.
pub const BORDER_MARGIN_VOXELS: f32 = 0.1;

/// A point of a volume's index space in the scene, [`BORDER_MARGIN_VOXELS`] its border.
pub fn inside(volume: &Volume, p: Vec3) -> Vec3 {
    let dims = Vec3::from(volume.sigma_t.size());
    let inside = p.clamp(
        Vec3::splat(BORDER_MARGIN_VOXELS),
        dims - BORDER_MARGIN_VOXELS,
    );
    let in_scene = volume.scene_from_index.transform_point3(inside.as_dvec3());
    in_scene.as_vec3()
}

/// Values at vertices, each made when first asked for and a function of its coordinates alone.
#[derive(Debug)]
pub struct Vertices<T> {
    /// Voxels between vertices.
    step: f32,
    count: [usize; 3],
    bricks: [usize; 3],
    values: Vec<OnceLock<Box<[OnceLock<T>]>>>,
}

impl<T> Vertices<T> {
    /// A lattice with a vertex every `step` voxels.
    pub fn new(dims: [usize; 3], step: usize) -> Self {
        let count = dims.map(|n| n.div_ceil(step) + 1);
        let bricks = count.map(|n| n.div_ceil(BRICK_EDGE));
        let values = (0..bricks[0] * bricks[1] * bricks[2])
            .map(|_| OnceLock::new())
            .collect();
        Self {
            step: step as f32,
            count,
            bricks,
            values,
        }
    }

    /// The value at a vertex; `evaluate(point in index space, vertex)` makes it.
    pub fn get(&self, v: [usize; 3], evaluate: &impl Fn(Vec3, [usize; 3]) -> T) -> &T {
        let b = v.map(|c| c / BRICK_EDGE);
        let l = v.map(|c| c % BRICK_EDGE);
        let brick = self.values[(b[2] * self.bricks[1] + b[1]) * self.bricks[0] + b[0]]
            .get_or_init(|| {
                (0..BRICK_EDGE * BRICK_EDGE * BRICK_EDGE)
                    .map(|_| OnceLock::new())
                    .collect()
            });
        brick[(l[2] * BRICK_EDGE + l[1]) * BRICK_EDGE + l[0]]
            .get_or_init(|| evaluate(self.at(v), v))
    }

    /// Vertices along each axis.
    pub fn count(&self) -> [usize; 3] {
        self.count
    }

    /// The place of a vertex in index space.
    pub fn at(&self, v: [usize; 3]) -> Vec3 {
        Vec3::from(v.map(|c| c as f32)) * self.step
    }

    /// The eight vertices around a point of index space.
    #[inline]
    pub fn around(&self, point_in_index: Vec3) -> CellCorners {
        let p = (point_in_index / self.step).to_array();
        let mut first = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let at = p[a].clamp(0.0, (self.count[a] - 1) as f32);
            first[a] = (at as usize).min(self.count[a].saturating_sub(2));
            f[a] = at - first[a] as f32;
        }
        let [[lx, ux], [ly, uy], [lz, uz]] = f.map(|f| [1.0 - f, f]);
        let along_x = f32x8::new([lx, ux, lx, ux, lx, ux, lx, ux]);
        let along_y = f32x8::new([ly, ly, uy, uy, ly, ly, uy, uy]);
        let along_z = f32x8::new([lz, lz, lz, lz, uz, uz, uz, uz]);
        CellCorners {
            first,
            weights: (along_x * along_y * along_z).to_array(),
        }
    }
}

/// The vertices at the corners of a cell around a point: bit `a` of a corner's number tells its end
/// along axis `a`.
#[derive(Clone, Copy, Debug)]
pub struct CellCorners {
    first: [usize; 3],
    /// Their trilinear weights, of which some may be 0.
    pub weights: [f32; 8],
}

impl CellCorners {
    /// The vertex at a corner.
    #[inline]
    pub fn vertex(&self, corner: usize) -> [usize; 3] {
        std::array::from_fn(|a| self.first[a] + (corner >> a & 1))
    }

    /// A bit for each corner whose weight is not 0.
    #[inline]
    fn matter(&self) -> u8 {
        f32x8::new(self.weights).simd_gt(f32x8::ZERO).to_bitmask() as u8
    }
}

/// The values at the cube of vertices that was asked for last: points in a row on a ray often lie
/// in one, or in the next.
#[derive(Debug, Default)]
pub struct CellCache<K, T> {
    /// Whose values they are, and the first vertex.
    of: Option<(K, [usize; 3])>,
    /// A bit for each value that is known.
    known: u8,
    /// A bit for each vertex that surfaces hide from the ray, once that was asked.
    hidden: Option<u8>,
    values: [T; 8],
}

impl<K: Copy + PartialEq, T: Copy> CellCache<K, T> {
    /// The values at vertices; `find` finds those that are not known, but for those of weight 0.
    /// Values that may differ at a vertex have another key.
    #[inline]
    pub fn values(
        &mut self,
        key: K,
        around: &CellCorners,
        find: impl Fn([usize; 3]) -> T,
    ) -> &[T; 8] {
        if self.of != Some((key, around.first)) {
            self.move_to(key, around.first);
        }
        let mut missing = around.matter() & !self.known;
        self.known |= missing;
        while missing != 0 {
            let i = missing.trailing_zeros() as usize;
            self.values[i] = find(around.vertex(i));
            missing &= missing - 1;
        }
        &self.values
    }

    /// To another cube, which may share vertices with the last.
    fn move_to(&mut self, key: K, first: [usize; 3]) {
        self.known = match self.of {
            Some((of, last)) if of == key => (0..3).fold(self.known, |known, a| {
                match first[a].wrapping_sub(last[a]) {
                    0 => known,
                    1 => self.shift(known, 1 << a, true),
                    usize::MAX => self.shift(known, 1 << a, false),
                    _ => 0,
                }
            }),
            _ => 0,
        };
        self.of = Some((key, first));
        self.hidden = None;
    }

    /// A step along the axis of this bit of a corner's number; returns which values are known then.
    fn shift(&mut self, known: u8, bit: usize, up: bool) -> u8 {
        /// Corners at the upper end of an axis, by its bit.
        const UPPER: [u8; 5] = [0, 0b1010_1010, 0b1100_1100, 0, 0b1111_0000];
        for lower in (0..8).filter(|i| i & bit == 0) {
            let (from, to) = if up {
                (lower | bit, lower)
            } else {
                (lower, lower | bit)
            };
            self.values[to] = self.values[from];
        }
        if up {
            (known & UPPER[bit]) >> bit
        } else {
            (known & !UPPER[bit]) << bit
        }
    }

    /// The values that [`Self::values`] gave last.
    #[inline]
    pub fn last(&self) -> &[T; 8] {
        &self.values
    }

    /// The weights of vertices, but none of those that are hidden, with the same sum; `None` if all
    /// are. What hides is asked of the vertices once, from where the ray first needs to know.
    pub fn unhidden(
        &mut self,
        around: &CellCorners,
        is_hidden: impl Fn([usize; 3]) -> bool,
    ) -> Option<[f32; 8]> {
        let ask = || {
            (0..8).fold(0, |bits, i| {
                bits | u8::from(is_hidden(around.vertex(i))) << i
            })
        };
        let hidden = *self.hidden.get_or_insert_with(ask);
        let mut weights = around.weights;
        let all: f32 = weights.iter().sum();
        for (i, weight) in weights.iter_mut().enumerate() {
            if hidden >> i & 1 == 1 {
                *weight = 0.0;
            }
        }
        let scale = all / weights.iter().sum::<f32>();
        weights.iter_mut().for_each(|weight| *weight *= scale);
        scale.is_finite().then_some(weights)
    }
}

/// The weighted sum of values, or of something that they have.
#[inline]
pub fn blend<T, V: Copy + Default + AddAssign + Mul<f32, Output = V>>(
    values: &[T; 8],
    weights: &[f32; 8],
    of: impl Fn(&T) -> V,
) -> V {
    let mut sum = V::default();
    for (value, &weight) in values.iter().zip(weights) {
        // What is not known, or the logarithm of no light, must not count, even times 0.
        if weight > 0.0 {
            sum += of(value) * weight;
        }
    }
    sum
}

/// Numbers side by side.
pub trait Lanes: Copy {
    /// The same number in all places.
    fn splat(v: f32) -> Self;
    /// The smaller of each and its counterpart.
    fn least(self, other: Self) -> Self;
    /// The larger of each and its counterpart.
    fn most(self, other: Self) -> Self;
}

macro_rules! lanes {
    ($($vector:ty),*) => {$(
        impl Lanes for $vector {
            #[inline]
            fn splat(v: f32) -> Self {
                Self::splat(v)
            }

            #[inline]
            fn least(self, other: Self) -> Self {
                self.fast_min(other)
            }

            #[inline]
            fn most(self, other: Self) -> Self {
                self.fast_max(other)
            }
        }
    )*};
}

lanes!(f32x4, f32x8);

/// The smallest and the largest that values of some weight have in each place, which are not below
/// 0.
#[inline]
pub fn extremes<T, V: Lanes>(values: &[T; 8], weights: &[f32; 8], of: impl Fn(&T) -> V) -> (V, V) {
    let (mut least, mut most) = (V::splat(f32::INFINITY), V::splat(0.0));
    for (value, &weight) in values.iter().zip(weights) {
        if weight > 0.0 {
            (least, most) = (of(value).least(least), of(value).most(most));
        }
    }
    (least, most)
}

/// Whether the brightest of values is no more than `ratio` times as bright as the darkest.
#[inline]
pub fn are_alike(least: f32, most: f32, ratio: f32) -> bool {
    most <= ratio * least || least == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_vertices_leave_their_weight_to_the_others_and_are_asked_for_once() {
        let lattice = Vertices::<f32>::new([8; 3], 4);
        let mut cube = CellCache::<(), f32>::default();
        let lit = |[x, _, _]: [usize; 3]| if x > 0 { 1.0 } else { 0.0 };
        let mut light_at = |x: f32, hidden: &dyn Fn([usize; 3]) -> bool| {
            let around = lattice.around(Vec3::new(x, 2.0, 2.0));
            cube.values((), &around, lit);
            let weights = cube.unhidden(&around, hidden)?;
            Some(blend(cube.last(), &weights, |v| *v))
        };
        assert_eq!(light_at(1.0, &|_| false), Some(0.25));
        // The same cube: what hides is known.
        assert_eq!(light_at(1.0, &|_| true), Some(0.25));
        assert_eq!(light_at(5.0, &|_| true), None);
        // Another one, behind a wall.
        assert_eq!(light_at(3.0, &|[x, _, _]| x > 0), Some(0.0));
        assert_eq!(light_at(3.9, &|_| panic!("asked again")), Some(0.0));
    }

    #[test]
    fn a_cube_has_the_values_of_its_vertices_and_asks_once_for_those_it_shares_with_the_last() {
        let lattice = Vertices::<f32>::new([32; 3], 2);
        let value = |[x, y, z]: [usize; 3]| (x + 20 * y + 400 * z) as f32;
        let mut cube = CellCache::<usize, f32>::default();
        let asked = std::cell::RefCell::new(Vec::new());
        let mut look = |key: usize, p: [f32; 3]| {
            let around = lattice.around(p.into());
            asked.borrow_mut().clear();
            let find = |v| {
                asked.borrow_mut().push(v);
                value(v) + key as f32 * 1e4
            };
            let values = *cube.values(key, &around, find);
            for (i, &weight) in around.weights.iter().enumerate() {
                let expected = value(around.vertex(i)) + key as f32 * 1e4;
                assert!(weight == 0.0 || values[i] == expected, "{p:?} {i}");
            }
            let asked = asked.borrow();
            assert!(asked.iter().all(|v| {
                let corner = (0..8).find(|i| around.vertex(*i) == *v);
                corner.is_some_and(|i| around.weights[i] > 0.0)
            }));
            asked.len()
        };
        assert_eq!(look(0, [1.0; 3]), 8);
        assert_eq!(look(0, [1.5; 3]), 0);
        // Across one face, an edge, a corner; and back.
        for (axes, shared) in [(1, 4), (2, 2), (3, 1)] {
            let to = std::array::from_fn(|a| if a < axes { 2.5 } else { 1.0 });
            assert_eq!(look(0, to), 8 - shared);
            assert_eq!(look(0, [1.0; 3]), 8 - shared);
        }
        assert_eq!(look(0, [1.0, 1.0, 5.0]), 8);
        assert_eq!(look(1, [1.0, 1.0, 5.0]), 8);
        // In a plane of vertices those beside it do not matter until they do.
        assert_eq!(look(1, [21.0, 22.0, 23.0]), 4);
        assert_eq!(look(1, [23.0, 22.0, 23.0]), 2);
        assert_eq!(look(1, [23.0, 22.5, 23.0]), 4);
    }

    #[test]
    fn weights_are_trilinear() {
        let lattice = Vertices::<f32>::new([7, 9, 1], 2);
        for p in [[0.3, 5.7, 0.9], [-3.0, 20.0, 0.0], [6.9, 8.0, 1.0]] {
            let around = lattice.around(p.into());
            let sums = |a: usize| {
                let along = (0..8).map(|i| around.weights[i] * around.vertex(i)[a] as f32);
                along.sum::<f32>()
            };
            let last = [4.0, 5.0, 1.0];
            for a in 0..3 {
                let expected = (p[a] / 2.0_f32).clamp(0.0, last[a]);
                assert!((sums(a) - expected).abs() < 1e-6, "{p:?}");
            }
        }
    }
}
