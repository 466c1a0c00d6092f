//! A scalar field as it comes out of a volume file, and its way into a [`Grid`] of extinction.
//!
//! The file's index space has the sample of voxel (i,j,k) at (i,j,k), as NRRD and OpenVDB have it.
//! A grid of ours has its voxel (i,j,k) from (i,j,k) to (i+1,j+1,k+1).

use super::files::Files;
use super::values::{GridValues, Voxels};
use crate::math::unflatten;
use crate::run::{memory, size};
use crate::scene::grid::{Grid, Layout};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};
use rayon::prelude::*;
use std::path::Path;

/// Bytes of a grid that a file of any length may ask for.
const ALLOWANCE: u64 = 2 << 30;
/// Bytes of a grid for each of the file's: bricks take 6 for a voxel of 1, and files are
/// compressed.
const MOST_GROWTH: u64 = 64;

/// Samples on a box of voxels.
pub(super) struct Field {
    /// Name in a file of several.
    pub(super) name: Option<String>,
    /// Voxels per axis, padding included; none is zero.
    pub(super) dims: [usize; 3],
    /// Index in the file of the first voxel.
    pub(super) first: [i64; 3],
    /// Empty voxels around the box on every side; the unit cube of `unitcube_to_world` leaves them
    /// out.
    pub(super) padding: usize,
    /// Where the file says it is, from its index space; `None` if it does not say.
    pub(super) world_from_file: Option<DAffine3>,
    pub(super) samples: Samples,
}

/// Where the values of a [`Field`] are.
pub(super) enum Samples {
    /// One after the other, x fastest.
    Array(Array),
    /// Anything else that answers for a voxel, with the length of the file it comes from.
    Lookup {
        value: Box<dyn Fn([usize; 3]) -> f32 + Sync>,
        file_bytes: usize,
    },
}

/// Numbers of one type in memory, still in the file's bytes.
pub(super) struct Array {
    pub(super) bytes: Vec<u8>,
    pub(super) number: Number,
    pub(super) big_endian: bool,
}

/// Type of the numbers of an [`Array`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    U64,
    I64,
    F32,
    F64,
}

/// From a value in the file to extinction.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    /// Extinction per world unit of the value 1, or of the upper end of the window.
    pub(super) sigma_t: f64,
    /// The values that become 0 and 1.
    pub(super) window: Option<[f64; 2]>,
}

impl Number {
    pub(super) const NAMES: [&str; 10] = [
        "u8", "i8", "u16", "i16", "u32", "i32", "u64", "i64", "f32", "f64",
    ];
    pub(super) const ALL: [Number; 10] = [
        Number::U8,
        Number::I8,
        Number::U16,
        Number::I16,
        Number::U32,
        Number::I32,
        Number::U64,
        Number::I64,
        Number::F32,
        Number::F64,
    ];

    /// Bytes of one number.
    pub(super) fn size(self) -> usize {
        match self {
            Number::U8 | Number::I8 => 1,
            Number::U16 | Number::I16 => 2,
            Number::U32 | Number::I32 | Number::F32 => 4,
            Number::U64 | Number::I64 | Number::F64 => 8,
        }
    }
}

/// Bytes that `dims` numbers take, unless that is beyond what a machine can address.
pub(super) fn byte_length(dims: [usize; 3], number: Number) -> Result<usize> {
    let voxels = dims
        .iter()
        .try_fold(number.size(), |n, &d| n.checked_mul(d));
    voxels
        .filter(|&n| n <= isize::MAX as usize)
        .ok_or_else(|| Error::input(format!("{dims:?} voxels are more than a machine can hold")))
}

