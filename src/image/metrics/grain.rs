//! Grain: error that changes within a few pixels on smooth ground, where a viewer sees it long
//! before means over a frame do.
//!
//! The relative error of a pixel's luminance, less its mean over the 7x7 pixels around, has no
//! bias, no gradient and no blotch much wider than that. The median over a block tells its standard
//! deviation whatever a few pixels on edges do (as Donoho & Johnstone 1994 estimate the noise of a
//! signal): grain is the root mean square of those of all blocks.

use super::blocks::BLOCK_EDGE;
use super::blur::{Border, columns, rows};
use super::linear::RELATIVE_FLOOR;
use crate::image::Picture;

const LUMINANCE: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Pixels along an edge of the window whose mean is taken off. Neighbours share 12 of the 16
/// corners around them, and means over 4x4 show 0.77 of their deviation by seven, 0.5 by three. A
/// line is in seven of the sixteen columns of a whole block, so the median does not see it, as it
/// would by nine.
const WINDOW: usize = 7;

/// Median size of a normal deviate.
const MEDIAN: f64 = 0.674_489_750_196_081_7;

/// Measures the grain of a picture beside a reference of the same size. White noise in luminance
/// has its own standard deviation, relative to the reference as in relMSE; noise alike over several
/// pixels has less. Noise of the reference counts, too: two frames of one renderer and two seeds
/// have the square root of 2 times the grain of one. NaN below 7 pixels on a side.
#[must_use]
pub fn rms(picture: &Picture, reference: &Picture) -> f64 {
    const SHARES: [f64; WINDOW] = [1.0 / WINDOW as f64; WINDOW];
    const RIM: usize = WINDOW / 2;
    let (width, height) = (picture.width, picture.height);
    let pairs = picture.pixels.iter().zip(&reference.pixels);
    let error: Vec<f64> = pairs.map(|(x, r)| relative_error(*x, *r)).collect();
    let across = rows(&error, width, &SHARES, Border::Clamp);
    let mean = columns(&across, width, &SHARES, Border::Clamp);
    // A pixel is a part of its own mean.
    let pixels = (WINDOW * WINDOW) as f64;
    let scale = (pixels / (pixels - 1.0)).sqrt() / MEDIAN;
    // Pixels at the border have no mean around them.
    let (right, bottom) = (width.saturating_sub(RIM), height.saturating_sub(RIM));
    let (mut squares, mut count) = (0.0, 0);
    let mut block = Vec::with_capacity(BLOCK_EDGE * BLOCK_EDGE);
    for y0 in (RIM..bottom).step_by(BLOCK_EDGE) {
        for x0 in (RIM..right).step_by(BLOCK_EDGE) {
            block.clear();
            for y in y0..bottom.min(y0 + BLOCK_EDGE) {
                let pixels = y * width + x0..y * width + right.min(x0 + BLOCK_EDGE);
                block.extend(pixels.map(|i| (error[i] - mean[i]).abs()));
            }
            let deviation = scale * median(&mut block);
            squares += deviation * deviation * block.len() as f64;
            count += block.len();
        }
    }
    (squares / count as f64).sqrt()
}

/// Difference of luminance over that of the reference; in the dark, over no less than relMSE takes.
fn relative_error(x: [f32; 3], r: [f32; 3]) -> f64 {
    let [x, r] = [x, r].map(luminance);
    (x - r) / (r * r + RELATIVE_FLOOR).sqrt()
}

fn luminance(rgb: [f32; 3]) -> f64 {
    let terms = rgb.into_iter().zip(LUMINANCE);
    terms.map(|(v, weight)| f64::from(v) * weight).sum()
}

