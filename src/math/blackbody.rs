//! The light of a black body.

use super::Rgb;
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
    let [x, y, z] = xyz.map(|v| v / xyz[1]);
    let rgb = [
        3.240_454_2 * x - 1.537_138_5 * y - 0.498_531_4 * z,
        -0.969_266_0 * x + 1.876_010_8 * y + 0.041_556_0 * z,
        0.055_643_4 * x - 0.204_025_9 * y + 1.057_225_2 * z,
    ];
    Rgb(rgb.map(|v| v.max(0.0) as f32))
}

/// Nanometres of the first colour match, and from each to the next.
const FIRST_NM: f64 = 380.0;
const STEP_NM: f64 = 10.0;
/// Colour matching functions of the CIE 1931 standard observer (2 degrees).
const MATCHES: [[f64; 3]; 41] = [
    [0.0014, 0.0, 0.0065],
    [0.0042, 0.0001, 0.0201],
    [0.0143, 0.0004, 0.0679],
    [0.0435, 0.0012, 0.2074],
    [0.1344, 0.0040, 0.6456],
    [0.2839, 0.0116, 1.3856],
    [0.3483, 0.0230, 1.7471],
    [0.3362, 0.0380, 1.7721],
    [0.2908, 0.0600, 1.6692],
    [0.1954, 0.0910, 1.2876],
    [0.0956, 0.1390, 0.8130],
    [0.0320, 0.2080, 0.4652],
    [0.0049, 0.3230, 0.2720],
    [0.0093, 0.5030, 0.1582],
    [0.0633, 0.7100, 0.0782],
    [0.1655, 0.8620, 0.0422],
    [0.2904, 0.9540, 0.0203],
    [0.4334, 0.9950, 0.0087],
    [0.5945, 0.9950, 0.0039],
    [0.7621, 0.9520, 0.0021],
    [0.9163, 0.8700, 0.0017],
    [1.0263, 0.7570, 0.0011],
    [1.0622, 0.6310, 0.0008],
    [1.0026, 0.5030, 0.0003],
    [0.8544, 0.3810, 0.0002],
    [0.6424, 0.2650, 0.0],
    [0.4479, 0.1750, 0.0],
    [0.2835, 0.1070, 0.0],
    [0.1649, 0.0610, 0.0],
    [0.0874, 0.0320, 0.0],
    [0.0468, 0.0170, 0.0],
    [0.0227, 0.0082, 0.0],
    [0.0114, 0.0041, 0.0],
    [0.0058, 0.0021, 0.0],
    [0.0029, 0.0010, 0.0],
    [0.0014, 0.0005, 0.0],
    [0.0007, 0.0002, 0.0],
    [0.0003, 0.0001, 0.0],
    [0.0002, 0.0001, 0.0],
    [0.0001, 0.0, 0.0],
    [0.0, 0.0, 0.0],
];

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
