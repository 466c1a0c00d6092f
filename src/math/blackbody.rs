//! The light of a black body.

use super::Rgb;
use super::observer::{FIRST_NM, MATCHES, STEP_NM, rgb_from_xyz};
use std::f32::consts::PI;
use std::sync::OnceLock;

/// Colours of black bodies from [`COLDEST`] to [`HOTTEST`], at even steps.
static COLORS: OnceLock<Vec<Rgb>> = OnceLock::new();

/// Kelvin between two colours that are kept.
const STEP: f32 = 25.0;
/// Kelvin below which a body has the colour of this.
const COLDEST: f32 = 800.0;
/// Kelvin above which a body has the colour of this.
const HOTTEST: f32 = 12_000.0;

/// What a black body of so many kelvin sends, by the law of Stefan and Boltzmann and in units in
/// which flames are near 1: `5.670373e-8 T^4 1e-6 / pi` times its linear Rec.709 colour of
/// luminance
/// 1. Cycles' Principled Volume has the same.
#[must_use]
pub fn blackbody(kelvin: f32) -> Rgb {
    const SCALE: f32 = 5.670_373e-14 / PI;
    let kelvin = kelvin.max(0.0);
    let squared = kelvin * kelvin;
    color(kelvin) * (SCALE * squared * squared)
}

/// Colour of a black body, linear Rec.709 of luminance 1; channels beyond the gamut are 0.
fn color(kelvin: f32) -> Rgb {
    let colors = COLORS.get_or_init(|| {
        let count = ((HOTTEST - COLDEST) / STEP) as usize + 1;
        let kelvin = |i| f64::from(COLDEST) + f64::from(STEP) * i as f64;
        (0..count).map(|i| exact_color(kelvin(i))).collect()
    });
    let at = (kelvin.clamp(COLDEST, HOTTEST) - COLDEST) / STEP;
    let i = (at as usize).min(colors.len() - 2);
    let share = at - i as f32;
    colors[i] * (1.0 - share) + colors[i + 1] * share
}

/// The colour by Planck's law and the eye.
fn exact_color(kelvin: f64) -> Rgb {
    /// Planck's constant times the speed of light over Boltzmann's constant, nm K.
    const SECOND_RADIATION: f64 = 1.438_776_877e7;
    let mut xyz = [0.0; 3];
    for (i, seen) in MATCHES.iter().enumerate() {
        let nm = FIRST_NM + STEP_NM * i as f64;
        let sent =
            1.0 / (libm::pow(nm / 500.0, 5.0) * libm::expm1(SECOND_RADIATION / (nm * kelvin)));
        for (sum, seen) in xyz.iter_mut().zip(seen) {
            *sum += sent * seen;
        }
    }
    let rgb = rgb_from_xyz(xyz.map(|v| v / xyz[1]));
    Rgb(rgb.map(|v| v.max(0.0) as f32))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn daylight_is_nearly_white_and_embers_are_red() {
        // A black body of 6504 K is a little pinker than D65 is.
        for channel in color(6504.0).0 {
            assert!((channel - 1.0).abs() < 0.06, "{:?}", color(6504.0));
        }
        let [red, green, blue] = color(1000.0).0;
        assert!(
            red > 4.0 && green < 0.05 && blue == 0.0,
            "{red} {green} {blue}"
        );
        assert_eq!(color(100.0), color(800.0));
        assert_eq!(color(1e9), color(12_000.0));
    }

    /// Luminance goes by the fourth power of temperature.
    #[test]
    fn luminance_is_that_of_stefan_and_boltzmann() {
        for kelvin in [1500.0_f32, 3000.0, 6010.0] {
            let expected = 5.670_373e-14 / PI * kelvin.powi(4);
            let found = blackbody(kelvin).luminance();
            assert!(
                (found / expected - 1.0).abs() < 0.01,
                "{kelvin} {found} {expected}"
            );
        }
        assert!(blackbody(0.0).is_black() && blackbody(-5.0).is_black());
    }
}
