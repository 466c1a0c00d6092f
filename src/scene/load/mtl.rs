//! Wavefront MTL: `Kd`, `map_Kd` with its options, `d`, `map_d`, and `Ke`, all linear but for colours of
//! textures. Keywords may be in any letter case.
//!
//! What else changes looks and is left out, `map_Ke`, is warned of, and in one line what is not diffuse: `illum` 3 to 10, `Ks` above what exporters write for plain surfaces,
//! `map_Ks`, `refl`, `Pm`, `Pc`, `Ps` and their maps, and bumps. `Ns`, `Ni`, `Tf` and `Pr` say
//! nothing by themselves.

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
        loaded: HashMap::new(),
        non_diffuse: Vec::new(),
        left_out: LeftOut::default(),
    };
    for (number, line) in text.lines().enumerate() {
        reader.files.cancel.check()?;
        let statement = reader.statement(line.trim(), number + 1);
        statement.map_err(|e| e.at(format!("line {}", number + 1)))?;
    }
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
            self.out
                .materials
                .push(Material::diffuse(rest, DEFAULT_ALBEDO));
            self.out.uv_maps.push(UvMap::IDENTITY);
            self.non_diffuse.push(NonDiffuse::default());
            self.has_kd = false;
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
            }
            "ke" => {
                let what = "`Ke` below 0 or beyond any light is brought into range";
                material.emission = self
                    .left_out
                    .within(color(rest)?, MAX_EMISSION, what, number);
            }
            "map_kd" => self.texture(rest)?,
            "d" => {
                let text = rest.strip_prefix("-halo").unwrap_or(rest);
                let what = "`d` outside of [0,1] is brought into it";
                let [d, ..] = self.left_out.within(color(text)?, 1.0, what, number);
                if d < 1.0 {
                    let what = "materials with `d` below 1 are there in part: they reflect that share of light and let the \
                                rest through";
                    self.left_out.note(what, name);
                    mask_of(material).opacity = d;
                }
            }
            "map_d" => self.opacity(rest)?,
            "map_ke" => self
                .left_out
                .note("emissive textures, `map_Ke`, are left out", name),
            _ => {}
        }
        Ok(())
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
        mask_of(material).texture = index;
        if material.texture.is_none() {
            *uv_map = map.uv_map;
        } else if *uv_map != map.uv_map {
            let what = "a `map_d` lies where the `map_Kd` of its material does";
            self.left_out
                .note(what, format_args!("`{}`", material.name));
        }
        Ok(())
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
            material.texture = index;
            *uv_map = map.uv_map;
            if !self.has_kd {
                material.albedo = [1.0; 3];
            }
        }
        Ok(())
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
mod tests {
    use super::*;

    #[test]
    fn materials_are_read_in_order() {
        let text = "# c\nKd 1 1 1\nnewmtl a\n Kd 0.1 0.2 0.3\nKe 5\nNs 10\nnewmtl b b\n";
        let library = read(text.as_bytes(), Path::new("x.mtl"), &mut Files::default());
        let materials = library.unwrap().materials;
        assert_eq!(materials.len(), 2);
        assert_eq!(materials[0].albedo, [0.1, 0.2, 0.3]);
        assert_eq!(materials[0].emission, [5.0; 3]);
        assert_eq!(materials[1], Material::diffuse("b b", DEFAULT_ALBEDO));
    }

    #[test]
    fn what_changes_looks_and_is_left_out_is_said_once() {
        let text = "newmtl glass\nd 0.2\nmap_d a.png\nnewmtl leaf\nd 1\nnewmtl wall\nd 7\nKe 1\n";
        let mut files = Files::default();
        let library = read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
        assert_eq!(
            files.warnings,
            [
                "x.mtl: materials with `d` below 1 are there in part: they reflect that share of light and let the rest \
                 through: `glass`",
                "x.mtl: textures that are not there are left out: `a.png`",
                "x.mtl: `d` outside of [0,1] is brought into it: line 7"
            ]
        );
        let masks: Vec<_> = library.materials.iter().map(|m| m.mask).collect();
        let glass = Mask {
            opacity: 0.2,
            texture: None,
            cutoff: None,
        };
        assert_eq!(masks, [Some(glass), None, None]);
        let mut files = Files::default();
        let text = "newmtl screen\nmap_Ke a.png\n";
        read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
        assert_eq!(
            files.warnings,
            ["x.mtl: emissive textures, `map_Ke`, are left out: `screen`"]
        );
    }

