//! Parts of the scene's triangles.

use crate::math::Hit;
use glam::Vec3;

/// The size of a triangle, and the least size of its patches.
#[derive(Clone, Copy, Debug)]
pub(super) struct PatchExtent {
    /// Square of its longest edge.
    pub edge2: f32,
    /// Square of the edge below which patches are not divided, about as long as surfels stand
    /// apart; [`Self::BLACK`] if the triangle reflects nothing.
    pub least: f32,
}

impl PatchExtent {
    /// The value of `least` for what reflects nothing, so that no tree need be asked.
    pub const BLACK: f32 = -1.0;

    /// The extent of a triangle; `least` is `None` where nothing is reflected.
    pub fn new([a, b, c]: [Vec3; 3], least: Option<f32>) -> Self {
        let edges = [b - a, c - a, c - b].map(Vec3::length_squared);
        Self {
            edge2: edges.into_iter().fold(0.0, f32::max),
            least: least.unwrap_or(Self::BLACK),
        }
    }

    /// The extent where patches are as large as `count` surfels. Not for what is black.
    #[inline]
    pub fn of_surfels(self, count: f32) -> Self {
        Self {
            least: self.least * count,
            ..self
        }
    }
}

/// A patch: one part of one side of a triangle, whose edges are divided by two `level` times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct PatchId {
    pub triangle: u32,
    pub is_back: bool,
    level: u32,
    /// Along the edges to the second and the third corner.
    at: [u32; 2],
    /// Whether the patch is the half of that parallelogram that is farther from the first corner.
    is_upper: bool,
}

impl PatchId {
    /// Most divisions of a triangle's edges by two.
    const MAX_LEVELS: u32 = 14;

    /// The patch that a ray met, of a triangle whose longest edge, squared, is `edge2`: that of the
    /// patch is at most `size`.
    #[inline]
    pub fn new(hit: &Hit, edge2: f32, size: f32) -> Self {
        // The upper end of the binade that the ratio is in, by its exponent: a loop would wait for
        // what the triangle is.
        let ratio = (edge2 / size).max(1.0);
        let log2 = ((ratio.to_bits() - 1) >> 23) - 126;
        let level = log2.div_ceil(2).min(Self::MAX_LEVELS);
        let parts = (1 << level) as f32;
        let [u, v] = hit.uv.map(|w| w.clamp(0.0, 1.0) * parts);
        // Rounding may put a hit beyond the edge across from the first corner.
        let i = u.floor().min(parts - 1.0);
        let j = v.floor().min(parts - 1.0 - i);
        Self {
            triangle: hit.triangle,
            is_back: hit.is_back,
            level,
            at: [i as u32, j as u32],
            is_upper: i + j + 1.0 < parts && (u - i) + (v - j) > 1.0,
        }
    }

    /// Number of times that the triangle's edges are divided by two.
    #[inline]
    pub fn level(&self) -> u32 {
        self.level
    }

    /// A number that no other patch has. Its leading bit is free: triangles are fewer than 2^31.
    #[inline]
    pub fn key(&self) -> u64 {
        let [i, j] = self.at;
        // The leading bit of the column tells the level.
        let column = i | 1 << self.level;
        let within =
            u32::from(self.is_back) << 31 | u32::from(self.is_upper) << 30 | column << 15 | j;
        u64::from(self.triangle) << 32 | u64::from(within)
    }

    /// The patch of a key.
    pub fn of_key(key: u64) -> Self {
        let within = key as u32;
        let (column, j) = (within >> 15 & 0x7fff, within & 0x7fff);
        let level = column.ilog2();
        Self {
            triangle: (key >> 32) as u32,
            is_back: within >> 31 == 1,
            level,
            at: [column ^ 1 << level, j],
            is_upper: within >> 30 & 1 == 1,
        }
    }

    /// Middle of the patch, in a triangle of these corners.
    pub fn middle(&self, [a, b, c]: [Vec3; 3]) -> Vec3 {
        let parts = (1 << self.level) as f32;
        let third = if self.is_upper { 2.0 / 3.0 } else { 1.0 / 3.0 };
        let [u, v] = self.at.map(|i| (i as f32 + third) / parts);
        a + (b - a) * u + (c - a) * v
    }

    /// Corners of the patch, in a triangle of these.
    pub fn corners(&self, [a, b, c]: [Vec3; 3]) -> [Vec3; 3] {
        let parts = (1 << self.level) as f32;
        let [i, j] = self.at;
        let at = |i: u32, j: u32| a + (b - a) * (i as f32 / parts) + (c - a) * (j as f32 / parts);
        if self.is_upper {
            [at(i + 1, j + 1), at(i, j + 1), at(i + 1, j)]
        } else {
            [at(i, j), at(i + 1, j), at(i, j + 1)]
        }
    }

    /// Returns the smaller of two patches that hold the same point.
    #[inline]
    pub fn smaller(self, other: Self) -> Self {
        if other.level > self.level {
            other
        } else {
            self
        }
    }

    /// Quarters of the patch, or itself where a triangle is not divided further: three that point
    /// as it does, and the one between them.
    pub fn quarters(&self) -> [Self; 4] {
        if self.level == Self::MAX_LEVELS {
            return [*self; 4];
        }
        let [i, j] = self.at.map(|c| 2 * c);
        let quarter = |at, is_upper| Self {
            level: self.level + 1,
            at,
            is_upper,
            ..*self
        };
        if self.is_upper {
            let [p, q] = [i + 1, j + 1];
            [
                ([p, q], true),
                ([i, q], true),
                ([p, j], true),
                ([p, q], false),
            ]
        } else {
            [
                ([i, j], false),
                ([i + 1, j], false),
                ([i, j + 1], false),
                ([i, j], true),
            ]
        }
        .map(|(at, is_upper)| quarter(at, is_upper))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn edges_are_divided_until_they_are_small_enough() {
        let hit = Hit {
            t: 1.0,
            triangle: 0,
            uv: [0.2; 2],
            is_back: false,
        };
        for (edge2, size, level) in [
            (1.0, 2.0, 0),
            (1.0, 1.0, 0),
            (1.0, 0.999, 1),
            (1.0, 0.25, 1),
            (1.0, 0.2499, 2),
            (64.0, 4.0, 2),
            (0.0, 1.0, 0),
            (1e-30, 1e-36, 10),
            (1e30, 1e-30, PatchId::MAX_LEVELS),
            (1.0, 0.0, PatchId::MAX_LEVELS),
        ] {
            assert_eq!(
                PatchId::new(&hit, edge2, size).level,
                level,
                "{edge2} {size}"
            );
        }
    }
}
