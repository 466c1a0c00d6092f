//! Numbers of lvoxels, told by how far they are from what their neighbours let expect.

use crate::morton::gather;
use crate::record::MAX_LEVEL;

/// Voxels in the brick inside which neighbours are looked for.
const BRICK: usize = 512;
const LEVELS: usize = MAX_LEVEL as usize + 1;
/// From a block to the one before it on x, y and z: the blocks of a brick stand in rows, each with
/// one place before it of which nothing is ever known.
const STEPS: [usize; 3] = [81, 9, 1];
/// To the furthest neighbour, which is one before on x and on y.
const REACH: usize = STEPS[0] + STEPS[1];
/// The furthest neighbour of a brick's last block.
const LAST: usize = 8 * (STEPS[0] + STEPS[1] + STEPS[2]) - REACH;
/// A power of two beyond [`LAST`], so that no index needs a test.
const FIRSTS: usize = (LAST + 1).next_power_of_two();

/// One or two numbers that have their neighbours in common, or sums of them, in the halves of one
/// word: what is done to one is done to the other. The highest bit tells that they are known.
type Pair = u64;
const KNOWN: Pair = 1 << 63;

#[inline]
fn pair<const N: usize>(numbers: [u16; N]) -> Pair {
    let halves = numbers.iter().rev();
    halves.fold(0, |pair, n| pair << 32 | Pair::from(*n))
}

/// What is known of a run: lvoxels of one brick and level, one after the other.
pub struct Forecast<const N: usize> {
    /// By place; nothing but the run's own is known.
    known: [Pair; FIRSTS + REACH + 1],
    /// Where the first of those are.
    listed: [u16; LISTED],
    count: usize,
    brick: u64,
    level: u8,
    last: [u16; N],
}

impl<const N: usize> Default for Forecast<N> {
    fn default() -> Self {
        Self {
            known: [0; FIRSTS + REACH + 1],
            listed: [0; LISTED],
            count: 0,
            brick: u64::MAX,
            level: 0,
            last: [0; N],
        }
    }
}

/// The furthest neighbour of a block, by the Morton code of the block in its brick.
static FIRST: [u16; BRICK] = {
    let mut all = [0; BRICK];
    let mut code = 0;
    while code < BRICK {
        let mut axis = 0;
        let mut place = 0;
        while axis < 3 {
            place += (1 + gather((code >> (2 - axis)) as u64) as usize) * STEPS[axis];
            axis += 1;
        }
        all[code] = (place - REACH) as u16;
        code += 1;
    }
    all
};

/// 2^32 over a number of terms, rounded up.
const PER_SUM: [u64; 4] = [0, 1 << 32, (1 << 32) / 2, (1 << 32) / 3 + 1];

/// All bits if a pair is known, else none.
#[inline]
fn if_known(pair: Pair) -> u64 {
    (pair as i64 >> 63) as u64
}

/// What is known of a longer run is forgotten by forgetting all places.
const LISTED: usize = 64;

/// Sums over the number of their terms, rounded down and clamped.
#[inline]
fn mean<const N: usize>(sums: Pair, terms: u64) -> [u16; N] {
    // Added to sums, so that none is negative; those that were become 0 again.
    const ABOVE_0: u64 = 1 << 20;
    let sums = sums.wrapping_add(ABOVE_0 << 32 | ABOVE_0) & !KNOWN;
    std::array::from_fn(|k| {
        let sum = (sums >> (32 * k) & 0xffff_ffff).saturating_sub(ABOVE_0);
        // Below 2^19, where the product is the mean, rounded down.
        ((sum * PER_SUM[terms as usize % 4]) >> 32).min(0xffff) as u16
    })
}

impl<const N: usize> Forecast<N> {
    /// Opens the place of an lvoxel of at most [`crate::record::MAX_LEVEL`], with the Morton code
    /// of its first voxel, and gives its furthest neighbour.
    #[inline]
    fn open(&mut self, first_voxel: u64, level: u8) -> usize {
        let brick = first_voxel / BRICK as u64;
        if (brick, level) != (self.brick, self.level) {
            (self.brick, self.level) = (brick, level);
            self.forget();
        }
        let code = (first_voxel as usize % BRICK) >> (3 * (usize::from(level) % LEVELS));
        usize::from(FIRST[code])
    }

    fn forget(&mut self) {
        match self.listed.get(..self.count) {
            Some(listed) => listed
                .iter()
                .for_each(|at| self.known[usize::from(*at) % FIRSTS + REACH] = 0),
            None => self.known[..=LAST + REACH].fill(0),
        }
        self.count = 0;
    }

