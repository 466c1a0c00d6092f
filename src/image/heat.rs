//! Colours for an error between 0 and 1: black, violet, red, orange, pale yellow; lightness rises
//! all the way, so that the map reads the same without colour.

use super::tone::Display;

/// Evenly spaced display colours.
const STOPS: [[f32; 3]; 6] = [
    [0.0, 0.0, 0.0],
    [52.0, 16.0, 104.0],
    [138.0, 34.0, 116.0],
    [220.0, 68.0, 84.0],
    [250.0, 152.0, 74.0],
    [254.0, 250.0, 196.0],
];

/// Colours a map of errors, row by row; values outside 0 to 1 are clipped, not-a-number is cyan.
#[must_use]
pub fn map(errors: &[f32], width: usize) -> Display {
    Display {
        width,
        height: errors.len() / width.max(1),
        pixels: errors.iter().map(|&e| colour(e)).collect(),
    }
}

fn colour(error: f32) -> [u8; 3] {
    if error.is_nan() {
        return [0, 255, 255];
    }
    let at = error.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let below = (at as usize).min(STOPS.len() - 2);
    let along = at - below as f32;
    [0, 1, 2].map(|c| {
        let (a, b) = (STOPS[below][c], STOPS[below + 1][c]);
        (a + (b - a) * along + 0.5) as u8
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_rises() {
        let light = |e: f32| {
            let [r, g, b] = colour(e).map(f32::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for i in 0..100 {
            let (low, high) = (i as f32 / 100.0, (i + 1) as f32 / 100.0);
            assert!(light(low) <= light(high), "{low}");
        }
        assert_eq!(colour(-1.0), [0, 0, 0]);
        assert_eq!(colour(2.0), [254, 250, 196]);
        assert_eq!(colour(f32::NAN), [0, 255, 255]);
    }
}
