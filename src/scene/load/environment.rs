//! Environment images: OpenEXR and Radiance HDR.

use super::files::{Files, extension};
use crate::run::size;
use crate::scene::EnvironmentImage;
use crate::{Error, Result};
use exr::meta::MetaData;
use exr::prelude::{ReadChannels, ReadLayers, RgbChannels, Vec2};
use glam::{Mat3, Vec3};
use image::ImageDecoder;
use image::codecs::hdr::HdrDecoder;
use std::fmt::Display;
use std::io::Cursor;
use std::path::Path;

/// Where red, green, blue and white of Rec. 709 lie, as CIE x and y.
const REC_709: [[f32; 2]; 4] = [[0.64, 0.33], [0.3, 0.6], [0.15, 0.06], [0.3127, 0.329]];

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
        let has = |name: &&str| channels.iter().any(|c| c.name.eq(name));
        !header.deep && ["R", "G", "B"].iter().all(has)
    };
    let Some(header) = meta.headers.iter().find(is_color) else {
        let channels = meta.headers.iter().flat_map(|h| &h.channels.list);
        let names: Vec<String> = channels.map(|c| c.name.to_string()).collect();
        return Err(Error::input(format!(
            "expected an image with the channels R, G and B, found {}",
            names.join(", ")
        )));
    };
    let window = ImageWindow::new(header);
    let Vec2(width, height) = window.size;
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
    let (across, texels) = image.layer_data.channel_data.pixels;
    let mut texels = window.filled(across, texels);
    if let Some(c) = image.attributes.chromaticities {
        let found = [c.red, c.green, c.blue, c.white].map(|Vec2(x, y)| [x, y]);
        to_rec709(found, &mut texels);
    }
    without_ringing(&mut texels, files);
    let side = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    EnvironmentImage::new(side(width), side(height), texels)
}

/// The part of the sphere's image that a file holds.
struct ImageWindow {
    /// Pixels of the whole image.
    size: Vec2<usize>,
    /// Where those of the file begin in it.
    from: [i64; 2],
}

impl ImageWindow {
    /// The display window, if that is a lat-long image; else what is held counts as one.
    fn new(header: &exr::meta::header::Header) -> Self {
        let whole = header.shared_attributes.display_window;
        let Vec2(width, height) = whole.size;
        if width != 2 * height {
            return Self {
                size: header.layer_size,
                from: [0; 2],
            };
        }
        let Vec2(x, y) = header.own_attributes.layer_position;
        let Vec2(x0, y0) = whole.position;
        Self {
            size: whole.size,
            from: [i64::from(x) - i64::from(x0), i64::from(y) - i64::from(y0)],
        }
    }

    /// The whole image from the texels that are held, rows of `across`; black elsewhere.
    fn filled(&self, across: usize, held: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
        let Vec2(width, height) = self.size;
        let rows = held.len() / across.max(1);
        if self.from == [0; 2] && (across, rows) == (width, height) {
            return held;
        }
        let mut texels = vec![[0.0; 3]; width * height];
        for (row, held) in held.chunks(across.max(1)).enumerate() {
            for (column, texel) in held.iter().enumerate() {
                let [x, y] = [column, row].map(|n| n as i64);
                let (x, y) = (x + self.from[0], y + self.from[1]);
                if (0..width as i64).contains(&x) && (0..height as i64).contains(&y) {
                    texels[y as usize * width + x as usize] = *texel;
                }
            }
        }
        texels
    }
}

/// Takes colours of other primaries to those of Rec. 709, of the same chromaticity: white points
/// are not adapted to each other.
fn to_rec709(found: [[f32; 2]; 4], texels: &mut [[f32; 3]]) {
    /// Of what files write as Rec. 709.
    const ROUNDING: f32 = 2e-3;
    let mut pairs = found.as_flattened().iter().zip(REC_709.as_flattened());
    if pairs.all(|(a, b)| (a - b).abs() < ROUNDING) {
        return;
    }
    let to_own = xyz_from_rgb(REC_709).inverse() * xyz_from_rgb(found);
    if !to_own.is_finite() {
        return;
    }
    for texel in texels {
        *texel = (to_own * Vec3::from(*texel)).max(Vec3::ZERO).to_array();
    }
}

