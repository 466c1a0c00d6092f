//! Numbers of lvoxels, told by how far they are from what their neighbours let expect.

use crate::record::MAX_LEVEL;

/// Voxels in the brick inside which neighbours are looked for.
const BRICK: usize = 512;
const LEVELS: usize = MAX_LEVEL as usize + 1;
/// Places in a brick, and behind them one of which nothing is ever known; a power of two, so that no index is beyond it.
const PLACES: usize = 2 * BRICK;
/// Bits of x, y and z in the Morton code of a place in its brick.
const AXES: [usize; 3] = [0x124, 0x92, 0x49];
/// Pairs of axes, in the order in which they count.
const PLANES: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];
/// One block before on each axis, and before on both axes of each pair.
const NEIGHBOURS: usize = 6;

/// Numbers that have their neighbours in common.
pub type Numbers = [u16; 2];

/// Both numbers, or sums of them, in the halves of one word: what is done to one is done to the other.
type Pair = u64;

fn pair([one, other]: Numbers) -> Pair {
    Pair::from(one) | Pair::from(other) << 32
}

/// What is known of a run: lvoxels of one brick and level, one after the other.
pub struct Forecast {
    /// By the Morton code of the block in its brick.
    known: [Pair; PLACES],
    /// The run that those are of.
    run_of: [u32; PLACES],
    run: u32,
    brick: u64,
    level: u8,
    last: Numbers,
}

impl Default for Forecast {
    fn default() -> Self {
        Self {
            known: [0; PLACES],
            run_of: [0; PLACES],
            run: 0,
            brick: u64::MAX,
            level: 0,
            last: [0; 2],
        }
    }
}

/// The place before `at` on an axis; [`BRICK`] if that is not in the brick.
const fn before(at: usize, axis: usize) -> usize {
    let bits = at & AXES[axis];
    let one = 1 << (2 - axis);
    if at == BRICK || bits < one {
        return BRICK;
    }
    at & !AXES[axis] | (bits - one) & AXES[axis]
}

/// By place.
static NEAR: [[u16; NEIGHBOURS]; BRICK] = {
    let mut all = [[0; NEIGHBOURS]; BRICK];
    let mut at = 0;
    while at < BRICK {
        let mut k = 0;
        while k < 3 {
            let [a, b] = PLANES[k];
            all[at][k] = before(at, k) as u16;
            all[at][3 + k] = before(before(at, a), b) as u16;
            k += 1;
        }
        at += 1;
    }
    all
};

/// How a forecast is made of the neighbours.
#[derive(Clone, Copy)]
struct Mean {
    /// Whole numbers, negative ones modulo 2^64.
    weights: [u64; NEIGHBOURS],
    /// 2^32 over the sum of the weights, rounded up.
    per_sum: u64,
}

/// By the set of neighbours that are known, a bit for each; of those sets that hold one on an axis.
static MEANS: [Mean; 1 << NEIGHBOURS] = {
    let mut all = [Mean {
        weights: [0; NEIGHBOURS],
        per_sum: 0,
    }; 1 << NEIGHBOURS];
    let mut known = 0;
    while known < all.len() {
        let weights = &mut all[known].weights;
        let mut sum = 0u64;
        let mut k = 0;
        while k < 3 {
            let [a, b] = PLANES[k];
            let all_three = 1 << a | 1 << b | 1 << (3 + k);
            if known & all_three == all_three {
                weights[a] += 1;
                weights[b] += 1;
                weights[3 + k] = weights[3 + k].wrapping_sub(1);
                sum += 1;
            }
            k += 1;
        }
        if sum == 0 {
            k = 0;
            while k < 3 {
                weights[k] = (known >> k & 1) as u64;
                sum += weights[k];
                k += 1;
            }
        }
        if sum > 0 {
            all[known].per_sum = (1u64 << 32).div_ceil(sum);
        }
        known += 1;
    }
    all
};

impl Forecast {
    /// Opens the place of an lvoxel of at most [`crate::record::MAX_LEVEL`], with the Morton code of its first voxel.
    #[inline]
    fn open(&mut self, first_voxel: u64, level: u8) -> usize {
        let brick = first_voxel / BRICK as u64;
        if (brick, level) != (self.brick, self.level) {
            (self.brick, self.level) = (brick, level);
            // At most 32,768 lvoxels are in a page.
            self.run += 1;
        }
        (first_voxel as usize % BRICK) >> (3 * (usize::from(level) % LEVELS))
    }

    /// What is expected there.
    #[inline]
    fn expect(&self, at: usize) -> Numbers {
        // Added to sums, so that none is negative; those that were become 0 again.
        const ABOVE_0: u32 = 1 << 20;
        let near = NEAR[at % BRICK].map(|n| usize::from(n) % PLACES);
        let mut set = 0;
        for (k, at) in near.into_iter().enumerate() {
            set |= usize::from(self.run_of[at] == self.run) << k;
        }
        // Without that branch each number would have to wait for the one before.
        if set & 0b111 == 0 {
            return self.last;
        }
        let Mean { weights, per_sum } = &MEANS[set];
        let mut sums = Pair::from(ABOVE_0) << 32 | Pair::from(ABOVE_0);
        for (at, weight) in near.into_iter().zip(weights) {
            sums = sums.wrapping_add(weight.wrapping_mul(self.known[at]));
        }
        // Below 2^19, where the product is the mean, rounded down.
        [sums as u32, (sums >> 32) as u32].map(|sum| {
            let mean = (u64::from(sum.saturating_sub(ABOVE_0)) * per_sum) >> 32;
            mean.min(0xffff) as u16
        })
    }

    #[inline]
    fn set(&mut self, at: usize, numbers: Numbers) {
        self.last = numbers;
        self.known[at % PLACES] = pair(numbers);
        self.run_of[at % PLACES] = self.run;
    }

    /// Codes of numbers whose lvoxels start at the given voxels and have the given levels.
    pub fn encode(places: &[(u64, u8)], numbers: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut forecast = Self::default();
        let code = |(&(first_voxel, level), number): (&(u64, u8), u16)| {
            let at = forecast.open(first_voxel, level);
            let step = number.wrapping_sub(forecast.expect(at)[0]) as i16;
            forecast.set(at, [number, 0]);
            (step << 1 ^ step >> 15) as u16
        };
        places.iter().zip(numbers).map(code).collect()
    }

    /// The numbers of the next codes.
    #[inline]
    pub fn decode(&mut self, first_voxel: u64, level: u8, codes: Numbers) -> Numbers {
        let at = self.open(first_voxel, level);
        let expected = self.expect(at);
        let number = |k: usize| {
            let step = codes[k] >> 1 ^ (codes[k] & 1).wrapping_neg();
            expected[k].wrapping_add(step)
        };
        let numbers = [number(0), number(1)];
        self.set(at, numbers);
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
