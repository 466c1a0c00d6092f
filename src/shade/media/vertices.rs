//! A lattice of values on a volume's own grid, made on demand.

use crate::scene::Volume;
use glam::Vec3;
use std::ops::{AddAssign, Mul};
use std::sync::OnceLock;

const BRICK: usize = 8;

/// Voxels that vertices and probes keep from the border of their volume: there may be a floor or a lamp in its plane, of which
/// they would see either side.
pub const INSIDE: f32 = 0.1;

/// A point of a volume's index space in the scene, [`INSIDE`] its border.
pub fn inside(volume: &Volume, p: Vec3) -> Vec3 {
    let dims = Vec3::from(volume.sigma_t.dims().map(|n| n as f32));
    let inside = p.clamp(Vec3::splat(INSIDE), dims - INSIDE);
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
        let bricks = count.map(|n| n.div_ceil(BRICK));
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
        let b = v.map(|c| c / BRICK);
        let l = v.map(|c| c % BRICK);
        let brick = self.values[(b[2] * self.bricks[1] + b[1]) * self.bricks[0] + b[0]]
            .get_or_init(|| {
                (0..BRICK * BRICK * BRICK)
                    .map(|_| OnceLock::new())
                    .collect()
            });
        brick[(l[2] * BRICK + l[1]) * BRICK + l[0]]
            .get_or_init(|| evaluate(Vec3::from(v.map(|c| c as f32)) * self.step, v))
    }

    /// The eight vertices around a point of index space and their trilinear weights, of which some may be 0.
    pub fn around(&self, point_in_index: Vec3) -> [([usize; 3], f32); 8] {
        let p = (point_in_index / self.step).to_array();
        let mut base = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let at = p[a].clamp(0.0, (self.count[a] - 1) as f32);
            base[a] = (at as usize).min(self.count[a].saturating_sub(2));
            f[a] = at - base[a] as f32;
        }
        std::array::from_fn(|corner| {
            let mut weight = 1.0;
            let v = std::array::from_fn(|a| {
                let upper = corner >> a & 1;
                weight *= if upper == 1 { f[a] } else { 1.0 - f[a] };
                base[a] + upper
            });
            (v, weight)
        })
    }
}

/// The values at the cube of vertices that was asked for last: points in a row on a ray often lie in one.
#[derive(Debug, Default)]
pub struct Cube<K, T> {
    /// Whose values they are, and the first vertex.
    of: Option<(K, [usize; 3])>,
    /// A bit for each value that is known.
    known: u8,
    /// A bit for each vertex that surfaces hide from the ray, once that was asked.
    hidden: Option<u8>,
    values: [T; 8],
}

impl<K: PartialEq, T: Copy + Default> Cube<K, T> {
    /// The values at the vertices [`Vertices::around`] a point, with their weights; `find` finds those that are not known, but
    /// for those of weight 0. Values that may differ at a vertex have another key.
    pub fn values(
        &mut self,
        key: K,
        around: [([usize; 3], f32); 8],
        find: impl Fn([usize; 3]) -> T,
    ) -> [(T, f32); 8] {
        let of = Some((key, around[0].0));
        if self.of != of {
            self.of = of;
            self.known = 0;
            self.hidden = None;
        }
        std::array::from_fn(|i| {
            let (v, weight) = around[i];
            if weight <= 0.0 {
                return (T::default(), 0.0);
            }
            if self.known >> i & 1 == 0 {
                self.values[i] = find(v);
                self.known |= 1 << i;
            }
            (self.values[i], weight)
        })
    }
}

impl<K, T> Cube<K, T> {
    /// The weights that [`Self::values`] gave last, but none of vertices that are hidden, with the same sum; `None` if all are.
    /// What hides is asked of the vertices once, from where the ray first needs to know.
    pub fn unhidden(
        &mut self,
        mut values: [(T, f32); 8],
        around: [([usize; 3], f32); 8],
        is_hidden: impl Fn([usize; 3]) -> bool,
    ) -> Option<[(T, f32); 8]> {
        let ask = || (0..8).fold(0, |bits, i| bits | u8::from(is_hidden(around[i].0)) << i);
        let hidden = *self.hidden.get_or_insert_with(ask);
        let sum = |values: &[(T, f32); 8]| values.iter().map(|(_, weight)| weight).sum::<f32>();
        let all = sum(&values);
        for (i, (_, weight)) in values.iter_mut().enumerate() {
            if hidden >> i & 1 == 1 {
                *weight = 0.0;
            }
        }
        let scale = all / sum(&values);
        values.iter_mut().for_each(|(_, weight)| *weight *= scale);
        scale.is_finite().then_some(values)
    }
}

/// Their weighted sum.
pub fn blend<T: Copy + Default + AddAssign + Mul<f32, Output = T>>(values: &[(T, f32); 8]) -> T {
    let mut sum = T::default();
    for &(value, weight) in values {
        if weight > 0.0 {
            sum += value * weight;
        }
    }
    sum
}

/// How bright the darkest and the brightest of them are.
pub fn extremes<T>(values: &[(T, f32); 8], brightness: impl Fn(&T) -> f32) -> (f32, f32) {
    let (mut least, mut most) = (f32::INFINITY, 0.0_f32);
    for (value, weight) in values {
        if *weight > 0.0 {
            let b = brightness(value);
            (least, most) = (least.min(b), most.max(b));
        }
    }
    (least, most)
}

/// Whether the brightest of them, by `brightness`, is no more than `ratio` times as bright as the darkest.
pub fn are_alike<T>(values: &[(T, f32); 8], ratio: f32, brightness: impl Fn(&T) -> f32) -> bool {
    let (least, most) = extremes(values, brightness);
    most <= ratio * least || least == 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_vertices_leave_their_weight_to_the_others_and_are_asked_for_once() {
        let lattice = Vertices::<f32>::new([8; 3], 4);
        let mut cube = Cube::<(), f32>::default();
        let lit = |[x, _, _]: [usize; 3]| if x > 0 { 1.0 } else { 0.0 };
        let mut light_at = |x: f32, hidden: &dyn Fn([usize; 3]) -> bool| {
            let around = lattice.around(Vec3::new(x, 2.0, 2.0));
            let values = cube.values((), around, lit);
            cube.unhidden(values, around, hidden).map(|v| blend(&v))
        };
        assert_eq!(light_at(1.0, &|_| false), Some(0.25));
        // The same cube: what hides is known.
        assert_eq!(light_at(1.0, &|_| true), Some(0.25));
        assert_eq!(light_at(5.0, &|_| true), None);
        // Another one, behind a wall.
        assert_eq!(light_at(3.0, &|[x, _, _]| x > 0), Some(0.0));
        assert_eq!(light_at(3.9, &|_| panic!("asked again")), Some(0.0));
    }
}
