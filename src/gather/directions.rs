//! The directions of a hemisphere that gathers on surfaces look along.

use crate::math::sampling::{self, cosine_hemisphere, sobol2, tangents};
use glam::Vec3;
use std::sync::OnceLock;

/// Sequences kept. The eight symmetries of a square make each of them eight; turned by any angle
/// they would no longer stand along the edges of what is seen where scenes are built along axes,
/// for 5 % more error.
pub(super) const SEQUENCES: usize = 32;
/// Directions kept of each: those of 16 gathers of 64 rays.
const DIRECTIONS_KEPT: usize = 1024;

/// Well-spread directions around +z with density cos / pi, which take longer to make than to turn.
static SEQUENCE: [OnceLock<Vec<Vec3>>; SEQUENCES] = [const { OnceLock::new() }; SEQUENCES];

fn direction(sequence: usize, i: u32) -> Vec3 {
    let seed = sampling::mix(sequence as u64) as u32;
    cosine_hemisphere(sobol2(i, 0, seed)).normalize()
}

/// A sequence of directions around a normal, in one of the symmetries of a square.
pub(super) struct Hemisphere {
    sequence: usize,
    kept: &'static [Vec3],
    axes: [Vec3; 3],
}

impl Hemisphere {
    /// The sequence that belongs to a key.
    pub fn new(normal: Vec3, key: u64) -> Self {
        let bits = sampling::mix(key);
        let sequence = bits as usize % SEQUENCES;
        let make = || {
            (0..DIRECTIONS_KEPT as u32)
                .map(|i| direction(sequence, i))
                .collect()
        };
        let (x, y) = tangents(normal);
        let (x, y) = if bits >> 32 & 1 == 1 { (y, x) } else { (x, y) };
        let side = |v: Vec3, bit: u32| if bits >> bit & 1 == 1 { -v } else { v };
        Self {
            sequence,
            kept: SEQUENCE[sequence].get_or_init(make),
            axes: [side(x, 33), side(y, 34), normal],
        }
    }

    /// Index of the sequence, below [`SEQUENCES`].
    pub fn sequence(&self) -> usize {
        self.sequence
    }

    /// Unit direction `i` of the sequence, around +z.
    #[inline]
    pub fn local_direction(&self, i: u32) -> Vec3 {
        let kept = self.kept.get(i as usize).copied();
        kept.unwrap_or_else(|| direction(self.sequence, i))
    }

    /// Unit direction `i`.
    #[inline]
    pub fn direction(&self, i: u32) -> Vec3 {
        let d = self.local_direction(i);
        let [x, y, z] = self.axes;
        x * d.x + y * d.y + z * d.z
    }

    /// Unit direction `i` if it is on the side of a facet's unit normal, else `None`.
    #[inline]
    pub fn direction_above(&self, i: u32, face_normal: Vec3) -> Option<Vec3> {
        let d = self.direction(i);
        (d.dot(face_normal) > 0.0).then_some(d)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_unit_and_have_the_moments_of_a_cosine_whatever_the_key() {
        for key in 0..50 {
            let normal = sampling::sphere(sampling::r2(key, [0.3; 2]));
            let hemisphere = Hemisphere::new(normal, key);
            let count = DIRECTIONS_KEPT as u32 + 512;
            let mut sum = Vec3::ZERO;
            for i in 0..count {
                let d = hemisphere.direction(i);
                assert!((d.length() - 1.0).abs() < 1e-6);
                assert!(d.dot(normal) > -1e-6);
                sum += d;
            }
            let mean = sum / count as f32;
            assert!(
                (mean - normal * (2.0 / 3.0)).length() < 5e-3,
                "{key}: {mean}"
            );
        }
    }

    #[test]
    fn what_is_not_kept_goes_on_where_that_ends() {
        let hemisphere = Hemisphere::new(Vec3::Z, 7);
        let made = direction(hemisphere.sequence, DIRECTIONS_KEPT as u32 - 1);
        assert_eq!(hemisphere.kept[DIRECTIONS_KEPT - 1], made);
    }
}
