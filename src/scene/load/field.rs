//! A scalar field as it comes out of a volume file, and its way into a [`Grid`] of extinction.
//!
//! The file's index space has the sample of voxel (i,j,k) at (i,j,k), as NRRD and OpenVDB have it.
//! A grid of ours has its voxel (i,j,k) from (i,j,k) to (i+1,j+1,k+1).

use super::files::Files;
use super::layers::Voxels;
use super::patient::{self, PatientSpace};
use super::samples::{Array, Number, Samples};
use super::scale::Scale;
use super::survey::Survey;
use super::values::GridValues;
use crate::math::unflatten;
use crate::run::{Cancel, size};
use crate::scene::grid::{Grid, Layout, Region, VoxelBox};
use crate::{Error, Result};
use glam::{DAffine3, DVec3};
use std::path::Path;
use std::sync::Arc;

/// Bytes of a grid that a file of any length may ask for.
const ALLOWANCE: u64 = 2 << 30;
/// Bytes of a grid for each of the file's: bricks take 6 for a voxel of 1, and files are
/// compressed.
const MOST_GROWTH: u64 = 64;

/// Samples on a box of voxels.
#[derive(Clone)]
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
    /// That of a patient is left, posterior, superior.
    pub(super) world_from_file: Option<DAffine3>,
    /// The axes of a patient along which the file has its place.
    pub(super) patient: Option<PatientSpace>,
    pub(super) samples: Arc<Samples>,
    /// Of these, the one that is that of the first voxel.
    pub(super) start: [usize; 3],
}

impl Field {
    /// Samples that are all that is known of them.
    pub(super) fn of_array(array: Array) -> Self {
        Self {
            name: None,
            dims: array.dims,
            first: [0; 3],
            padding: 0,
            world_from_file: None,
            patient: None,
            samples: Samples::Array(array).into(),
            start: [0; 3],
        }
    }

    /// Writes the values in the file of a box of voxels, counted from the first of the field's box.
    pub(super) fn read(&self, voxels: &VoxelBox, out: &mut [f32]) -> Result<()> {
        self.samples.source().read(&self.in_samples(voxels), out)
    }

    /// A box of voxels, counted as the samples are.
    fn in_samples(&self, voxels: &VoxelBox) -> VoxelBox {
        VoxelBox {
            first: std::array::from_fn(|a| self.start[a] + voxels.first[a]),
            dims: voxels.dims,
        }
    }

    /// What there is of a box in which each end is a share of its own box without padding; voxels
    /// are there if their centres are. `None` if there is no voxel.
    pub(super) fn cropped(&self, min: [f64; 3], max: [f64; 3]) -> Option<Self> {
        let pad = self.padding;
        let inner = self.dims.map(|n| (n - 2 * pad) as f64);
        // Voxel i is from i to i + 1, and its centre half way.
        let start = std::array::from_fn(|a| (min[a] * inner[a] - 0.5).ceil().max(0.0) as usize);
        let end: [usize; 3] =
            std::array::from_fn(|a| (max[a] * inner[a] + 0.5).floor().min(inner[a]) as usize);
        let dims: [usize; 3] = std::array::from_fn(|a| end[a].saturating_sub(start[a]));
        let start: [usize; 3] = start;
        (!dims.contains(&0)).then(|| Self {
            dims,
            first: std::array::from_fn(|a| self.first[a] + (start[a] + pad) as i64),
            padding: 0,
            start: std::array::from_fn(|a| self.start[a] + start[a] + pad),
            ..self.clone()
        })
    }

    /// Keeps what its values are, if anyone wants to know.
    pub(super) fn note_values(&self, path: &Path, files: &mut Files) -> Result<()> {
        if let Some(kept) = &mut files.values {
            kept.push(self.values(None, path, &files.cancel)?);
        }
        Ok(())
    }

    /// What its values are, or the extinctions that a scale makes of them.
    pub(super) fn values(
        &self,
        scale: Option<&Scale>,
        path: &Path,
        cancel: &Cancel,
    ) -> Result<GridValues> {
        let voxels = Voxels {
            dims: self.dims,
            first: self.first,
            padding: self.padding,
            read: |voxels: &VoxelBox, out: &mut [f32]| {
                self.read(voxels, out)?;
                if let Some(scale) = scale {
                    scale.apply_to_row(out);
                }
                Ok(())
            },
        };
        let space = self.patient.map(PatientSpace::name);
        GridValues::of(&voxels, self.name.clone(), space, path, cancel)
    }