    #[test]
    fn what_is_not_diffuse_is_summed_up_in_a_line() {
        let warnings = |text: &str| {
            let mut files = Files::default();
            read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
            files.warnings
        };
        let text = "newmtl a\nillum 5\nNi 1.5\nnewmtl b\nillum 7\nTf 1 1 1\nmap_Bump -bm 1 b.png\nbump b.png\n\
                    newmtl c\nKs 0.9 0.6 0.1\nillum 2\nnewmtl d\nillum 4\nnewmtl e\nPm 1\nPc 0.2\n";
        assert_eq!(
            warnings(text),
            [
                "x.mtl: all surfaces are taken as diffuse; of 5 materials this leaves out mirrors of 1, glass of 2, metal \
                 of 1, highlights of 1, clear coats of 1, bumps and normal maps of 1"
            ]
        );
        for seen in [
            "map_Ks a.png",
            "refl a.png",
            "Ks 1 1 1",
            "illum 10",
            "illum 3\nKs 0.1",
            "disp a.png",
        ] {
            assert_eq!(warnings(&format!("newmtl a\n{seen}\n")).len(), 1, "{seen}");
        }
        // What exporters write for anything.
        for plain in [
            "Ns 250\nKa 1 1 1\nKs 0.5 0.5 0.5\nKe 0 0 0\nNi 1.45\nd 1\nillum 2",
            "Ns 10\nNi 1.5\nd 1\nTr 0\nTf 1 1 1\nillum 2\nKs 0 0 0",
            "Pr 0.5\nPm 0\nPs 0\nPc 0\nPcr 0.03\naniso 0\nanisor 0",
            "Ks 0 0 0\nillum 3",
            "Ks 1 1 1\nmap_Ks a.png\nillum 1",
            "Ka 0.2 0.2 0.2\nKs 1 1 1\nTr 1\nillum 2\nNs 0",
            "Ks 0 0 0\nmap_Ks a.png",
        ] {
            assert_eq!(
                warnings(&format!("newmtl a\n{plain}\n")),
                [] as [String; 0],
                "{plain}"
            );
        }
    }

    #[test]
    fn a_wrong_colour_names_its_line() {
        let library = read(
            b"newmtl a\nKd 1 2",
            Path::new("x.mtl"),
            &mut Files::default(),
        );
        let message = library.unwrap_err().to_string();
        assert!(message.starts_with("line 2: expected a colour of one or three"));
    }

    #[test]
    fn what_is_out_of_range_or_not_there_is_mended_and_told() {
        let text = "\u{feff}NEWMTL a\nKD 1.5 0.5 -1\nMAP_KD -s 1 1 1 my tile.png\nKe nan 1 1\nnewmtl b\n\
                    map_Kd x.png\nmap_Kd -imfchan r x.png\nKd xyz 1 1 1\n";
        let mut files = Files::default();
        let library = read(text.as_bytes(), Path::new("m/x.mtl"), &mut files).unwrap();
        let [a, b] = &library.materials[..] else {
            panic!()
        };
        assert_eq!((a.albedo, a.emission), ([1.0, 0.5, 0.0], [0.0, 1.0, 1.0]));
        assert_eq!(
            (a.texture, b.texture, b.albedo),
            (None, None, DEFAULT_ALBEDO)
        );
        assert_eq!(
            files.warnings,
            [
                "m/x.mtl: `Kd` outside of [0,1] is brought into it: line 2",
                "m/x.mtl: textures that are not there are left out: `my tile.png`, `x.png`",
                "m/x.mtl: `Ke` below 0 or beyond any light is brought into range: line 4",
                "m/x.mtl: the choice of a channel is left out: `r`",
                "m/x.mtl: colours as spectra or XYZ are left out: line 8",
            ]
        );
    }

    #[test]
    fn options_of_a_texture_are_read() {
        let map = |text| TextureMap::parse(text, &mut LeftOut::default());
        let plain = |name| TextureMap {
            name,
            uv_map: UvMap::IDENTITY,
            wrap: [Wrap::Repeat; 2],
            decoding: Decoding::default(),
        };
        for text in [
            "a b.png",
            "-bm 2 a b.png",
            "-colorspace sRGB -cc on a b.png",
        ] {
            assert_eq!(map(text), plain("a b.png"), "{text}");
        }
        assert_eq!(map("-1.png"), plain("-1.png"));
        assert_eq!(map("-s"), plain(""));
        let moved = map("-s 2 3 1 -o 0.5 1.png");
        assert_eq!(moved.uv_map.scale, Vec2::new(2.0, 3.0));
        assert_eq!(moved.uv_map.offset, Vec2::new(0.5, 0.0));
        assert_eq!(moved.name, "1.png");
        let map = map("-CLAMP on -mm 0.25 0.5 -colorspace linear a.png");
        assert_eq!(map.wrap, [Wrap::Clamp; 2]);
        let expected = Decoding {
            encoding: ColorEncoding::Linear,
            base: 0.25,
            gain: 0.5,
        };
        assert_eq!(map.decoding, expected);
    }
}
