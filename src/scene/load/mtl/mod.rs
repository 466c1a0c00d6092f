//! Wavefront MTL: `Kd`, `map_Kd` with its options, `d` or else `Tr`, `map_d`, `Ke` and `map_Ke`,
//! all linear but for colours of textures. Keywords may be in any letter case.
//!
//! In one line is warned of what is not diffuse: `illum` 3 to 10, `Ks` above what exporters write
//! for plain surfaces, `map_Ks`, `refl`, `Pm`, `Pc`, `Ps` and their maps, and bumps. `Ns`, `Ni`,
//! `Tf` and `Pr` say nothing by themselves.

use super::colors::ColorEncoding;
use super::files::{Files, text_start};
use super::images::ImagePart;
use super::left_out::{LeftOut, SurfaceFeature};
use super::texture::{self, Decoding};
use crate::scene::builder::{DEFAULT_ALBEDO, MAX_EMISSION};
use crate::scene::{Mask, Material, Texture, Wrap};
use crate::{Error, Result};
use glam::Vec2;
use std::collections::HashMap;
use std::path::Path;

/// Highlights of at most this are those of any plastic; exporters write it for all that is not told
/// apart.
const PLAIN_HIGHLIGHT: f32 = 0.5;

/// What an MTL file holds.
#[derive(Debug, Default)]
pub(super) struct Library {
    pub(super) materials: Vec<Material>,
    /// Where the texture of each material is on its surface.
    pub(super) uv_maps: Vec<UvMap>,
    pub(super) textures: Vec<Texture>,
}

/// A map of texture coordinates with v upwards: scale, then offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct UvMap {
    pub(super) scale: Vec2,
    pub(super) offset: Vec2,
}

impl UvMap {
    pub(super) const IDENTITY: Self = Self {
        scale: Vec2::ONE,
        offset: Vec2::ZERO,
    };
}

/// What a material says of itself beyond its diffuse reflection.
#[derive(Default)]
struct NonDiffuse {
    illum: Option<u32>,
    highlight: Option<[f32; 3]>,
    exponent: Option<f32>,
    has_highlight_map: bool,
    others: Vec<SurfaceFeature>,
}

impl NonDiffuse {
    /// Takes a statement in; its keyword is in lower case.
    fn read(&mut self, word: &str, rest: &str) {
        let is_above_0 = || color(rest).is_ok_and(|c| c.iter().any(|v| *v > 0.0));
        match word {
            "illum" => self.illum = rest.parse().ok(),
            "ks" => self.highlight = color(rest).ok(),
            "ns" => self.exponent = rest.parse().ok(),
            "map_ks" => self.has_highlight_map = true,
            "pm" if is_above_0() => self.others.push(SurfaceFeature::Metal),
            "map_pm" => self.others.push(SurfaceFeature::Metal),
            "pc" if is_above_0() => self.others.push(SurfaceFeature::Coat),
            "ps" if is_above_0() => self.others.push(SurfaceFeature::Sheen),
            "map_ps" => self.others.push(SurfaceFeature::Sheen),
            "refl" | "map_refl" => self.others.push(SurfaceFeature::Mirror),
            "bump" | "map_bump" | "disp" | "norm" | "map_kn" => {
                self.others.push(SurfaceFeature::Bump);
            }
            _ => {}
        }
    }

    /// What would be seen of it.
    fn features(self) -> Vec<SurfaceFeature> {
        let mut features = self.others;
        let brightest = self.highlight.map(|c| c.into_iter().fold(0.0, f32::max));
        let is_black = brightest == Some(0.0);
        match self.illum {
            Some(4 | 6 | 7 | 9 | 10) => features.push(SurfaceFeature::Glass),
            Some(3 | 5 | 8) if !is_black => features.push(SurfaceFeature::Mirror),
            // These have no highlights, whatever is said of them.
            Some(0 | 1) => {}
            // Nor do these, which spread over all directions.
            _ if self.exponent.is_some_and(|e| e <= 1.0) => {}
            _ if brightest > Some(PLAIN_HIGHLIGHT) => features.push(SurfaceFeature::Highlight),
            _ if self.has_highlight_map && !is_black => features.push(SurfaceFeature::Highlight),
            _ => {}
        }
        features
    }
}

