//! Metrics on linear radiance.

use crate::image::Picture;

/// Keeps relMSE finite in the dark: errors below about a tenth of a unit of radiance count
/// absolutely. Radiance squared.
pub const RELATIVE_FLOOR: f64 = 0.01;

/// Pixels of which the trimmed mean drops one.
const PIXELS_PER_DROPPED: usize = 1000;

/// Number of pixels that the trimmed mean keeps: all but the worst 0.1 %, rounded down.
#[must_use]
pub fn kept(pixels: usize) -> usize {
    pixels - pixels / PIXELS_PER_DROPPED
}

/// Metrics of [`compare`]; see [`super::Scores`] for their meaning.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// Root mean squared error.
    pub rmse: f64,
    /// Relative mean squared error.
    pub relmse: f64,
    /// Relative mean squared error without the worst 0.1 % of pixels.
    pub relmse_trimmed: f64,
    /// Relative bias of the mean.
    pub bias: f64,
    /// Relative mean absolute error.
    pub relmae: f64,
    /// Largest absolute difference of a channel of a pixel, radiance.
    pub max_abs: f64,
}

/// Compares the radiance of two pictures of the same size.
#[must_use]
pub fn compare(picture: &Picture, reference: &Picture) -> Linear {
    let (mut squares, mut absolute) = (0.0, 0.0);
    let mut max_abs = 0.0f64;
    let (mut sum, mut reference_sum) = (0.0, 0.0);
    let mut relative: Vec<f64> = Vec::with_capacity(picture.pixels.len());
    for (x, r) in picture.pixels.iter().zip(&reference.pixels) {
        // NaN may carry a sign, and a negative one would sort first.
        relative.push(relative_square(*x, *r).abs());
        for (x, r) in x.iter().zip(r) {
            let (x, r) = (f64::from(*x), f64::from(*r));
            squares += (x - r) * (x - r);
            sum += x;
            reference_sum += r;
            // NaN must not hide behind the comparison inside max.
            let difference = (x - r).abs();
            if difference > max_abs || difference.is_nan() {
                max_abs = difference;
            }
            absolute += difference;
        }
    }
    let count = relative.len() as f64;
    let relmse = relative.iter().sum::<f64>() / count;
    // NaN sorts last, so a few broken pixels are trimmed like fireflies.
    relative.sort_unstable_by(f64::total_cmp);
    let kept = kept(relative.len());
    Linear {
        rmse: (squares / (3.0 * count)).sqrt(),
        relmse,
        relmse_trimmed: relative[..kept].iter().sum::<f64>() / kept as f64,
        bias: sum / reference_sum - 1.0,
        relmae: absolute / reference_sum,
        max_abs,
    }
}

/// Mean over channels of `(x-r)^2 / (r^2 + 0.01)`.
pub(super) fn relative_square(x: [f32; 3], r: [f32; 3]) -> f64 {
    let terms = x.iter().zip(r).map(|(&x, r)| {
        let (x, r) = (f64::from(x), f64::from(r));
        (x - r) * (x - r) / (r * r + RELATIVE_FLOOR)
    });
    terms.sum::<f64>() / 3.0
}
