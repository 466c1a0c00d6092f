//! The octree's cells in Morton order, by keys.

use crate::formats::Bounds;
use crate::formats::morton::interleave;

/// Levels below the root: 21 bits per axis, 63 in a key.
pub const LEVELS: u32 = 21;

/// The cube that the octree divides.
#[derive(Clone, Copy, Debug)]
pub struct Cube {
    min: [f64; 3],
    /// Cells of the last level per unit length.
    cells: f64,
}

impl Cube {
    /// The cube at the lower corner of a box, as wide as its longest side.
    pub fn around(bounds: &Bounds) -> Self {
        let min = bounds.min.map(f64::from);
        let side = (0..3)
            .map(|k| f64::from(bounds.max[k]) - min[k])
            .fold(0.0, f64::max);
        let cells = f64::from(1u32 << LEVELS);
        Self {
            min,
            cells: if side > 0.0 { cells / side } else { 0.0 },
        }
    }

    /// Key of the last-level cell that holds a point; points outside go to the nearest cell.
    pub fn key(&self, point: [f32; 3]) -> u64 {
        let most = (1u64 << LEVELS) - 1;
        // The cast takes what is below zero, or not a number, to zero.
        let cell = |k: usize| ((f64::from(point[k]) - self.min[k]) * self.cells) as u64;
        interleave([0, 1, 2].map(|k| cell(k).min(most)))
    }
}

/// Which child of a cell of `level` holds a key; `level` is below [`LEVELS`].
pub fn child(key: u64, level: u32) -> usize {
    (key >> (3 * (LEVELS - 1 - level)) & 7) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_follow_the_octree() {
        let cube = Cube::around(&Bounds {
            min: [-1.0; 3],
            max: [1.0, 0.0, 0.0],
        });
        assert_eq!(cube.key([-1.0; 3]), 0);
        assert_eq!(child(cube.key([0.5, -0.9, -0.9]), 0), 0b100);
        assert_eq!(child(cube.key([-0.9, 0.5, -0.9]), 0), 0b010);
        assert_eq!(child(cube.key([-0.9, -0.9, 0.5]), 0), 0b001);
        assert_eq!(cube.key([9.0; 3]), (1 << 63) - 1);
        assert_eq!(cube.key([f32::NAN; 3]), 0);
        let point = Cube::around(&Bounds {
            min: [3.0; 3],
            max: [3.0; 3],
        });
        assert_eq!(point.key([3.0; 3]), 0);
    }
}
