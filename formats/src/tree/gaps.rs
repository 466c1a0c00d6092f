//! The blocks of lvoxels, coded as gaps along a Morton curve over the voxels of a volume.

use crate::morton::{gather, interleave};
use crate::record::{Lvoxel, MAX_LEVEL};

/// Bits of a voxel's coordinate: those of a block at the coarsest level.
const VOXEL_BITS: u32 = 16 + MAX_LEVEL as u32;

/// Voxels in an lvoxel of a level.
const fn voxels(level: u8) -> u64 {
    1 << (3 * level)
}

/// Morton code of the first voxel of an lvoxel.
fn first_voxel(v: &Lvoxel) -> u64 {
    interleave(v.block.map(|b| u64::from(b) << v.level))
}

/// The gap before each lvoxel: the voxels between the end of the lvoxel before it (0 for the
/// first one) and its own first voxel, modulo 2^64. Levels must be checked before.
pub fn encode(lvoxels: &[Lvoxel]) -> impl Iterator<Item = u64> + '_ {
    let mut end = 0_u64;
    lvoxels.iter().map(move |v| {
        let start = first_voxel(v);
        let gap = start.wrapping_sub(end);
        end = start + voxels(v.level);
        gap
    })
}

/// Voxels in a brick.
const BRICK_VOXELS: u64 = voxels(MAX_LEVEL);

/// Coordinates of the voxels of a brick, by Morton code.
static IN_BRICK: [[u32; 3]; BRICK_VOXELS as usize] = {
    let mut all = [[0; 3]; BRICK_VOXELS as usize];
    let mut code = 0;
    while code < all.len() {
        let mut axis = 0;
        while axis < 3 {
            all[code][axis] = gather(code as u64 >> (2 - axis)) as u32;
            axis += 1;
        }
        code += 1;
    }
    all
};

/// Decodes gaps to blocks, one lvoxel after the other.
#[derive(Default)]
pub struct Decoder {
    end: u64,
    /// Number of the brick of the last lvoxel, and its first voxel.
    brick: u64,
    corner: [u32; 3],
}

impl Decoder {
    /// The block behind a gap; `None` if it is outside all volumes, or no block of that level
    /// starts there.
    #[inline]
    pub fn next(&mut self, gap: u64, level: u8) -> Option<[u16; 3]> {
        let start = self.end.wrapping_add(gap);
        let is_aligned = level <= MAX_LEVEL && start & (voxels(level) - 1) == 0;
        if !is_aligned || start >> (3 * VOXEL_BITS) != 0 {
            return None;
        }
        self.end = start + voxels(level);
        if start / BRICK_VOXELS != self.brick {
            self.brick = start / BRICK_VOXELS;
            self.corner = [2, 1, 0].map(|shift| (gather(self.brick >> shift) as u32) << MAX_LEVEL);
        }
        let inside = IN_BRICK[(start % BRICK_VOXELS) as usize];
        let [x, y, z] = std::array::from_fn(|k| (self.corner[k] + inside[k]) >> level);
        ((x | y | z) >> 16 == 0).then_some([x as u16, y as u16, z as u16])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(level: u8, block: [u16; 3]) -> Lvoxel {
        Lvoxel {
            volume: 0,
            level,
            block,
            sigma_t: 1.0,
            ..Lvoxel::default()
        }
    }

    fn gaps(lvoxels: &[Lvoxel]) -> Vec<u64> {
        encode(lvoxels).collect()
    }

    #[test]
    fn neighbours_in_morton_order_have_no_gap() {
        let order = [
            at(0, [2, 0, 1]),
            at(0, [2, 1, 0]),
            at(0, [2, 1, 1]),
            at(0, [3, 0, 0]),
            at(1, [2, 0, 0]),
        ];
        // (2, 0, 1) is voxel 33: bit 5 is the second bit of x, bit 0 the first of z.
        assert_eq!(gaps(&order), [33, 0, 0, 0, 219]);
        // The second one starts two voxels before the end of the first.
        assert_eq!(gaps(&[order[1], order[0]]), [34, u64::MAX - 1]);
        let last = at(3, [u16::MAX; 3]);
        let gap = gaps(&[last])[0];
        assert_eq!(Decoder::default().next(gap, 3), Some(last.block));
    }

    #[test]
    fn gaps_that_lead_nowhere_are_refused() {
        let next = |gap, level| Decoder::default().next(gap, level);
        assert_eq!(next(8, 1), Some([0, 0, 1]));
        assert_eq!(next(7, 1), None, "no block of that level starts there");
        assert_eq!(next(1 << 57, 0), None, "beyond the last bit");
        assert_eq!(next(1 << 56, 0), None, "a voxel beyond the blocks' numbers");
        assert_eq!(next(u64::MAX, 0), None, "before the first voxel");
        assert_eq!(next(0, 4), None);
        assert_eq!(next(0, 255), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(500)
        })]

        #[test]
        fn blocks_in_any_order_come_back(
            given in prop::collection::vec((0..=MAX_LEVEL, any::<[u16; 3]>(), 1u16..64), 1..50),
        ) {
            // Small coordinates crowd, so that some touch and some overlap.
            let all: Vec<Lvoxel> = given
                .iter()
                .map(|(level, block, most)| {
                    let crowd = |b: u16| if *most < 32 { b } else { b % most };
                    at(*level, block.map(crowd))
                })
                .collect();
            let mut decoder = Decoder::default();
            for (v, gap) in all.iter().zip(encode(&all)) {
                prop_assert_eq!(decoder.next(gap, v.level), Some(v.block));
            }
        }

        #[test]
        fn any_gap_gives_a_block_or_none(
            gaps in prop::collection::vec((any::<u64>(), 0u32..64, any::<u8>()), 1..20),
        ) {
            let mut decoder = Decoder::default();
            for (gap, shift, level) in gaps {
                let (before, level) = (decoder.end, level % 6);
                if let Some(block) = decoder.next(gap >> shift, level) {
                    let start = before.wrapping_add(gap >> shift);
                    prop_assert_eq!(first_voxel(&at(level, block)), start);
                }
            }
        }
    }
}
