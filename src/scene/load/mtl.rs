//! Wavefront MTL: `Kd`, `map_Kd` and `Ke`, all linear but for the texture. What else changes looks
//! and is left out, `d`, `map_d` and `map_Ke`, is warned of, and in one line what is not diffuse:
//! `illum` 3 to 10, `Ks` above what exporters write for plain surfaces, `map_Ks`, `refl`, `Pm`,
//! `Pc`, `Ps` and their maps, and bumps. `Ns`, `Ni`, `Tf` and `Pr` say nothing by themselves.

use super::files::{Files, beside};
use super::surfaces::{LeftOut, Look};
use super::texture;
use crate::scene::builder::DEFAULT_ALBEDO;
use crate::scene::{Material, Texture};
use crate::{Error, Result};
use std::collections::{BTreeSet, HashMap};
use std::path::Path;

/// Highlights of at most this are those of any plastic; exporters write it for all that is not told
/// apart.
const PLAIN_HIGHLIGHT: f32 = 0.5;

/// What a material says of itself beyond its diffuse reflection.
#[derive(Default)]
struct Beyond {
    illum: Option<u32>,
    highlight: Option<[f32; 3]>,
    exponent: Option<f32>,
    has_highlight_map: bool,
    others: Vec<Look>,
}

impl Beyond {
    /// Takes a statement in.
    fn read(&mut self, word: &str, rest: &str) {
        let is_above_0 = || color(rest).is_ok_and(|c| c.iter().any(|v| *v > 0.0));
        match word.to_ascii_lowercase().as_str() {
            "illum" => self.illum = rest.parse().ok(),
            "ks" => self.highlight = color(rest).ok(),
            "ns" => self.exponent = rest.parse().ok(),
            "map_ks" => self.has_highlight_map = true,
            "pm" if is_above_0() => self.others.push(Look::Metal),
            "map_pm" => self.others.push(Look::Metal),
            "pc" if is_above_0() => self.others.push(Look::Coat),
            "ps" if is_above_0() => self.others.push(Look::Sheen),
            "map_ps" => self.others.push(Look::Sheen),
            "refl" | "map_refl" => self.others.push(Look::Mirror),
            "bump" | "map_bump" | "disp" | "norm" | "map_kn" => self.others.push(Look::Bump),
            _ => {}
        }
    }

    /// What would be seen of it.
    fn looks(self) -> Vec<Look> {
        let mut looks = self.others;
        let brightest = self.highlight.map(|c| c.into_iter().fold(0.0, f32::max));
        let is_black = brightest == Some(0.0);
        match self.illum {
            Some(4 | 6 | 7 | 9 | 10) => looks.push(Look::Glass),
            Some(3 | 5 | 8) if !is_black => looks.push(Look::Mirror),
            // These have no highlights, whatever is said of them.
            Some(0 | 1) => {}
            // Nor do these, which spread over all directions.
            _ if self.exponent.is_some_and(|e| e <= 1.0) => {}
            _ if brightest > Some(PLAIN_HIGHLIGHT) => looks.push(Look::Highlight),
            _ if self.has_highlight_map && !is_black => looks.push(Look::Highlight),
            _ => {}
        }
        looks
    }
}

