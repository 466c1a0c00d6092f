//! What the values of a volume file are, before a window or a scale is applied to them.

use crate::Result;
use crate::run::Cancel;
use rayon::prelude::*;
use std::path::{Path, PathBuf};

/// Bins of a [`Histogram`].
const BINS: usize = 16;

/// The values of a grid as its file has them.
#[derive(Clone, Debug, PartialEq)]
pub struct GridValues {
    /// The file.
    pub file: PathBuf,
    /// Name of the grid in a file of several.
    pub grid: Option<String>,
    /// Voxels along x, y and z of the box that is read.
    pub dims: [usize; 3],
    /// Index in the file of the first voxel of the box.
    pub first: [i64; 3],
    /// Voxels whose value is a number other than 0.
    pub active: u64,
    /// Voxels whose value is below 0.
    pub negative: u64,
    /// Voxels whose value is infinite or no number.
    pub not_finite: u64,
    /// The least value, those of 0 included; 0 if no value is finite.
    pub min: f32,
    /// The greatest value, those of 0 included.
    pub max: f32,
    /// The mean of the values other than 0; 0 if there are none.
    pub active_mean: f64,
    /// Counts of the values other than 0.
    pub histogram: Histogram,
}

/// Counts of values in bins of equal width.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Histogram {
    /// Lower end of the first bin.
    pub from: f32,
    /// Upper end of the last bin.
    pub to: f32,
    /// Values in each bin; none if there are no values.
    pub counts: Vec<u64>,
}

/// Voxels to look at, with empty ones on every side that do not count.
pub(super) struct Voxels<F> {
    /// Voxels per axis, padding included.
    pub(super) dims: [usize; 3],
    /// Index in the file of the first voxel, that of the padding.
    pub(super) first: [i64; 3],
    pub(super) padding: usize,
    /// The value of a voxel.
    pub(super) value: F,
}

/// What there is in some of the rows.
#[derive(Clone)]
struct Survey {
    active: u64,
    negative: u64,
    not_finite: u64,
    sum: f64,
    /// Ends of all values.
    all: [f32; 2],
    /// Ends of the values other than 0.
    others: [f32; 2],
}

impl Survey {
    const EMPTY: Self = Self {
        active: 0,
        negative: 0,
        not_finite: 0,
        sum: 0.0,
        all: [f32::INFINITY, f32::NEG_INFINITY],
        others: [f32::INFINITY, f32::NEG_INFINITY],
    };

    fn add(&mut self, value: f32) {
        if !value.is_finite() {
            self.not_finite += 1;
            return;
        }
        self.all = [self.all[0].min(value), self.all[1].max(value)];
        if value != 0.0 {
            self.active += 1;
            self.negative += u64::from(value < 0.0);
            self.sum += f64::from(value);
            self.others = [self.others[0].min(value), self.others[1].max(value)];
        }
    }

    fn and(self, other: &Self) -> Self {
        let ends = |a: [f32; 2], b: [f32; 2]| [a[0].min(b[0]), a[1].max(b[1])];
        Self {
            active: self.active + other.active,
            negative: self.negative + other.negative,
            not_finite: self.not_finite + other.not_finite,
            sum: self.sum + other.sum,
            all: ends(self.all, other.all),
            others: ends(self.others, other.others),
        }
    }
}

impl GridValues {
    /// Looks at all voxels of a grid of the file `path`.
    ///
    /// # Errors
    /// A stop on request.
    pub(super) fn of<F: Fn([usize; 3]) -> f32 + Sync>(
        voxels: &Voxels<F>,
        grid: Option<String>,
        path: &Path,
        cancel: &Cancel,
    ) -> Result<Self> {
        let layers = layers(voxels, cancel, |rows| {
            let mut survey = Survey::EMPTY;
            rows.for_each(|v| survey.add(v));
            survey
        })?;
        // One layer after the other, so that the sum does not depend on threads.
        let survey = layers.iter().fold(Survey::EMPTY, Survey::and);
        let any = survey.all[0] <= survey.all[1];
        let pad = voxels.padding;
        Ok(Self {
            file: path.to_owned(),
            grid,
            dims: voxels.dims.map(|n| n - 2 * pad),
            first: voxels.first.map(|i| i + pad as i64),
            active: survey.active,
            negative: survey.negative,
            not_finite: survey.not_finite,
            min: if any { survey.all[0] } else { 0.0 },
            max: if any { survey.all[1] } else { 0.0 },
            active_mean: survey.sum / survey.active.max(1) as f64,
            histogram: histogram(voxels, survey.others, cancel)?,
        })
    }
}

fn histogram<F: Fn([usize; 3]) -> f32 + Sync>(
    voxels: &Voxels<F>,
    [from, to]: [f32; 2],
    cancel: &Cancel,
) -> Result<Histogram> {
    if from > to {
        return Ok(Histogram::default());
    }
    let width = f64::from(to) - f64::from(from);
    let layers = layers(voxels, cancel, |values| {
        let mut counts = [0_u64; BINS];
        for value in values.filter(|v| v.is_finite() && *v != 0.0) {
            let at = (f64::from(value) - f64::from(from)) / width * BINS as f64;
            // A single value is in the first bin: 0 / 0 is cast to 0.
            counts[(at as usize).min(BINS - 1)] += 1;
        }
        counts
    })?;
    let mut counts = vec![0; BINS];
    for layer in layers {
        counts.iter_mut().zip(layer).for_each(|(sum, n)| *sum += n);
    }
    Ok(Histogram { from, to, counts })
}

/// What `look` makes of the values of each layer, without the padding.
fn layers<F: Fn([usize; 3]) -> f32 + Sync, T: Send>(
    voxels: &Voxels<F>,
    cancel: &Cancel,
    look: impl Fn(&mut dyn Iterator<Item = f32>) -> T + Sync,
) -> Result<Vec<T>> {
    let within = |a: usize| voxels.padding..voxels.dims[a] - voxels.padding;
    let layer = |z: usize| {
        cancel.check()?;
        let rows = within(1).flat_map(|y| within(0).map(move |x| [x, y, z]));
        Ok(look(&mut rows.map(|voxel| (voxels.value)(voxel))))
    };
    within(2).into_par_iter().map(layer).collect()
}