/// Reads the materials of an MTL file and the textures that they refer to.
pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<Library> {
    let text = String::from_utf8_lossy(text_start(content)?);
    let mut reader = Reader {
        path,
        files,
        out: Library::default(),
        has_kd: false,
        has_ke: false,
        has_d: false,
        transparency: None,
        loaded: HashMap::new(),
        non_diffuse: Vec::new(),
        left_out: LeftOut::default(),
    };
    for (number, line) in text.lines().enumerate() {
        reader.files.cancel.check()?;
        let statement = reader.statement(line.trim(), number + 1);
        statement.map_err(|e| e.at(format!("line {}", number + 1)))?;
    }
    reader.apply_transparency();
    for (i, non_diffuse) in reader.non_diffuse.into_iter().enumerate() {
        for feature in non_diffuse.features() {
            reader.left_out.feature(feature, i);
        }
    }
    let materials = reader.out.materials.len();
    reader.left_out.tell(path, materials, reader.files);
    Ok(reader.out)
}

struct Reader<'a> {
    path: &'a Path,
    files: &'a mut Files,
    out: Library,
    /// Whether the last material has a `Kd`.
    has_kd: bool,
    /// Whether it has a `Ke`.
    has_ke: bool,
    /// Whether it has a `d`.
    has_d: bool,
    /// Its `Tr`.
    transparency: Option<f32>,
    /// Index of each texture by what it was made of; `None` if it cannot be read.
    loaded: HashMap<String, Option<u32>>,
    non_diffuse: Vec<NonDiffuse>,
    left_out: LeftOut,
}