    /// Whether the file has a finite number there that is none in f32.
    fn is_beyond_f32(&self, voxel: [usize; 3]) -> bool {
        let Samples::Array(array) = &*self.samples else {
            return false;
        };
        let is_beyond = |v: f64| v.is_finite() && (v as f32).is_infinite();
        let voxel = std::array::from_fn(|a| self.start[a] + voxel[a]);
        array.number == Number::F64 && is_beyond(f64::from_le_bytes(array.at(array.place(voxel))))
    }

    /// The map from the space of the grid to the file's index space.
    pub(super) fn file_from_grid(&self) -> DAffine3 {
        let first = DVec3::from(self.first.map(|i| i as f64));
        DAffine3::from_translation(first - 0.5)
    }

    /// The map from the space of the grid to where the file says that it is, turned so that its z
    /// is up, or not. If that is not known, patients are: they stand upright.
    pub(super) fn placed(&self, has_z_up: Option<bool>) -> Option<DAffine3> {
        let stand = match has_z_up.unwrap_or(self.patient.is_some()) {
            true => patient::y_up_from_z_up(),
            false => DAffine3::IDENTITY,
        };
        (self.world_from_file)
            .map(|world_from_file| stand * world_from_file * self.file_from_grid())
    }

    /// The map from the space of the grid to the unit cube around the box without its padding.
    pub(super) fn unitcube_from_grid(&self) -> DAffine3 {
        let pad = self.padding as f64;
        let size = DVec3::from(self.dims.map(|n| n as f64)) - 2.0 * pad;
        DAffine3::from_scale(size.recip()) * DAffine3::from_translation(DVec3::splat(-pad))
    }

    /// Bytes that the grid may take: a few of a file can stand for a large box that is full.
    fn allowance(&self) -> u64 {
        ALLOWANCE + MOST_GROWTH * self.samples.source().file_bytes() as u64
    }

    /// The grid of extinction. More than the file makes likely, or than the machine has memory for,
    /// is an error before it is allocated. Values that are not finite, or negative without a
    /// window, are errors, and so is a stop on request; a few that are hardly below zero are taken
    /// as zero with a warning.
    pub(super) fn grid(&self, scale: &Scale, path: &Path, files: &mut Files) -> Result<Grid> {
        let source = self.samples.source();
        let cancel = &files.cancel;
        let counts = |low: f32, high: f32| scale.counts(low, high);
        let layout = Layout::of(self.dims, |voxels| {
            cancel.check()?;
            Ok::<_, Error>(source.may_hold(&self.in_samples(voxels), &counts))
        })?;
        if layout.bytes() > self.allowance() {
            let [x, y, z] = self.dims;
            return Err(Error::input(format!(
                "{x} x {y} x {z} voxels take {} in memory, more than the {} that a file of this \
                 length may ask for",
                size::format(layout.bytes()),
                size::format(self.allowance())
            ))
            .hint("crop or coarsen the grid, or prune tiles that need not be active"));
        }
        let samples = files
            .lists
            .zeros("the grid of a volume", layout.samples())?;
        let (grid, surveys) = layout.fill(samples, |region, samples| {
            cancel.check()?;
            self.read(&region.voxels, samples)?;
            Ok::<_, Error>(self.to_extinction(region, samples, scale))
        })?;
        source.check()?;
        let survey = surveys.into_iter().fold(Survey::default(), Survey::and);
        if let Some(bad) = survey.first_bad(self.dims.iter().product()) {
            return Err(self.bad_voxel(bad)?);
        }
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

    /// Makes extinctions of the values of a region, and tells what these were.
    fn to_extinction(&self, region: &Region, samples: &mut [f32], scale: &Scale) -> Survey {
        let mut survey = Survey::default();
        let [nx, ny, _] = self.dims;
        let [width, height, depth] = region.own;
        let first = region.voxels.first;
        for ([x, y, z], at) in region.voxels.rows() {
            let row = &mut samples[at..at + region.voxels.dims[0]];
            if y < first[1] + height && z < first[2] + depth {
                let number = (z * ny + y) * nx + x;
                survey.add_row(number, &row[..width], |v| scale.apply(v));
            }
            scale.apply_to_row(row);
        }
        survey
    }

    fn bad_voxel(&self, bad: usize) -> Result<Error> {
        let voxel = unflatten(bad, self.dims);
        let mut value = [0.0];
        self.read(&VoxelBox::one(voxel), &mut value)?;
        let [value] = value;
        let index: [i64; 3] = std::array::from_fn(|a| self.first[a] + voxel[a] as i64);
        let error = |what: &str| Error::input(format!("voxel {index:?}: {what}: {value}"));
        Ok(if self.is_beyond_f32(voxel) {
            error("the value leaves the range of f32")
        } else if !value.is_finite() {
            error("the value is not finite")
                .hint("write 0 in the place of such values, as numpy.nan_to_num does")
        } else if value < 0.0 {
            error("the density is negative")
                .hint("give the values that mean 0 and 1 as `window = [low, high]`")
        } else {
            error("the extinction leaves the range of f32")
        })
    }
}

#[cfg(test)]
impl Field {
    /// The value in the file of a voxel, counted from the first of the box.
    pub(super) fn value(&self, voxel: [usize; 3]) -> f32 {
        let mut value = [0.0];
        self.read(&VoxelBox::one(voxel), &mut value).unwrap();
        value[0]
    }
}

#[cfg(test)]
mod tests {
    use super::super::samples::{Array, Source, byte_length};
    use super::super::scale::Density;
    use super::*;

