//! Textures, decoded to codes of 8 or 16 bits: PNG, JPEG, TGA, BMP, TIFF, GIF and WebP.

use super::colors::ColorEncoding;
use super::files::Files;
use super::images::{ImageKey, ImagePart};
use super::left_out::LeftOut;
use crate::math::Rgb;
use crate::scene::builder::MeshInput;
use crate::scene::texture::{CodeValues, Codes};
use crate::scene::{Material, Texture};
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};
use std::fmt::Display;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

/// What to make of the texels of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Decoding {
    pub(super) encoding: ColorEncoding,
    /// Added to encoded values, after the factor.
    pub(super) base: f32,
    /// Factor on encoded values.
    pub(super) gain: f32,
}

impl Default for Decoding {
    fn default() -> Self {
        Self {
            encoding: ColorEncoding::Srgb,
            base: 0.0,
            gain: 1.0,
        }
    }
}

impl Decoding {
    fn texel(&self, encoded: f32) -> f32 {
        let changed = match (self.base, self.gain) {
            (0.0, 1.0) => encoded,
            (base, gain) => (base + gain * encoded).clamp(0.0, 1.0),
        };
        self.encoding.linear(changed)
    }
}

/// Reads the texture that the file `by` names. One that is not there or cannot be decoded is noted,
/// at `place`, and is none.
///
/// # Errors
/// If the machine fails, or on a stop on request.
pub(super) fn load(
    by: &Path,
    name: &str,
    decoding: Decoding,
    left_out: &mut LeftOut,
    files: &mut Files,
) -> Result<Option<Texture>> {
    load_as(by, name, left_out, files, |content, path, files| {
        decode(content, path, decoding, files)
    })
}

/// Reads the opacity that the file `by` names, as [`load`] does.
///
/// # Errors
/// As [`load`].
pub(super) fn load_opacity(
    by: &Path,
    name: &str,
    decoding: Decoding,
    left_out: &mut LeftOut,
    files: &mut Files,
) -> Result<Option<Texture>> {
    load_as(by, name, left_out, files, |content, path, files| {
        decode_opacity(content, path, decoding, files)
    })
}

fn load_as(
    by: &Path,
    name: &str,
    left_out: &mut LeftOut,
    files: &mut Files,
    decode: impl Fn(&[u8], &Path, &mut Files) -> Result<Result<Texture>>,
) -> Result<Option<Texture>> {
    let path = match files.find("texture", by, name) {
        Ok(Some(path)) => path,
        Ok(None) => {
            let what = "textures that are not there are left out";
            left_out.note(what, format_args!("`{name}`"));
            return Ok(None);
        }
        Err(e) => return noted(Err(e), format_args!("`{name}`"), left_out),
    };
    let read = files.read("texture", &path);
    let image = match read {
        Ok(content) => decode(&content, &path, files)?,
        Err(e) => Err(e),
    };
    noted(image, format_args!("`{name}`"), left_out)
}

/// An image of a file that cannot be read is noted, and is none.
///
/// # Errors
/// If it is not the file that is wrong.
pub(super) fn noted<T>(
    image: Result<T>,
    name: impl Display,
    left_out: &mut LeftOut,
) -> Result<Option<T>> {
    match image {
        Ok(image) => Ok(Some(image)),
        Err(e) if e.kind() == crate::Kind::Input => {
            let what = "textures that cannot be read are left out";
            left_out.note(what, format_args!("{name} ({e})"));
            Ok(None)
        }
        Err(e) => Err(e),
    }
}

/// Decodes the opacity that an image file states: its alpha, or else its grey.
///
/// # Errors
/// As [`decode`].
pub(super) fn decode_opacity(
    content: &[u8],
    path: &Path,
    decoding: Decoding,
    files: &mut Files,
) -> Result<Result<Texture>> {
    let decoding = Decoding {
        encoding: ColorEncoding::Linear,
        ..decoding
    };
    match decode_alpha(content, path, decoding, files)? {
        Ok(Some(alpha)) => Ok(Ok(alpha)),
        Ok(None) => decode(content, path, decoding, files),
        Err(e) => Ok(Err(e)),
    }
}

/// Decodes the alpha of an image file as a texture of one channel; `None` if it has none.
///
/// # Errors
/// As [`decode`].
pub(super) fn decode_alpha(
    content: &[u8],
    path: &Path,
    decoding: Decoding,
    files: &mut Files,
) -> Result<Result<Option<Texture>>> {
    decode_part(content, path, ImagePart::Alpha, decoding, files)
}