impl Array {
    fn value(&self, i: usize) -> f32 {
        match self.number {
            Number::U8 => f32::from(self.bytes[i]),
            Number::I8 => f32::from(self.bytes[i] as i8),
            Number::U16 => f32::from(u16::from_le_bytes(self.at(i))),
            Number::I16 => f32::from(i16::from_le_bytes(self.at(i))),
            Number::U32 => u32::from_le_bytes(self.at(i)) as f32,
            Number::I32 => i32::from_le_bytes(self.at(i)) as f32,
            Number::U64 => u64::from_le_bytes(self.at(i)) as f32,
            Number::I64 => i64::from_le_bytes(self.at(i)) as f32,
            Number::F32 => f32::from_le_bytes(self.at(i)),
            Number::F64 => f64::from_le_bytes(self.at(i)) as f32,
        }
    }

    fn at<const N: usize>(&self, i: usize) -> [u8; N] {
        let mut bytes: [u8; N] = std::array::from_fn(|k| self.bytes[i * N + k]);
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }
}

impl Scale {
    fn apply(&self, value: f32) -> f32 {
        match self.window {
            Some([low, high]) => {
                let t = (f64::from(value) - low) / (high - low);
                (self.sigma_t * t.clamp(0.0, 1.0)) as f32
            }
            None => (self.sigma_t * f64::from(value)) as f32,
        }
    }
}

impl Field {
    /// The value in the file of a voxel, counted from the first of the box.
    pub(super) fn value(&self, voxel: [usize; 3]) -> f32 {
        match &self.samples {
            Samples::Array(array) => {
                array.value((voxel[2] * self.dims[1] + voxel[1]) * self.dims[0] + voxel[0])
            }
            Samples::Lookup { value, .. } => value(voxel),
        }
    }

    /// Keeps what its values are, if anyone wants to know.
    pub(super) fn note_values(&self, path: &Path, files: &mut Files) -> Result<()> {
        if let Some(kept) = &mut files.values {
            let voxels = Voxels {
                dims: self.dims,
                first: self.first,
                padding: self.padding,
                value: |voxel| self.value(voxel),
            };
            kept.push(GridValues::of(
                &voxels,
                self.name.clone(),
                path,
                &files.cancel,
            )?);
        }
        Ok(())
    }

    /// Whether the file has a finite number there that is none in f32.
    fn is_beyond_f32(&self, voxel: [usize; 3]) -> bool {
        let Samples::Array(array) = &self.samples else {
            return false;
        };
        let i = (voxel[2] * self.dims[1] + voxel[1]) * self.dims[0] + voxel[0];
        array.number == Number::F64
            && f64::from_le_bytes(array.at(i)).is_finite()
            && array.value(i).is_infinite()
    }

    /// The map from the space of the grid to the file's index space.
    pub(super) fn file_from_grid(&self) -> DAffine3 {
        let first = DVec3::from(self.first.map(|i| i as f64));
        DAffine3::from_translation(first - 0.5)
    }

    /// The map from the space of the grid to the unit cube around the box without its padding.
    pub(super) fn unitcube_from_grid(&self) -> DAffine3 {
        let pad = self.padding as f64;
        let size = DVec3::from(self.dims.map(|n| n as f64)) - 2.0 * pad;
        DAffine3::from_scale(size.recip()) * DAffine3::from_translation(DVec3::splat(-pad))
    }

    /// Bytes that the grid may take: a few of a file can stand for a large box that is full.
    fn allowance(&self) -> u64 {
        let behind = match &self.samples {
            Samples::Array(array) => array.bytes.len(),
            Samples::Lookup { file_bytes, .. } => *file_bytes,
        };
        ALLOWANCE + MOST_GROWTH * behind as u64
    }

