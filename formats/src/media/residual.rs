//! Integer codes of a brick as differences to what their neighbours foretell: along x, then y, then
//! z, so that of a field which is linear along any axis nothing is left.
//!
//! Arithmetic is that of integers of 8, 16, 24 or 32 bits, so no code gets longer. Differences are
//! zigzag: 0, -1, 1, -2, … are 0, 1, 2, 3, …

use super::{BRICK_EDGE, BRICK_VOXELS};

/// The codes of a brick, x fastest.
pub type Codes = [u32; BRICK_VOXELS];

const LAYER: usize = BRICK_EDGE * BRICK_EDGE;

/// Bytes of integers that hold codes up to `most`; 1 to 4.
pub fn width_of(most: u32) -> usize {
    (4 - most.leading_zeros() as usize / 8).max(1)
}

/// Puts residuals in the place of codes of so many bytes.
pub fn encode(codes: &mut Codes, width: usize) {
    for row in codes.chunks_exact_mut(BRICK_EDGE) {
        for x in (1..BRICK_EDGE).rev() {
            row[x] = row[x].wrapping_sub(row[x - 1]);
        }
    }
    for layer in codes.chunks_exact_mut(LAYER) {
        for i in (BRICK_EDGE..LAYER).rev() {
            layer[i] = layer[i].wrapping_sub(layer[i - BRICK_EDGE]);
        }
    }
    for i in (LAYER..BRICK_VOXELS).rev() {
        codes[i] = codes[i].wrapping_sub(codes[i - LAYER]);
    }
    let spare = 32 - 8 * width as u32;
    for code in codes {
        let difference = (*code << spare) as i32 >> spare;
        *code = ((difference << 1) ^ (difference >> 31)) as u32 & (u32::MAX >> spare);
    }
}

/// Puts codes of so many bytes in the place of residuals.
pub fn decode(codes: &mut Codes, width: usize) {
    for code in codes.iter_mut() {
        *code = (*code >> 1) ^ (*code & 1).wrapping_neg();
    }
    for i in LAYER..BRICK_VOXELS {
        codes[i] = codes[i].wrapping_add(codes[i - LAYER]);
    }
    for layer in codes.chunks_exact_mut(LAYER) {
        for i in BRICK_EDGE..LAYER {
            layer[i] = layer[i].wrapping_add(layer[i - BRICK_EDGE]);
        }
    }
    let mask = u32::MAX >> (32 - 8 * width as u32);
    for row in codes.chunks_exact_mut(BRICK_EDGE) {
        let mut sum = 0_u32;
        for code in row {
            sum = sum.wrapping_add(*code);
            *code = sum & mask;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_of_every_width_come_back() {
        let mut state = 1_u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state
        };
        for width in 1..=4 {
            let mask = u32::MAX >> (32 - 8 * width as u32);
            let ends: Codes = std::array::from_fn(|i| if i % 3 == 0 { mask } else { 0 });
            let any: Codes = std::array::from_fn(|_| random() & mask);
            for codes in [ends, any, [mask; BRICK_VOXELS]] {
                let mut coded = codes;
                encode(&mut coded, width);
                assert!(coded.iter().all(|c| c & !mask == 0));
                decode(&mut coded, width);
                assert_eq!(coded, codes);
            }
        }
    }

    #[test]
    fn nothing_is_left_inside_of_a_linear_field() {
        let at = |i: usize| [i % 8, i / 8 % 8, i / 64];
        let mut codes: Codes = std::array::from_fn(|i| {
            let [x, y, z] = at(i);
            (1000 + 3 * x + 5 * y + 7 * z) as u32
        });
        encode(&mut codes, 2);
        let inside = codes.iter().enumerate().filter(|(i, _)| {
            let zeros = at(*i).iter().filter(|c| **c == 0).count();
            zeros < 2
        });
        assert!(inside.clone().count() > 400);
        assert!(inside.into_iter().all(|(_, c)| *c == 0));
    }

    #[test]
    fn widths_hold_their_codes() {
        for (most, width) in [
            (0, 1),
            (255, 1),
            (256, 2),
            (65_535, 2),
            (65_536, 3),
            (1 << 24, 4),
        ] {
            assert_eq!(width_of(most), width, "{most}");
        }
    }
}
