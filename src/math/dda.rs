//! Walking a ray through a regular grid of boxes (Amanatides & Woo 1987).

use super::Ray;
use glam::{Affine3A, BVec3A, DAffine3, DVec3, Vec3A};
use wide::{f32x4, f64x4};

/// Steps over cells along one ray (Amanatides & Woo 1987), at some scale. Without branches: which
/// axis is next is as good as random, and a wrong guess of the processor would cost more than a
/// step.
#[derive(Clone, Copy, Debug)]
pub struct Steps {
    /// Coordinates of the present cell: whole numbers.
    at: Vec3A,
    step: Vec3A,
    limit: Vec3A,
    t_next: Vec3A,
    t_step: Vec3A,
}

impl Steps {
    /// Cells of edge `edge` from parameter `t` on, the first one clamped into `0..limit`.
    #[inline]
    #[must_use]
    pub fn new(line: &Line, t: f32, base: [i32; 3], edge: f32, limit: [i32; 3]) -> Self {
        let Line {
            origin,
            direction,
            inverse,
        } = *line;
        let base = Vec3A::from_array(base.map(|v| v as f32));
        let limit = Vec3A::from_array(limit.map(|n| n as f32));
        let p = (origin + direction * t - base) * (1.0 / edge);
        let first = p.floor().max(Vec3A::ZERO).min(limit - 1.0);
        let stays = line.stays();
        let is_up = direction.cmpgt(Vec3A::ZERO);
        let ahead = Vec3A::select(is_up, Vec3A::ONE, Vec3A::ZERO);
        let step = Vec3A::select(is_up, Vec3A::ONE, Vec3A::NEG_ONE);
        let border = base + (first + ahead) * edge;
        let next = (border - origin) * inverse;
        Self {
            at: first,
            step: Vec3A::select(stays, Vec3A::ZERO, step),
            limit,
            t_next: Vec3A::select(stays, Vec3A::INFINITY, next),
            t_step: Vec3A::select(stays, Vec3A::INFINITY, inverse.abs() * edge),
        }
    }

    /// Coordinates of the present cell.
    #[inline]
    #[must_use]
    pub fn at(&self) -> [i32; 3] {
        truncated(self.at)
    }

    /// Coordinates of the present cell, as floating-point numbers.
    #[inline]
    #[must_use]
    pub fn corner(&self) -> Vec3A {
        self.at
    }

    /// Parameter at which the present cell is left.
    #[inline]
    #[must_use]
    pub fn leave(&self) -> f32 {
        self.t_next.min_element()
    }

    /// Moves to the next cell, across an edge or a corner if the ray meets one; returns whether it
    /// is inside the limit. A ray that crosses nothing is outside, so that every walk ends.
    #[inline]
    pub fn advance(&mut self) -> bool {
        let leave = self.leave();
        let crosses = self.t_next.cmple(Vec3A::splat(leave));
        self.t_next += Vec3A::select(crosses, self.t_step, Vec3A::ZERO);
        self.at += Vec3A::select(crosses, self.step, Vec3A::ZERO);
        let inside = self.at.cmpge(Vec3A::ZERO) & self.at.cmplt(self.limit);
        // Not so for NaN, and for no direction at all.
        leave < f32::INFINITY && inside.all()
    }
}

/// Coordinates as integers, those that are whole numbers already.
#[inline]
fn truncated(v: Vec3A) -> [i32; 3] {
    let [x, y, z, _] = f32x4::new([v.x, v.y, v.z, 0.0]).fast_trunc_int().to_array();
    [x, y, z]
}

/// A straight line through a grid.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    /// Start, in grid coordinates.
    pub origin: Vec3A,
    /// Grid coordinates per unit of the parameter.
    pub direction: Vec3A,
    /// One over `direction`, infinite where that is 0.
    inverse: Vec3A,
}

impl Line {
    /// A line from a point along a direction, in grid coordinates.
    #[inline]
    #[must_use]
    pub fn new(origin: Vec3A, direction: Vec3A) -> Self {
        Self {
            origin,
            direction,
            inverse: direction.recip(),
        }
    }

    /// Along which axes it does not move, or less than a number can tell.
    #[inline]
    fn stays(&self) -> BVec3A {
        self.inverse.abs().cmpeq(Vec3A::INFINITY)
    }

    /// Returns the part of the line from `near` to `far` that is inside a box, by its parameters.
    #[inline]
    #[must_use]
    pub fn within(&self, lower: Vec3A, upper: Vec3A, near: f32, far: f32) -> Option<(f32, f32)> {
        let stays = self.stays();
        let is_outside = self.origin.cmplt(lower) | self.origin.cmpgt(upper);
        let t0 = (lower - self.origin) * self.inverse;
        let t1 = (upper - self.origin) * self.inverse;
        let enter = Vec3A::select(stays, Vec3A::NEG_INFINITY, t0.min(t1));
        let leave = Vec3A::select(stays, Vec3A::INFINITY, t0.max(t1));
        let near = near.max(enter.max_element());
        let far = far.min(leave.min_element());
        (near < far && !(stays & is_outside).any()).then_some((near, far))
    }
}