/// Reads the materials of an MTL file and the textures that they refer to.
pub(super) fn read(
    content: &[u8],
    path: &Path,
    files: &mut Files,
) -> Result<(Vec<Material>, Vec<Texture>)> {
    let text = String::from_utf8_lossy(content);
    let mut materials: Vec<Material> = Vec::new();
    let mut textures = Vec::new();
    let mut loaded = HashMap::new();
    let mut has_kd = false;
    let (mut see_through, mut emissive_textures) = (BTreeSet::new(), BTreeSet::new());
    let mut beyond: Vec<Beyond> = Vec::new();
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        let place = || format!("line {}", number + 1);
        if word == "newmtl" {
            materials.push(Material::diffuse(rest, DEFAULT_ALBEDO));
            beyond.push(Beyond::default());
            has_kd = false;
            continue;
        }
        let (Some(material), Some(beyond)) = (materials.last_mut(), beyond.last_mut()) else {
            continue;
        };
        beyond.read(word, rest);
        match word {
            "Kd" => {
                material.albedo = color(rest).map_err(|e| e.at(place()))?;
                has_kd = true;
            }
            "Ke" => material.emission = color(rest).map_err(|e| e.at(place()))?,
            "map_Kd" => {
                let name = without_options(rest);
                let index = match loaded.get(name) {
                    Some(&index) => index,
                    None => {
                        let file = beside(path, name);
                        let content = files.read("texture", &file).map_err(|e| e.at(place()))?;
                        let image = texture::decode(&content).map_err(|e| e.at(file.display()))?;
                        textures.push(image);
                        loaded.insert(name.to_string(), textures.len() as u32 - 1);
                        textures.len() as u32 - 1
                    }
                };
                material.texture = Some(index);
                if !has_kd {
                    material.albedo = [1.0; 3];
                }
            }
            "d" if color(rest).is_ok_and(|[d, ..]| d < 1.0) => {
                see_through.insert(material.name.clone());
            }
            "map_d" => {
                see_through.insert(material.name.clone());
            }
            "map_Ke" => {
                emissive_textures.insert(material.name.clone());
            }
            _ => {}
        }
    }
    let mut warn = |names: BTreeSet<String>, what: &str| {
        if !names.is_empty() {
            let names: Vec<_> = names.iter().map(|n| format!("`{n}`")).collect();
            let (path, names) = (path.display(), names.join(", "));
            files.warn(format!("{path}: {what}: {names}"));
        }
    };
    warn(
        see_through,
        "materials with `d` below 1 or `map_d` are taken as opaque",
    );
    warn(
        emissive_textures,
        "emissive textures, `map_Ke`, are left out",
    );
    let mut left_out = LeftOut::default();
    for (i, beyond) in beyond.into_iter().enumerate() {
        let looks = beyond.looks().into_iter();
        looks.for_each(|look| left_out.add(look, i));
    }
    if let Some(what) = left_out.told(materials.len()) {
        files.warn(format!("{}: {what}", path.display()));
    }
    Ok((materials, textures))
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
        _ => Err(Error::input(format!(
            "expected one or three numbers, found \"{text}\""
        ))),
    }
}

/// The file name after options such as `-s 1 1 1`.
fn without_options(text: &str) -> &str {
    if !text.starts_with('-') {
        return text;
    }
    let is_value = |word: &str| {
        word.starts_with('-') || word.parse::<f32>().is_ok() || word == "on" || word == "off"
    };
    let mut rest = text;
    loop {
        let word = rest.split_whitespace().next().unwrap_or("");
        if word.is_empty() || !is_value(word) {
            return rest;
        }
        rest = rest[word.len()..].trim_start();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn materials_are_read_in_order() {
        let text = "# c\nKd 1 1 1\nnewmtl a\n Kd 0.1 0.2 0.3\nKe 5\nNs 10\nnewmtl b b\n";
        let (materials, _) =
            read(text.as_bytes(), Path::new("x.mtl"), &mut Files::default()).unwrap();
        assert_eq!(materials.len(), 2);
        assert_eq!(materials[0].albedo, [0.1, 0.2, 0.3]);
        assert_eq!(materials[0].emission, [5.0; 3]);
        assert_eq!(materials[1], Material::diffuse("b b", DEFAULT_ALBEDO));
    }

    #[test]
    fn what_changes_looks_and_is_left_out_is_said_once() {
        let text =
            "newmtl glass\nd 0.2\nmap_d a.png\nnewmtl leaf\nmap_d b.png\nnewmtl wall\nd 1\nKe 1\n";
        let mut files = Files::default();
        read(text.as_bytes(), Path::new("x.mtl"), &mut files).unwrap();
        assert_eq!(
            files.warnings,
            ["x.mtl: materials with `d` below 1 or `map_d` are taken as opaque: `glass`, `leaf`"]
        );
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
    fn wrong_colours_and_missing_textures_name_their_line() {
        let message = |text: &str| {
            let read = read(text.as_bytes(), Path::new("m/x.mtl"), &mut Files::default());
            read.unwrap_err().to_string()
        };
        assert!(message("newmtl a\nKd 1 2").starts_with("line 2: expected one or three"));
        assert_eq!(
            message("newmtl a\nmap_Kd -s 1 1 1 my tile.png"),
            "line 2: texture file m/my tile.png is not there"
        );
    }

    #[test]
    fn options_before_a_file_name_are_skipped() {
        assert_eq!(without_options("-clamp on -o 0.5 1 a b.png"), "a b.png");
        assert_eq!(without_options("a b.png"), "a b.png");
        assert_eq!(without_options("-s 1"), "");
    }
}
