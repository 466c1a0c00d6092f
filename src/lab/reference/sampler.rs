//! The random numbers of one path: well spread where a path makes its few weighty choices, plain
//! elsewhere.
//!
//! Sets of four dimensions of an Owen-scrambled Sobol sequence are padded with fresh scrambles
//! (Burley 2020), so a path may be as long as it likes and pixels do not see each other's patterns.

use crate::math::sampling::{hash, mix, unit};

/// Numbers in [0,1) for one path, a pure function of its key and index.
#[derive(Debug)]
pub struct Sampler {
    key: u64,
    index: u32,
    set: u64,
    stream: u64,
}

impl Sampler {
    /// Points of the sequence before its scramble changes.
    const LENGTH: u32 = 1 << 16;

    /// The numbers of path `index` of the sequence named `key`.
    #[must_use]
    pub fn new(key: u64, index: u32) -> Self {
        Self {
            key: hash(&[key, u64::from(index / Self::LENGTH)]),
            index: index % Self::LENGTH,
            set: 0,
            stream: hash(&[key, u64::from(index), u64::MAX]),
        }
    }

    /// Four numbers that are well spread over the paths of the sequence.
    #[must_use]
    pub fn next4(&mut self) -> [f32; 4] {
        self.set += 1;
        sobol_burley::sample_4d(self.index, 0, hash(&[self.key, self.set]) as u32)
    }

    /// A number that is only random, for choices of unknown count.
    #[must_use]
    #[inline]
    pub fn uniform(&mut self) -> f32 {
        self.stream = self.stream.wrapping_add(0x9e37_79b9_7f4a_7c15);
        unit(mix(self.stream))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_paths_fill_sixteen_cells_in_every_set() {
        for key in 0..20 {
            let mut samplers: Vec<_> = (0..16).map(|i| Sampler::new(key, i)).collect();
            for _ in 0..5 {
                let mut seen = [false; 16];
                for s in &mut samplers {
                    let [u, v, ..] = s.next4();
                    seen[(u * 4.0) as usize * 4 + (v * 4.0) as usize] = true;
                }
                assert_eq!(seen, [true; 16]);
            }
        }
    }

    #[test]
    fn long_sequences_go_on() {
        let mut a = Sampler::new(3, 5);
        let mut b = Sampler::new(3, 5 + (1 << 16));
        assert_ne!(a.next4(), b.next4());
        let mean = (0..10_000).map(|_| f64::from(a.uniform())).sum::<f64>() / 1e4;
        assert!((mean - 0.5).abs() < 0.02, "{mean}");
    }
}