    fn field(values: &[f32], dims: [usize; 3]) -> Field {
        Field {
            name: None,
            dims,
            first: [0; 3],
            padding: 0,
            world_from_file: None,
            patient: None,
            samples: Samples::Array(Array {
                dims,
                bytes: values
                    .iter()
                    .flat_map(|v| v.to_be_bytes())
                    .collect::<Vec<u8>>()
                    .into(),
                number: Number::F32,
                big_endian: true,
                rescale: None,
            })
            .into(),
            start: [0; 3],
        }
    }

    const PLAIN: Scale = Scale {
        sigma_t: 2.0,
        density: Density::Value,
    };

    #[test]
    fn values_are_scaled_and_windowed() {
        let grid = field(&[0.0, 1.0, 2.0, 3.0], [2, 2, 1])
            .grid(&PLAIN, Path::new("a"), &mut Files::default())
            .unwrap();
        assert_eq!(grid.sample(glam::Vec3::new(1.5, 1.5, 0.5)), 6.0);
        let window = Scale {
            sigma_t: 10.0,
            density: Density::Window([1.0, 2.0]),
        };
        assert_eq!(window.apply(-3.0), 0.0);
        assert_eq!(window.apply(1.5), 5.0);
        assert_eq!(window.apply(7.0), 10.0);
    }

    #[test]
    fn a_part_is_what_the_whole_has_there() {
        let values: Vec<f32> = (0..4 * 3 * 5).map(|i| i as f32).collect();
        let whole = field(&values, [4, 3, 5]);
        let part = whole.cropped([0.2, 0.0, 0.5], [0.8, 1.0, 1.0]).unwrap();
        // Centres along x are at 1/8, 3/8, 5/8 and 7/8, along z at 0.1 to 0.9.
        assert_eq!((part.dims, part.first), ([2, 3, 3], [1, 0, 2]));
        for [x, y, z] in [[0, 0, 0], [1, 2, 2], [0, 1, 1]] {
            assert_eq!(part.value([x, y, z]), whole.value([x + 1, y, z + 2]));
        }
        let grid = part.grid(&PLAIN, Path::new("a"), &mut Files::default());
        let at = |x, y, z| 2.0 * ((z * 3 + y) * 4 + x) as f32;
        assert_eq!(
            grid.unwrap().sample(glam::Vec3::new(0.5, 1.5, 2.5)),
            at(1, 1, 4)
        );
        let twice = part.cropped([0.5, 0.0, 0.0], [1.0; 3]).unwrap();
        assert_eq!(
            (twice.first, twice.value([0, 0, 0])),
            ([2, 0, 2], whole.value([2, 0, 2]))
        );
        assert_eq!(whole.cropped([0.0; 3], [1.0; 3]).unwrap().dims, whole.dims);
        assert!(whole.cropped([0.3, 0.0, 0.0], [0.31, 1.0, 1.0]).is_none());
    }

    /// The grid of a field, by as many threads.
    fn on_threads(threads: usize, field: &Field, scale: &Scale) -> Grid {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let grid = || field.grid(scale, Path::new("a"), &mut Files::default());
        pool.build().unwrap().install(grid).unwrap()
    }