/// Returns the part of the line o + t d that is inside the box 0..dims, for t in 0..t_max.
#[inline]
fn clip_to_box(o: DVec3, d: DVec3, dims: DVec3, t_max: f64) -> Option<(f64, f64)> {
    // The fourth axis has neither length nor direction: it stays inside.
    let [o, d, dims] = [o, d, dims].map(|v| f64x4::new([v.x, v.y, v.z, 0.0]));
    let stays = d.simd_eq(f64x4::ZERO);
    let is_outside = o.simd_lt(f64x4::ZERO) | o.simd_gt(dims);
    if (stays & is_outside).any() {
        return None;
    }
    let inverse = f64x4::ONE / d;
    let (t0, t1) = (-o * inverse, (dims - o) * inverse);
    let enter = stays.select(f64x4::splat(f64::NEG_INFINITY), t0.min(t1));
    let leave = stays.select(f64x4::splat(f64::INFINITY), t0.max(t1));
    let near = enter.to_array().into_iter().fold(0.0, f64::max);
    let far = leave.to_array().into_iter().fold(t_max, f64::min);
    (near < far).then_some((near, far))
}

/// The part of a ray that is inside the box of a grid.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    /// The line from where the ray enters, in grid coordinates, by distance in scene units: exact
    /// for far-away origins, too.
    pub line: Line,
    /// Distance from the ray's origin to that of the line.
    pub start: f32,
    /// Distance from there to where the ray leaves.
    pub end: f32,
}

impl Passage {
    /// Finds the part of a ray that is inside the box 0..dims of a grid; `None` if it misses that.
    /// The map from scene space to grid coordinates is given in both precisions.
    #[inline]
    #[must_use]
    pub fn new((map, exact): (&Affine3A, &DAffine3), dims: [f32; 3], ray: &Ray) -> Option<Self> {
        let &Ray {
            origin,
            direction,
            t_max,
        } = ray;
        // Most rays miss most volumes. Rounding must not make one of them that does not.
        let line = Line::new(
            map.transform_point3a(origin.into()),
            map.transform_vector3a(direction.into()),
        );
        let dims = Vec3A::from_array(dims);
        let size = line.origin.abs().max(dims).max_element();
        let margin = Vec3A::splat(2.0 * f32::EPSILON * size);
        line.within(-margin, dims + margin, 0.0, t_max)?;
        // Rounding the ends of a ray in a dense medium would be seen: they are found once more,
        // exactly.
        let o = exact.transform_point3(origin.as_dvec3());
        let d = exact.transform_vector3(direction.as_dvec3());
        let (start, end) = clip_to_box(o, d, dims.as_dvec3(), f64::from(t_max))?;
        let entry = (o + d * start).as_vec3a();
        Some(Self {
            line: Line::new(entry.clamp(Vec3A::ZERO, dims), d.as_vec3a()),
            start: start as f32,
            end: (end - start) as f32,
        })
    }

    /// The passage in the coordinates of cells, whose corners are the middles of voxels, in a
    /// margin of half a cell.
    #[inline]
    #[must_use]
    pub fn in_cells(mut self) -> Self {
        self.line.origin += Vec3A::splat(0.5);
        self
    }
}

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
                let line = Line::new(Vec3A::new(d, 0.5, 0.5), direction.into());
                for edge in [1.0, 8.0] {
                    let mut steps = Steps::new(&line, 0.0, [0; 3], edge, [4; 3]);
                    let cells = (0..13).take_while(|_| steps.advance()).count();
                    assert!(cells <= 9, "{line:?}");
                }
            }
        }
    }

    #[test]
    fn a_line_along_an_axis_is_inside_a_box_or_beside_it() {
        let (lower, upper) = (Vec3A::ZERO, Vec3A::new(2.0, 3.0, 4.0));
        // One over the second is beyond all numbers.
        for still in [0.0, -0.0, 1e-39] {
            let along = |y: f32| Line::new(Vec3A::new(-1.0, y, 4.0), Vec3A::new(2.0, still, 0.0));
            for y in [0.0, 1.5, 3.0] {
                assert_eq!(along(y).within(lower, upper, 0.0, 9.0), Some((0.5, 1.5)));
            }
            for y in [-0.1, 3.1] {
                assert_eq!(along(y).within(lower, upper, 0.0, 9.0), None);
            }
        }
    }
}
