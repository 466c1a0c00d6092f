//! Walking a ray through a regular grid of boxes (Amanatides & Woo 1987).

use glam::{Affine3A, DAffine3, Vec3};

/// Steps over cells along one ray (Amanatides & Woo 1987), at some scale. Without branches: which axis is next is as good
/// as random, and a wrong guess of the processor would cost more than a step.
#[derive(Clone, Copy, Debug)]
pub struct Steps {
    /// Coordinates of the present cell.
    pub at: [i32; 3],
    step: [i32; 3],
    limit: [u32; 3],
    t_next: [f32; 3],
    t_step: [f32; 3],
}

impl Steps {
    /// Cells of edge `edge` from parameter `t` on, the first one clamped into `0..limit`.
    #[inline]
    #[must_use]
    pub fn new(line: &Line, t: f32, base: [i32; 3], edge: f32, limit: [i32; 3]) -> Self {
        let mut s = Self {
            at: [0; 3],
            step: [0; 3],
            limit: limit.map(|n| n as u32),
            t_next: [f32::INFINITY; 3],
            t_step: [f32::INFINITY; 3],
        };
        let per_edge = 1.0 / edge;
        for a in 0..3 {
            let d = line.direction[a];
            let p = (line.origin[a] + d * t - base[a] as f32) * per_edge;
            s.at[a] = (p.floor() as i32).clamp(0, limit[a] - 1);
            if d != 0.0 {
                s.step[a] = if d > 0.0 { 1 } else { -1 };
                s.t_step[a] = edge * line.inverse[a].abs();
                let border = base[a] as f32 + (s.at[a] + i32::from(d > 0.0)) as f32 * edge;
                s.t_next[a] = (border - line.origin[a]) * line.inverse[a];
            }
        }
        s
    }

    /// Parameter at which the present cell is left.
    #[inline]
    #[must_use]
    pub fn leave(&self) -> f32 {
        let [x, y, z] = self.t_next;
        let least = if x < y { x } else { y };
        if least < z { least } else { z }
    }

    /// To the next cell, across an edge or a corner if the ray meets one; returns whether it is inside the limit. A ray that
    /// crosses nothing is outside, so that every walk ends.
    #[inline]
    pub fn advance(&mut self) -> bool {
        let leave = self.leave();
        // Not so for NaN, and for no direction at all.
        let mut inside = leave < f32::INFINITY;
        for a in 0..3 {
            let crosses = self.t_next[a] <= leave;
            self.t_next[a] += if crosses { self.t_step[a] } else { 0.0 };
            self.at[a] += if crosses { self.step[a] } else { 0 };
            inside &= (self.at[a] as u32) < self.limit[a];
        }
        inside
    }
}

/// A straight line through a grid.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Start, in grid coordinates.
    pub origin: [f32; 3],
    /// Grid coordinates per unit of the parameter.
    pub direction: [f32; 3],
    /// One over `direction`, infinite where that is 0.
    pub inverse: [f32; 3],
}

impl Line {
    /// Where the line is inside a box, for parameters from `near` to `far`.
    #[inline]
    #[must_use]
    pub fn within(
        &self,
        lower: [f32; 3],
        upper: [f32; 3],
        mut near: f32,
        mut far: f32,
    ) -> Option<(f32, f32)> {
        for a in 0..3 {
            if self.direction[a] == 0.0 {
                if self.origin[a] < lower[a] || self.origin[a] > upper[a] {
                    return None;
                }
                continue;
            }
            let t0 = (lower[a] - self.origin[a]) * self.inverse[a];
            let t1 = (upper[a] - self.origin[a]) * self.inverse[a];
            near = near.max(t0.min(t1));
            far = far.min(t0.max(t1));
        }
        (near < far).then_some((near, far))
    }
}

/// Where the line o + t d is inside the box 0..dims, for t in 0..t_max; in either precision.
#[must_use]
pub fn clip_to_box<F: Coordinate>(o: [F; 3], d: [F; 3], dims: [F; 3], t_max: F) -> Option<(F, F)> {
    let (mut near, mut far) = (F::ZERO, t_max);
    for a in 0..3 {
        if d[a] == F::ZERO {
            if o[a] < F::ZERO || o[a] > dims[a] {
                return None;
            }
            continue;
        }
        let inverse = F::ONE / d[a];
        let (t0, t1) = (-o[a] * inverse, (dims[a] - o[a]) * inverse);
        near = near.larger(t0.smaller(t1));
        far = far.smaller(t0.larger(t1));
    }
    (near < far).then_some((near, far))
}

