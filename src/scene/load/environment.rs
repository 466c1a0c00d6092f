//! Environment images: OpenEXR and Radiance HDR.

use super::files::{Files, extension};
use crate::run::size;
use crate::scene::EnvironmentImage;
use crate::{Error, Result};
use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, RgbChannels, Vec2};
use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;
use std::fmt::Display;
use std::io::Cursor;
use std::path::Path;

/// Reads the image at `path`.
///
/// # Errors
/// A file that is not there, is no lat-long image, holds what is no radiance, or takes more memory
/// than textures may.
pub(super) fn load(path: &Path, files: &mut Files) -> Result<EnvironmentImage> {
    let read = match extension(path).as_str() {
        "exr" => open_exr,
        "hdr" => radiance_hdr,
        other => {
            return Err(Error::input(format!(
                "{}: an environment image with the extension \"{other}\" is not supported",
                path.display()
            ))
            .hint("environment images are .exr or .hdr files"));
        }
    };
    let content = files.read("environment image", path)?;
    read(&content, files).map_err(|e| e.at(path.display()))
}

/// Refuses an image of a size that none has, that takes too much memory, or that cannot come out of
/// a file of so many bytes.
fn check(width: usize, height: usize, content: &[u8], files: &mut Files) -> Result<()> {
    // The codecs shrink at most 1032 times, but for flat pictures, for which the rest is enough.
    const MOST_SHRUNK: u64 = 1032;
    const ALLOWED_BYTES: u64 = 64 << 20;
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    EnvironmentImage::check_size(side(width), side(height))?;
    let bytes = (width * height * size_of::<[f32; 3]>()) as u64;
    if bytes > content.len() as u64 * MOST_SHRUNK + ALLOWED_BYTES {
        let [bytes, found] = [bytes, content.len() as u64].map(size::format);
        return Err(Error::input(format!(
            "{bytes} of radiance cannot come out of {found}: the file is damaged or cut"
        )));
    }
    let name = format_args!("an environment image of {width} x {height}");
    let limit = files.settings.texture_limit;
    files.images.check(name, bytes, limit)?;
    files.images.count(bytes);
    files.cancel.check()
}

fn refused(e: &dyn Display) -> Error {
    let text = e.to_string();
    let first_line = text.lines().next().unwrap_or_default();
    Error::input(format!("not an image that can be read: {first_line}"))
}

/// The first layer of an OpenEXR file that has red, green and blue.
fn open_exr(content: &[u8], files: &mut Files) -> Result<EnvironmentImage> {
    let meta = MetaData::read_from_buffered(Cursor::new(content), false);
    let meta = meta.map_err(|e| refused(&e))?;
    let is_color = |header: &&exr::meta::header::Header| {
        let channels = &header.channels.list;
        let has = |name: &&str| channels.iter().any(|c| c.name.eq_case_insensitive(name));
        !header.deep && ["R", "G", "B"].iter().all(has)
    };
    let Some(header) = meta.headers.iter().find(is_color) else {
        return Err(Error::input(
            "expected an image with the channels R, G and B, found none",
        ));
    };
    let Vec2(width, height) = header.layer_size;
    check(width, height, content, files)?;
    type Texels = (usize, Vec<[f32; 3]>);
    let create = |size: Vec2<usize>, _: &RgbChannels| -> Texels {
        (size.0, vec![[0.0; 3]; size.0 * size.1])
    };
    let set = |(width, texels): &mut Texels, at: Vec2<usize>, (r, g, b): (f32, f32, f32)| {
        texels[at.1 * *width + at.0] = [r, g, b];
    };
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(create, set)
        .first_valid_layer()
        .all_attributes()
        .from_buffered(Cursor::new(content))
        .map_err(|e| refused(&e))?;
    let Vec2(width, height) = image.layer_data.size;
    let (_, texels) = image.layer_data.channel_data.pixels;
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    EnvironmentImage::new(side(width), side(height), texels)
}

fn radiance_hdr(content: &[u8], files: &mut Files) -> Result<EnvironmentImage> {
    let decoder = HdrDecoder::new(Cursor::new(content)).map_err(|e| refused(&e))?;
    let (width, height) = decoder.dimensions();
    check(width as usize, height as usize, content, files)?;
    let mut texels = vec![[0.0_f32; 3]; width as usize * height as usize];
    let bytes = bytemuck::cast_slice_mut(&mut texels);
    decoder.read_image(bytes).map_err(|e| refused(&e))?;
    EnvironmentImage::new(width, height, texels)
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::hdr::HdrEncoder;

    fn hdr(width: usize, texels: &[[f32; 3]]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let pixels: Vec<_> = texels.iter().map(|t| image::Rgb(*t)).collect();
        let height = texels.len() / width;
        HdrEncoder::new(&mut bytes)
            .encode(&pixels, width, height)
            .unwrap();
        bytes
    }

    fn exr(width: usize, texels: Vec<[f32; 3]>) -> Vec<u8> {
        use exr::prelude::{Image, SpecificChannels, WritableImage};
        let height = texels.len() / width;
        let pixel = move |Vec2(x, y): Vec2<usize>| {
            let [r, g, b] = texels[y * width + x];
            (r, g, b)
        };
        let image = Image::from_channels((width, height), SpecificChannels::rgb(pixel));
        let mut bytes = Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes).unwrap();
        bytes.into_inner()
    }

    /// Numbers that both formats hold exactly.
    fn texels(width: u32) -> Vec<[f32; 3]> {
        let texel = |i: u32| [1.0, 0.5, 0.25].map(|v| v * (1 << (i % 11)) as f32);
        (0..width * width / 2).map(texel).collect()
    }

    #[test]
    fn both_formats_come_back_row_by_row_from_the_top() {
        for width in [4, 32] {
            let expected = texels(width);
            let across = width as usize;
            let mut files = Files::default();
            let images = [
                open_exr(&exr(across, expected.clone()), &mut files).unwrap(),
                radiance_hdr(&hdr(across, &expected), &mut files).unwrap(),
            ];
            for image in images {
                assert_eq!(image.size(), [width, width / 2]);
                assert_eq!(image.texels(), expected);
            }
        }
    }

    #[test]
    fn bad_files_are_told_in_one_line() {
        let said = |read: fn(&[u8], &mut Files) -> Result<EnvironmentImage>, content: &[u8]| {
            let error = read(content, &mut Files::default()).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
            let said = error.to_string();
            assert!(!said.contains('\n'), "{said}");
            said
        };
        let whole = [exr(8, texels(8)), hdr(8, &texels(8))];
        for (read, whole) in [open_exr as fn(&[u8], &mut Files) -> _, radiance_hdr]
            .into_iter()
            .zip(&whole)
        {
            for length in [0, 5, whole.len() / 2] {
                let said = said(read, &whole[..length]);
                assert!(said.contains("image that can be read"), "{length} {said}");
            }
        }
        assert!(said(radiance_hdr, &hdr(8, &texels(8)[..24])).contains("found 8 x 3"));
        let mut bad = texels(8);
        bad[3][1] = f32::NAN;
        assert!(said(open_exr, &exr(8, bad.clone())).contains("column 3 of row 0"));
        bad[3][1] = -1.0;
        assert!(said(open_exr, &exr(8, bad)).contains("from 0 to"));
        let mut files = Files::default();
        files.settings.texture_limit = 100;
        let error = open_exr(&whole[0], &mut files).unwrap_err().to_string();
        assert!(error.contains("`texture_limit`"), "{error}");
    }
}
