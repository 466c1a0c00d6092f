//! Scene files, and readers of all files that they name.
//!
#![doc = include_str!("../../../docs/scene.md")]

// In come paths; out comes a `SceneBuilder` that is filled, and what the user should know.
//
// - `description`: the scene file, its `light`s, its `volume`s, a packed scene in place of these;
//   with `table` (typed access to TOML), `nearest` (words that may have been meant) and `transform`
//   (placement)
// - `obj` with `mtl`, `ply`, `gltf`, `builtin`: meshes, each as a `MeshInput`
// - `mitsuba`: scenes of Mitsuba in XML
// - `vdb`, `nrrd`, `nifti`, `metaimage`, `raw`, `vol`, `builtin`: volumes, each as a
//   `field::Field`, which becomes a grid; with `unpack` (bytes), `samples` (boxes of values),
//   `scale` and `transfer` (extinctions of values, presets), `survey` (what is wrong with them) and
//   `patient` (axes)
// - `environment`: images of the sky
// - `polygon`: cuts the faces of OBJ and PLY; `texture`: images; `normals`: shading normals at a
//   crease angle
// - `contents`: what a file holds, for those who ask; `values`: what the values of a volume are,
//   by `layers`; `suggest` and `depth`: what to write of them, and what to warn of
// - `groups`: groups of lights
// - `files`: reads and hashes files and collects warnings; `images`: those that were decoded;
//   `left_out`: what to tell of them; `changes`: values of a scene file that are changed as it is
//   read

mod albedo;
mod builtin;
mod changes;
pub(crate) mod colors;
mod contents;
mod depth;
mod description;
mod environment;
mod field;
mod files;
mod gltf;
mod groups;
mod images;
mod layers;
mod left_out;
mod metaimage;
mod mitsuba;
mod mtl;
mod nearest;
mod nifti;
mod normals;
mod nrrd;
mod numbers;
mod obj;
mod patient;
pub(crate) mod ply;
mod polygon;
mod raw;
mod samples;
mod scale;
mod stl;
mod suggest;
mod survey;
mod table;
mod texture;
mod transfer;
mod transform;
mod unpack;
mod values;
mod vdb;
mod vol;

pub use changes::Change;
pub use contents::{Contents, ContentsKind, EXTENSIONS, contents, has_contents};
pub use groups::{DEFAULT as DEFAULT_GROUP, is_name as is_group_name};
pub use suggest::SuggestedWindow;
pub use values::{GridValues, Histogram};

use super::{Scene, SceneBuilder, packed};
use crate::run::{Cancel, Job, Lists};
use crate::{Error, Result};
use field::Field;
use files::Files;
use std::path::{Path, PathBuf};

/// How a scene is read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Most bytes that the texels of all textures may take; more is an error, before they are
    /// decoded.
    pub texture_limit: u64,
    /// Whether meshes, materials and volumes may name files outside of the folder of the scene and
    /// of their own, links followed. What the scene file names may be anywhere. What may not be
    /// read is taken as not there: a texture or materials with a warning, data with an error.
    pub allow_outside: bool,
    /// The frame to read: cameras that move are where they are in that, and names of files in a
    /// scene file may have tokens for its number, as `####`.
    pub frame: Option<i32>,
    /// Values in place of those of the scene file, one after the other. The hash of the scene is
    /// over them, too.
    pub changes: Vec<Change>,
    /// The group of lights that lights the scene alone; `None` for all. [`DEFAULT_GROUP`] is that
    /// of lights that are in no group. The hash of the scene is over it, too.
    pub group: Option<String>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            texture_limit: 4 << 30,
            allow_outside: false,
            frame: None,
            changes: Vec::new(),
            group: None,
        }
    }
}

impl Scene {
    /// Reads and checks a scene: a `.toml` scene file, a Mitsuba scene (`.xml`), a `.gltf` or
    /// `.glb` by itself, or a packed scene (`.lvp`). What the caller should know is in its
    /// `warnings`. [`load`](crate::scene::load) describes scene files.
    ///
    /// # Errors
    /// Of kind [`crate::Kind::Input`] for anything wrong with the files; the message names the file
    /// and the line or element.
    pub fn load(path: &Path) -> Result<Self> {
        let cancel = Cancel::default();
        Self::load_into(&Lists::default(), path, &Settings::default(), &cancel)
    }

