//! A choice of cells of a grid by their weights.

/// Cells of a grid, of which each is chosen as often as its weight says: by inversion of sums, row
/// first, so that well-spread numbers choose well-spread places.
#[derive(Clone, Debug)]
pub struct GridDistribution {
    width: usize,
    height: usize,
    /// Sum of the weights up to each row, this included, over all.
    rows: Vec<f32>,
    /// The same for the cells of each row, over those of the row.
    cells: Vec<f32>,
}

/// What was chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChosenPlace {
    /// Number of the cell, row by row.
    pub cell: usize,
    /// Place in the grid, from 0 to 1 across and down.
    pub place: [f32; 2],
    /// Density of the place over the unit square.
    pub pdf: f32,
}

impl GridDistribution {
    /// Cells row by row, `width` in each row; `None` if all weights are zero.
    #[must_use]
    pub fn new(width: usize, weights: impl ExactSizeIterator<Item = f64>) -> Option<Self> {
        let height = weights.len() / width.max(1);
        let mut running = Vec::with_capacity(weights.len());
        let mut row_sums = Vec::with_capacity(height);
        let mut sum = 0.0;
        for (i, weight) in weights.enumerate() {
            if i % width == 0 {
                sum = 0.0;
            }
            sum += weight;
            running.push(sum);
            if i % width == width - 1 {
                row_sums.push(sum);
            }
        }
        let total: f64 = row_sums.iter().sum();
        if !(total > 0.0 && total.is_finite()) {
            return None;
        }
        let over = |sum: f64, all: f64| if all > 0.0 { (sum / all) as f32 } else { 0.0 };
        let cells = running.iter().enumerate();
        let cells = cells.map(|(i, s)| over(*s, row_sums[i / width])).collect();
        let mut sum = 0.0;
        let rows = row_sums.iter().map(|s| {
            sum += s;
            over(sum, total)
        });
        Some(Self {
            width,
            height,
            rows: rows.collect(),
            cells,
        })
    }

    /// The place that two numbers in [0,1) choose.
    #[must_use]
    pub fn choose(&self, [u, v]: [f32; 2]) -> ChosenPlace {
        let (row, y, row_share) = choose(&self.rows, u);
        let first = row * self.width;
        let (column, x, share) = choose(&self.cells[first..first + self.width], v);
        ChosenPlace {
            cell: first + column,
            place: [
                (column as f32 + x) / self.width as f32,
                (row as f32 + y) / self.height as f32,
            ],
            pdf: row_share * share * (self.width * self.height) as f32,
        }
    }

    /// Density of a place of the unit square.
    #[must_use]
    #[cfg(feature = "lab")]
    pub fn pdf(&self, [x, y]: [f32; 2]) -> f32 {
        let at = |c: f32, n: usize| ((c * n as f32) as usize).min(n - 1);
        let (column, row) = (at(x, self.width), at(y, self.height));
        let first = row * self.width;
        let share = share(&self.rows, row) * share(&self.cells[first..first + self.width], column);
        share * (self.width * self.height) as f32
    }
}

/// The share of one of some parts, given running sums of all.
fn share(running: &[f32], i: usize) -> f32 {
    running[i] - if i == 0 { 0.0 } else { running[i - 1] }
}

/// The part that a number in [0,1) falls into, where in it, and its share.
fn choose(running: &[f32], u: f32) -> (usize, f32, f32) {
    let all = running.last().copied().unwrap_or(1.0);
    let u = u * all;
    let i = running.partition_point(|&sum| sum <= u);
    let mut i = i.min(running.len() - 1);
    // Rounding may lead behind the last part that has a share.
    while i > 0 && share(running, i) <= 0.0 {
        i -= 1;
    }
    let below = if i == 0 { 0.0 } else { running[i - 1] };
    let share = share(running, i);
    (
        i,
        ((u - below) / share).clamp(0.0, 1.0 - f32::EPSILON),
        share,
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    #[test]
    fn cells_are_chosen_by_their_weights() {
        let weights = [0.0, 1.0, 3.0, 0.0, 0.0, 0.0, 2.0, 0.0, 4.0_f64];
        let grid = GridDistribution::new(3, weights.iter().copied()).unwrap();
        let mut counts = [0; 9];
        let n = 1 << 12;
        for i in 0..n {
            let chosen = grid.choose(sampling::sobol2(i, 0, 3));
            counts[chosen.cell] += 1;
            assert!((chosen.pdf - grid.pdf(chosen.place)).abs() < 1e-5);
            let expected = weights[chosen.cell] * 9.0 / 10.0;
            assert!((f64::from(chosen.pdf) - expected).abs() < 1e-5);
        }
        for (count, weight) in counts.iter().zip(weights) {
            let expected = weight / 10.0 * f64::from(n);
            assert!((f64::from(*count) - expected).abs() < 8.0, "{counts:?}");
        }
        // The ends of the range choose what has weight, too.
        for u in [0.0, 1.0 - f32::EPSILON] {
            for v in [0.0, 1.0 - f32::EPSILON] {
                assert!(weights[grid.choose([u, v]).cell] > 0.0);
            }
        }
        assert!(GridDistribution::new(3, [0.0; 9].into_iter()).is_none());
    }
}
