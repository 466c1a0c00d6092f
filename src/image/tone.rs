//! The tone map of previews and perceptual metrics: `clip(exposure * radiance, 0, 1)^(1/2.2)` in
//! eight bits.

use super::Picture;
use rayon::prelude::*;

/// Display-referred pixels of eight bits a channel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Display {
    /// Pixels in a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// `width * height` RGB pixels, top row first.
    pub pixels: Vec<[u8; 3]>,
}

/// Tone-maps a picture. Not-a-number becomes black, infinity white.
#[must_use]
pub fn map(picture: &Picture, exposure: f32) -> Display {
    Display {
        width: picture.width,
        height: picture.height,
        pixels: picture
            .pixels
            .par_iter()
            .with_min_len(4096)
            .map(|pixel| pixel.map(|v| encode(v, exposure)))
            .collect(),
    }
}

/// Inverts [`map`] where it did not clip: mapping the result again at the same exposure gives the
/// same bytes.
#[must_use]
pub fn unmap(display: &Display, exposure: f32) -> Picture {
    let table: Vec<f32> = (0..=255u8).map(|v| decode(v, exposure)).collect();
    Picture {
        width: display.width,
        height: display.height,
        pixels: display
            .pixels
            .iter()
            .map(|p| p.map(|v| table[usize::from(v)]))
            .collect(),
    }
}

fn encode(radiance: f32, exposure: f32) -> u8 {
    let value = f64::from(radiance) * f64::from(exposure);
    // NaN fails the comparison and is black.
    let value = if value > 0.0 { value.min(1.0) } else { 0.0 };
    (libm::pow(value, 1.0 / 2.2) * 255.0 + 0.5) as u8
}

fn decode(value: u8, exposure: f32) -> f32 {
    (libm::pow(f64::from(value) / 255.0, 2.2) / f64::from(exposure)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_survive_a_round_trip() {
        for exposure in [0.01, 1.0, 2.0, 37.5] {
            for value in 0..=255 {
                assert_eq!(encode(decode(value, exposure), exposure), value);
            }
        }
    }

    #[test]
    fn ends_are_clipped() {
        assert_eq!(encode(-1.0, 1.0), 0);
        assert_eq!(encode(f32::NAN, 1.0), 0);
        assert_eq!(encode(f32::INFINITY, 1.0), 255);
        assert_eq!(encode(0.5, 4.0), 255);
        assert_eq!(encode(0.25, 2.0), 186);
    }
}
