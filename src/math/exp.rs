//! exp(-x) and 1 - exp(-x) that are the same on every machine and keep their relative accuracy at
//! both ends.
//!
//! The system's exponential differs between C libraries, and pixels must not.

const LN2_HIGH: f32 = 0.693_359_4;
const LN2_LOW: f32 = -2.121_944_4e-4;

/// exp(-x) for x >= 0, relative error below 4e-7; 0 from x = 87 on, where the result would be
/// denormal.
#[must_use]
#[inline]
pub fn exp_neg(x: f32) -> f32 {
    exp_neg_and_rest(x).0
}

/// 1 - exp(-x) for x >= 0: the share of light that a segment of optical depth x takes; relative
/// error below 1e-6.
#[must_use]
#[inline]
pub fn one_minus_exp_neg(x: f32) -> f32 {
    exp_neg_and_rest(x).1
}

/// exp(-x) and 1 - exp(-x) together, of the same accuracy, for the price of one.
#[must_use]
#[inline]
pub fn exp_neg_and_rest(x: f32) -> (f32, f32) {
    if x >= 87.0 {
        return (0.0, 1.0);
    }
    let n = (x * std::f32::consts::LOG2_E + 0.5).floor();
    // f in about [-ln2/2, ln2/2], exact in two steps.
    let f = -((x - n * LN2_HIGH) - n * LN2_LOW);
    // exp(f) - 1 keeps its relative accuracy at 0, and so does the rest: its other term is 0 or at
    // least a half.
    let poly = 1.0 / 5040.0;
    let poly = poly * f + 1.0 / 720.0;
    let poly = poly * f + 1.0 / 120.0;
    let poly = poly * f + 1.0 / 24.0;
    let poly = poly * f + 1.0 / 6.0;
    let poly = poly * f + 0.5;
    let poly = poly * f + 1.0;
    let scale = f32::from_bits(((127 - n as i32) as u32) << 23);
    let scaled = scale * (poly * f);
    (scale + scaled, (1.0 - scale) - scaled)
}

/// [`exp_neg`] of each of many values, in their place: the same bits, several at a time.
pub fn exp_neg_in_place(values: &mut [f32]) {
    /// Its lowest bits are those of a small integer that is added to it.
    const INTEGER: f32 = 12_582_912.0;
    for value in values {
        let x = *value;
        let capped = if x < 87.0 { x } else { 87.0 };
        let n = (capped * std::f32::consts::LOG2_E + 0.5).floor();
        let f = -((capped - n * LN2_HIGH) - n * LN2_LOW);
        let poly = 1.0 / 5040.0;
        let poly = poly * f + 1.0 / 720.0;
        let poly = poly * f + 1.0 / 120.0;
        let poly = poly * f + 1.0 / 24.0;
        let poly = poly * f + 1.0 / 6.0;
        let poly = poly * f + 0.5;
        let poly = poly * f + 1.0;
        let scale = f32::from_bits((INTEGER + (127.0 - n)).to_bits() << 23);
        let exp = scale + scale * (poly * f);
        *value = if x < 87.0 { exp } else { 0.0 };
    }
}

/// Mean depth at which light from a segment of optical depth x leaves its last particle, as a share
/// of the segment: 1/x - 1/(exp(x) - 1), from 1/2 at 0 towards 0; relative error below 1e-5.
#[must_use]
#[inline]
pub fn mean_reach(x: f32) -> f32 {
    if x < 0.5 {
        0.5 - x * (1.0 / 12.0 - x * x * (1.0 / 720.0 - x * x * (1.0 / 30240.0)))
    } else {
        1.0 / x - exp_neg(x) / one_minus_exp_neg(x)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_reach_is_that_of_an_exponential() {
        let mut x = 1e-6_f32;
        while x < 1e5 {
            let exact = f64::from(x);
            let exact = if exact < 1e-3 {
                0.5 - exact / 12.0
            } else {
                1.0 / exact - 1.0 / exact.exp_m1()
            };
            assert!((f64::from(mean_reach(x)) / exact - 1.0).abs() < 1e-5, "{x}");
            x *= 1.3;
        }
        assert_eq!(mean_reach(0.0), 0.5);
    }

    #[test]
    fn both_agree_with_double_precision() {
        let mut x = 1e-12_f32;
        while x < 86.0 {
            let t = (-f64::from(x)).exp();
            assert!((f64::from(exp_neg(x)) / t - 1.0).abs() < 4e-7, "exp(-{x})");
            let a = -(-f64::from(x)).exp_m1();
            assert!(
                (f64::from(one_minus_exp_neg(x)) / a - 1.0).abs() < 1e-6,
                "1-exp(-{x})"
            );
            let (exp, rest) = exp_neg_and_rest(x);
            assert!((f64::from(exp) / t - 1.0).abs() < 4e-7, "exp(-{x})");
            assert_eq!(rest, one_minus_exp_neg(x));
            let mut both = [x, 3.0 * x];
            exp_neg_in_place(&mut both);
            assert_eq!(both, [exp, exp_neg(3.0 * x)]);
            x *= 1.01;
        }
        assert_eq!(exp_neg(0.0), 1.0);
        assert_eq!(one_minus_exp_neg(0.0), 0.0);
        assert_eq!(exp_neg(1e4), 0.0);
        assert_eq!(one_minus_exp_neg(1e30), 1.0);
    }
}
