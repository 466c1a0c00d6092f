//! Perceptual difference after Yee, "A Perceptual Metric for Production Testing" (2004), with the
//! settings of the `perceptualdiff` tool: 45 degrees of view, gamma 2.2, white at 100 cd/m2.
//!
//! A pyramid of undecimated low-pass images gives contrast by frequency band; Barten's contrast
//! sensitivity and Daly's masking raise the threshold that Ward's adaptation curve sets for the
//! difference of luminance; a second test looks at CIELAB chromaticity. The tool takes red for blue
//! and blue for red; published figures come from it, so this does the same, and counts the same
//! pixels.

use super::blur::{Border, columns, rows};
use crate::image::tone::Display;
use rayon::prelude::*;

const LEVELS: usize = 8;
/// Low-pass filter between levels.
const FILTER: [f64; 5] = [0.05, 0.25, 0.4, 0.25, 0.05];
const FIELD_OF_VIEW_DEG: f64 = 45.0;
const GAMMA: f64 = 2.2;
const WHITE_CD_PER_M2: f64 = 100.0;
/// Adobe RGB (1998) to XYZ.
const XYZ_FROM_RGB: [[f64; 3]; 3] = [
    [0.576700, 0.185556, 0.188212],
    [0.297361, 0.627355, 0.0752847],
    [0.0270328, 0.0706879, 0.991248],
];
/// Below this adaptation luminance colour is not seen.
const MIN_COLOUR_CD_PER_M2: f64 = 10.0;

/// Computes the fraction of pixels that differ visibly, 0 to 1.
#[must_use]
pub fn fraction(a: &Display, b: &Display) -> f64 {
    let differing = differing(a, b);
    differing.iter().filter(|&&f| f).count() as f64 / differing.len() as f64
}

/// Whether each pixel differs visibly, row by row.
fn differing(a: &Display, b: &Display) -> Vec<bool> {
    if a == b {
        return vec![false; a.pixels.len()];
    }
    let (viewed_a, viewed_b) = (Viewed::new(a), Viewed::new(b));
    let (levels_a, levels_b) = (pyramid(&viewed_a, a.width), pyramid(&viewed_b, b.width));

    let degrees = (2.0 * (FIELD_OF_VIEW_DEG / 2.0).to_radians().tan()).to_degrees();
    let pixels_per_degree = a.width as f64 / degrees;
    // The level whose blur spans about a degree: what the eye adapts to.
    let adaptation_level = (0..LEVELS)
        .find(|&level| f64::from(1u32 << level) > degrees)
        .unwrap_or(LEVELS - 1);
    let bands = LEVELS - 2;
    let cycles_per_degree: Vec<f64> = (0..bands)
        .map(|band| 0.5 * pixels_per_degree * 0.5f64.powi(band as i32))
        .collect();
    let peak = sensitivity(3.248, 100.0);
    let weights: Vec<f64> = cycles_per_degree
        .iter()
        .map(|&cpd| peak / sensitivity(cpd, 100.0))
        .collect();

    (0..a.pixels.len())
        .into_par_iter()
        .with_min_len(1024)
        .map(|i| {
            let adapted = 0.5 * (levels_a[adaptation_level][i] + levels_b[adaptation_level][i]);
            let adapted = adapted.max(1e-5);
            let (mut contrasts, mut factor) = (0.0, 0.0);
            for band in 0..bands {
                let step = |levels: &[Vec<f64>]| (levels[band][i] - levels[band + 1][i]).abs();
                let base = |levels: &[Vec<f64>]| levels[band + 2][i].abs();
                let contrast = step(&levels_a).max(step(&levels_b))
                    / base(&levels_a).max(base(&levels_b)).max(1e-5);
                let masked = masking(contrast * sensitivity(cycles_per_degree[band], adapted));
                factor += contrast * weights[band] * masked;
                contrasts += contrast;
            }
            let factor = (factor / f64::max(contrasts, 1e-5)).clamp(1.0, 10.0);
            let luminance = (levels_a[0][i] - levels_b[0][i]).abs();
            if luminance > factor * threshold(adapted) {
                return true;
            }
            let (da, db) = (
                viewed_a.lab_a[i] - viewed_b.lab_a[i],
                viewed_a.lab_b[i] - viewed_b.lab_b[i],
            );
            adapted >= MIN_COLOUR_CD_PER_M2 && da * da + db * db > factor
        })
        .collect()
}

