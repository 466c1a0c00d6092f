//! Rays, and boxes along the axes.

use glam::Vec3;

/// A ray of scene space, from its origin to a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// The point at which it starts.
    pub origin: Vec3,
    /// The direction, of unit length.
    pub direction: Vec3,
    /// The distance from the origin at which it ends, scene units; may be infinite.
    pub t_max: f32,
}

impl Ray {
    /// A ray of unit direction that ends `t_max` from its origin.
    #[inline]
    #[must_use]
    pub const fn new(origin: Vec3, direction: Vec3, t_max: f32) -> Self {
        Self {
            origin,
            direction,
            t_max,
        }
    }

    /// A ray of unit direction that never ends.
    #[inline]
    #[must_use]
    pub const fn endless(origin: Vec3, direction: Vec3) -> Self {
        Self::new(origin, direction, f32::INFINITY)
    }

    /// The part of the ray before a distance from its origin.
    #[inline]
    #[must_use]
    pub const fn up_to(self, t: f32) -> Self {
        Self {
            t_max: self.t_max.min(t),
            ..self
        }
    }

    /// The point at a distance from its origin.
    #[inline]
    #[must_use]
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// A box along the axes of scene space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// The lower corner.
    pub min: Vec3,
    /// The upper corner; below the lower one in an empty box.
    pub max: Vec3,
}

impl Aabb {
    /// The box that holds no point.
    pub const EMPTY: Self = Self {
        min: Vec3::INFINITY,
        max: Vec3::NEG_INFINITY,
    };

    /// The box that holds this one and a point.
    #[inline]
    #[must_use]
    pub fn with(self, point: Vec3) -> Self {
        Self {
            min: self.min.min(point),
            max: self.max.max(point),
        }
    }

    /// The distance at which an endless ray enters the box; 0 from inside, `None` if it misses it.
    #[must_use]
    pub fn enter(&self, origin: Vec3, direction: Vec3) -> Option<f32> {
        let (mut near, mut far) = (0.0_f32, f32::INFINITY);
        for a in 0..3 {
            if direction[a] == 0.0 {
                if origin[a] < self.min[a] || origin[a] > self.max[a] {
                    return None;
                }
                continue;
            }
            let (t0, t1) = (
                (self.min[a] - origin[a]) / direction[a],
                (self.max[a] - origin[a]) / direction[a],
            );
            near = near.max(t0.min(t1));
            far = far.min(t0.max(t1));
        }
        (near <= far).then_some(near)
    }

    /// The distance along a direction at which a point has left the box; 0 if it is already beyond.
    #[must_use]
    pub fn leave(&self, point: Vec3, direction: Vec3) -> f32 {
        let mut far = f32::INFINITY;
        for a in 0..3 {
            if direction[a] != 0.0 {
                let border = if direction[a] > 0.0 {
                    self.max[a]
                } else {
                    self.min[a]
                };
                far = far.min((border - point[a]) / direction[a]);
            }
        }
        far.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ray_enters_and_leaves_a_box_where_its_faces_are() {
        let unit = Aabb::EMPTY.with(Vec3::ONE).with(Vec3::ZERO);
        let (from, along) = (Vec3::new(-2.0, 0.5, 0.5), Vec3::X);
        assert_eq!(unit.enter(from, along), Some(2.0));
        assert_eq!(unit.leave(from, along), 3.0);
        assert_eq!(unit.enter(Vec3::splat(0.5), along), Some(0.0));
        assert_eq!(unit.enter(from, -along), None);
        assert_eq!(unit.leave(from, -along), 0.0);
        assert_eq!(unit.enter(from, Vec3::Y), None);
        assert_eq!(Aabb::EMPTY.enter(from, along), None);
    }
}
