//! Where a picture is furthest from its reference: errors of square blocks of pixels.

use super::linear;
use crate::image::Picture;

/// Pixels along an edge of a block; blocks at the right and lower border may be smaller.
pub const BLOCK_EDGE: usize = 16;

/// A block of pixels and its errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Block {
    /// First column, counted from the left of the picture.
    pub x0: usize,
    /// First row, counted from the top of the picture.
    pub y0: usize,
    /// One past the last column.
    pub x1: usize,
    /// One past the last row.
    pub y1: usize,
    /// Mean of the reference over pixels and channels, radiance.
    pub reference: f64,
    /// Mean signed difference from the reference, radiance.
    pub error: f64,
    /// Mean of `(x-r)^2 / (r^2 + 0.01)`.
    pub relmse: f64,
}

/// Finds the `count` blocks of the largest relMSE, worst first, of two pictures of the same size.
/// Blocks without a value (NaN) are the worst of all.
#[must_use]
pub fn worst(picture: &Picture, reference: &Picture, count: usize) -> Vec<Block> {
    let mut blocks = Vec::new();
    for y0 in (0..reference.height).step_by(BLOCK_EDGE) {
        for x0 in (0..reference.width).step_by(BLOCK_EDGE) {
            blocks.push(block(picture, reference, x0, y0));
        }
    }
    // NaN may carry a sign. The sort is stable: equal blocks stay in reading order.
    blocks.sort_by(|a: &Block, b| b.relmse.abs().total_cmp(&a.relmse.abs()));
    blocks.truncate(count);
    blocks
}

fn block(picture: &Picture, reference: &Picture, x0: usize, y0: usize) -> Block {
    let x1 = (x0 + BLOCK_EDGE).min(reference.width);
    let y1 = (y0 + BLOCK_EDGE).min(reference.height);
    let (mut sum, mut error, mut relative) = (0.0, 0.0, 0.0);
    for y in y0..y1 {
        let row = y * reference.width;
        let pixels = row + x0..row + x1;
        let pairs = picture.pixels[pixels.clone()]
            .iter()
            .zip(&reference.pixels[pixels]);
        for (x, r) in pairs {
            relative += linear::relative_square(*x, *r);
            for (x, r) in x.iter().zip(r) {
                sum += f64::from(*r);
                error += f64::from(*x) - f64::from(*r);
            }
        }
    }
    let count = ((x1 - x0) * (y1 - y0)) as f64;
    Block {
        x0,
        y0,
        x1,
        y1,
        reference: sum / (3.0 * count),
        error: error / (3.0 * count),
        relmse: relative / count,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_comes_first_and_relmse_adds_up() {
        let reference = Picture {
            width: 40,
            height: 20,
            pixels: vec![[0.5; 3]; 800],
        };
        let mut picture = reference.clone();
        picture.pixels[40 * 3 + 20] = [0.9, 0.5, 0.5]; // block (1, 0)
        picture.pixels[40 * 18 + 39] = [0.5, 0.5, 0.1]; // the lower right one, 8 x 4 pixels
        let all = worst(&picture, &reference, usize::MAX);
        assert_eq!(all.len(), 6);
        let corner = |b: &Block| [b.x0, b.y0, b.x1, b.y1];
        assert_eq!(corner(&all[0]), [32, 16, 40, 20]);
        assert_eq!(corner(&all[1]), [16, 0, 32, 16]);
        assert_eq!(corner(&all[2]), [0, 0, 16, 16]);
        assert!((all[0].error + 0.4 / 96.0).abs() < 1e-7 && all[0].reference == 0.5);
        assert!((all[1].error - 0.4 / 768.0).abs() < 1e-7);
        let whole: f64 = all
            .iter()
            .map(|b| b.relmse * ((b.x1 - b.x0) * (b.y1 - b.y0)) as f64)
            .sum();
        let expected = linear::compare(&picture, &reference).relmse;
        assert!((whole / 800.0 / expected - 1.0).abs() < 1e-12);

        picture.pixels[0] = [f32::NAN; 3];
        let first = worst(&picture, &reference, 1);
        assert_eq!((first.len(), corner(&first[0])), (1, [0, 0, 16, 16]));
    }
}