    /// The grid of extinction. More than the file makes likely, or than the machine has memory for,
    /// is an error before it is allocated. Values that are not finite, or negative without a
    /// window, are errors, and so is a stop on request; a few that are hardly below zero are taken
    /// as zero with a warning.
    pub(super) fn into_grid(self, scale: Scale, path: &Path, files: &mut Files) -> Result<Grid> {
        let sigma_t = |voxel| scale.apply(self.value(voxel)).max(0.0);
        let go_on = || files.cancel.check();
        let layout = Layout::of(self.dims, sigma_t, go_on)?;
        if layout.bytes() > self.allowance() {
            let [x, y, z] = self.dims;
            return Err(Error::input(format!(
                "{x} x {y} x {z} voxels take {} in memory, more than the {} that a file of this length may ask for",
                size::format(layout.bytes()),
                size::format(self.allowance())
            ))
            .hint("crop or coarsen the grid, or prune tiles that need not be active"));
        }
        memory::check("the grid of a volume", layout.bytes())?;
        let survey = self.survey(scale, &go_on)?;
        if let Some(bad) = survey.first_bad(self.dims.iter().product()) {
            return Err(self.bad_voxel(bad));
        }
        let grid = layout.fill(sigma_t, go_on)?;
        if survey.negative > 0 {
            files.warn(format!(
                "{}: {} voxels below 0 are taken as 0, the lowest is {}",
                path.display(),
                survey.negative,
                survey.lowest
            ));
        }
        Ok(grid)
    }

    /// Looks at all values, row by row, so that a message can name the first bad voxel whatever the
    /// order of the threads.
    fn survey(&self, scale: Scale, go_on: &(impl Fn() -> Result<()> + Sync)) -> Result<Survey> {
        let rows = self.dims[1] * self.dims[2];
        let rows = (0..rows).into_par_iter().map(|row| {
            go_on()?;
            let [j, k] = [row % self.dims[1], row / self.dims[1]];
            let mut survey = Survey::default();
            for i in 0..self.dims[0] {
                let value = self.value([i, j, k]);
                let sigma_t = scale.apply(value);
                survey.add(row * self.dims[0] + i, value, sigma_t);
            }
            Ok(survey)
        });
        rows.try_reduce(Survey::default, |a, b| Ok(a.and(b)))
    }

    fn bad_voxel(&self, bad: usize) -> Error {
        let voxel = unflatten(bad, self.dims);
        let value = self.value(voxel);
        let index: [i64; 3] = std::array::from_fn(|a| self.first[a] + voxel[a] as i64);
        let error = |what: &str| Error::input(format!("voxel {index:?}: {what}: {value}"));
        if self.is_beyond_f32(voxel) {
            error("the value leaves the range of f32")
        } else if !value.is_finite() {
            error("the value is not finite")
        } else if value < 0.0 {
            error("the density is negative")
                .hint("give the values that mean 0 and 1 as `window = [low, high]`")
        } else {
            error("the extinction leaves the range of f32")
        }
    }
}

/// What there is among the values of a field.
#[derive(Clone, Copy)]
struct Survey {
    /// The first voxel whose value is of no use.
    first_useless: usize,
    /// The first voxel whose extinction is negative, and the number of such voxels.
    first_negative: usize,
    negative: usize,
    lowest: f32,
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

    fn and(self, other: Self) -> Self {
        Self {
            first_useless: self.first_useless.min(other.first_useless),
            first_negative: self.first_negative.min(other.first_negative),
            negative: self.negative + other.negative,
            lowest: self.lowest.min(other.lowest),
            highest: self.highest.max(other.highest),
        }
    }