    /// Reads and checks a scene as [`Scene::load`] does, but by these settings, stops when the job
    /// is cancelled, and hands warnings to the job's progress, too.
    ///
    /// # Errors
    /// As [`Scene::load`], and if cancelled.
    pub fn load_with(path: &Path, settings: &Settings, job: &Job) -> Result<Self> {
        let scene = Self::load_into(&Lists::of(job), path, settings, &job.cancel)?;
        scene.warnings.iter().for_each(|w| job.progress.warn(w));
        scene.notes.iter().for_each(|n| job.progress.say(n));
        Ok(scene)
    }

    /// Opens a packed scene, whatever its name, by default settings.
    ///
    /// # Errors
    /// As [`Scene::load`], and if cancelled.
    pub(crate) fn open_packed(path: &Path, job: &Job) -> Result<Self> {
        let texture_limit = Settings::default().texture_limit;
        packed::read(path, None, texture_limit, &Lists::of(job), &job.cancel)
    }

    fn load_into(lists: &Lists, path: &Path, settings: &Settings, cancel: &Cancel) -> Result<Self> {
        if is_packed(path) {
            refuse_changes(path, settings)?;
            refuse_group(path, settings)?;
            return packed::read(path, settings.frame, settings.texture_limit, lists, cancel);
        }
        let mut files = Files::with(settings.clone(), cancel);
        files.lists = lists.clone();
        let builder = read_scene(path, &mut files)?;
        finish(builder, files).map_err(|e| e.at(path.display()))
    }

    /// A room with coloured walls, a few shapes, a plume of smoke and a warm light; needs no files.
    ///
    /// # Errors
    /// None that the caller could cause.
    pub fn demo() -> Result<Self> {
        Self::demo_with(&Settings::default())
    }

    /// The scene of [`Scene::demo`] with changes.
    ///
    /// # Errors
    /// A change that is none of the scene.
    pub fn demo_with(settings: &Settings) -> Result<Self> {
        let text = include_str!("demo.toml");
        let mut files = Files::with(settings.clone(), &Cancel::default());
        files.add(text.as_bytes())?;
        files.add_changes()?;
        let builder = description::read(text, Path::new("demo.toml"), &mut files)?;
        finish(builder, files)
    }
}

/// Whether the name of a file is that of a packed scene.
#[must_use]
pub fn is_packed(path: &Path) -> bool {
    files::extension(path) == "lvp"
}

/// The packed scene that a file is, or that a scene file takes its surfaces and volumes from;
/// `None` for others.
///
/// # Errors
/// A scene file that cannot be read as far as it names one.
pub fn packed_file(path: &Path, settings: &Settings) -> Result<Option<PathBuf>> {
    match files::extension(path).as_str() {
        "lvp" => Ok(Some(path.to_owned())),
        "toml" => {
            let mut files = Files::with(settings.clone(), &Cancel::default());
            let text = read_text(path, &mut files)?;
            description::packed_file(&text, path, &mut files)
        }
        _ => Ok(None),
    }
}

/// Reads the text of a scene file.
fn read_text(path: &Path, files: &mut Files) -> Result<String> {
    table::check_bytes(path)?;
    let text = files.read("scene", path)?;
    let text = files::text_start(&text).map_err(|e| e.at(path.display()))?;
    let text = std::str::from_utf8(text)
        .map_err(|e| Error::input(format!("{}: not UTF-8 text: {e}", path.display())))?;
    Ok(text.into())
}

/// Refuses changes of what is no text.
fn refuse_changes(path: &Path, settings: &Settings) -> Result<()> {
    match settings.changes.first() {
        None => Ok(()),
        Some(change) => Err(Error::input(format!(
            "{}: `set` {}: this is no scene file whose values could be changed",
            path.display(),
            change.key
        ))
        .hint(
            "change the .toml file before it is packed, or take this file into one: packed = \
             \"FILE\"",
        )),
    }
}

/// Refuses a group of lights of what has none.
fn refuse_group(path: &Path, settings: &Settings) -> Result<()> {
    match &settings.group {
        None => Ok(()),
        Some(group) => Err(Error::input(format!(
            "{}: `group` {group}: expected a scene file (.toml), whose lights have groups",
            path.display()
        ))
        .hint("take this file into a scene file (.toml), or pack a scene of one group")),
    }
}

/// Extensions of volume files of one field that say themselves what their samples are.
const FIELD_FILES: [&str; 6] = ["nrrd", "nhdr", "nii", "mhd", "mha", "vol"];