impl Reader<'_> {
    fn statement(&mut self, line: &str, number: usize) -> Result<()> {
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let (word, rest) = (word.to_ascii_lowercase(), rest.trim());
        if word == "newmtl" {
            self.apply_transparency();
            self.out
                .materials
                .push(Material::diffuse(rest, DEFAULT_ALBEDO));
            self.out.uv_maps.push(UvMap::IDENTITY);
            self.non_diffuse.push(NonDiffuse::default());
            self.has_kd = false;
            self.has_ke = false;
            self.has_d = false;
            return Ok(());
        }
        let (Some(material), Some(non_diffuse)) =
            (self.out.materials.last_mut(), self.non_diffuse.last_mut())
        else {
            return Ok(());
        };
        non_diffuse.read(&word, rest);
        let name = format!("`{}`", material.name);
        match word.as_str() {
            "kd" | "ke" if rest.starts_with("spectral") || rest.starts_with("xyz") => {
                let what = "colours as spectra or XYZ are left out";
                self.left_out.note(what, format_args!("line {number}"));
            }
            "kd" => {
                let what = "`Kd` outside of [0,1] is brought into it";
                material.albedo = self.left_out.within(color(rest)?, 1.0, what, number);
                self.has_kd = true;
                self.show();
            }
            "ke" => {
                let what = "`Ke` below 0 or beyond any light is brought into range";
                material.emission = self
                    .left_out
                    .within(color(rest)?, MAX_EMISSION, what, number);
                self.has_ke = true;
                self.shine();
            }
            "map_kd" => self.texture(rest)?,
            "d" => {
                let text = rest.strip_prefix("-halo").unwrap_or(rest);
                let what = "`d` outside of [0,1] is brought into it";
                let [d, ..] = self.left_out.within(color(text)?, 1.0, what, number);
                self.has_d = true;
                if d < 1.0 {
                    let what = "materials with `d` below 1 are there in part: they reflect that \
                                share of light and let the rest through";
                    self.left_out.note(what, name);
                    mask_of(material).opacity = d;
                }
            }
            "tr" => {
                let what = "`Tr` outside of [0,1] is brought into it";
                let tr = color(rest).ok();
                let tr = tr.map(|tr| self.left_out.within(tr, 1.0, what, number));
                self.transparency = tr.map(|[tr, ..]| tr);
            }
            "map_d" => self.opacity(rest)?,
            "map_ke" => self.emission(rest)?,
            _ => {}
        }
        Ok(())
    }

    /// Gives the last material the mask of its `Tr`, unless it has a `d`, beside which exporters
    /// write the same or the opposite. A `Tr` of 1 alone is how some write what is opaque.
    fn apply_transparency(&mut self) {
        let (Some(tr), Some(material)) = (self.transparency.take(), self.out.materials.last_mut())
        else {
            return;
        };
        if !self.has_d && 0.0 < tr && tr < 1.0 {
            let what = "materials with `Tr` and no `d` are there in part: they reflect the share \
                        1 - `Tr` of light and let the rest through";
            self.left_out
                .note(what, format_args!("`{}`", material.name));
            mask_of(material).opacity = 1.0 - tr;
        }
    }

    /// Gives the last material the mask of a `map_d`.
    fn opacity(&mut self, text: &str) -> Result<()> {
        let map = TextureMap::parse(text, &mut self.left_out);
        let index = self.loaded(&map, ImagePart::Alpha)?;
        let (Some(material), Some(uv_map)) =
            (self.out.materials.last_mut(), self.out.uv_maps.last_mut())
        else {
            return Ok(());
        };
        if index.is_none() {
            return Ok(());
        }
        let is_placed = material.texture.is_some() || material.emission_texture.is_some();
        mask_of(material).texture = index;
        if !is_placed {
            *uv_map = map.uv_map;
        } else if *uv_map != map.uv_map {
            let what = "a `map_d` lies where the `map_Kd` of its material does";
            self.left_out
                .note(what, format_args!("`{}`", material.name));
        }
        Ok(())
    }

    /// Gives the last material the texture of a `map_Ke`.
    fn emission(&mut self, text: &str) -> Result<()> {
        let map = TextureMap::parse(text, &mut self.left_out);
        let index = self.loaded(&map, ImagePart::Color)?;
        let (Some(material), Some(uv_map)) =
            (self.out.materials.last_mut(), self.out.uv_maps.last_mut())
        else {
            return Ok(());
        };
        if index.is_none() {
            return Ok(());
        }
        let is_placed =
            material.texture.is_some() || material.mask.is_some_and(|m| m.texture.is_some());
        material.emission_texture = index;
        if !is_placed {
            *uv_map = map.uv_map;
        } else if *uv_map != map.uv_map {
            let what = "a `map_Ke` lies where the `map_Kd` of its material does";
            self.left_out
                .note(what, format_args!("`{}`", material.name));
        }
        self.shine();
        Ok(())
    }

    /// Lets a `map_Ke` shine as it is where the last material has no `Ke`, or a black one, as
    /// exporters write it beside a texture.
    fn shine(&mut self) {
        let Some(material) = self.out.materials.last_mut() else {
            return;
        };
        if material.emission_texture.is_some() && !material.emits() {
            material.emission = [1.0; 3];
            if self.has_ke {
                let what = "a black `Ke` beside a `map_Ke` is taken as 1";
                self.left_out
                    .note(what, format_args!("`{}`", material.name));
            }
        }
    }

    /// The index of a texture, which is read but once.
    fn loaded(&mut self, map: &TextureMap, part: ImagePart) -> Result<Option<u32>> {
        let key = format!("{part:?} {:?} {:?} {}", map.decoding, map.wrap, map.name);
        Ok(match self.loaded.get(&key) {
            Some(&index) => index,
            None => {
                let (left_out, files) = (&mut self.left_out, &mut *self.files);
                let load = match part {
                    ImagePart::Color => texture::load,
                    ImagePart::Alpha => texture::load_opacity,
                };
                let image = load(self.path, map.name, map.decoding, left_out, files)?;
                let index = image.map(|mut image| {
                    image.wrap = map.wrap;
                    self.out.textures.push(image);
                    self.out.textures.len() as u32 - 1
                });
                self.loaded.insert(key, index);
                index
            }
        })
    }

    /// Gives the last material the texture of a `map_Kd`.
    fn texture(&mut self, text: &str) -> Result<()> {
        let map = TextureMap::parse(text, &mut self.left_out);
        let index = self.loaded(&map, ImagePart::Color)?;
        if let (Some(material), Some(uv_map)) =
            (self.out.materials.last_mut(), self.out.uv_maps.last_mut())
            && index.is_some()
        {
            if material.emission_texture.is_some() && *uv_map != map.uv_map {
                let what = "a `map_Ke` lies where the `map_Kd` of its material does";
                self.left_out
                    .note(what, format_args!("`{}`", material.name));
            }
            material.texture = index;
            *uv_map = map.uv_map;
            if !self.has_kd {
                material.albedo = [1.0; 3];
            }
        }
        self.show();
        Ok(())
    }

    /// Shows a `map_Kd` as it is where `Kd` is black, as some exporters write it beside a texture.
    fn show(&mut self) {
        let Some(material) = self.out.materials.last_mut() else {
            return;
        };
        if material.texture.is_some() && material.albedo == [0.0; 3] {
            material.albedo = [1.0; 3];
            let what = "a black `Kd` beside a `map_Kd` is taken as 1";
            self.left_out
                .note(what, format_args!("`{}`", material.name));
        }
    }
}

