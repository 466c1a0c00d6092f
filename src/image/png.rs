//! PNG files of eight bits: previews, heat maps, and pictures to compare.

use super::tone::{self, Display};
use super::{Exposure, Frame, Picture};
use crate::run::{Output, Progress};
use crate::{Error, Result};
use ::image::codecs::png::{CompressionType, FilterType, PngEncoder};
use ::image::{ExtendedColorType, ImageEncoder, ImageFormat, ImageReader, Limits};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Bytes that a decoded image may take, so that a small hostile file cannot ask for all memory.
const MAX_DECODED_BYTES: u64 = 4 << 30;

/// Writes a PNG file of eight bits a channel; it appears under its name when it is complete. An
/// image that is there is replaced.
///
/// # Errors
/// If the output cannot be written; then nothing is left behind.
pub fn write(path: &Path, display: &Display) -> Result<()> {
    let size = [display.width, display.height];
    let bytes = display.pixels.as_flattened();
    encode(path, size, bytes, ExtendedColorType::Rgb8)
}

/// Writes the beauty of a frame after the tone map, as [`write()`] does. Where it has alpha, so has
/// the file: beside colours that are not multiplied by it, as PNG wants them.
///
/// # Errors
/// [`crate::Kind::Input`] for a frame without colours; else as [`write()`].
pub fn write_frame(path: &Path, frame: &Frame, exposure: f32) -> Result<()> {
    let picture = shown(frame)?;
    let display = tone::map(&picture, exposure);
    let Some(alpha) = alpha(frame) else {
        return write(path, &display);
    };
    let eighth = |alpha: f32| (alpha.clamp(0.0, 1.0) * 255.0 + 0.5) as u8;
    let pixels = display.pixels.iter().zip(alpha);
    let pixels: Vec<[u8; 4]> = pixels
        .map(|(&[r, g, b], &alpha)| [r, g, b, eighth(alpha)])
        .collect();
    let size = [display.width, display.height];
    encode(path, size, pixels.as_flattened(), ExtendedColorType::Rgba8)
}

/// The same at an exposure that may have to be found, which is said then.
///
/// # Errors
/// As [`write_frame`].
pub fn write_exposed(
    path: &Path,
    frame: &Frame,
    exposure: Exposure,
    progress: &Progress,
) -> Result<()> {
    let found = exposure.of(&shown(frame)?).unwrap_or(1.0);
    if exposure == Exposure::Automatic {
        progress.say(&format!(
            "{}: automatic exposure {found}, at which one lit pixel in fifty is \
             brighter than white",
            path.display()
        ));
    }
    write_frame(path, frame, found)
}

/// The beauty of a frame as a PNG shows it: without what alpha took of it.
///
/// # Errors
/// [`crate::Kind::Input`] for a frame without colours.
pub fn shown(frame: &Frame) -> Result<Picture> {
    let mut picture = frame.picture("", &frame.region)?;
    if let Some(alpha) = alpha(frame) {
        for (pixel, &alpha) in picture.pixels.iter_mut().zip(alpha) {
            if alpha > 0.0 {
                *pixel = pixel.map(|v| v / alpha);
            }
        }
    }
    Ok(picture)
}

fn alpha(frame: &Frame) -> Option<&[f32]> {
    frame.layer("")?.channel("A")
}

fn encode(path: &Path, size: [usize; 2], pixels: &[u8], color: ExtendedColorType) -> Result<()> {
    let side =
        |v: usize| u32::try_from(v).map_err(|_| Error::input("the image is too large for PNG"));
    let mut bytes = Vec::new();
    PngEncoder::new_with_quality(&mut bytes, CompressionType::Default, FilterType::Adaptive)
        .write_image(pixels, side(size[0])?, side(size[1])?, color)
        .map_err(|e| Error::failed(format!("cannot encode {}: {e}", path.display())))?;
    Output::write_all_to(path, &bytes)
}

/// Reads a PNG file as eight-bit RGB; transparency is ignored.
///
/// # Errors
/// [`crate::Kind::Input`] if the file is not there, or is no PNG, or is damaged.
pub fn read(path: &Path) -> Result<Display> {
    let file = File::open(path).map_err(|e| Error::io("read", path, &e))?;
    let mut reader = ImageReader::with_format(BufReader::new(file), ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODED_BYTES);
    reader.limits(limits);
    let image = reader
        .decode()
        .map_err(|e| Error::input(format!("cannot read {} as PNG: {e}", path.display())))?
        .into_rgb8();
    Ok(Display {
        width: image.width() as usize,
        height: image.height() as usize,
        pixels: image.pixels().map(|p| p.0).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_survive_a_round_trip() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        let display = Display {
            width: 5,
            height: 3,
            pixels: (0..15u8).map(|i| [i, 255 - i, 17 * i]).collect(),
        };
        write(&path, &display).unwrap();
        assert_eq!(read(&path).unwrap(), display);
    }

    #[test]
    fn damaged_files_are_input_errors() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.png");
        for bytes in [&b""[..], b"\x89PNG\r\n\x1a\n", b"P6 1 1 255\n..."] {
            std::fs::write(&path, bytes).unwrap();
            let error = read(&path).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
            assert!(error.to_string().contains("a.png"));
        }
    }
}