/// From red, green and blue of given chromaticities, and white of the last, to CIE XYZ.
fn xyz_from_rgb(chromaticities: [[f32; 2]; 4]) -> Mat3 {
    let [r, g, b, white] = chromaticities.map(|[x, y]| Vec3::new(x / y, 1.0, (1.0 - x - y) / y));
    let primaries = Mat3::from_cols(r, g, b);
    primaries * Mat3::from_diagonal(primaries.inverse() * white)
}

/// Takes what is a little negative, as filters leave it beside what is bright, for black, and says
/// so.
fn without_ringing(texels: &mut [[f32; 3]], files: &mut Files) {
    /// Of the brightest.
    const LITTLE: f32 = 0.01;
    let all = texels.as_flattened();
    let brightest = all.iter().copied().fold(0.0, f32::max);
    let least = all.iter().copied().fold(0.0, f32::min);
    if least >= 0.0 || -least > LITTLE * brightest {
        return;
    }
    let mut count = 0_usize;
    for value in texels.as_flattened_mut().iter_mut().filter(|v| **v < 0.0) {
        *value = 0.0;
        count += 1;
    }
    files.warnings.push(format!(
        "an environment image has {count} values below 0, down to {least:.2e}, \
         which are taken for 0"
    ));
}

fn radiance_hdr(content: &[u8], files: &mut Files) -> Result<EnvironmentImage> {
    // Not all programs write the same first line.
    let decoder = HdrDecoder::new_nonstrict(Cursor::new(content)).map_err(|e| refused(&e))?;
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
    fn a_part_of_an_image_lies_where_its_window_is() {
        use exr::prelude::{Encoding, SpecificChannels, WritableImage};
        use exr::prelude::{Image, ImageAttributes, IntegerBounds, Layer, LayerAttributes};
        let of = |x0: i32, y0: i32| {
            let pixel = |Vec2(x, y): Vec2<usize>| (1.0 + x as f32, 1.0 + y as f32, 2.0_f32);
            let attributes = LayerAttributes {
                layer_position: Vec2(x0, y0),
                ..LayerAttributes::default()
            };
            let channels = SpecificChannels::rgb(pixel);
            let layer = Layer::new((4, 2), attributes, Encoding::default(), channels);
            let image = Image {
                attributes: ImageAttributes::new(IntegerBounds::new((0, 0), (8, 4))),
                layer_data: layer,
            };
            let mut bytes = Cursor::new(Vec::new());
            image.write().to_buffered(&mut bytes).unwrap();
            open_exr(&bytes.into_inner(), &mut Files::default()).unwrap()
        };
        for [x0, y0] in [[2, 1], [-1, -1], [6, 3]] {
            let image = of(x0, y0);
            assert_eq!(image.size(), [8, 4]);
            for (i, texel) in image.texels().iter().enumerate() {
                let (x, y) = (i as i32 % 8 - x0, i as i32 / 8 - y0);
                let is_held = (0..4).contains(&x) && (0..2).contains(&y);
                let expected = match is_held {
                    true => [1.0 + x as f32, 1.0 + y as f32, 2.0],
                    false => [0.0; 3],
                };
                assert_eq!(*texel, expected, "{x0} {y0} {i}");
            }
        }
    }

    #[test]
    fn other_primaries_become_those_of_rec_709() {
        let ap1 = [
            [0.713, 0.293],
            [0.165, 0.83],
            [0.128, 0.044],
            [0.32168, 0.33767],
        ];
        let mut texels = [[0.2, 0.4, 1.0]];
        to_rec709(ap1, &mut texels);
        for (found, expected) in texels[0].iter().zip([0.025, 0.419, 1.011]) {
            assert!((found - expected).abs() < 2e-3, "{texels:?}");
        }
        let mut same = [[0.2, 0.4, 1.0]];
        to_rec709(REC_709, &mut same);
        assert_eq!(same, [[0.2, 0.4, 1.0]]);
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
        bad[3][1] = -100.0;
        assert!(said(open_exr, &exr(8, bad)).contains("from 0 to"));
        let mut files = Files::default();
        files.settings.texture_limit = 100;
        let error = open_exr(&whole[0], &mut files).unwrap_err().to_string();
        assert!(error.contains("`texture_limit`"), "{error}");
    }
}
