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
mod table;
mod texture;
mod vdb;

use super::Scene;
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
    /// Of kind [`crate::Kind::Input`] for anything wrong with the files; the message names the file and the line or
    /// element.
    pub fn load(path: &Path) -> Result<Self> {
        let mut files = Files::default();
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
        files.add(text.as_bytes());
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