/// A picture on the screen: luminance (cd/m2) and CIELAB chromaticity of every pixel.
struct Viewed {
    luminance: Vec<f64>,
    lab_a: Vec<f64>,
    lab_b: Vec<f64>,
}

impl Viewed {
    fn new(display: &Display) -> Self {
        let linear: Vec<f64> = (0..=255u8)
            .map(|v| (f64::from(v) / 255.0).powf(GAMMA))
            .collect();
        let white = XYZ_FROM_RGB.map(|row| row.iter().sum::<f64>());
        let converted: Vec<[f64; 3]> = display
            .pixels
            .par_iter()
            .with_min_len(4096)
            .map(|pixel| {
                // Red and blue change places: see the head of this file.
                let [b, g, r] = pixel.map(|v| linear[usize::from(v)]);
                let xyz = XYZ_FROM_RGB.map(|row| row[0] * r + row[1] * g + row[2] * b);
                let f = [0, 1, 2].map(|i| lab_curve(xyz[i] / white[i]));
                [xyz[1], 500.0 * (f[0] - f[1]), 200.0 * (f[1] - f[2])]
            })
            .collect();
        let plane = |i: usize, scale: f64| converted.iter().map(|c| c[i] * scale).collect();
        Self {
            luminance: plane(0, WHITE_CD_PER_M2),
            lab_a: plane(1, 1.0),
            lab_b: plane(2, 1.0),
        }
    }
}

fn lab_curve(ratio: f64) -> f64 {
    if ratio > 216.0 / 24389.0 {
        ratio.cbrt()
    } else {
        (24389.0 / 27.0 * ratio + 16.0) / 116.0
    }
}

fn pyramid(viewed: &Viewed, width: usize) -> Vec<Vec<f64>> {
    let mut levels = vec![viewed.luminance.clone()];
    for level in 1..LEVELS {
        let across = rows(&levels[level - 1], width, &FILTER, Border::Uneven);
        levels.push(columns(&across, width, &FILTER, Border::Uneven));
    }
    levels
}

/// Ward's just noticeable difference (cd/m2) at an adaptation luminance.
fn threshold(adapted: f64) -> f64 {
    let log = adapted.log10();
    let exponent = if log < -3.94 {
        -2.86
    } else if log < -1.44 {
        (0.405 * log + 1.6).max(0.0).powf(2.18) - 2.86
    } else if log < -0.0184 {
        log - 0.395
    } else if log < 1.9 {
        (0.249 * log + 0.65).max(0.0).powf(2.7) - 0.72
    } else {
        log - 1.255
    };
    10.0f64.powf(exponent)
}

/// Barten's contrast sensitivity at a frequency (cycles a degree) and a luminance (cd/m2).
fn sensitivity(cycles_per_degree: f64, luminance: f64) -> f64 {
    let a = 440.0 * (1.0 + 0.7 / luminance).powf(-0.2);
    let b = 0.3 * (1.0 + 100.0 / luminance).powf(0.15);
    let x = b * cycles_per_degree;
    a * cycles_per_degree * (-x).exp() * (1.0 + 0.06 * x.exp()).sqrt()
}

/// Daly's elevation of the threshold by contrast that is there already.
fn masking(contrast: f64) -> f64 {
    let a = (392.498 * contrast).powf(0.7);
    let b = (0.0153 * a).powi(4);
    (1.0 + b).powf(0.25)
}
