//! Structural similarity (Wang, Bovik, Sheikh, Simoncelli 2004) of tone-mapped pictures.
//!
//! Gaussian weights of sigma 1.5 over 11x11 pixels, plain (not sample) covariance, range 255, the
//! mean over the three channels without the five pixels at the border: the numbers of
//! scikit-image's `structural_similarity` so set.

use super::blur::{Border, columns, rows};
use crate::image::tone::Display;

const SIGMA: f64 = 1.5;
const RADIUS: usize = 5;
const C1: f64 = (0.01 * 255.0) * (0.01 * 255.0);
const C2: f64 = (0.03 * 255.0) * (0.03 * 255.0);

/// Measures the mean structural similarity of two pictures of the same size: 1 for the same
/// picture, NaN below 11 pixels on a side.
#[must_use]
pub fn mean(a: &Display, b: &Display) -> f64 {
    let (width, height) = (a.width, a.height);
    if width <= 2 * RADIUS || height <= 2 * RADIUS {
        return f64::NAN;
    }
    let weights = gaussian();
    let blur = |plane: &[f64]| {
        let down = columns(plane, width, &weights, Border::Reflect);
        rows(&down, width, &weights, Border::Reflect)
    };
    let mut sum = 0.0;
    for channel in 0..3 {
        let plane =
            |d: &Display| -> Vec<f64> { d.pixels.iter().map(|p| f64::from(p[channel])).collect() };
        let (x, y) = (plane(a), plane(b));
        let product =
            |p: &[f64], q: &[f64]| -> Vec<f64> { p.iter().zip(q).map(|(p, q)| p * q).collect() };
        let (mean_x, mean_y) = (blur(&x), blur(&y));
        let (xx, yy, xy) = (
            blur(&product(&x, &x)),
            blur(&product(&y, &y)),
            blur(&product(&x, &y)),
        );
        for row in RADIUS..height - RADIUS {
            for i in row * width + RADIUS..(row + 1) * width - RADIUS {
                let (mx, my) = (mean_x[i], mean_y[i]);
                let (vx, vy, vxy) = (xx[i] - mx * mx, yy[i] - my * my, xy[i] - mx * my);
                let numerator = (2.0 * mx * my + C1) * (2.0 * vxy + C2);
                sum += numerator / ((mx * mx + my * my + C1) * (vx + vy + C2));
            }
        }
    }
    sum / (3 * (width - 2 * RADIUS) * (height - 2 * RADIUS)) as f64
}

fn gaussian() -> Vec<f64> {
    let raw: Vec<f64> = (0..=2 * RADIUS)
        .map(|i| {
            let x = i as f64 - RADIUS as f64;
            (-0.5 * x * x / (SIGMA * SIGMA)).exp()
        })
        .collect();
    let sum: f64 = raw.iter().sum();
    raw.iter().map(|w| w / sum).collect()
}
