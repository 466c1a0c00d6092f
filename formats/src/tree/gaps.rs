//! Where lvoxels lie, told by the gaps between them in Morton order.

use crate::morton::{gather, interleave};
use crate::record::{Lvoxel, MAX_LEVEL};

/// Bits of a voxel's coordinate: those of a block at the coarsest level.
const BITS: u32 = 16 + MAX_LEVEL as u32;

/// Voxels in an lvoxel.
const fn voxels(level: u8) -> u64 {
    1 << (3 * level)
}

/// Morton code of the first voxel of an lvoxel.
pub fn first_voxel(v: &Lvoxel) -> u64 {
    interleave(v.block.map(|b| u64::from(b) << v.level))
}

/// The voxels between the end of each lvoxel and the start of the next in Morton order, the first
/// one's from 0; `None` if they overlap or are in another order. Levels must be checked before.
pub fn encode(lvoxels: &[Lvoxel]) -> Option<Vec<u64>> {
    let mut end = 0;
    let gap = |v: &Lvoxel| {
        let start = first_voxel(v);
        let gap = start.checked_sub(end)?;
        end = start + voxels(v.level);
        Some(gap)
    };
    lvoxels.iter().map(gap).collect()
}

/// Voxels in a brick.
const BRICK: u64 = voxels(MAX_LEVEL);

/// Coordinates of the voxels of a brick, by Morton code.
static IN_BRICK: [[u32; 3]; BRICK as usize] = {
    let mut all = [[0; 3]; BRICK as usize];
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

/// Finds the blocks again, one after the other.
#[derive(Default)]
pub struct Walk {
    end: u64,
    /// Number of the brick that the last one was in, and its first voxel.
    brick: u64,
    corner: [u32; 3],
}

impl Walk {
    /// Morton code of the first voxel so far behind the last lvoxel, and the block there; `None` if
    /// it is outside all volumes, or none of that level can start there.
    #[inline]
    pub fn next(&mut self, gap: u64, level: u8) -> Option<(u64, [u16; 3])> {
        let start = self.end.checked_add(gap)?;
        if level > MAX_LEVEL || start >> (3 * BITS) != 0 || start & (voxels(level) - 1) != 0 {
            return None;
        }
        self.end = start + voxels(level);
        if start / BRICK != self.brick {
            self.brick = start / BRICK;
            self.corner = [2, 1, 0].map(|shift| (gather(self.brick >> shift) as u32) << MAX_LEVEL);
        }
        let inside = IN_BRICK[(start % BRICK) as usize];
        let [x, y, z] = std::array::from_fn(|k| (self.corner[k] + inside[k]) >> level);
        ((x | y | z) >> 16 == 0).then_some((start, [x as u16, y as u16, z as u16]))
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
            source: [0.0; 3],
        }
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
        assert_eq!(encode(&order).unwrap(), [33, 0, 0, 0, 219]);
        assert_eq!(encode(&[order[1], order[0]]), None, "out of order");
        assert_eq!(encode(&[order[0], order[0]]), None, "twice");
        assert_eq!(encode(&[at(1, [1, 0, 0]), at(0, [2, 0, 1])]), None, "in it");
        assert_eq!(encode(&[]).unwrap(), []);
        let last = at(3, [u16::MAX; 3]);
        let gap = encode(&[last]).unwrap()[0];
        assert_eq!(Walk::default().next(gap, 3), Some((gap, last.block)));
    }

    #[test]
    fn gaps_that_lead_nowhere_are_refused() {
        let next = |gap, level| Walk::default().next(gap, level);
        assert_eq!(next(8, 1), Some((8, [0, 0, 1])));
        assert_eq!(next(7, 1), None, "no block of that level starts there");
        assert_eq!(next(1 << 57, 0), None, "beyond the last bit");
        assert_eq!(next(1 << 56, 0), None, "a voxel beyond the blocks' numbers");
        assert_eq!(next(0, 4), None);
        assert_eq!(next(0, 255), None);
        let mut walk = Walk::default();
        assert!(walk.next(1, 0).is_some());
        assert_eq!(walk.next(u64::MAX, 0), None, "a sum beyond 64 bits");
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        #[test]
        fn blocks_in_order_come_back(given in prop::collection::vec((0..=MAX_LEVEL, any::<[u16; 3]>(), 1u16..64), 1..50)) {
            // Small coordinates crowd, so that some touch and some overlap.
            let mut all: Vec<Lvoxel> = given
                .iter()
                .map(|(level, block, most)| at(*level, block.map(|b| if *most < 32 { b } else { b % most })))
                .collect();
            all.sort_by_key(first_voxel);
            let mut apart: Vec<Lvoxel> = Vec::new();
            for v in all {
                if apart.last().is_none_or(|last| first_voxel(last) + voxels(last.level) <= first_voxel(&v)) {
                    apart.push(v);
                }
            }
            let gaps = encode(&apart).unwrap();
            let mut walk = Walk::default();
            for (v, gap) in apart.iter().zip(gaps) {
                prop_assert_eq!(walk.next(gap, v.level), Some((first_voxel(v), v.block)));
            }
        }

        #[test]
        fn any_gap_gives_a_block_or_none(gaps in prop::collection::vec((any::<u64>(), 0u32..64, any::<u8>()), 1..20)) {
            let mut walk = Walk::default();
            for (gap, shift, level) in gaps {
                let (before, level) = (walk.end, level % 6);
                if let Some((start, block)) = walk.next(gap >> shift, level) {
                    prop_assert_eq!(start, before + (gap >> shift));
                    prop_assert_eq!(first_voxel(&at(level, block)), start);
                }
            }
        }
    }
}
