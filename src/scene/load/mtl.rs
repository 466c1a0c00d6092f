//! Wavefront MTL: `Kd`, `map_Kd` and `Ke`, all linear but for the texture. What else changes looks and is left out, `d`,
//! `map_d` and `map_Ke`, is warned of.

use super::super::{Material, Texture};
use super::files::{Files, beside};
use super::part::DEFAULT_ALBEDO;
use super::texture;
use crate::{Error, Result};
use std::collections::{BTreeSet, HashMap};
use std::path::Path;

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
    for (number, line) in text.lines().enumerate() {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let rest = rest.trim();
        let place = || format!("line {}", number + 1);
        if word == "newmtl" {
            materials.push(Material::diffuse(rest, DEFAULT_ALBEDO));
            has_kd = false;
            continue;
        }
        let Some(material) = materials.last_mut() else {
            continue;
        };
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
