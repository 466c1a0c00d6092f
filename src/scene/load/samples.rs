//! The samples of a volume file, in whatever form they come, and boxes of them as f32.

use super::files::Content;
use crate::scene::grid::VoxelBox;
use crate::{Error, Result};
use smallvec::{SmallVec, smallvec};

/// Where the values of a field are.
pub(super) enum Samples {
    /// One after the other, x fastest.
    Array(Array),
    /// Anywhere else.
    Other(Box<dyn Source>),
}

/// What has the samples of a field, and gives them by boxes. Voxels are counted from the first of
/// the field.
pub(super) trait Source: Send + Sync {
    /// Whether a box may have values from one to another of which `counts` is true.
    fn may_hold(&self, voxels: &VoxelBox, counts: &dyn Fn(f32, f32) -> bool) -> bool;

    /// Writes the samples of a box, x fastest.
    fn read(&self, voxels: &VoxelBox, out: &mut [f32]) -> Result<()>;

    /// Length of the file that they come from.
    fn file_bytes(&self) -> usize;

    /// Refuses a file that was cut while it was read.
    fn check(&self) -> Result<()> {
        Ok(())
    }
}

/// Numbers of one type, still in the file's bytes.
pub(super) struct Array {
    /// Voxels per axis.
    pub(super) dims: [usize; 3],
    pub(super) bytes: Content,
    pub(super) number: Number,
    pub(super) big_endian: bool,
    /// Slope and intercept that make values of the numbers.
    pub(super) rescale: Option<[f64; 2]>,
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
    /// The place of a voxel among the numbers.
    pub(super) fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.dims[1] + y) * self.dims[0] + x
    }

    /// The eight bytes of a number of so many, little-endian.
    pub(super) fn at<const N: usize>(&self, i: usize) -> [u8; N] {
        let all = self.bytes.as_ref();
        let mut bytes: [u8; N] = std::array::from_fn(|k| all[i * N + k]);
        if self.big_endian {
            bytes.reverse();
        }
        bytes
    }

    /// Writes the numbers from the `first` on.
    fn row(&self, first: usize, out: &mut [f32]) {
        match self.number {
            Number::U8 => self.numbers(first, out, |[b]| f32::from(b)),
            Number::I8 => self.numbers(first, out, |[b]| f32::from(b as i8)),
            Number::U16 => self.numbers(first, out, |b| f32::from(u16::from_le_bytes(b))),
            Number::I16 => self.numbers(first, out, |b| f32::from(i16::from_le_bytes(b))),
            Number::U32 => self.numbers(first, out, |b| u32::from_le_bytes(b) as f32),
            Number::I32 => self.numbers(first, out, |b| i32::from_le_bytes(b) as f32),
            Number::U64 => self.numbers(first, out, |b| u64::from_le_bytes(b) as f32),
            Number::I64 => self.numbers(first, out, |b| i64::from_le_bytes(b) as f32),
            Number::F32 => self.numbers(first, out, f32::from_le_bytes),
            Number::F64 => self.numbers(first, out, |b| f64::from_le_bytes(b) as f32),
        }
        if let Some([slope, intercept]) = self.rescale {
            let value = |v: f32| (slope * f64::from(v) + intercept) as f32;
            out.iter_mut().for_each(|v| *v = value(*v));
        }
    }

    fn numbers<const N: usize>(
        &self,
        first: usize,
        out: &mut [f32],
        value: impl Fn([u8; N]) -> f32,
    ) {
        let bytes = &self.bytes.as_ref()[first * N..(first + out.len()) * N];
        let (numbers, _) = bytes.as_chunks::<N>();
        let all = out.iter_mut().zip(numbers);
        if self.big_endian {
            all.for_each(|(out, number)| {
                let mut number = *number;
                number.reverse();
                *out = value(number);
            });
        } else {
            all.for_each(|(out, number)| *out = value(*number));
        }
    }
}

impl Source for Array {
    fn may_hold(&self, voxels: &VoxelBox, counts: &dyn Fn(f32, f32) -> bool) -> bool {
        let mut row: SmallVec<[f32; 16]> = smallvec![0.0; voxels.dims[0]];
        voxels.rows().any(|(first, _)| {
            self.row(self.place(first), &mut row);
            let ends = Ends::of(&row);
            ends.has_nan || counts(ends.low, ends.high)
        })
    }

    fn read(&self, voxels: &VoxelBox, out: &mut [f32]) -> Result<()> {
        for (first, at) in voxels.rows() {
            self.row(self.place(first), &mut out[at..at + voxels.dims[0]]);
        }
        Ok(())
    }

    fn file_bytes(&self) -> usize {
        self.bytes.as_ref().len()
    }

    fn check(&self) -> Result<()> {
        self.bytes.check()
    }
}

impl Samples {
    /// What gives boxes of them.
    pub(super) fn source(&self) -> &dyn Source {
        match self {
            Samples::Array(array) => array,
            Samples::Other(source) => source.as_ref(),
        }
    }
}

/// The least and the greatest of some values.
pub(super) struct Ends {
    pub(super) low: f32,
    pub(super) high: f32,
    /// Whether there are values that are no numbers, too.
    pub(super) has_nan: bool,
}

impl Ends {
    /// Those of a row of at least one value.
    pub(super) fn of(row: &[f32]) -> Self {
        let none = (f32::INFINITY, f32::NEG_INFINITY, false);
        let (low, high, has_nan) = row.iter().fold(none, |(low, high, has_nan), &v| {
            // Comparisons with what is no number are false.
            let low = if v < low { v } else { low };
            let high = if v > high { v } else { high };
            (low, high, has_nan | v.is_nan())
        });
        Self { low, high, has_nan }
    }
}