/// Decodes an image file; alpha is dropped. The kind of file is told by its content, or else by the
/// extension of `path`, as for TGA. Images of the same content share their texels. The inner error
/// is that of a file that is no image.
///
/// # Errors
/// More memory for textures than the files of the scene may take, or than the machine has.
pub(super) fn decode(
    content: &[u8],
    path: &Path,
    decoding: Decoding,
    files: &mut Files,
) -> Result<Result<Texture>> {
    let none = || refused(&"it has no colours");
    let image = decode_part(content, path, ImagePart::Color, decoding, files)?;
    Ok(image.and_then(|image| image.ok_or_else(none)))
}

fn decode_part(
    content: &[u8],
    path: &Path,
    part: ImagePart,
    decoding: Decoding,
    files: &mut Files,
) -> Result<Result<Option<Texture>>> {
    let mut reader = match ImageReader::new(Cursor::new(content)).with_guessed_format() {
        Ok(reader) => reader,
        Err(e) => return Ok(Err(refused(&e))),
    };
    if reader.format().is_none()
        && let Ok(format) = ImageFormat::from_path(path)
    {
        reader.set_format(format);
    }
    let format = reader.format();
    if format == Some(ImageFormat::Hdr) {
        return Ok(Err(refused(&"Radiance HDR")));
    }
    let mut decoder = match reader.into_decoder() {
        Ok(decoder) => decoder,
        Err(e) => return Ok(Err(refused(&e))),
    };
    let (width, height) = decoder.dimensions();
    if width == 0 || height == 0 {
        return Ok(Err(Error::input(format!(
            "the image is {width} x {height}"
        ))));
    }
    if part == ImagePart::Alpha && !decoder.color_type().has_alpha() {
        return Ok(Ok(None));
    }
    let key: ImageKey = (*blake3::hash(content).as_bytes(), format, part);
    let codes = match files.images.get(&key) {
        Some(codes) => codes.clone(),
        None => {
            let bytes = decoder.total_bytes();
            let name = format_args!("{}: a texture of {width} x {height}", path.display());
            files
                .images
                .check(name, bytes, files.settings.texture_limit)?;
            // That of the texels is checked; this is for what is needed on the way.
            let mut limits = Limits::default();
            limits.max_alloc = limits.max_alloc.map(|most| most.saturating_add(bytes));
            let image = decoder
                .set_limits(limits)
                .and_then(|()| DynamicImage::from_decoder(decoder));
            let codes = match image {
                Ok(image) => Arc::new(match part {
                    ImagePart::Color => codes(image),
                    ImagePart::Alpha => alpha(image),
                }),
                Err(e) => return Ok(Err(refused(&e))),
            };
            files.images.add(key, codes.clone());
            codes
        }
    };
    let last = codes.colors() - 1;
    let linear = (0..=last).map(|code| decoding.texel(code as f32 / last as f32));
    let texture = Texture::coded(width, height, codes, linear.collect());
    Ok(Ok(Some(texture)))
}

fn refused(e: &dyn Display) -> Error {
    let text = e.to_string();
    let first_line = text.lines().next().unwrap_or_default();
    Error::input(format!("not an image that can be read: {first_line}"))
        .hint("textures are PNG, JPEG, TGA, BMP, TIFF, GIF or WebP files")
}

/// The texels of an image in the memory that it has, or less.
fn codes(image: DynamicImage) -> Codes {
    let (channels, values) = match image {
        DynamicImage::ImageLuma8(image) => (1, CodeValues::Bytes(image.into_raw().into())),
        DynamicImage::ImageLumaA8(image) => (
            1,
            CodeValues::Bytes(without_alpha(image.into_raw(), 2).into()),
        ),
        DynamicImage::ImageRgb8(image) => (3, CodeValues::Bytes(image.into_raw().into())),
        DynamicImage::ImageRgba8(image) => (
            3,
            CodeValues::Bytes(without_alpha(image.into_raw(), 4).into()),
        ),
        DynamicImage::ImageLuma16(image) => (1, CodeValues::Words(image.into_raw().into())),
        DynamicImage::ImageLumaA16(image) => (
            1,
            CodeValues::Words(without_alpha(image.into_raw(), 2).into()),
        ),
        DynamicImage::ImageRgba16(image) => (
            3,
            CodeValues::Words(without_alpha(image.into_raw(), 4).into()),
        ),
        other => (3, CodeValues::Words(other.into_rgb16().into_raw().into())),
    };
    Codes { channels, values }
}

