//! Morton order: the order in which a depth-first walk of an octree meets its cells.

/// Morton code of coordinates of 21 bits, with the bits of z lowest.
#[must_use]
pub fn interleave([x, y, z]: [u64; 3]) -> u64 {
    spread(x) << 2 | spread(y) << 1 | spread(z)
}

/// Moves bit i to bit 3i, for 21 bits.
fn spread(bits: u64) -> u64 {
    let mut x = bits & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

/// Coordinate z of a Morton code; y and x are those of the code shifted right by 1 and 2.
#[must_use]
pub(crate) const fn gather(code: u64) -> u64 {
    let mut x = code & 0x1249_2492_4924_9249;
    x = (x | x >> 2) & 0x10c3_0c30_c30c_30c3;
    x = (x | x >> 4) & 0x100f_00f0_0f00_f00f;
    x = (x | x >> 8) & 0x001f_0000_ff00_00ff;
    x = (x | x >> 16) & 0x001f_0000_0000_ffff;
    (x | x >> 32) & 0x1f_ffff
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig {
            failure_persistence: None,
            ..ProptestConfig::with_cases(500)
        })]

        #[test]
        fn bits_are_interleaved_and_gathered(c in prop::array::uniform3(0u64..1 << 21)) {
            let bit = |axis: usize, i: u32| (c[axis] >> i & 1) << (3 * i + 2 - axis as u32);
            let plain = (0..21).fold(0, |x, i| x | bit(0, i) | bit(1, i) | bit(2, i));
            let code = interleave(c);
            prop_assert_eq!(code, plain);
            prop_assert_eq!([gather(code >> 2), gather(code >> 1), gather(code)], c);
        }
    }
}
