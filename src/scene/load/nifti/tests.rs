//! Small NIfTI files written here.

use super::*;
use std::io::Write;

/// A file in the making.
#[derive(Clone)]
struct Made {
    is_second: bool,
    big_endian: bool,
    bytes: Vec<u8>,
}

impl Made {
    /// A file of 2 x 3 x 2 voxels of this type, without a placement but the sizes of voxels.
    fn new(is_second: bool, big_endian: bool, datatype: i16, bits: i16) -> Self {
        let (length, at, magic): (i32, usize, &[u8]) = match is_second {
            true => (540, 4, b"n+2\0\r\n\x1a\n"),
            false => (348, 344, b"n+1\0"),
        };
        let mut made = Self {
            is_second,
            big_endian,
            bytes: vec![0; length as usize + 4],
        };
        made.bytes[at..at + magic.len()].copy_from_slice(magic);
        made.put([0, 0], &length.to_le_bytes());
        made.put([70, 12], &datatype.to_le_bytes());
        made.put([72, 14], &bits.to_le_bytes());
        made.dims(&[3, 2, 3, 2]);
        made.floats([76, 104], &[1.0, 1.0, 2.0, 3.0]);
        made
    }

    fn put(&mut self, places: [usize; 2], little: &[u8]) {
        let at = places[usize::from(self.is_second)];
        let mut bytes = little.to_vec();
        if self.big_endian {
            bytes.reverse();
        }
        self.bytes[at..at + bytes.len()].copy_from_slice(&bytes);
    }

    fn dims(&mut self, dims: &[i16]) {
        for (i, n) in dims.iter().enumerate() {
            match self.is_second {
                true => self.put([0, 16 + 8 * i], &i64::from(*n).to_le_bytes()),
                false => self.put([40 + 2 * i, 0], &n.to_le_bytes()),
            }
        }
    }

    fn floats(&mut self, places: [usize; 2], values: &[f64]) {
        for (i, v) in values.iter().enumerate() {
            match self.is_second {
                true => self.put([0, places[1] + 8 * i], &v.to_le_bytes()),
                false => self.put([places[0] + 4 * i, 0], &(*v as f32).to_le_bytes()),
            }
        }
    }

    fn code(&mut self, places: [usize; 2], code: i32) {
        match self.is_second {
            true => self.put(places, &code.to_le_bytes()),
            false => self.put(places, &(code as i16).to_le_bytes()),
        }
    }

    /// With the samples 0 to 11, each made bytes.
    fn with<const N: usize>(&self, sample: impl Fn(u8) -> [u8; N]) -> Vec<u8> {
        let mut bytes = self.bytes.clone();
        for i in 0..12 {
            let mut sample = sample(i);
            if self.big_endian {
                sample.reverse();
            }
            bytes.extend(sample);
        }
        bytes
    }
}

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(bytes).unwrap();
    packed.finish().unwrap()
}

fn load(content: &[u8]) -> Result<(Field, Vec<String>)> {
    let mut files = Files::default();
    let field = read(content.to_vec(), Path::new("x.nii"), &mut files)?;
    Ok((field, files.warnings))
}

fn values(field: &Field) -> Vec<f32> {
    let voxels = (0..12).map(|i| [i % 2, i / 2 % 3, i / 6]);
    voxels.map(|v| field.value(v)).collect()
}