/// The alpha of an image that has one.
fn alpha(image: DynamicImage) -> Codes {
    let values = match image {
        DynamicImage::ImageLumaA8(image) => CodeValues::Bytes(last_of(&image, 2).into()),
        DynamicImage::ImageRgba8(image) => CodeValues::Bytes(last_of(&image, 4).into()),
        other => CodeValues::Words(last_of(&other.into_rgba16(), 4).into()),
    };
    let channels = 1;
    Codes { channels, values }
}

/// The last of so many channels of pixels.
fn last_of<T: Copy>(values: &[T], channels: usize) -> Vec<T> {
    values[channels - 1..]
        .iter()
        .step_by(channels)
        .copied()
        .collect()
}

/// What is left of pixels of so many channels without the last of these.
fn without_alpha<T: Copy>(mut values: Vec<T>, channels: usize) -> Vec<T> {
    let kept = channels - 1;
    let pixels = values.len() / channels;
    for pixel in 0..pixels {
        values.copy_within(pixel * channels..pixel * channels + kept, pixel * kept);
    }
    values.truncate(pixels * kept);
    values.shrink_to_fit();
    values
}

/// Lets the mean colours of textures stand for them, where nothing says which part of a texture is
/// meant.
pub(super) fn replace_by_means(mesh: &mut MeshInput) {
    for material in &mut mesh.materials {
        if let Some(index) = material.texture.take() {
            let mean = mean(&mesh.textures[index as usize]);
            material.albedo = std::array::from_fn(|i| material.albedo[i] * mean[i]);
        }
        if let Some(mask) = &mut material.mask
            && let Some(index) = mask.texture.take()
        {
            mask.opacity *= Rgb(mean(&mesh.textures[index as usize])).luminance();
        }
        replace_emission_by_mean(material, &mesh.textures);
    }
    mesh.textures.clear();
}

/// Lets the mean of the texture of an emission stand for it.
pub(super) fn replace_emission_by_mean(material: &mut Material, textures: &[Texture]) {
    if let Some(index) = material.emission_texture.take() {
        let mean = mean(&textures[index as usize]);
        material.emission = std::array::from_fn(|i| material.emission[i] * mean[i]);
    }
}

