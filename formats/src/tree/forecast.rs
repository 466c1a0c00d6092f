//! Numbers of lvoxels, told by how far they are from what their neighbours let expect.

use crate::record::MAX_LEVEL;

/// Voxels in the brick inside which neighbours are looked for.
const BRICK: usize = 512;
const LEVELS: usize = MAX_LEVEL as usize + 1;
/// Bits of x, y and z in the Morton code of a voxel in its brick.
const AXES: [usize; 3] = [0x124, 0x92, 0x49];
/// Pairs of axes, in the order in which they count.
const PLANES: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// Numbers that have their neighbours in common.
pub type Numbers = [u16; 2];

/// What is known of a run: lvoxels of one brick and level, one after the other.
pub struct Forecast {
    /// By the Morton code of the first voxel in the brick: the two numbers there, and above them the run that they are of.
    known: [u64; BRICK + 1],
    run: u32,
    brick: Option<(u64, u8)>,
    last: Numbers,
}

impl Default for Forecast {
    fn default() -> Self {
        Self {
            known: [0; BRICK + 1],
            run: 0,
            brick: None,
            last: [0; 2],
        }
    }
}

/// The place one block of `level` before `at` on an axis; [`BRICK`], of which nothing is ever known, if it is not in the brick.
const fn before(at: usize, axis: usize, level: usize) -> usize {
    if at == BRICK {
        return BRICK;
    }
    let bits = at & AXES[axis];
    let one = 1 << (3 * level + 2 - axis);
    if bits < one {
        return BRICK;
    }
    at & !AXES[axis] | (bits - one) & AXES[axis]
}

/// By level and place: one block before on each axis, and before on both axes of each pair.
type Neighbours = [[[u16; 6]; BRICK]; LEVELS];
static NEIGHBOURS: Neighbours = {
    let mut all = [[[0; 6]; BRICK]; LEVELS];
    let mut level = 0;
    while level < LEVELS {
        let mut at = 0;
        while at < BRICK {
            let mut k = 0;
            while k < 3 {
                let [a, b] = PLANES[k];
                all[level][at][k] = before(at, k, level) as u16;
                all[level][at][3 + k] = before(before(at, a, level), b, level) as u16;
                k += 1;
            }
            at += 1;
        }
        level += 1;
    }
    all
};

/// Their mean, rounded down.
#[inline]
fn mean(sum: i32, count: u32) -> i32 {
    match count {
        1 => sum,
        2 => sum >> 1,
        _ => sum.div_euclid(3),
    }
}

impl Forecast {
    /// Opens the place of an lvoxel of at most [`crate::record::MAX_LEVEL`], with the Morton code of its first voxel, and
    /// returns what is expected there.
    #[inline]
    fn expect(&mut self, first_voxel: u64, level: u8) -> Numbers {
        let brick = Some((first_voxel / BRICK as u64, level));
        if brick != self.brick {
            self.brick = brick;
            // At most 32,768 lvoxels are in a page.
            self.run += 1;
        }
        let places = &NEIGHBOURS[usize::from(level) % LEVELS][first_voxel as usize % BRICK];
        let near = places.map(|at| self.known[usize::from(at) % (BRICK + 1)]);
        let is_known = near.map(|known| known >> 32 == u64::from(self.run));
        let [a, b, c, ab, ac, bc] =
            near.map(|known| [known as u16, (known >> 16) as u16].map(i32::from));
        if is_known == [true; 6] {
            let sum = |k: usize| 2 * (a[k] + b[k] + c[k]) - ab[k] - ac[k] - bc[k];
            return [sum(0), sum(1)].map(|sum| mean(sum, 3).clamp(0, 0xffff) as u16);
        }
        let (faces, edges) = ([a, b, c], [ab, ac, bc]);
        let (mut sums, mut count) = ([0; 2], 0);
        for (k, [a, b]) in PLANES.into_iter().enumerate() {
            if is_known[a] && is_known[b] && is_known[3 + k] {
                sums = std::array::from_fn(|i| sums[i] + faces[a][i] + faces[b][i] - edges[k][i]);
                count += 1;
            }
        }
        if count == 0 {
            for (face, _) in faces.into_iter().zip(is_known).filter(|(_, known)| *known) {
                sums = std::array::from_fn(|i| sums[i] + face[i]);
                count += 1;
            }
        }
        match count {
            0 => self.last,
            _ => sums.map(|sum| mean(sum, count).clamp(0, 0xffff) as u16),
        }
    }

