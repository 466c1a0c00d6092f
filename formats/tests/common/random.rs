//! Numbers from a seed, for the tests of both packages.

/// SplitMix64: written out, so that the golden files do not depend on a crate's version.
pub struct Random(pub u64);

impl Random {
    /// Sixty-four random bits.
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In [0, 1).
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    /// A whole number below another.
    pub fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    /// A unit vector.
    pub fn normal(&mut self) -> [f32; 3] {
        loop {
            let v: [f32; 3] = std::array::from_fn(|_| self.unit() * 2.0 - 1.0);
            let len = v.iter().map(|c| c * c).sum::<f32>().sqrt();
            if len > 0.1 && len < 1.0 {
                return v.map(|c| c / len);
            }
        }
    }

    /// In [-1, 1).
    pub fn signed(&mut self) -> f32 {
        2.0 * self.unit() - 1.0
    }

    /// On the unit sphere.
    pub fn direction(&mut self) -> [f32; 3] {
        let z = self.signed();
        let (sin, cos) = (std::f32::consts::PI * self.signed()).sin_cos();
        let r = (1.0 - z * z).sqrt();
        [r * cos, r * sin, z]
    }
}
