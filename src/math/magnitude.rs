//! Lengths of any scale brought near 1: products of several would leave the range of f32.

/// The power of two that brings a length that is not negative to between 1 and 2. It changes no
/// digit of what it multiplies. At the ends of the range of f32 it brings it nearer to that only,
/// and its own inverse stays finite.
#[inline]
#[must_use]
pub fn to_unit(length: f32) -> f32 {
    // By the bits of the exponent: this is asked for every triangle that lights a point.
    let exponent = (length.to_bits() >> 23).clamp(1, 253);
    f32::from_bits((254 - exponent) << 23)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_come_near_one_and_back() {
        for exponent in -125..=126 {
            for mantissa in [1.0, 1.3, 1.999_999_9] {
                let length = libm::ldexpf(mantissa, exponent);
                let scale = to_unit(length);
                assert_eq!(length * scale, mantissa);
                assert_eq!(mantissa * (1.0 / scale), length);
            }
        }
        for length in [0.0, 1e-45, f32::MAX, f32::INFINITY, f32::NAN] {
            let scale = to_unit(length);
            assert!(scale.is_normal() && (1.0 / scale).is_normal(), "{length}");
        }
    }
}
