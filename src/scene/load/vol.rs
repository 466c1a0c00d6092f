//! `.vol` files of Mitsuba: a header of 48 bytes, and numbers of one channel or more, x fastest.

use super::field::Field;
use super::samples::{Array, Number, Samples, byte_length};
use crate::run::memory;
use crate::{Error, Result};
use glam::{DAffine3, DVec3};

/// "VOL", the version, the type of its numbers, three sizes, channels, and the corners of its box.
const HEADER_BYTES: usize = 48;

/// What such a file holds.
pub(super) struct Vol {
    dims: [usize; 3],
    channels: usize,
    number: Number,
    /// Corners of its box.
    bounds: [DVec3; 2],
    /// The numbers, channels beside each other.
    bytes: Vec<u8>,
}

impl Vol {
    /// Reads the content of a file.
    ///
    /// # Errors
    /// Another header, or another length than it says.
    pub(super) fn read(mut content: Vec<u8>) -> Result<Self> {
        let header = content.get(..HEADER_BYTES);
        let Some(header) = header.filter(|h| h.starts_with(b"VOL")) else {
            return Err(Error::input(
                "expected a .vol file of Mitsuba, which begins with VOL",
            ));
        };
        if header[3] != 3 {
            return Err(Error::input(format!(
                "expected a .vol file of version 3, found {}",
                header[3]
            )));
        }
        let word = |i: usize| std::array::from_fn::<u8, 4, _>(|k| header[4 + 4 * i + k]);
        let int = |i: usize| i32::from_le_bytes(word(i));
        let number = match int(0) {
            1 => Number::F32,
            3 => Number::U8,
            other => {
                return Err(Error::input(format!(
                    "expected numbers of type 1 (float32) or 3 (uint8), found type {other}"
                )));
            }
        };
        let size = |i: usize| usize::try_from(int(i)).ok().filter(|n| *n > 0);
        let (Some(x), Some(y), Some(z), Some(channels)) = (size(1), size(2), size(3), size(4))
        else {
            return Err(Error::input(format!(
                "expected sizes and channels of at least 1, found {:?}",
                [int(1), int(2), int(3), int(4)]
            )));
        };
        let dims = [x, y, z];
        let of_one = byte_length(dims, number)?;
        let expected = of_one.checked_mul(channels);
        let found = content.len() - HEADER_BYTES;
        if expected != Some(found) {
            return Err(Error::input(format!(
                "expected {x} x {y} x {z} numbers in {channels} channels, \
                 found {found} bytes of them"
            )));
        }
        let float = |i: usize| f64::from(f32::from_le_bytes(word(i)));
        let bounds = [5, 8].map(|i| DVec3::new(float(i), float(i + 1), float(i + 2)));
        content.drain(..HEADER_BYTES);
        Ok(Self {
            dims,
            channels,
            number,
            bounds,
            bytes: content,
        })
    }

    /// Numbers for each voxel.
    pub(super) fn channels(&self) -> usize {
        self.channels
    }

    /// The map of the unit cube to the box that the file states, if it states one.
    pub(super) fn box_from_unitcube(&self) -> Option<DAffine3> {
        let [low, high] = self.bounds;
        let size = high - low;
        let is_box = low.is_finite() && high.is_finite() && size.min_element() > 0.0;
        is_box.then(|| DAffine3::from_translation(low) * DAffine3::from_scale(size))
    }

    /// The factor that makes a number what it stands for.
    pub(super) fn scale(&self) -> f64 {
        match self.number {
            Number::U8 => 1.0 / 255.0,
            _ => 1.0,
        }
    }

    /// The mean of each of the first three channels, or of the one that there is.
    pub(super) fn means(&self) -> [f32; 3] {
        let mut sums = [0.0_f64; 3];
        let step = self.number.size();
        for voxel in self.bytes.chunks_exact(step * self.channels) {
            for (i, sum) in sums.iter_mut().enumerate() {
                let at = step * i.min(self.channels - 1);
                *sum += self.value(&voxel[at..at + step]);
            }
        }
        let count = (self.dims[0] * self.dims[1] * self.dims[2]) as f64;
        sums.map(|sum| (sum / count) as f32)
    }

    /// Whether the first three channels have one ratio in all voxels, up to a step of 8 bits.
    pub(super) fn is_of_one_color(&self) -> bool {
        const STEP: f64 = 1.0 / 255.0;
        let means = self.means().map(f64::from);
        let whole: f64 = means.iter().sum();
        let step = self.number.size();
        let voxels = || {
            let voxels = self.bytes.chunks_exact(step * self.channels);
            voxels.map(|voxel| {
                let channel = |i: usize| {
                    let at = step * i.min(self.channels - 1);
                    self.value(&voxel[at..at + step])
                };
                [0, 1, 2].map(channel)
            })
        };
        let most = voxels().flatten().fold(0.0, f64::max);
        voxels().all(|voxel| {
            let sum: f64 = voxel.iter().sum();
            let is_near = |(v, mean): (&f64, &f64)| (v - sum * mean / whole).abs() <= STEP * most;
            voxel.iter().zip(&means).all(is_near)
        })
    }

