//! PNG and JPEG textures, decoded from sRGB to linear RGB.

use crate::scene::Texture;
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use image::ImageReader;
use std::io::Cursor;

/// Linear value of an sRGB-encoded one, both in [0,1].
pub(super) fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.04045 {
        encoded / 12.92
    } else {
        libm::powf((encoded + 0.055) / 1.055, 2.4)
    }
}

/// Decodes an image file; alpha is dropped.
pub(super) fn decode(content: &[u8]) -> Result<Texture> {
    let refused = |e: &dyn std::fmt::Display| {
        Error::input(format!("not an image that can be read: {e}"))
            .hint("textures are PNG or JPEG files")
    };
    let reader = ImageReader::new(Cursor::new(content))
        .with_guessed_format()
        .map_err(|e| refused(&e))?;
    let image = reader.decode().map_err(|e| refused(&e))?;
    let (width, height) = (image.width(), image.height());
    if width == 0 || height == 0 {
        return Err(Error::input(format!("the image is {width} x {height}")));
    }
    let texels = match image.color().bytes_per_pixel() / image.color().channel_count() {
        1 => {
            let table: Vec<f32> = (0..256)
                .map(|i| linear_from_srgb(i as f32 / 255.0))
                .collect();
            let rgb = image.into_rgb8();
            rgb.pixels()
                .map(|p| p.0.map(|c| table[c as usize]))
                .collect()
        }
        _ => {
            let rgb = image.into_rgb16();
            rgb.pixels()
                .map(|p| p.0.map(|c| linear_from_srgb(f32::from(c) / 65535.0)))
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

/// The mean colour.
pub(super) fn mean(texture: &Texture) -> [f32; 3] {
    let texels = texture.texels.iter();
    let sum = texels.fold(DVec3::ZERO, |sum, t| sum + Vec3::from(*t).as_dvec3());
    (sum / texture.texels.len() as f64).as_vec3().to_array()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_is_decoded() {
        assert_eq!(linear_from_srgb(0.0), 0.0);
        assert_eq!(linear_from_srgb(1.0), 1.0);
        assert!((linear_from_srgb(0.5) - 0.214_041).abs() < 1e-6);
    }

    #[test]
    fn a_png_comes_back_row_by_row_from_the_top() {
        let image = image::RgbImage::from_fn(2, 3, |x, y| image::Rgb([255 * x as u8, 0, y as u8]));
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, image::ImageFormat::Png).unwrap();
        let texture = decode(bytes.get_ref()).unwrap();
        assert_eq!((texture.width, texture.height), (2, 3));
        assert_eq!(texture.texels[1], [1.0, 0.0, 0.0]);
        assert_eq!(texture.texels[4][2], linear_from_srgb(2.0 / 255.0));
        assert!(
            decode(b"nothing")
                .unwrap_err()
                .to_string()
                .contains("image")
        );
    }
}