fn refused(content: &[u8]) -> String {
    match load(content) {
        Ok(_) => panic!("it was read"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn every_type_and_byte_order_gives_the_same_samples_plain_or_packed() {
    let expected: Vec<f32> = (0..12).map(|i| i as f32).collect();
    for is_second in [false, true] {
        for big_endian in [false, true] {
            let made = |code, bits| Made::new(is_second, big_endian, code, bits);
            for content in [
                made(2, 8).with(|i| [i]),
                made(256, 8).with(|i| [i]),
                made(4, 16).with(|i| i16::from(i).to_le_bytes()),
                made(512, 16).with(|i| u16::from(i).to_le_bytes()),
                made(8, 32).with(|i| i32::from(i).to_le_bytes()),
                made(768, 32).with(|i| u32::from(i).to_le_bytes()),
                made(1024, 64).with(|i| i64::from(i).to_le_bytes()),
                made(1280, 64).with(|i| u64::from(i).to_le_bytes()),
                made(16, 32).with(|i| f32::from(i).to_le_bytes()),
                made(64, 64).with(|i| f64::from(i).to_le_bytes()),
            ] {
                for content in [gzip(&content), content] {
                    let (field, warnings) = load(&content).unwrap();
                    assert_eq!(values(&field), expected);
                    assert_eq!(warnings.len(), 1, "no placement");
                    assert!(load(&content[..content.len() / 2]).is_err());
                }
            }
        }
    }
}

#[test]
fn slope_and_intercept_make_values() {
    for is_second in [false, true] {
        let mut made = Made::new(is_second, false, 2, 8);
        made.floats([112, 176], &[2.0, -1024.0]);
        let (field, _) = load(&made.with(|i| [i])).unwrap();
        let expected: Vec<f32> = (0..12).map(|i| 2.0 * i as f32 - 1024.0).collect();
        assert_eq!(values(&field), expected);
        for [slope, inter] in [[0.0, 7.0], [f64::NAN, 0.0], [1.0, 0.0]] {
            made.floats([112, 176], &[slope, inter]);
            let (field, _) = load(&made.with(|i| [i])).unwrap();
            assert_eq!(field.value([1, 2, 1]), 11.0, "{slope} {inter}");
        }
    }
}

#[test]
fn a_file_is_placed_by_sform_or_else_qform_or_else_sizes() {
    // By its corners in right, anterior, superior; sheared as a tilted gantry does.
    let at = |field: &Field, voxel: [f64; 3]| {
        let p = field
            .world_from_file
            .unwrap()
            .transform_point3(voxel.into());
        (p * DVec3::new(-1.0, -1.0, 1.0)).to_array()
    };
    for is_second in [false, true] {
        let mut made = Made::new(is_second, false, 2, 8);
        let (field, warnings) = load(&made.with(|i| [i])).unwrap();
        assert_eq!(at(&field, [1.0, 1.0, 1.0]), [1.0, 2.0, 3.0]);
        assert!(
            warnings[0].contains("neither `sform` nor `qform`"),
            "{warnings:?}"
        );
        // By 90 degrees about z, and mirrored along its third axis.
        let half = 0.5_f64.sqrt();
        made.code([252, 344], 1);
        made.floats([256, 352], &[0.0, 0.0, half, 10.0, 20.0, 30.0]);
        made.floats([76, 104], &[-1.0]);
        let (field, warnings) = load(&made.with(|i| [i])).unwrap();
        assert!(warnings.is_empty());
        let found = at(&field, [1.0, 1.0, 1.0]);
        for (found, expected) in found.into_iter().zip([8.0, 21.0, 27.0]) {
            assert!((found - expected).abs() < 1e-5, "{found} {expected}");
        }
        made.code([254, 348], 2);
        made.floats([280, 400], &[-2.0, 0.0, 0.0, 5.0]);
        made.floats([296, 432], &[0.0, 2.0, 0.5, 6.0]);
        made.floats([312, 464], &[0.0, 0.0, 3.0, 7.0]);
        let (field, _) = load(&made.with(|i| [i])).unwrap();
        assert_eq!(at(&field, [1.0, 1.0, 1.0]), [3.0, 8.5, 10.0]);
        made.floats([312, 464], &[0.0, 0.0, 0.0, 7.0]);
        assert!(refused(&made.with(|i| [i])).contains("by `sform` is singular"));
    }
}

#[test]
fn half_a_turn_is_one_in_spite_of_rounding() {
    let mut made = Made::new(false, false, 2, 8);
    made.code([252, 344], 1);
    let third = f64::from(1.0_f32 / 3.0_f32.sqrt());
    made.floats([256, 352], &[third, third, third]);
    let (field, _) = load(&made.with(|i| [i])).unwrap();
    let map = field.world_from_file.unwrap().matrix3;
    assert!((map.determinant() - 6.0).abs() < 1e-5, "{map}");
}

#[test]
fn what_is_no_volume_is_refused_in_a_line() {
    let good = Made::new(false, false, 2, 8);
    let content = |change: &dyn Fn(&mut Made)| {
        let mut made = good.clone();
        change(&mut made);
        made.with(|i| [i])
    };
    for (content, says) in [
        (b"hello".to_vec(), "found another kind of file"),
        (
            good.bytes[..300].to_vec(),
            "expected a header of 348 bytes, found 300",
        ),
        (content(&|m| m.dims(&[4, 2, 3, 2, 5])), "a series"),
        (content(&|m| m.dims(&[2, 2, 3])), "expected 3 to 7 axes"),
        (content(&|m| m.dims(&[3, 2, -3, 2])), "expected 3 to 7 axes"),
        (
            content(&|m| m.dims(&[3, 30000, 30000, 30000])),
            "bytes of samples, found 12",
        ),
        (
            content(&|m| m.put([70, 12], &128_i16.to_le_bytes())),
            "128, colours, is not supported",
        ),
        (
            content(&|m| m.put([72, 14], &16_i16.to_le_bytes())),
            "expected `bitpix` 8",
        ),
        (
            content(&|m| m.put([108, 0], &3_f32.to_le_bytes())),
            "`vox_offset` of at least 352, found 3",
        ),
        (
            content(&|m| m.put([108, 0], &1e30_f32.to_le_bytes())),
            "`vox_offset`",
        ),
        (content(&|m| m.put([344, 0], b"ni1\0")), ".img file"),
        (content(&|m| m.put([344, 0], b"    ")), "ANALYZE"),
    ] {
        let message = refused(&content);
        assert!(
            message.contains(says) && !message.contains('\n'),
            "{message}"
        );
    }
    // A small file cannot ask for much memory.
    let huge = content(&|m| m.dims(&[3, 30000, 30000, 30000]));
    assert!(refused(&gzip(&huge)).contains("compressed bytes can hold"));
}