    fn value(&self, bytes: &[u8]) -> f64 {
        let value = match bytes {
            [byte] => f64::from(*byte),
            &[a, b, c, d] => f64::from(f32::from_le_bytes([a, b, c, d])),
            _ => 0.0,
        };
        value * self.scale()
    }

    /// The field of its numbers; of several channels, of their mean. It is in the box that the file
    /// states.
    pub(super) fn into_field(self) -> Result<Field> {
        let [nx, ny, nz] = self.dims.map(|n| n as f64);
        let to_unit = DAffine3::from_scale(DVec3::new(nx, ny, nz).recip())
            * DAffine3::from_translation(DVec3::splat(0.5));
        let world_from_file = self.box_from_unitcube().map(|map| map * to_unit);
        let (dims, number) = (self.dims, self.number);
        let (bytes, number) = match self.channels {
            1 => (self.bytes, number),
            _ => (self.mean_bytes()?, Number::F32),
        };
        Ok(Field {
            name: None,
            dims,
            first: [0; 3],
            padding: 0,
            world_from_file,
            patient: None,
            samples: Samples::Array(Array {
                dims,
                bytes: bytes.into(),
                number,
                big_endian: false,
                rescale: None,
            })
            .into(),
            start: [0; 3],
        })
    }

    /// Means over channels, not yet scaled.
    fn mean_bytes(&self) -> Result<Vec<u8>> {
        let step = self.number.size();
        let voxels = self.bytes.len() / (step * self.channels);
        let mut out: Vec<u8> = memory::room("the channels of a volume", 4 * voxels)?;
        let factor = 1.0 / (self.channels as f64 * self.scale());
        for voxel in self.bytes.chunks_exact(step * self.channels) {
            let sum: f64 = voxel.chunks_exact(step).map(|v| self.value(v)).sum();
            out.extend(((sum * factor) as f32).to_le_bytes());
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(dims: [i32; 3], channels: i32, bounds: [f32; 6], values: &[f32]) -> Vec<u8> {
        let mut bytes = b"VOL\x03\x01\0\0\0".to_vec();
        let sizes = dims
            .into_iter()
            .chain([channels])
            .flat_map(i32::to_le_bytes);
        bytes.extend(sizes);
        bytes.extend(bounds.into_iter().flat_map(f32::to_le_bytes));
        bytes.extend(values.iter().flat_map(|v| v.to_le_bytes()));
        bytes
    }

    #[test]
    fn values_and_box_are_those_of_the_file() {
        let content = file([2, 1, 1], 1, [0.0, 0.0, 0.0, 4.0, 1.0, 1.0], &[3.0, 5.0]);
        let field = Vol::read(content).unwrap().into_field().unwrap();
        assert_eq!((field.value([0; 3]), field.value([1, 0, 0])), (3.0, 5.0));
        let map = field.world_from_file.unwrap();
        assert_eq!(map.transform_point3(DVec3::ZERO), DVec3::new(1.0, 0.5, 0.5));
        let colors = file([1, 1, 2], 3, [0.0; 6], &[1.0, 2.0, 6.0, 3.0, 4.0, 8.0]);
        let vol = Vol::read(colors).unwrap();
        assert_eq!(vol.means(), [2.0, 3.0, 7.0]);
        assert!(!vol.is_of_one_color());
        assert!(vol.box_from_unitcube().is_none());
        let field = vol.into_field().unwrap();
        assert_eq!((field.value([0; 3]), field.value([0, 0, 1])), (3.0, 5.0));
    }

    #[test]
    fn channels_of_one_ratio_are_of_one_color() {
        let of = |values: &[f32]| {
            let content = file([3, 1, 1], 3, [0.0; 6], values);
            Vol::read(content).unwrap().is_of_one_color()
        };
        assert!(of(&[4.0, 2.0, 1.0, 0.0, 0.0, 0.0, 8.0, 4.01, 2.0]));
        assert!(!of(&[4.0, 2.0, 1.0, 0.0, 0.1, 0.0, 8.0, 4.0, 2.0]));
    }

    #[test]
    fn other_files_are_refused() {
        let good = file([2, 1, 1], 1, [0.0; 6], &[3.0, 5.0]);
        let with = |at: usize, byte: u8| {
            let mut bytes = good.clone();
            bytes[at] = byte;
            bytes
        };
        for (content, says) in [
            (b"VOL".to_vec(), "begins with VOL"),
            (with(0, b'W'), "begins with VOL"),
            (with(3, 2), "version 3, found 2"),
            (with(4, 2), "found type 2"),
            (with(8, 0), "at least 1"),
            (with(11, 0x80), "at least 1"),
            (with(8, 3), "found 8 bytes"),
            (with(11, 0x7f), "found 8 bytes"),
            (good[..good.len() - 1].to_vec(), "found 7 bytes"),
        ] {
            let Err(error) = Vol::read(content) else {
                panic!("{says}");
            };
            assert!(error.to_string().contains(says), "{error}");
        }
    }
}
