//! NumPy's `.npy`: a frame as an array of its rows, columns and channels.

use super::frame::channel_name;
use super::{Frame, Picture, Region};
use crate::run::Output;
use crate::{Error, Result};
use half::f16;
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;

/// What such a file begins with.
const MAGIC: &[u8] = b"\x93NUMPY";

/// The header of an array of 32-bit floats, as NumPy writes it.
pub(crate) fn header(shape: &[u64]) -> Vec<u8> {
    const BLOCK: usize = 64;
    let sizes: Vec<String> = shape.iter().map(u64::to_string).collect();
    let sizes = sizes.join(", ");
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({sizes}), }}");
    let before = MAGIC.len() + 4;
    let length = (before + text.len() + 1).next_multiple_of(BLOCK) - before;
    text += &" ".repeat(length - 1 - text.len());
    text.push('\n');
    let mut header = MAGIC.to_vec();
    header.extend([1, 0]);
    header.extend((length as u16).to_le_bytes());
    header.extend(text.bytes());
    header
}

/// Names of a frame's channels, in the order in which an array has them.
#[must_use]
pub fn channels(frame: &Frame) -> Vec<String> {
    let layers = frame.layers.iter();
    let names = layers.flat_map(|layer| {
        let channels = layer.channels.iter();
        channels.map(|(channel, _)| channel_name(&layer.name, channel))
    });
    names.collect()
}

/// Says what an array of a frame holds.
#[must_use]
pub fn told(path: &Path, frame: &Frame) -> String {
    let names = channels(frame);
    format!(
        "{}: {} x {} x {} of float32, channels {}",
        path.display(),
        frame.region.height(),
        frame.region.width(),
        names.len(),
        names.join(" ")
    )
}

/// Writes the region of a frame as 32-bit floats, rows by columns by [`channels`]; it appears under
/// its name when it is complete. A file that is there is replaced.
///
/// # Errors
/// As [`super::exr::write`].
pub fn write(path: &Path, frame: &Frame) -> Result<()> {
    frame.check().map_err(|e| e.at(path.display()))?;
    let [width, height] = [frame.region.width(), frame.region.height()];
    let layers = frame.layers.iter();
    let planes: Vec<&[f32]> = layers
        .flat_map(|layer| layer.channels.iter().map(|(_, samples)| &samples[..]))
        .collect();
    let mut output = Output::create(path)?;
    let head = header(&[height.into(), width.into(), planes.len() as u64]);
    output.write_all(&head).map_err(|e| output.failed(&e))?;
    let mut row = Vec::with_capacity(width as usize * planes.len() * size_of::<f32>());
    for y in 0..height as usize {
        row.clear();
        for i in y * width as usize..(y + 1) * width as usize {
            row.extend(planes.iter().flat_map(|plane| plane[i].to_le_bytes()));
        }
        output.write_all(&row).map_err(|e| output.failed(&e))?;
    }
    output.commit()
}

/// Numbers of an array.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Number {
    F16,
    F32,
    F64,
}

impl Number {
    fn bytes(self) -> usize {
        match self {
            Self::F16 => 2,
            Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The number in so many bytes.
    fn read(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Self::F16, &[a, b]) => f16::from_le_bytes([a, b]).to_f32(),
            (Self::F32, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
            (_, &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32,
            _ => f32::NAN,
        }
    }
}

/// What a header says.
struct Array {
    number: Number,
    /// Rows, columns, channels.
    shape: [usize; 3],
    /// Where the numbers begin.
    start: usize,
}

/// Reads linear RGB: the first three channels of an array of rows, columns and channels. `None` for
/// the region means all of it.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is not there, is damaged or cut, is another kind of array, or
/// does not cover the region.
pub fn read(path: &Path, region: Option<Region>) -> Result<Picture> {
    let mut bytes = Vec::new();
    File::open(path)
        .and_then(|mut file| file.read_to_end(&mut bytes))
        .map_err(|e| Error::io("read", path, &e))?;
    let whole = decode(&bytes).map_err(|e| e.at(path.display()))?;
    match region {
        Some(region) => whole.crop(&region).map_err(|e| e.at(path.display())),
        None => Ok(whole),
    }
}

fn decode(bytes: &[u8]) -> Result<Picture> {
    let Array {
        number,
        shape: [height, width, channels],
        start,
    } = parse(bytes)?;
    let size = number.bytes();
    let needed = [width, channels, size]
        .into_iter()
        .try_fold(height, usize::checked_mul);
    let data = &bytes[start..];
    if needed != Some(data.len()) {
        return Err(Error::input(format!(
            "expected {height} x {width} x {channels} numbers of {size} bytes, found {} bytes; the \
             file is truncated or damaged",
            data.len()
        )));
    }
    let pixels = data.chunks_exact(channels * size).map(|pixel| {
        let value = |c: usize| number.read(&pixel[c * size..(c + 1) * size]);
        [0, 1, 2].map(value)
    });
    Ok(Picture {
        width,
        height,
        pixels: pixels.collect(),
    })
}

fn parse(bytes: &[u8]) -> Result<Array> {
    let damaged = || Error::input("the header is not whole; the file is truncated or damaged");
    let rest = bytes.strip_prefix(MAGIC).ok_or_else(damaged)?;
    let (length, before) = match *rest {
        [1, _, a, b, ..] => (usize::from(u16::from_le_bytes([a, b])), 4),
        [2 | 3, _, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]) as usize, 6),
        _ => return Err(damaged()),
    };
    let start = MAGIC.len() + before;
    let end = start.checked_add(length).ok_or_else(damaged)?;
    let text = bytes.get(start..end).ok_or_else(damaged)?;
    let text = std::str::from_utf8(text).map_err(|_| damaged())?;
    let value = |key: &str| {
        let (_, behind) = text.split_once(&format!("'{key}'"))?;
        Some(behind.trim_start().strip_prefix(':')?.trim_start())
    };
    let number = value("descr").and_then(|text| match text.get(..5)? {
        "'<f2'" => Some(Number::F16),
        "'<f4'" => Some(Number::F32),
        "'<f8'" => Some(Number::F64),
        _ => None,
    });
    let by_rows = value("fortran_order").is_some_and(|text| text.starts_with("False"));
    let shape = value("shape").and_then(|text| {
        let (inner, _) = text.strip_prefix('(')?.split_once(')')?;
        let sizes: Option<Vec<usize>> = inner.split(',').map(|n| n.trim().parse().ok()).collect();
        <[usize; 3]>::try_from(sizes?).ok()
    });
    match (number, shape) {
        (Some(number), Some(shape @ [height, width, channels]))
            if by_rows && height > 0 && width > 0 && channels > 2 =>
        {
            Ok(Array {
                number,
                shape,
                start: end,
            })
        }
        _ => Err(Error::input(format!(
            "expected an array of rows, columns and three channels or more of float16, float32 or \
             float64, found {}",
            text.trim_end()
                .chars()
                .take(100)
                .collect::<String>()
                .escape_debug()
        ))
        .hint("store numpy.ascontiguousarray(image, dtype='f4')")),
    }
}

