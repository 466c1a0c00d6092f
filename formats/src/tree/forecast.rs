//! Numbers of lvoxels, told by how far they are from what their neighbours let expect.

/// Voxels in the brick inside which neighbours are looked for.
const BRICK: usize = 512;
/// Bits of x, y and z in the Morton code of a voxel in its brick.
const AXES: [usize; 3] = [0x124, 0x92, 0x49];
/// Pairs of axes, in the order in which they count.
const PLANES: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// What is known of a run: lvoxels of one brick and level, one after the other.
pub struct Forecast {
    /// Which run it is of, and the number there, by the Morton code of the first voxel in the brick.
    known: [(u32, u16); BRICK],
    run: u32,
    brick: Option<(u64, u8)>,
    last: u16,
}

impl Default for Forecast {
    fn default() -> Self {
        Self {
            known: [(0, 0); BRICK],
            run: 0,
            brick: None,
            last: 0,
        }
    }
}

/// The place one block of `level` before `at` on an axis, if it is in the brick.
#[inline]
fn before(at: usize, axis: usize, level: u8) -> Option<usize> {
    let bits = at & AXES[axis];
    let one = 1 << (3 * usize::from(level) + 2 - axis);
    (bits >= one).then(|| at & !AXES[axis] | (bits - one) & AXES[axis])
}

impl Forecast {
    /// Opens the place of an lvoxel of at most [`crate::record::MAX_LEVEL`], with the Morton code of its first voxel, and
    /// returns what is expected there.
    pub fn expect(&mut self, first_voxel: u64, level: u8) -> u16 {
        let brick = Some((first_voxel / BRICK as u64, level));
        if brick != self.brick {
            self.brick = brick;
            // At most 32,768 lvoxels are in a page.
            self.run += 1;
        }
        let at = first_voxel as usize % BRICK;
        let known = |at: usize| {
            let (run, number) = self.known[at];
            (run == self.run).then_some(i32::from(number))
        };
        let places: [Option<usize>; 3] = std::array::from_fn(|axis| before(at, axis, level));
        let faces = places.map(|place| place.and_then(known));
        let (mut sum, mut count) = (0, 0);
        for [a, b] in PLANES {
            if let (Some(place), Some(one), Some(other)) = (places[a], faces[a], faces[b])
                && let Some(edge) = before(place, b, level).and_then(known)
            {
                sum += one + other - edge;
                count += 1;
            }
        }
        if count == 0 {
            for face in faces.into_iter().flatten() {
                sum += face;
                count += 1;
            }
        }
        match count {
            0 => self.last,
            _ => sum.div_euclid(count).clamp(0, 0xffff) as u16,
        }
    }

    /// Sets the number at the place that was opened last.
    pub fn set(&mut self, first_voxel: u64, number: u16) {
        self.known[first_voxel as usize % BRICK] = (self.run, number);
        self.last = number;
    }

    /// Codes of numbers whose lvoxels start at the given voxels and have the given levels.
    pub fn encode(places: &[(u64, u8)], numbers: impl Iterator<Item = u16>) -> Vec<u16> {
        let mut forecast = Self::default();
        let code = |(&(at, level), number): (&(u64, u8), u16)| {
            let step = number.wrapping_sub(forecast.expect(at, level)) as i16;
            forecast.set(at, number);
            (step << 1 ^ step >> 15) as u16
        };
        places.iter().zip(numbers).map(code).collect()
    }

    /// The number of the next code.
    #[inline]
    pub fn decode(&mut self, first_voxel: u64, level: u8, code: u16) -> u16 {
        let step = code >> 1 ^ (code & 1).wrapping_neg();
        let number = self.expect(first_voxel, level).wrapping_add(step);
        self.set(first_voxel, number);
        number
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
        fn numbers_come_back(given in prop::collection::vec((0u64..3000, 0u8..=3, any::<u16>()), 1..200)) {
            let place = |(at, level, _): &(u64, u8, u16)| (at >> (3 * level) << (3 * level), *level);
            let places: Vec<_> = given.iter().map(place).collect();
            let codes = Forecast::encode(&places, given.iter().map(|(_, _, n)| *n));
            let mut forecast = Forecast::default();
            for ((&(at, level), code), (_, _, number)) in places.iter().zip(codes).zip(given) {
                prop_assert_eq!(forecast.decode(at, level, code), number);
            }
        }
    }
}
