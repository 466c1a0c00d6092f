//! What the values of a volume file are, before a window or a scale is applied to them.

use super::layers::{Voxels, layers};
use super::suggest::{self, SuggestedWindow};
use crate::Result;
use crate::run::Cancel;
use crate::scene::Grid;
use crate::scene::grid::VoxelBox;
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
    /// The axes of a patient along which the file has its place, as `RAS`.
    pub patient_space: Option<&'static str>,
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
    /// A window for them; none if all are the same.
    pub suggested: Option<SuggestedWindow>,
}

impl GridValues {
    /// The values of a medium of which a scene file says a formula.
    pub(super) fn of_made(file: PathBuf, grid: &Grid) -> Self {
        let values = grid.means([1; 3]);
        let active = values.iter().filter(|v| **v > 0.0).count();
        let sum: f64 = values.iter().copied().map(f64::from).sum();
        Self {
            file,
            grid: None,
            patient_space: None,
            dims: grid.dims(),
            first: [0; 3],
            active: active as u64,
            negative: 0,
            not_finite: 0,
            min: values.iter().copied().fold(f32::INFINITY, f32::min),
            max: values.iter().copied().fold(0.0, f32::max),
            active_mean: sum / active.max(1) as f64,
            histogram: Histogram::default(),
            suggested: None,
        }
    }
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
    pub(super) fn of<F: Fn(&VoxelBox, &mut [f32]) -> Result<()> + Sync>(
        voxels: &Voxels<F>,
        grid: Option<String>,
        patient_space: Option<&'static str>,
        path: &Path,
        cancel: &Cancel,
    ) -> Result<Self> {
        let add = |survey: &mut Survey, row: &[f32]| row.iter().for_each(|v| survey.add(*v));
        let layers = layers(voxels, cancel, &Survey::EMPTY, add)?;
        // One layer after the other, so that the sum does not depend on threads.
        let survey = layers.iter().fold(Survey::EMPTY, Survey::and);
        let any = survey.all[0] <= survey.all[1];
        let pad = voxels.padding;
        Ok(Self {
            file: path.to_owned(),
            grid,
            patient_space,
            dims: voxels.dims.map(|n| n - 2 * pad),
            first: voxels.first.map(|i| i + pad as i64),
            active: survey.active,
            negative: survey.negative,
            not_finite: survey.not_finite,
            min: if any { survey.all[0] } else { 0.0 },
            max: if any { survey.all[1] } else { 0.0 },
            active_mean: survey.sum / survey.active.max(1) as f64,
            histogram: histogram(voxels, survey.others, cancel)?,
            suggested: if any {
                let inner: f64 = voxels.dims.iter().map(|&n| (n - 2 * pad) as f64).product();
                let zeros = inner - (survey.active + survey.not_finite) as f64;
                suggest::window(voxels, survey.all, zeros / inner, cancel)?
            } else {
                None
            },
        })
    }
}

fn histogram<F: Fn(&VoxelBox, &mut [f32]) -> Result<()> + Sync>(
    voxels: &Voxels<F>,
    [from, to]: [f32; 2],
    cancel: &Cancel,
) -> Result<Histogram> {
    if from > to {
        return Ok(Histogram::default());
    }
    let width = f64::from(to) - f64::from(from);
    let count = |counts: &mut [u64; BINS], row: &[f32]| {
        for &value in row.iter().filter(|v| v.is_finite() && **v != 0.0) {
            let at = (f64::from(value) - f64::from(from)) / width * BINS as f64;
            // A single value is in the first bin: 0 / 0 is cast to 0.
            counts[(at as usize).min(BINS - 1)] += 1;
        }
    };
    let layers = layers(voxels, cancel, &[0; BINS], count)?;
    let mut counts = vec![0; BINS];
    for layer in layers {
        counts.iter_mut().zip(layer).for_each(|(sum, n)| *sum += n);
    }
    Ok(Histogram { from, to, counts })
}
