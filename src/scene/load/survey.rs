//! What is wrong, or odd, with the values of a volume.

use super::samples::Ends;

/// What there is among the values of a field.
#[derive(Clone, Copy)]
pub(super) struct Survey {
    /// The first voxel whose value is of no use.
    first_useless: usize,
    /// The first voxel whose extinction is negative, and the number of such voxels.
    first_negative: usize,
    pub(super) negative: usize,
    /// The lowest value of these.
    pub(super) lowest: f32,
    highest: f32,
}

impl Default for Survey {
    fn default() -> Self {
        Self {
            first_useless: usize::MAX,
            first_negative: usize::MAX,
            negative: 0,
            lowest: 0.0,
            highest: 0.0,
        }
    }
}

impl Survey {
    /// Adds a row of voxels that begins with the number `first`. `sigma_t` of a value between two
    /// is between those of both.
    pub(super) fn add_row(&mut self, first: usize, row: &[f32], sigma_t: impl Fn(f32) -> f32) {
        let ends = Ends::of(row);
        let is_right = |v: f32| v.is_finite() && sigma_t(v).is_finite() && sigma_t(v) >= 0.0;
        if !ends.has_nan && is_right(ends.low) && is_right(ends.high) {
            self.highest = self.highest.max(ends.high);
            return;
        }
        for (i, &value) in row.iter().enumerate() {
            self.add(first + i, value, sigma_t(value));
        }
    }

    fn add(&mut self, voxel: usize, value: f32, sigma_t: f32) {
        if !value.is_finite() || !sigma_t.is_finite() {
            self.first_useless = self.first_useless.min(voxel);
            return;
        }
        self.highest = self.highest.max(value);
        if sigma_t < 0.0 {
            self.first_negative = self.first_negative.min(voxel);
            self.negative += 1;
            self.lowest = self.lowest.min(value);
        }
    }

    pub(super) fn and(self, other: Self) -> Self {
        Self {
            first_useless: self.first_useless.min(other.first_useless),
            first_negative: self.first_negative.min(other.first_negative),
            negative: self.negative + other.negative,
            lowest: self.lowest.min(other.lowest),
            highest: self.highest.max(other.highest),
        }
    }

    /// The first voxel of so many that is an error, if there is one.
    pub(super) fn first_bad(&self, voxels: usize) -> Option<usize> {
        /// Shares of the voxels, and of the highest value, up to which what is negative is taken
        /// for noise of a filter.
        const FEW: f64 = 0.01;
        const SLIGHT: f32 = 0.01;
        let is_noise =
            self.negative as f64 <= FEW * voxels as f64 && -self.lowest <= SLIGHT * self.highest;
        let negative = if is_noise {
            usize::MAX
        } else {
            self.first_negative
        };
        let first = self.first_useless.min(negative);
        (first != usize::MAX).then_some(first)
    }
}
