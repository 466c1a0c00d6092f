//! Morton order: the order in which a depth-first walk of an octree meets its cells.

use crate::formats::Bounds;

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
        (0..3).fold(0, |key, k| {
            // The cast takes what is below zero, or not a number, to zero.
            let cell = ((f64::from(point[k]) - self.min[k]) * self.cells) as u64;
            key | spread(cell.min(most)) << (2 - k)
        })
    }
}

/// Moves bit i to bit 3i, for 21 bits.
pub fn spread(bits: u64) -> u64 {
    let mut x = bits & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Which child of a cell of `level` holds a key; `level` is below [`LEVELS`].
pub fn child(key: u64, level: u32) -> usize {
    (key >> (3 * (LEVELS - 1 - level)) & 7) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_interleave_bits() {
        for bits in [0, 1, 2, 0x155555, 0x1f_ffff, 0x12345] {
            let plain = (0..21).fold(0, |x, i| x | (bits >> i & 1) << (3 * i));
            assert_eq!(spread(bits), plain);
        }
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
