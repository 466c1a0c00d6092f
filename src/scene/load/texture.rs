//! Textures, decoded to linear RGB: PNG, JPEG, TGA, BMP, TIFF, GIF and WebP.

use super::colors::ColorEncoding;
use super::files::{Files, find};
use super::left_out::LeftOut;
use crate::scene::Texture;
use crate::scene::builder::MeshInput;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use image::{ImageFormat, ImageReader};
use std::io::Cursor;
use std::path::Path;

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
    let Some(path) = find(by, name) else {
        let what = "textures that are not there are left out";
        left_out.note(what, format_args!("`{name}`"));
        return Ok(None);
    };
    let read = files.read("texture", &path);
    let image = read.and_then(|content| decode_as(&content, &path, decoding));
    match image {
        Ok(image) => Ok(Some(image)),
        Err(e) if e.kind() == crate::Kind::Input => {
            let what = "textures that cannot be read are left out";
            left_out.note(what, format_args!("`{name}` ({e})"));
            Ok(None)
        }
        Err(e) => Err(e),
    }
}

/// Decodes an image file of sRGB values; alpha is dropped.
pub(super) fn decode(content: &[u8], path: &Path) -> Result<Texture> {
    decode_as(content, path, Decoding::default())
}

/// Decodes an image file. The kind of file is told by its content, or else by the extension of
/// `path`, as for TGA.
fn decode_as(content: &[u8], path: &Path, decoding: Decoding) -> Result<Texture> {
    let refused = |e: &dyn std::fmt::Display| {
        let first_line = e.to_string().lines().next().unwrap_or_default().to_owned();
        Error::input(format!("not an image that can be read: {first_line}"))
            .hint("textures are PNG, JPEG, TGA, BMP, TIFF, GIF or WebP files")
    };
    let mut reader = ImageReader::new(Cursor::new(content))
        .with_guessed_format()
        .map_err(|e| refused(&e))?;
    if reader.format().is_none()
        && let Ok(format) = ImageFormat::from_path(path)
    {
        reader.set_format(format);
    }
    let image = reader.decode().map_err(|e| refused(&e))?;
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 {
        return Err(Error::input(format!("the image is {width} x {height}")));
    }
    let texels = match image.color().bytes_per_pixel() / image.color().channel_count() {
        1 => {
            let table: Vec<f32> = (0..256).map(|i| decoding.texel(i as f32 / 255.0)).collect();
            let rgb = image.into_rgb8();
            rgb.pixels()
                .map(|p| p.0.map(|c| table[c as usize]))
                .collect()
        }
        _ => {
            let rgb = image.into_rgb16();
            rgb.pixels()
                .map(|p| p.0.map(|c| decoding.texel(f32::from(c) / 65535.0)))
                .collect()
        }
    };
    Ok(Texture {
        width,
        height,
        texels,
        wrap: Default::default(),
    })
}

/// Lets the mean colours of textures stand for them, where nothing says which part of a texture is
/// meant.
pub(super) fn replace_by_means(mesh: &mut MeshInput) {
    for material in &mut mesh.materials {
        if let Some(index) = material.texture.take() {
            let mean = mean(&mesh.textures[index as usize]);
            material.albedo = std::array::from_fn(|i| material.albedo[i] * mean[i]);
        }
    }
    mesh.textures.clear();
}

/// The mean colour.
pub(super) fn mean(texture: &Texture) -> [f32; 3] {
    let texels = texture.texels.iter();
    let sum = texels.fold(DVec3::ZERO, |sum, t| sum + Vec3::from(*t).as_dvec3());
    (sum / texture.texels.len() as f64).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::super::colors::linear_from_srgb;
    use super::*;

    #[test]
    fn a_png_comes_back_row_by_row_from_the_top() {
        let image = image::RgbImage::from_fn(2, 3, |x, y| image::Rgb([255 * x as u8, 0, y as u8]));
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        let texture = decode(bytes.get_ref(), Path::new("a")).unwrap();
        assert_eq!((texture.width, texture.height), (2, 3));
        assert_eq!(texture.texels[1], [1.0, 0.0, 0.0]);
        assert_eq!(texture.texels[4][2], linear_from_srgb(2.0 / 255.0));
        assert!(
            decode(b"nothing", Path::new("a.jpg"))
                .unwrap_err()
                .to_string()
                .contains("image")
        );
    }
}