    #[test]
    fn regions_on_threads_fill_what_single_voxels_do() {
        // Several regions, the last of one layer of bricks; empty bricks, and an empty region.
        let dims = [140, 9, 66];
        let value = |i: usize| match unflatten(i, dims) {
            [x, _, z] if x < 80 && z < 50 => 0,
            _ => (i * 7919 % 251) as u8 / 2,
        };
        let count = dims.iter().product();
        let window = Scale {
            sigma_t: 3.0,
            density: Density::Window([20.0, 100.0]),
        };
        for scale in [PLAIN, window] {
            let extinction = |i: usize| scale.apply(f32::from(value(i)));
            let held = (0..count).filter(|&i| extinction(i) != 0.0);
            let voxels = held.map(|i| (unflatten(i, dims), extinction(i)));
            let plain = Grid::sparse(dims, voxels).unwrap();
            for number in Number::ALL {
                for big_endian in [false, true] {
                    let bytes = |i: usize| {
                        let mut bytes = match number {
                            Number::F32 => f32::from(value(i)).to_le_bytes().to_vec(),
                            Number::F64 => f64::from(value(i)).to_le_bytes().to_vec(),
                            _ => [&[value(i)][..], &[0; 7][..number.size() - 1]].concat(),
                        };
                        if big_endian {
                            bytes.reverse();
                        }
                        bytes
                    };
                    let array = || Array {
                        dims,
                        bytes: (0..count).flat_map(bytes).collect::<Vec<u8>>().into(),
                        number,
                        big_endian,
                        rescale: None,
                    };
                    let field = || Field {
                        samples: Samples::Array(array()).into(),
                        ..field(&[], dims)
                    };
                    let grid = on_threads(1, &field(), &scale);
                    for b in plain.bricks() {
                        let brick = |g: &Grid| g.brick(b).map(|b| (b.samples().to_vec(), b.max));
                        assert_eq!(brick(&grid), brick(&plain), "{number:?} {b:?}");
                    }
                    assert_eq!(grid.bytes(), plain.bytes());
                    assert_eq!(on_threads(7, &field(), &scale), grid);
                }
            }
        }
    }

    #[test]
    fn the_first_bad_voxel_is_named() {
        let message = |values: &[f32]| match field(values, [2, 2, 1]).grid(
            &PLAIN,
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
        let grid = field(&values, [10, 10, 10]).grid(&PLAIN, Path::new("a.raw"), &mut files);
        assert_eq!(grid.unwrap().sample(glam::Vec3::new(7.5, 0.5, 0.5)), 0.0);
        assert_eq!(
            files.warnings,
            ["a.raw: 2 voxels below 0 are taken as 0, the lowest is -0.000002"]
        );
        values[8] = -0.5;
        let error = field(&values, [10, 10, 10]).grid(&PLAIN, Path::new("a"), &mut files);
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("negative: -0.000001")
        );
        let many = field(&vec![-1e-6; 1000], [10, 10, 10]);
        assert!(many.grid(&PLAIN, Path::new("a"), &mut files).is_err());
    }

    #[test]
    fn doubles_beyond_floats_are_told_from_what_is_not_finite() {
        for (value, part) in [
            (1e39, "range of f32"),
            (f64::INFINITY, "not finite"),
            (f64::NAN, "not finite"),
        ] {
            let mut field = field(&[0.0; 2], [1, 1, 1]);
            if let Some(Samples::Array(array)) = Arc::get_mut(&mut field.samples) {
                array.bytes = value.to_be_bytes().to_vec().into();
                array.number = Number::F64;
            }
            let Err(error) = field.grid(&PLAIN, Path::new("a"), &mut Files::default()) else {
                panic!("{value}");
            };
            assert!(error.to_string().contains(part), "{error}");
        }
    }

    #[test]
    fn a_small_file_cannot_ask_for_all_memory() {
        struct Full(usize);
        impl Source for Full {
            fn may_hold(&self, _: &VoxelBox, counts: &dyn Fn(f32, f32) -> bool) -> bool {
                counts(1.0, 1.0)
            }
            fn read(&self, _: &VoxelBox, out: &mut [f32]) -> Result<()> {
                out.fill(1.0);
                Ok(())
            }
            fn file_bytes(&self) -> usize {
                self.0
            }
        }
        let full = |dims: [usize; 3], file_bytes| {
            let field = Field {
                name: None,
                dims,
                first: [0; 3],
                padding: 0,
                world_from_file: None,
                patient: None,
                samples: Samples::Other(Box::new(Full(file_bytes))).into(),
                start: [0; 3],
            };
            field.grid(&PLAIN, Path::new("a"), &mut Files::default())
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
        let layout = Layout::of([2000, 1000, 1000], |_| Ok::<_, Error>(true)).unwrap();
        assert!(layout.bytes() < ALLOWANCE + MOST_GROWTH * 300_000_000);
    }

    #[test]
    fn a_hostile_size_is_refused_without_an_overflow() {
        assert!(byte_length([usize::MAX, 2, 2], Number::U8).is_err());
        assert_eq!(byte_length([3, 2, 2], Number::F64).unwrap(), 96);
    }
}