    /// What is expected at a place, given its furthest neighbour.
    #[inline]
    fn expect(&self, first: usize) -> [u16; N] {
        let near = &self.known[first % FIRSTS..][..REACH];
        let [dx, dy, dz] = STEPS;
        let (x, y, z) = (near[REACH - dx], near[REACH - dy], near[REACH - dz]);
        let (xy, xz, yz) = (
            near[REACH - dx - dy],
            near[REACH - dx - dz],
            near[REACH - dy - dz],
        );
        let sum = |a: Pair, b: Pair, c: Pair| a.wrapping_add(b).wrapping_add(c);
        if (x & y & z & xy & xz & yz) & KNOWN != 0 {
            return mean(
                sum(x, y, z).wrapping_mul(2).wrapping_sub(sum(xy, xz, yz)),
                3,
            );
        }
        // Without that branch each number would have to wait for the one before.
        if (x | y | z) & KNOWN == 0 {
            return self.last;
        }
        let term = |a: Pair, b: Pair, both: Pair| {
            let known = if_known(a & b & both);
            (a.wrapping_add(b).wrapping_sub(both) & known, known & 1)
        };
        let [(a, in_a), (b, in_b), (c, in_c)] = [term(x, y, xy), term(x, z, xz), term(y, z, yz)];
        let (sums, terms) = (sum(a, b, c), in_a + in_b + in_c);
        // No branch: it would often be told wrong.
        let no_pair = u64::from(terms > 0).wrapping_sub(1);
        let sums = sums | sum(x, y, z) & no_pair;
        let terms = terms | sum(x >> 63, y >> 63, z >> 63) & no_pair;
        mean(sums, terms)
    }

    #[inline]
    fn set(&mut self, first: usize, numbers: [u16; N]) {
        self.last = numbers;
        self.known[first % FIRSTS + REACH] = pair(numbers) | KNOWN;
        if let Some(at) = self.listed.get_mut(self.count) {
            *at = first as u16;
        }
        self.count += 1;
    }

    /// The numbers of the next codes.
    #[inline]
    pub fn decode(&mut self, first_voxel: u64, level: u8, codes: [u16; N]) -> [u16; N] {
        let at = self.open(first_voxel, level);
        let expected = self.expect(at);
        let numbers = std::array::from_fn(|k| {
            let step = codes[k] >> 1 ^ (codes[k] & 1).wrapping_neg();
            expected[k].wrapping_add(step)
        });
        self.set(at, numbers);
        numbers
    }
}

impl Forecast<1> {
    /// Codes of numbers whose lvoxels start at the given voxels and have the given levels.
    pub fn encode(places: &[(u64, u8)], numbers: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut forecast = Self::default();
        let code = |(&(first_voxel, level), number): (&(u64, u8), u16)| {
            let at = forecast.open(first_voxel, level);
            let step = number.wrapping_sub(forecast.expect(at)[0]) as i16;
            forecast.set(at, [number]);
            (step << 1 ^ step >> 15) as u16
        };
        places.iter().zip(numbers).map(code).collect()
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

    /// The forecast as the text of the format has it.
    fn stated(places: &[(u64, u8)], numbers: &[u16], i: usize) -> u16 {
        let same_run = |j: &usize| {
            let run = |j: usize| (places[j].0 / 512, places[j].1);
            (*j..i).all(|j| run(j) == run(i))
        };
        let axis = |j: usize, k: usize| {
            let code = places[j].0 >> (3 * places[j].1);
            (0..20).fold(0, |x, bit| {
                x | (code >> (3 * bit + 2 - k as u64) & 1) << bit
            }) as i64
        };
        let near = |axes: &[usize]| {
            (0..i)
                .rev()
                .filter(same_run)
                .find(|j| (0..3).all(|k| axis(i, k) - axis(*j, k) == i64::from(axes.contains(&k))))
        };
        let number = |axes: &[usize]| near(axes).map(|j| i64::from(numbers[j]));
        let mut given: Vec<i64> = [[0, 1], [0, 2], [1, 2]]
            .iter()
            .filter_map(|[a, b]| Some(number(&[*a])? + number(&[*b])? - number(&[*a, *b])?))
            .collect();
        if given.is_empty() {
            given = (0..3).filter_map(|k| number(&[k])).collect();
        }
        if given.is_empty() {
            given.push(i.checked_sub(1).map_or(0, |j| i64::from(numbers[j])));
        }
        let mean = given.iter().sum::<i64>().div_euclid(given.len() as i64);
        mean.clamp(0, 0xffff) as u16
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

        #[test]
        fn forecasts_are_the_stated_ones(level in 0u8..3, holes in 0u8..4, given in prop::collection::vec((any::<u8>(), any::<u16>()), 1..150)) {
            let kept: Vec<_> = (0u64..).zip(given).filter(|(_, (hole, _))| hole % 4 >= holes).collect();
            let places: Vec<_> = kept.iter().map(|(at, _)| (at << (3 * level), level)).collect();
            let numbers: Vec<u16> = kept.iter().map(|(_, (_, n))| *n).collect();
            let codes = Forecast::encode(&places, numbers.iter().copied());
            for (i, code) in codes.into_iter().enumerate() {
                let step = numbers[i].wrapping_sub(stated(&places, &numbers, i)) as i16;
                let of_step = if step < 0 { -2 * i32::from(step) - 1 } else { 2 * i32::from(step) };
                prop_assert_eq!(i32::from(code), of_step);
            }
        }

        #[test]
        fn numbers_come_back(given in prop::collection::vec((0u64..3000, 0u8..=3, any::<[u16; 2]>()), 1..200)) {
            let place = |(at, level, _): &(u64, u8, [u16; 2])| (at >> (3 * level) << (3 * level), *level);
            let places: Vec<_> = given.iter().map(place).collect();
            let [one, other] = [0, 1].map(|k| Forecast::encode(&places, given.iter().map(|(_, _, n)| n[k])));
            let mut forecast = Forecast::<2>::default();
            for (i, &(at, level)) in places.iter().enumerate() {
                prop_assert_eq!(forecast.decode(at, level, [one[i], other[i]]), given[i].2);
            }
        }
    }
}