/// The mean colour.
pub(super) fn mean(texture: &Texture) -> [f32; 3] {
    let texels = texture.texels();
    let count = texels.len() as f64;
    let sum = texels.fold(DVec3::ZERO, |sum, t| sum + Vec3::from(t).as_dvec3());
    (sum / count).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::super::colors::linear_from_srgb;
    use super::*;

    fn decoded(content: &[u8], files: &mut Files) -> Result<Texture> {
        decode(content, Path::new("a.png"), Decoding::default(), files)?
    }

    fn png(image: impl Into<DynamicImage>) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn a_png_comes_back_row_by_row_from_the_top() {
        let image = image::RgbImage::from_fn(2, 3, |x, y| image::Rgb([255 * x as u8, 0, y as u8]));
        let texture = decoded(&png(image), &mut Files::default()).unwrap();
        assert_eq!((texture.width, texture.height), (2, 3));
        let texels: Vec<_> = texture.texels().collect();
        assert_eq!(texels[1], [1.0, 0.0, 0.0]);
        assert_eq!(texels[4][2], linear_from_srgb(2.0 / 255.0));
        let error = decoded(b"nothing", &mut Files::default()).unwrap_err();
        assert!(error.to_string().contains("image"));
    }

    /// Against the image as RGB, each value made linear by itself.
    #[test]
    fn images_of_all_kinds_are_what_they_are_as_rgb() {
        let noise = |x: u32, y: u32, c: u32| (x * 7919 + y * 104_729 + c * 1_299_709) as u16;
        let kinds: [DynamicImage; 8] = [
            image::GrayImage::from_fn(5, 3, |x, y| image::Luma([noise(x, y, 0) as u8])).into(),
            image::GrayAlphaImage::from_fn(5, 3, |x, y| {
                image::LumaA([0, 1].map(|c| noise(x, y, c) as u8))
            })
            .into(),
            image::RgbImage::from_fn(5, 3, |x, y| {
                image::Rgb([0, 1, 2].map(|c| noise(x, y, c) as u8))
            })
            .into(),
            image::RgbaImage::from_fn(5, 3, |x, y| {
                image::Rgba([0, 1, 2, 3].map(|c| noise(x, y, c) as u8))
            })
            .into(),
            image::ImageBuffer::from_fn(5, 3, |x, y| image::Luma([noise(x, y, 0)])).into(),
            image::ImageBuffer::from_fn(5, 3, |x, y| image::LumaA([0, 1].map(|c| noise(x, y, c))))
                .into(),
            image::ImageBuffer::from_fn(5, 3, |x, y| image::Rgb([0, 1, 2].map(|c| noise(x, y, c))))
                .into(),
            image::ImageBuffer::from_fn(5, 3, |x, y| {
                image::Rgba([0, 1, 2, 3].map(|c| noise(x, y, c)))
            })
            .into(),
        ];
        for image in kinds {
            let name = format!("{:?}", image.color());
            let is_8_bit = image.color().bytes_per_pixel() == image.color().channel_count();
            let texture = decoded(&png(image.clone()), &mut Files::default()).unwrap();
            assert_eq!(texture.bits(), if is_8_bit { 8 } else { 16 }, "{name}");
            let decoding = Decoding::default();
            let plain: Vec<[f32; 3]> = match is_8_bit {
                true => (image.into_rgb8().pixels())
                    .map(|p| p.0.map(|c| decoding.texel(f32::from(c) / 255.0)))
                    .collect(),
                false => (image.into_rgb16().pixels())
                    .map(|p| p.0.map(|c| decoding.texel(f32::from(c) / 65535.0)))
                    .collect(),
            };
            assert_eq!(texture.texels().collect::<Vec<_>>(), plain, "{name}");
        }
    }

    #[test]
    fn alpha_is_taken_where_there_is_one_and_grey_elsewhere() {
        let rgba =
            image::RgbaImage::from_fn(3, 2, |x, y| image::Rgba([9, 8, 7, (x + 3 * y) as u8]));
        let wide = image::ImageBuffer::from_fn(3, 2, |x, y| {
            image::LumaA([7_u16, 1000 * (x + 3 * y) as u16])
        });
        let grey = image::GrayImage::from_fn(3, 2, |x, y| image::Luma([(x + 3 * y) as u8]));
        let (path, plain) = (Path::new("a.png"), Decoding::default());
        for (image, one, has_alpha) in [
            (png(rgba), 255.0, true),
            (png(wide), 65.535, true),
            (png(grey), 255.0, false),
        ] {
            let mut files = Files::default();
            let alpha = decode_alpha(&image, path, plain, &mut files)
                .unwrap()
                .unwrap();
            assert_eq!(alpha.is_some(), has_alpha);
            let opacity = decode_opacity(&image, path, plain, &mut files)
                .unwrap()
                .unwrap();
            for (i, [r, g, b]) in opacity.texels().enumerate() {
                assert!(
                    r == g && r == b && (r - i as f32 / one).abs() < 1e-6,
                    "{r} {i}"
                );
            }
            // Its colours are another texture.
            let color = decoded(&image, &mut files).unwrap();
            assert!(!color.shares_texels(&opacity) || !has_alpha);
        }
    }

    #[test]
    fn the_same_image_is_kept_once_and_a_large_one_refused_before_it_is_decoded() {
        let grey = png(image::GrayImage::from_pixel(40, 30, image::Luma([9])));
        let other = png(image::GrayImage::from_pixel(40, 30, image::Luma([8])));
        let mut files = Files::default();
        files.settings.texture_limit = 2000;
        let first = decoded(&grey, &mut files).unwrap();
        let linear = Decoding {
            encoding: ColorEncoding::Linear,
            ..Decoding::default()
        };
        let second = decode(&grey, Path::new("b.png"), linear, &mut files).unwrap();
        assert!(second.unwrap().shares_texels(&first));
        let error = decode(&other, Path::new("b.png"), linear, &mut files).unwrap_err();
        assert_eq!(
            error.to_string(),
            "b.png: a texture of 40 x 30 takes 1.17 KiB beside 1.17 KiB of other textures, more \
             than the `texture_limit` of 1.95 KiB"
        );
        assert!(error.hint_text().unwrap().contains("`texture_limit`"));
        // It is no image that is left out, either.
        let dir = tempfile::tempdir().unwrap();
        std::fs::write(dir.path().join("b.png"), &other).unwrap();
        let by = dir.path().join("a.mtl");
        load(&by, "b.png", linear, &mut LeftOut::default(), &mut files).unwrap_err();
        files.settings.texture_limit = 2400;
        load(&by, "b.png", linear, &mut LeftOut::default(), &mut files)
            .unwrap()
            .unwrap();
    }
}
