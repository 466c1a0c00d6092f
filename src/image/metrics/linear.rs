//! Metrics on linear radiance.

use crate::image::Picture;

/// Keeps relMSE finite in the dark: errors below about a tenth of a unit of radiance count absolutely.
const RELATIVE_FLOOR: f64 = 0.01;

/// Share of pixels that the trimmed mean keeps.
const KEPT: f64 = 0.999;

/// Metrics of [`compare`]; see [`super::Scores`] for their meaning.
#[derive(Clone, Copy, Debug)]
pub struct Linear {
    /// Root mean squared error.
    pub rmse: f64,
    /// Relative mean squared error.
    pub relmse: f64,
    /// The same without the worst pixels.
    pub relmse_trimmed: f64,
    /// Relative bias of the mean.
    pub bias: f64,
    /// Largest difference.
    pub max_abs: f64,
}

/// Compares two pictures of the same size.
#[must_use]
pub fn compare(picture: &Picture, reference: &Picture) -> Linear {
    let mut squares = 0.0;
    let mut max_abs = 0.0f64;
    let (mut sum, mut reference_sum) = (0.0, 0.0);
    let mut relative: Vec<f64> = Vec::with_capacity(picture.pixels.len());
    for (x, r) in picture.pixels.iter().zip(&reference.pixels) {
        let mut pixel = 0.0;
        for (x, r) in x.iter().zip(r) {
            let (x, r) = (f64::from(*x), f64::from(*r));
            let square = (x - r) * (x - r);
            squares += square;
            pixel += square / (r * r + RELATIVE_FLOOR);
            sum += x;
            reference_sum += r;
            // NaN must not hide behind the comparison inside max.
            let difference = (x - r).abs();
            if difference > max_abs || difference.is_nan() {
                max_abs = difference;
            }
        }
        // NaN may carry a sign, and a negative one would sort first.
        relative.push((pixel / 3.0).abs());
    }
    let count = relative.len() as f64;
    let relmse = relative.iter().sum::<f64>() / count;
    // NaN sorts last, so a few broken pixels are trimmed like fireflies.
    relative.sort_unstable_by(f64::total_cmp);
    let kept = ((count * KEPT) as usize).max(1);
    Linear {
        rmse: (squares / (3.0 * count)).sqrt(),
        relmse,
        relmse_trimmed: relative[..kept].iter().sum::<f64>() / kept as f64,
        bias: sum / reference_sum - 1.0,
        max_abs,
    }
}