    /// Sets the numbers at the place that was opened last.
    #[inline]
    fn set(&mut self, first_voxel: u64, numbers: Numbers) {
        self.known[first_voxel as usize % BRICK] =
            u64::from(self.run) << 32 | u64::from(numbers[1]) << 16 | u64::from(numbers[0]);
        self.last = numbers;
    }

    /// Codes of numbers whose lvoxels start at the given voxels and have the given levels.
    pub fn encode(places: &[(u64, u8)], numbers: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut forecast = Self::default();
        let code = |(&(at, level), number): (&(u64, u8), u16)| {
            let step = number.wrapping_sub(forecast.expect(at, level)[0]) as i16;
            forecast.set(at, [number, 0]);
            (step << 1 ^ step >> 15) as u16
        };
        places.iter().zip(numbers).map(code).collect()
    }

    /// The numbers of the next codes.
    #[inline]
    pub fn decode(&mut self, first_voxel: u64, level: u8, codes: Numbers) -> Numbers {
        let expected = self.expect(first_voxel, level);
        let number = |k: usize| {
            let step = codes[k] >> 1 ^ (codes[k] & 1).wrapping_neg();
            expected[k].wrapping_add(step)
        };
        let numbers = [number(0), number(1)];
        self.set(first_voxel, numbers);
        numbers
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Places of a brick's blocks of a level, in Morton order, and their coordinates.
    fn brick(level: u8) -> impl Iterator<Item = ((u64, u8), [u16; 3])> {
        let size = 1u64 << (3 * level);
        (0..512 / size).map(move |i| {
            let axis = |shift: u64| (0..3).fold(0, |x, k| x | (i >> (3 * k + shift) & 1) << k);
            (
                (i * size, level),
                [axis(2), axis(1), axis(0)].map(|c| c as u16),
            )
        })
    }

    #[test]
    fn a_plane_needs_codes_on_its_edges_alone() {
        for level in 0..3 {
            let (places, blocks): (Vec<_>, Vec<_>) = brick(level).unzip();
            let plane = |[x, y, z]: [u16; 3]| 1000 + 7 * x + 300 * y - 5 * z;
            let codes = Forecast::encode(&places, blocks.iter().map(|b| plane(*b)));
            for (code, block) in codes.iter().zip(&blocks) {
                let inside = block.iter().filter(|c| **c > 0).count();
                assert!(inside < 2 || *code == 0, "level {level}, {block:?}: {code}");
            }
            // Along x from the first, then from the one before it in z and y.
            assert_eq!(codes[0], 2000);
            assert_eq!(codes[1], 9, "5 less than the one before it along z");
        }
    }

    #[test]
    fn other_bricks_and_levels_are_no_neighbours() {
        let places = [(0, 0), (1, 0), (8, 1), (512, 0), (513, 0)];
        let codes = Forecast::encode(&places, [10, 20, 50, 7, 9].into_iter());
        assert_eq!(codes, [20, 20, 60, 85, 4]);
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

        #[test]
        fn numbers_come_back(given in prop::collection::vec((0u64..3000, 0u8..=3, any::<[u16; 2]>()), 1..200)) {
            let place = |(at, level, _): &(u64, u8, Numbers)| (at >> (3 * level) << (3 * level), *level);
            let places: Vec<_> = given.iter().map(place).collect();
            let [one, other] = [0, 1].map(|k| Forecast::encode(&places, given.iter().map(|(_, _, n)| n[k])));
            let mut forecast = Forecast::default();
            for (i, &(at, level)) in places.iter().enumerate() {
                prop_assert_eq!(forecast.decode(at, level, [one[i], other[i]]), given[i].2);
            }
        }
    }
}
