//! Four vectors at a time.

use glam::Vec3;
use wide::f32x4;

/// Vec3x4 vectors, by axis.
#[derive(Clone, Copy, Debug)]
pub struct Vec3x4([f32x4; 3]);

impl Vec3x4 {
    /// Vectors side by side.
    #[inline]
    #[must_use]
    pub fn new([a, b, c, d]: [Vec3; 4]) -> Self {
        Self([
            f32x4::new([a.x, b.x, c.x, d.x]),
            f32x4::new([a.y, b.y, c.y, d.y]),
            f32x4::new([a.z, b.z, c.z, d.z]),
        ])
    }

    /// One vector in all four places.
    #[inline]
    #[must_use]
    pub fn splat(v: Vec3) -> Self {
        Self(v.to_array().map(f32x4::splat))
    }

    /// Applies `f` to the four components of each axis.
    #[inline]
    #[must_use]
    pub fn map(&self, f: impl Fn([f32; 4]) -> [f32; 4]) -> Self {
        Self(self.0.map(|axis| f32x4::new(f(axis.to_array()))))
    }

    /// Cross product of each with its counterpart.
    #[inline]
    #[must_use]
    pub fn cross(&self, other: &Self) -> Self {
        let ([ax, ay, az], [bx, by, bz]) = (self.0, other.0);
        Self([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
    }

    /// Dot product of each with its counterpart.
    #[inline]
    #[must_use]
    pub fn dot(&self, other: &Self) -> f32x4 {
        let ([ax, ay, az], [bx, by, bz]) = (self.0, other.0);
        ax * bx + ay * by + az * bz
    }

    /// Euclidean length of each vector.
    #[inline]
    #[must_use]
    pub fn length(&self) -> f32x4 {
        self.dot(self).sqrt()
    }

    /// Each divided by its number.
    #[inline]
    #[must_use]
    pub fn over(&self, by: f32x4) -> Self {
        Self(self.0.map(|axis| axis / by))
    }
}
