//! How far a picture is from a reference: one metric a file, and all of them at once by
//! [`compare`].
//!
//! Linear metrics look at radiance; FLIP, SSIM and the perceptual difference look at the
//! tone-mapped picture in eight bits, as a viewer does.

pub mod blocks;
mod blur;
pub(crate) mod flip;
pub(crate) mod grain;
pub(crate) mod linear;
pub(crate) mod pdiff;
pub(crate) mod ssim;

use super::{Picture, tone};
use crate::run::Cancel;
use crate::{Error, Result};

/// Memory that a comparison takes, two pictures included; most of it are the pyramids of the
/// perceptual difference.
pub const BYTES_PER_PIXEL: u64 = 220;

/// All metrics of one comparison. A metric that has no value (a black reference has no relative
/// bias, an image of ten pixels no SSIM, a picture with infinities no mean) is NaN, `null` in JSON.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Scores {
    /// Root of the mean squared difference over pixels and channels, radiance.
    pub rmse: f64,
    /// Mean of `(x-r)^2 / (r^2 + 0.01)` over pixels and channels.
    pub relmse: f64,
    /// [`Self::relmse`] without the worst 0.1 % of pixels (rounded down, none of 999), so that a
    /// single firefly does not decide it.
    pub relmse_trimmed: f64,
    /// Mean of the picture over mean of the reference, less 1.
    pub bias: f64,
    /// Mean absolute difference over the mean of the reference, both over pixels and channels.
    pub relmae: f64,
    /// Standard deviation of the error that changes within a few pixels on smooth ground,
    /// [`grain::rms`].
    pub grain: f64,
    /// Mean LDR-FLIP error at 67 pixels a degree, 0 (same) to 1.
    pub flip: f64,
    /// Mean structural similarity, 1 for the same picture.
    pub ssim: f64,
    /// Fraction of pixels that a viewer can tell apart by Yee's metric, 0 to 1.
    pub pdiff: f64,
    /// Largest difference of a channel, radiance.
    pub max_abs: f64,
    /// Pixels of the picture that are infinite or not a number.
    pub non_finite: usize,
    /// Pixels of the reference that are infinite or not a number.
    pub reference_non_finite: usize,
    /// Factor on radiance before the tone map of the perceptual metrics.
    pub exposure: f32,
}

/// Scores and the error at every pixel.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// One number for each metric, over all pixels.
    pub scores: Scores,
    /// LDR-FLIP error of every pixel, 0 to 1, row by row.
    pub error_map: Vec<f32>,
}

/// Compares a picture with a reference of the same size.
///
/// # Errors
/// [`crate::Kind::Input`] if the sizes differ, there are no pixels, or the exposure is not a
/// positive number.
pub fn compare(picture: &Picture, reference: &Picture, exposure: f32) -> Result<Comparison> {
    compare_until(picture, reference, exposure, &Cancel::default())
}

/// Compares a picture with a reference as [`compare`] does, but stops between two metrics on
/// request.
///
/// # Errors
/// As [`compare`], and [`crate::Kind::Cancelled`].
pub fn compare_until(
    picture: &Picture,
    reference: &Picture,
    exposure: f32,
    cancel: &Cancel,
) -> Result<Comparison> {
    if (picture.width, picture.height) != (reference.width, reference.height) {
        return Err(Error::input(format!(
            "sizes differ: the image has {}x{} pixels, the reference {}x{}",
            picture.width, picture.height, reference.width, reference.height
        )));
    }
    if picture.pixels.is_empty() {
        return Err(Error::input("there are no pixels to compare"));
    }
    if !(exposure.is_finite() && exposure > 0.0) {
        return Err(Error::input(format!(
            "exposure {exposure} is not a positive number"
        )));
    }
    let linear = linear::compare(picture, reference);
    let grain = grain::rms(picture, reference);
    let (picture_shown, reference_shown) =
        (tone::map(picture, exposure), tone::map(reference, exposure));
    cancel.check()?;
    let error_map = flip::error_map(&picture_shown, &reference_shown);
    cancel.check()?;
    let ssim = ssim::mean(&picture_shown, &reference_shown);
    cancel.check()?;
    let pdiff = pdiff::fraction(&picture_shown, &reference_shown);
    cancel.check()?;
    let scores = Scores {
        rmse: linear.rmse,
        relmse: linear.relmse,
        relmse_trimmed: linear.relmse_trimmed,
        bias: linear.bias,
        relmae: linear.relmae,
        grain,
        flip: flip::mean(&error_map),
        ssim,
        pdiff,
        max_abs: linear.max_abs,
        non_finite: picture.non_finite(),
        reference_non_finite: reference.non_finite(),
        exposure,
    };
    Ok(Comparison { scores, error_map })
}

#[cfg(test)]
mod tests;
