//! From files to a checked [`Scene`].
//!
#![doc = include_str!("../../../docs/scene.md")]

mod builtin;
mod description;
mod draft;
mod field;
mod files;
mod gltf;
mod mtl;
mod normals;
mod nrrd;
mod obj;
mod part;
mod place;
mod ply;
mod raw;
mod surfaces;
mod table;
mod texture;
mod vdb;

use super::Scene;
use crate::run::Cancel;
use crate::{Error, Result};
use files::Files;
use glam::DAffine3;
use std::path::Path;

/// Emission, intensity and irradiance beyond this are taken for a mistake.
const BRIGHTEST: f32 = 1e30;

impl Scene {
    /// Reads and checks a scene: a `.toml` scene file, or a `.gltf` or `.glb` by itself.
    ///
    /// # Errors
    /// Of kind [`crate::Kind::Input`] for anything wrong with the files; the message names the file
    /// and the line or element.
    pub fn load(path: &Path) -> Result<Self> {
        Self::load_until(path, &Cancel::default())
    }

    /// As [`Scene::load`], but stops on request.
    ///
    /// # Errors
    /// As [`Scene::load`], and if cancelled.
    pub fn load_until(path: &Path, cancel: &Cancel) -> Result<Self> {
        let mut files = Files::until(cancel);
        let draft = match files::extension(path).as_str() {
            "toml" => {
                let text = files.read("scene", path)?;
                let text = String::from_utf8(text).map_err(|e| {
                    Error::input(format!("{}: not UTF-8 text: {e}", path.display()))
                })?;
                description::read(&text, path, &mut files)?
            }
            "gltf" | "glb" => {
                let content = files.read("scene", path)?;
                let import =
                    gltf::read(&content, path, &mut files).map_err(|e| e.at(path.display()))?;
                import.into_draft(path).map_err(|e| e.at(path.display()))?
            }
            other => {
                return Err(Error::input(format!(
                    "{}: expected a scene file, found the extension \"{other}\"",
                    path.display()
                ))
                .hint("scenes are .toml, .gltf or .glb files"));
            }
        };
        draft.finish(files).map_err(|e| e.at(path.display()))
    }

    /// A room with coloured walls, a few shapes, a plume of smoke and a warm light; needs no files.
    ///
    /// # Errors
    /// None that the caller could cause.
    pub fn demo() -> Result<Self> {
        let text = include_str!("demo.toml");
        let mut files = Files::default();
        files.add(text.as_bytes())?;
        description::read(text, Path::new("demo.toml"), &mut files)?.finish(files)
    }
}

/// Whether a map has no inverse worth the name: its axes are, up to rounding, in one plane.
fn is_singular(map: &DAffine3) -> bool {
    let m = map.matrix3;
    let volume = m.x_axis.length() * m.y_axis.length() * m.z_axis.length();
    let finite = map.to_cols_array().iter().all(|x| x.is_finite());
    !finite || volume == 0.0 || m.determinant().abs() < 1e-12 * volume
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;
    use field::Scale;
    use std::io::Write;

    const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    const PLY: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nelement face 0\n\
                       property list uchar int vertex_indices\nend_header\n0\n";
    /// A triangle without area.
    const GLTF: &str = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "type": "VEC3", "count": 3, "bufferView": 0, "min": [0, 0, 0],
            "max": [0, 0, 0]}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}], "buffers": [{"byteLength": 36,
            "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAA"}]}"#;

    fn nrrd() -> Vec<u8> {
        let header = "NRRD0004\ntype: uint8\ndimension: 3\nsizes: 1 1 1\nencoding: gzip\n\n";
        let mut file = header.as_bytes().to_vec();
        let mut packed = flate2::write::GzEncoder::new(&mut file, flate2::Compression::fast());
        packed.write_all(&[7]).unwrap();
        packed.finish().unwrap();
        file
    }

    type Read<'a> = dyn Fn(&Cancel) -> Result<()> + 'a;

    #[test]
    fn each_reader_stops_on_request() {
        let part =
            |cancel: &Cancel| obj::read(OBJ.as_bytes(), Path::new("x"), &mut Files::until(cancel));
        let field = |cancel: &Cancel| nrrd::read(nrrd(), Path::new("x"), &mut Files::until(cancel));
        let going = Cancel::default();
        let read: [(&str, &Read); 7] = [
            ("file", &|c| {
                Files::until(c)
                    .read("mesh", Path::new("Cargo.toml"))
                    .map(drop)
            }),
            ("obj", &|c| part(c).map(drop)),
            ("ply", &|c| ply::read(PLY.as_bytes(), None, c).map(drop)),
            ("gltf", &|c| {
                gltf::read(GLTF.as_bytes(), Path::new("x"), &mut Files::until(c)).map(drop)
            }),
            ("nrrd", &|c| field(c).map(drop)),
            ("grid", &|c| {
                let scale = Scale {
                    sigma_t: 1.0,
                    window: None,
                };
                field(&going)?.into_grid(scale, c).map(drop)
            }),
            ("creases", &|c| normals::crease(&mut part(&going)?, 0.5, c)),
        ];
        let stopped = Cancel::default();
        stopped.request();
        let is_deaf = |read: &Read| {
            read(&going).unwrap();
            read(&stopped).err().map(|e| e.kind()) != Some(Kind::Cancelled)
        };
        let deaf: Vec<&str> = read
            .into_iter()
            .filter(|(_, read)| is_deaf(read))
            .map(|(name, _)| name)
            .collect();
        assert!(deaf.is_empty(), "{deaf:?}");
    }

    #[test]
    fn a_scene_stops_as_everything_does() {
        let stopped = Cancel::default();
        stopped.request();
        let error = Scene::load_until(Path::new("src/scene/load/demo.toml"), &stopped).unwrap_err();
        assert_eq!(error.to_string(), "stopped on request");
    }
}