/// The mask of a material, of which nothing else is said yet.
fn mask_of(material: &mut Material) -> &mut Mask {
    material.mask.get_or_insert(Mask {
        opacity: 1.0,
        texture: None,
        cutoff: None,
    })
}

impl LeftOut {
    /// The colour with each channel brought to 0 to `high`, and a note of it if that changes it;
    /// what is no number becomes 0.
    fn within(&mut self, color: [f32; 3], high: f32, what: &str, line: usize) -> [f32; 3] {
        if color.iter().all(|c| (0.0..=high).contains(c)) {
            return color;
        }
        self.note(what, format_args!("line {line}"));
        color.map(|c| c.max(0.0).min(high))
    }
}

/// A `map_Kd`: a file name behind options.
#[derive(Debug, PartialEq)]
struct TextureMap<'a> {
    name: &'a str,
    uv_map: UvMap,
    wrap: [Wrap; 2],
    decoding: Decoding,
}

impl<'a> TextureMap<'a> {
    fn parse(text: &'a str, left_out: &mut LeftOut) -> Self {
        let mut map = Self {
            name: text,
            uv_map: UvMap::IDENTITY,
            wrap: Default::default(),
            decoding: Decoding::default(),
        };
        while map.name.starts_with('-') {
            let (option, rest) = first_word(map.name);
            let option = option.to_ascii_lowercase();
            let mut values = Values { rest };
            match option.as_str() {
                "-s" => map.uv_map.scale = values.point(1.0),
                "-o" => map.uv_map.offset = values.point(0.0),
                "-t" => {
                    if values.point(0.0) != Vec2::ZERO {
                        left_out.note("turbulence of textures is left out", "`-t`");
                    }
                }
                "-mm" => {
                    map.decoding.base = values.number().unwrap_or(0.0);
                    map.decoding.gain = values.number().unwrap_or(1.0);
                }
                // What is filtered, and how fine, changes no looks.
                "-bm" | "-boost" | "-texres" => {
                    values.number();
                }
                "-blendu" | "-blendv" | "-cc" | "-type" => {
                    values.word();
                }
                "-clamp" => {
                    if values.word().eq_ignore_ascii_case("on") {
                        map.wrap = [Wrap::Clamp; 2];
                    }
                }
                "-imfchan" => {
                    let channel = values.word();
                    left_out.note(
                        "the choice of a channel is left out",
                        format_args!("`{channel}`"),
                    );
                }
                "-colorspace" => {
                    let space = values.word().to_ascii_lowercase();
                    if ["linear", "raw", "non-color", "none"].contains(&space.as_str()) {
                        map.decoding.encoding = ColorEncoding::Linear;
                    } else if space != "srgb" {
                        left_out.note("colour spaces are taken as sRGB", format_args!("`{space}`"));
                    }
                }
                // No option: a name that begins so.
                _ => break,
            }
            map.name = values.rest;
        }
        map
    }
}

/// What follows an option; the last word is the name of the file and none of them.
struct Values<'a> {
    rest: &'a str,
}

impl<'a> Values<'a> {
    fn word(&mut self) -> &'a str {
        let (word, rest) = first_word(self.rest);
        self.rest = rest;
        word
    }

    fn number(&mut self) -> Option<f32> {
        let (word, rest) = first_word(self.rest);
        let number = word
            .parse()
            .ok()
            .filter(|n: &f32| n.is_finite() && !rest.is_empty());
        if number.is_some() {
            self.rest = rest;
        }
        number
    }

    /// One to three numbers, of which the third is for solid textures; the others are `missing`
    /// where they are not given.
    fn point(&mut self, missing: f32) -> Vec2 {
        let u = self.number();
        let v = u.and_then(|_| self.number());
        v.and_then(|_| self.number());
        Vec2::new(u.unwrap_or(missing), v.unwrap_or(missing))
    }
}

fn first_word(text: &str) -> (&str, &str) {
    let text = text.trim_start();
    let (word, rest) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, rest.trim_start())
}

/// One number stands for three.
fn color(text: &str) -> Result<[f32; 3]> {
    let numbers: Vec<f32> = text
        .split_whitespace()
        .map_while(|w| w.parse().ok())
        .collect();
    match numbers[..] {
        [grey] => Ok([grey; 3]),
        [r, g, b, ..] => Ok([r, g, b]),
        // Not quoted: the file may be any that is named so.
        _ => Err(Error::input(format!(
            "expected a colour of one or three numbers, found {} numbers",
            numbers.len()
        ))),
    }
}

#[cfg(test)]
mod tests;