/// Reads a volume file with one of the extensions [`FIELD_FILES`].
fn read_field(kind: &str, content: Vec<u8>, path: &Path, files: &mut Files) -> Result<Field> {
    match kind {
        "nii" => nifti::read(content, path, files),
        "mhd" | "mha" => metaimage::read(content, path, files),
        "vol" => vol::Vol::read(content)?.into_field(),
        _ => nrrd::read(content, path, files),
    }
}

/// Reads a scene file and all files that it names.
fn read_scene(path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    files.enter(path);
    files.add_changes()?;
    match files::extension(path).as_str() {
        "toml" => {
            let text = read_text(path, files)?;
            description::read(&text, path, files)
        }
        "gltf" | "glb" => {
            refuse_changes(path, &files.settings)?;
            refuse_group(path, &files.settings)?;
            let content = files.read("scene", path)?;
            let import = gltf::read(&content, path, files).map_err(|e| e.at(path.display()))?;
            import.tell_photometric(path, files);
            import.into_scene(path).map_err(|e| e.at(path.display()))
        }
        "xml" => {
            refuse_group(path, &files.settings)?;
            mitsuba::read(path, files)
        }
        other => Err(Error::input(format!(
            "{}: expected a scene file, found the extension \"{other}\"",
            path.display()
        ))
        .hint(match other {
            "blend" => "export it: `python3 tools/blender_export.py FILE.blend -o FOLDER`",
            "usd" | "usda" | "usdc" | "usdz" => {
                "export it: `python3 tools/usd_export.py FILE.usd -o FOLDER`"
            }
            _ => "scenes are .toml, .xml (Mitsuba), .gltf, .glb or .lvp files",
        })),
    }
}

/// The scene of what was read from files.
fn finish(builder: SceneBuilder, mut files: Files) -> Result<Scene> {
    left_out::tell_left_grids(&mut files);
    let frame = files.settings.frame;
    let builder = SceneBuilder { frame, ..builder };
    let mut scene = builder.finish(&files.cancel)?;
    scene.hash = files.hash();
    scene.group.clone_from(&files.settings.group);
    let names_frame = frame.filter(|_| files.names_frames);
    scene.files_of_frame = names_frame.or(scene.files_of_frame);
    scene.has_empty_volumes = files.has_empty_volumes;
    scene.files = files.paths;
    scene.warnings.splice(..0, files.warnings);
    scene.notes.splice(..0, files.notes);
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;
    use colors::ColorEncoding;
    use scale::Scale;
    use std::io::Write;

    const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    const STL: &str = "solid\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendsolid\n";
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
        let path = Path::new("x");
        let coloring = ply::Coloring {
            palette: None,
            encoding: ColorEncoding::Srgb,
        };
        let mesh = |cancel: &Cancel| {
            let encoding = ColorEncoding::Srgb;
            obj::read(OBJ.as_bytes(), path, encoding, &mut Files::until(cancel))
        };
        let field = |cancel: &Cancel| nrrd::read(nrrd(), Path::new("x"), &mut Files::until(cancel));
        let going = Cancel::default();
        let read: [(&str, &Read); 8] = [
            ("file", &|c| {
                Files::until(c)
                    .read("mesh", Path::new("Cargo.toml"))
                    .map(drop)
            }),
            ("obj", &|c| mesh(c).map(drop)),
            ("ply", &|c| {
                ply::read(PLY.as_bytes(), path, &coloring, &mut Files::until(c)).map(drop)
            }),
            ("stl", &|c| {
                stl::read(STL.as_bytes(), path, &mut Files::until(c)).map(drop)
            }),
            ("gltf", &|c| {
                gltf::read(GLTF.as_bytes(), Path::new("x"), &mut Files::until(c)).map(drop)
            }),
            ("nrrd", &|c| field(c).map(drop)),
            ("grid", &|c| {
                let scale = Scale::plain(1.0);
                field(&going)?
                    .grid(&scale, path, &mut Files::until(c))
                    .map(drop)
            }),
            ("creases", &|c| normals::crease(&mut mesh(&going)?, 0.5, c)),
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
        let demo = Path::new("src/scene/load/demo.toml");
        let error =
            Scene::load_into(&Lists::default(), demo, &Settings::default(), &stopped).unwrap_err();
        assert_eq!(error.to_string(), "stopped on request");
    }
}
