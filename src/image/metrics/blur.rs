//! Separable filters over planes of one channel.

use rayon::prelude::*;

/// What lies beyond the border of a plane.
#[derive(Clone, Copy, Debug)]
pub(super) enum Border {
    /// `a a a | a b c d | d d d`
    Clamp,
    /// `c b a | a b c d | d c b`
    Reflect,
    /// `c b | a b c d | d c`: mirrored about the first sample on one side and beyond the last on
    /// the other.
    Uneven,
}

impl Border {
    fn index(self, at: isize, length: usize) -> usize {
        let n = length as isize;
        let inside = match self {
            Self::Clamp => at,
            Self::Reflect => {
                let at = at.rem_euclid(2 * n);
                if at < n { at } else { 2 * n - 1 - at }
            }
            Self::Uneven => {
                let at = if at < 0 { -at } else { at };
                if at >= n { 2 * n - at - 1 } else { at }
            }
        };
        // Planes narrower than the filter end here.
        inside.clamp(0, n - 1) as usize
    }
}

/// Correlates each row with a filter of odd length.
pub(super) fn rows(plane: &[f64], width: usize, filter: &[f64], border: Border) -> Vec<f64> {
    let radius = filter.len() / 2;
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(width)
        .zip(plane.par_chunks(width))
        .with_min_len(8)
        .for_each(|(out, row)| {
            let padded: Vec<f64> = (0..width + 2 * radius)
                .map(|i| row[border.index(i as isize - radius as isize, width)])
                .collect();
            for (k, weight) in filter.iter().enumerate() {
                for (out, value) in out.iter_mut().zip(&padded[k..]) {
                    *out += weight * value;
                }
            }
        });
    out
}

/// Correlates each column with a filter of odd length.
pub(super) fn columns(plane: &[f64], width: usize, filter: &[f64], border: Border) -> Vec<f64> {
    let (height, radius) = (plane.len() / width, filter.len() / 2);
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_mut(width)
        .enumerate()
        .with_min_len(8)
        .for_each(|(y, out)| {
            for (k, weight) in filter.iter().enumerate() {
                let from = border.index(y as isize + k as isize - radius as isize, height);
                let row = &plane[from * width..(from + 1) * width];
                for (out, value) in out.iter_mut().zip(row) {
                    *out += weight * value;
                }
            }
        });
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_are_as_drawn() {
        let seen = |border: Border| -> Vec<usize> { (-3..7).map(|i| border.index(i, 4)).collect() };
        assert_eq!(seen(Border::Clamp), [0, 0, 0, 0, 1, 2, 3, 3, 3, 3]);
        assert_eq!(seen(Border::Reflect), [2, 1, 0, 0, 1, 2, 3, 3, 2, 1]);
        assert_eq!(seen(Border::Uneven), [3, 2, 1, 0, 1, 2, 3, 3, 2, 1]);
    }

    #[test]
    fn narrow_planes_stay_inside() {
        for border in [Border::Clamp, Border::Reflect, Border::Uneven] {
            for length in 1..5 {
                for at in -25..25 {
                    assert!(border.index(at, length) < length);
                }
            }
            assert_eq!(rows(&[2.0], 1, &[0.25; 5], border), [2.5]);
            assert_eq!(columns(&[2.0], 1, &[0.25; 5], border), [2.5]);
        }
    }
}