/// The middle value of some; not-a-number is larger than all.
fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 150;
    const HEIGHT: usize = 110;

    /// A picture of what is at each pixel.
    fn picture(at: impl Fn(usize, usize) -> f64) -> Picture {
        let pixels = (0..WIDTH * HEIGHT).map(|i| [at(i % WIDTH, i / WIDTH) as f32; 3]);
        Picture {
            width: WIDTH,
            height: HEIGHT,
            pixels: pixels.collect(),
        }
    }

    /// A normal deviate for each pixel, of variance 1.
    fn white(x: usize, y: usize) -> f64 {
        let key = (x as u64) << 32 | y as u64;
        // The last step of SplitMix64 (Steele, Lea & Flood 2014).
        let uniform = |draw: u64| {
            let mut z = (key * 12 + draw + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z ^ (z >> 31)) as f64 / u64::MAX as f64
        };
        (0..12).map(uniform).sum::<f64>() - 6.0
    }

    #[track_caller]
    fn is_within(value: f64, range: std::ops::Range<f64>) {
        assert!(range.contains(&value), "{value} is not in {range:?}");
    }

    #[test]
    fn white_noise_has_its_own_deviation() {
        let flat = picture(|_, _| 2.0);
        for deviation in [0.001, 0.03] {
            // In the unit of relMSE, whose floor is 0.01.
            let scale = deviation * (4.0f64 + 0.01).sqrt();
            let noisy = picture(|x, y| 2.0 + scale * white(x, y));
            is_within(rms(&noisy, &flat) / deviation, 0.98..1.02);
            // Two of that kind.
            let other = picture(|x, y| 2.0 + scale * white(x + WIDTH, y));
            is_within(rms(&noisy, &other) / deviation, 1.39..1.44);
        }
    }

    #[test]
    fn bias_gradients_and_slow_errors_have_none() {
        let ramp = |x: usize, y: usize| 0.5 + 0.004 * x as f64 + 0.002 * y as f64;
        let reference = picture(ramp);
        assert_eq!(rms(&reference, &reference), 0.0);
        let errors: [&dyn Fn(usize, usize) -> f64; 4] = [
            &|_, _| 0.1,
            &|x, y| 0.1 * ramp(x, y),
            &|x, y| 0.001 * x as f64 - 0.002 * y as f64,
            &|x, y| 0.1 * (x as f64 / 40.0).sin() * (y as f64 / 40.0).cos(),
        ];
        for error in errors {
            let wrong = picture(|x, y| ramp(x, y) + error(x, y));
            is_within(rms(&wrong, &reference), 0.0..5e-4);
        }
    }

    #[test]
    fn edges_do_not_count_and_a_patch_of_grain_does() {
        let flat = picture(|_, _| 1.0);
        let edges = picture(|x, _| if x % 16 == 5 { 3.0 } else { 1.0 });
        assert!(rms(&edges, &flat) < 1e-6);
        // Four of the blocks have all of it.
        let patch = picture(|x, y| {
            let inside = (35..67).contains(&x) && (35..67).contains(&y);
            1.0 + if inside { 0.04 * white(x, y) } else { 0.0 }
        });
        let share = (32.0 * 32.0) / ((WIDTH - 6) * (HEIGHT - 6)) as f64;
        is_within(rms(&patch, &flat) / (0.04 * share.sqrt()), 0.9..1.1);
    }

    #[test]
    fn broken_pixels_are_as_large_as_can_be() {
        let flat = picture(|_, _| 1.0);
        let mut broken = flat.clone();
        broken.pixels[20 * WIDTH + 20] = [f32::NAN; 3];
        assert_eq!(rms(&broken, &flat), 0.0);
        broken.pixels.fill([f32::INFINITY; 3]);
        assert!(rms(&broken, &flat).is_nan());
    }

    #[test]
    fn pictures_smaller_than_the_window_have_no_value() {
        for (width, height) in [(1, 1), (6, 9), (9, 6)] {
            let small = Picture {
                width,
                height,
                pixels: vec![[1.0; 3]; width * height],
            };
            assert!(rms(&small, &small).is_nan());
        }
    }
}