/// The part of a ray that is inside the box of a grid.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    /// From where the ray enters, in grid coordinates, by distance in scene units: exact for far-away origins, too.
    pub line: Line,
    /// Distance from the ray's origin to that of the line.
    pub start: f32,
    /// Distance from there to where the ray leaves.
    pub end: f32,
}

impl Passage {
    /// Where a ray of unit direction, in scene space, is inside the box 0..dims of a grid, before `t_max`. The map from scene
    /// space to grid coordinates is given in both precisions.
    #[inline]
    #[must_use]
    pub fn new(
        (map, exact): (&Affine3A, &DAffine3),
        dims: [f32; 3],
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
    ) -> Option<Self> {
        let o = map.transform_point3(origin).to_array();
        let d = map.transform_vector3(direction).to_array();
        // Most rays miss most volumes. Rounding must not make one of them that does not.
        let size = o
            .into_iter()
            .chain(dims)
            .fold(0.0, |m: f32, v| m.max(v.abs()));
        let margin = 2.0 * f32::EPSILON * size;
        let wider = dims.map(|n| n + 2.0 * margin);
        clip_to_box(o.map(|v| v + margin), d, wider, t_max)?;
        // Rounding the ends of a ray in a dense medium would be seen: they are found once more, exactly.
        let o = exact.transform_point3(origin.as_dvec3());
        let d = exact.transform_vector3(direction.as_dvec3());
        let exact_dims = dims.map(f64::from);
        let (start, end) = clip_to_box(o.to_array(), d.to_array(), exact_dims, f64::from(t_max))?;
        let entry = (o + d * start).as_vec3().to_array();
        let direction = d.as_vec3().to_array();
        Some(Self {
            line: Line {
                origin: std::array::from_fn(|a| entry[a].clamp(0.0, dims[a])),
                direction,
                inverse: direction.map(|v| 1.0 / v),
            },
            start: start as f32,
            end: (end - start) as f32,
        })
    }

    /// The same in the coordinates of cells, whose corners are the middles of voxels, in a margin of half a cell.
    #[inline]
    #[must_use]
    pub fn in_cells(mut self) -> Self {
        self.line.origin = self.line.origin.map(|v| v + 0.5);
        self
    }
}

/// Distance along a unit direction at which a point has left a box, 0 if it is already beyond.
#[must_use]
pub fn leave_box(point: Vec3, direction: Vec3, (lower, upper): (Vec3, Vec3)) -> f32 {
    let mut far = f32::INFINITY;
    for a in 0..3 {
        if direction[a] != 0.0 {
            let border = if direction[a] > 0.0 {
                upper[a]
            } else {
                lower[a]
            };
            far = far.min((border - point[a]) / direction[a]);
        }
    }
    far.max(0.0)
}

/// A number that coordinates may be.
pub trait Coordinate:
    Copy
    + PartialOrd
    + std::ops::Neg<Output = Self>
    + std::ops::Sub<Output = Self>
    + std::ops::Mul<Output = Self>
    + std::ops::Div<Output = Self>
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;

    /// The smaller of two; the other one of a number and none.
    fn smaller(self, other: Self) -> Self;

    /// The larger of two; the other one of a number and none.
    fn larger(self, other: Self) -> Self;
}

macro_rules! coordinate {
    ($($number:ty),*) => {$(
        impl Coordinate for $number {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;

            #[inline]
            fn smaller(self, other: Self) -> Self {
                self.min(other)
            }

            #[inline]
            fn larger(self, other: Self) -> Self {
                self.max(other)
            }
        }
    )*};
}
coordinate!(f32, f64);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_walk_ends() {
        let values = [
            0.0,
            1.0,
            -1.0,
            1e-45,
            -1e-30,
            1e30,
            f32::MAX,
            f32::INFINITY,
            f32::NEG_INFINITY,
            f32::NAN,
        ];
        let count = values.len();
        for i in 0..count.pow(4) {
            let [a, b, c, d] =
                [1, count, count.pow(2), count.pow(3)].map(|n| values[i / n % count]);
            for direction in [[a, b, c], [c, a, b]] {
                let line = Line {
                    origin: [d, 0.5, 0.5],
                    direction,
                    inverse: direction.map(|v| 1.0 / v),
                };
                for edge in [1.0, 8.0] {
                    let mut steps = Steps::new(&line, 0.0, [0; 3], edge, [4; 3]);
                    let cells = (0..13).take_while(|_| steps.advance()).count();
                    assert!(cells <= 9, "{line:?}");
                }
            }
        }
    }
}