    /// The first voxel of so many that is an error, if there is one.
    fn first_bad(&self, voxels: usize) -> Option<usize> {
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

#[cfg(test)]
mod tests {
    use super::*;

    fn field(values: &[f32], dims: [usize; 3]) -> Field {
        Field {
            name: None,
            dims,
            first: [0; 3],
            padding: 0,
            world_from_file: None,
            samples: Samples::Array(Array {
                bytes: values.iter().flat_map(|v| v.to_be_bytes()).collect(),
                number: Number::F32,
                big_endian: true,
            }),
        }
    }

    const PLAIN: Scale = Scale {
        sigma_t: 2.0,
        window: None,
    };

    #[test]
    fn values_are_scaled_and_windowed() {
        let grid = field(&[0.0, 1.0, 2.0, 3.0], [2, 2, 1])
            .into_grid(PLAIN, Path::new("a"), &mut Files::default())
            .unwrap();
        assert_eq!(grid.sample(glam::Vec3::new(1.5, 1.5, 0.5)), 6.0);
        let window = Scale {
            sigma_t: 10.0,
            window: Some([1.0, 2.0]),
        };
        assert_eq!(window.apply(-3.0), 0.0);
        assert_eq!(window.apply(1.5), 5.0);
        assert_eq!(window.apply(7.0), 10.0);
    }

    #[test]
    fn the_first_bad_voxel_is_named() {
        let message = |values: &[f32]| match field(values, [2, 2, 1]).into_grid(
            PLAIN,
            Path::new("a"),
            &mut Files::default(),
        ) {
            Err(e) => e.to_string(),
            Ok(_) => "none".into(),
        };
        assert_eq!(
            message(&[0.0, 1.0, -2.0, f32::NAN]),
            "voxel [0, 1, 0]: the density is negative: -2"
        );
        assert!(
            message(&[0.0, f32::NAN, -2.0, 0.0]).contains("[1, 0, 0]: the value is not finite")
        );
        assert!(message(&[f32::MAX; 4]).contains("range of f32"));
    }

    #[test]
    fn a_little_noise_below_zero_is_cut_off_and_told() {
        let mut values = vec![1.0; 1000];
        values[7] = -1e-6;
        values[9] = -2e-6;
        let mut files = Files::default();
        let grid = field(&values, [10, 10, 10]).into_grid(PLAIN, Path::new("a.raw"), &mut files);
        assert_eq!(grid.unwrap().sample(glam::Vec3::new(7.5, 0.5, 0.5)), 0.0);
        assert_eq!(
            files.warnings,
            ["a.raw: 2 voxels below 0 are taken as 0, the lowest is -0.000002"]
        );
        values[8] = -0.5;
        let error = field(&values, [10, 10, 10]).into_grid(PLAIN, Path::new("a"), &mut files);
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("negative: -0.000001")
        );
        let many = field(&vec![-1e-6; 1000], [10, 10, 10]);
        assert!(many.into_grid(PLAIN, Path::new("a"), &mut files).is_err());
    }

    #[test]
    fn doubles_beyond_floats_are_told_from_what_is_not_finite() {
        for (value, part) in [
            (1e39, "range of f32"),
            (f64::INFINITY, "not finite"),
            (f64::NAN, "not finite"),
        ] {
            let mut field = field(&[0.0; 2], [1, 1, 1]);
            if let Samples::Array(array) = &mut field.samples {
                array.bytes = value.to_be_bytes().to_vec();
                array.number = Number::F64;
            }
            let Err(error) = field.into_grid(PLAIN, Path::new("a"), &mut Files::default()) else {
                panic!("{value}");
            };
            assert!(error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn a_small_file_cannot_ask_for_all_memory() {
        let full = |dims: [usize; 3], file_bytes| {
            let field = Field {
                name: None,
                dims,
                first: [0; 3],
                padding: 0,
                world_from_file: None,
                samples: Samples::Lookup {
                    value: Box::new(|_| 1.0),
                    file_bytes,
                },
            };
            field.into_grid(PLAIN, Path::new("a"), &mut Files::default())
        };
        let error = full([2000, 1000, 1000], 30_000).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input);
        let message = error.to_string();
        assert!(
            message.contains("2000 x 1000 x 1000 voxels take 10.9 GiB"),
            "{message}"
        );
        assert!(full([64, 64, 64], 0).is_ok());
        // What a file has bytes for it may have.
        let layout = Layout::of([2000, 1000, 1000], |_| 1.0, || Ok::<_, Error>(())).unwrap();
        assert!(layout.bytes() < ALLOWANCE + MOST_GROWTH * 300_000_000);
    }

    #[test]
    fn a_hostile_size_is_refused_without_an_overflow() {
        assert!(byte_length([usize::MAX, 2, 2], Number::U8).is_err());
        assert_eq!(byte_length([3, 2, 2], Number::F64).unwrap(), 96);
    }
}