#[cfg(test)]
mod tests {
    use super::super::Layer;
    use super::*;

    #[test]
    fn a_frame_survives_a_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.npy");
        let mut frame = Frame::new(
            9,
            9,
            Region {
                x0: 2,
                y0: 3,
                x1: 7,
                y1: 5,
            },
        );
        let pixels: Vec<[f32; 3]> = (0..10_u8).map(|i| [f32::from(i), 0.1, f32::NAN]).collect();
        frame.layers.push(Layer::rgb("", &pixels));
        frame
            .layers
            .push(Layer::single("depth", "Z", vec![2.0; 10]));
        assert_eq!(channels(&frame), ["R", "G", "B", "depth.Z"]);
        write(&path, &frame).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00\x76\x00{'descr': '<f4', "));
        assert_eq!(bytes.len(), 128 + 2 * 5 * 4 * 4);
        let back = read(&path, None).unwrap();
        assert_eq!((back.width, back.height), (5, 2));
        for (a, b) in back.pixels.iter().zip(&pixels) {
            assert_eq!((a[0], a[1], a[2].is_nan()), (b[0], b[1], true));
        }
        let part = Region {
            x0: 4,
            y0: 1,
            x1: 5,
            y1: 2,
        };
        assert_eq!(read(&path, Some(part)).unwrap().pixels[0][0], 9.0);
        assert!(read(&path, Some(Region::full(9, 9))).is_err());
    }

    #[test]
    fn what_is_wrong_is_said_in_a_line() {
        let file = |text: &str, data: &[u8]| {
            let mut bytes = MAGIC.to_vec();
            bytes.extend([2, 0]);
            bytes.extend((text.len() as u32).to_le_bytes());
            bytes.extend(text.bytes());
            bytes.extend(data);
            bytes
        };
        let head = |kind: &str, shape: &str| {
            format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}")
        };
        let half = decode(&file(&head("<f2", "1, 1, 3"), &[0, 0x3c, 0, 0, 0, 0x40])).unwrap();
        assert_eq!(half.pixels, [[1.0, 0.0, 2.0]]);
        let double = [1.5_f64, 2.0, 3.0].map(f64::to_le_bytes).concat();
        let double = decode(&file(&head("<f8", "1, 1, 3"), &double)).unwrap();
        assert_eq!(double.pixels, [[1.5, 2.0, 3.0]]);
        for (kind, shape, says) in [
            ("<f4", "1, 1, 3", "found 6 bytes"),
            (
                "<f4",
                "99999999999, 99999999999, 9999999999",
                "found 6 bytes",
            ),
            ("<i4", "1, 1, 3", "float32"),
            ("<f4", "2, 2", "rows, columns"),
            ("<f4", "2, 2, 1", "rows, columns"),
            ("<f4", "0, 2, 3", "rows, columns"),
        ] {
            let error = decode(&file(&head(kind, shape), &[0; 6])).err().unwrap();
            assert!(error.to_string().contains(says), "{error}");
            assert_eq!(error.kind(), crate::Kind::Input);
        }
        let whole = file(&head("<f4", "1, 1, 3"), &[0; 12]);
        for length in 0..whole.len() {
            assert!(decode(&whole[..length]).is_err());
        }
    }
}
