//! Colours of spectra, as the eye sees them.

/// Nanometres of the first colour match, and from each to the next.
pub(super) const FIRST_NM: f64 = 380.0;
pub(super) const STEP_NM: f64 = 10.0;
/// Colour matching functions of the CIE 1931 standard observer (2 degrees).
pub(super) const MATCHES: [[f64; 3]; 41] = [
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
/// The CIE standard illuminant D65 at the same wavelengths.
const D65: [f64; 41] = [
    49.9755, 54.6482, 82.7549, 91.486, 93.4318, 86.6823, 104.865, 117.008, 117.812, 114.861,
    115.923, 108.811, 109.354, 107.802, 104.79, 107.689, 104.405, 104.046, 100.0, 96.3342, 95.788,
    88.6856, 90.0062, 89.5991, 87.6987, 83.2886, 83.6992, 80.0268, 80.2146, 82.2778, 78.2842,
    69.7213, 71.6091, 74.349, 61.604, 69.8856, 75.087, 63.5927, 46.4182, 66.8054, 63.3828,
];
/// XYZ of its light, which is the white of Rec.709.
const WHITE: [f64; 3] = [0.950_47, 1.0, 1.088_83];

/// Linear Rec.709 of light of so much at each wavelength in nanometres; of 1 at all, it is of
/// luminance 1.
pub fn color_of_light(sent: impl Fn(f64) -> f64) -> [f64; 3] {
    rgb_from_xyz(means(sent, |_| 1.0))
}

/// Linear Rec.709 of a surface or a medium in daylight, D65, of which it leaves such a share; white
/// is 1.
pub fn color_in_daylight(share: impl Fn(f64) -> f64) -> [f64; 3] {
    let means = means(share, |step| between(step, |i| D65[i]));
    rgb_from_xyz(std::array::from_fn(|i| means[i] * WHITE[i]))
}

/// Means over the wavelengths by each of the colour matches and an illuminant.
fn means(value: impl Fn(f64) -> f64, illuminant: impl Fn(f64) -> f64) -> [f64; 3] {
    /// Per nanometre, as spectra may have steep flanks.
    const SAMPLES_PER_NM: usize = 2;
    let (mut sums, mut weights) = ([0.0; 3], [0.0; 3]);
    let per_step = SAMPLES_PER_NM * STEP_NM as usize;
    for sample in 0..=(MATCHES.len() - 1) * per_step {
        let step = sample as f64 / per_step as f64;
        let value = value(FIRST_NM + STEP_NM * step);
        let light = illuminant(step);
        for i in 0..3 {
            let weight = light * between(step, |k| MATCHES[k][i]);
            sums[i] += weight * value;
            weights[i] += weight;
        }
    }
    std::array::from_fn(|i| sums[i] / weights[i])
}

/// The value of a table between two of its rows.
fn between(step: f64, row: impl Fn(usize) -> f64) -> f64 {
    let low = (step as usize).min(MATCHES.len() - 2);
    let share = step - low as f64;
    row(low) * (1.0 - share) + row(low + 1) * share
}

pub(super) fn rgb_from_xyz([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        3.240_454_2 * x - 1.537_138_5 * y - 0.498_531_4 * z,
        -0.969_266_0 * x + 1.876_010_8 * y + 0.041_556_0 * z,
        0.055_643_4 * x - 0.204_025_9 * y + 1.057_225_2 * z,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn near(found: [f64; 3], expected: [f64; 3]) {
        let is_near = |(a, b): (f64, f64)| (a - b).abs() < 1e-3;
        assert!(
            found.into_iter().zip(expected).all(is_near),
            "{found:?} {expected:?}"
        );
    }

    #[test]
    fn even_spectra_are_white_as_surfaces_and_pink_as_light() {
        near(color_in_daylight(|_| 0.5), [0.5; 3]);
        near(color_of_light(|_| 1.0), [1.2048, 0.9483, 0.9089]);
        let daylight = color_of_light(|nm| between((nm - FIRST_NM) / STEP_NM, |i| D65[i]));
        near(daylight.map(|c| c / daylight[1]), [1.0; 3]);
    }
}
