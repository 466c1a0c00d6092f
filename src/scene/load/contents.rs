//! What a scene, mesh or volume file holds, read as for rendering but without the need to be a
//! whole scene.

use super::colors::ColorEncoding;
use super::field::Field;
use super::files::{Files, extension};
use super::left_out::tell_left_grids;
use super::scale::{Density, Scale};
use super::values::GridValues;
use super::{
    FIELD_FILES, Settings, finish, obj, ply, read_field, read_scene, refuse_changes, stl, vdb,
};
use crate::run::Job;
use crate::scene::Scene;
use crate::scene::builder::{SceneBuilder, VolumeInput};
use crate::{Error, Result};
use std::path::Path;

/// Extensions of the files that [`contents`] reads.
pub const EXTENSIONS: [&str; 14] = [
    "toml", "xml", "gltf", "glb", "obj", "ply", "stl", "vdb", "nrrd", "nhdr", "nii", "mhd", "mha",
    "vol",
];

/// What a file says that it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContentsKind {
    /// A scene file.
    Scene,
    /// A mesh; the camera and the light of the scene are made up.
    Mesh,
    /// A volume; the camera and the light of the scene are made up, and its extinction is that of a
    /// scale of 1.
    Volume,
}

/// What was read of a scene, mesh or volume file.
#[derive(Debug)]
pub struct Contents {
    /// What the file is.
    pub kind: ContentsKind,
    /// All that would be rendered, with the warnings of what is left out.
    pub scene: Scene,
    /// The values of each volume of the scene, as its file has them.
    pub values: Vec<GridValues>,
}

/// Whether the name of a file is that of one that [`contents`] reads.
#[must_use]
pub fn has_contents(path: &Path) -> bool {
    EXTENSIONS.contains(&extension(path).as_str())
}

/// Reads a scene file, or a mesh or volume file by itself, with the readers that rendering has; of
/// a VDB all grids. Warnings are in the scene; only those before an error go to the job's progress.
///
/// # Errors
/// As [`Scene::load`], and if cancelled.
pub fn contents(path: &Path, settings: &Settings, job: &Job) -> Result<Contents> {
    let mut files = Files::with(settings.clone(), &job.cancel);
    files.values = Some(Vec::new());
    files.enter(path);
    let kind = match extension(path).as_str() {
        "obj" | "ply" | "stl" => ContentsKind::Mesh,
        "vdb" => ContentsKind::Volume,
        kind if FIELD_FILES.contains(&kind) => ContentsKind::Volume,
        _ => ContentsKind::Scene,
    };
    if kind != ContentsKind::Scene {
        refuse_changes(path, settings)?;
    }
    let builder = match kind {
        ContentsKind::Scene => read_scene(path, &mut files),
        ContentsKind::Mesh => mesh(path, &mut files).map_err(|e| e.at(path.display())),
        ContentsKind::Volume => volumes(path, &mut files),
    };
    // An error may be the last of what is odd.
    let builder =
        builder.inspect_err(|_| files.warnings.iter().for_each(|w| job.progress.warn(w)))?;
    let values = files.values.take().unwrap_or_default();
    tell_left_grids(&mut files);
    let read_warnings = files.warnings.len();
    let builder = SceneBuilder {
        keeps_voxels: true,
        ..builder
    };
    let mut scene = finish(builder, files).map_err(|e| e.at(path.display()))?;
    if kind != ContentsKind::Scene {
        // That there is no camera and no light is no surprise.
        scene.warnings.truncate(read_warnings);
    }
    Ok(Contents {
        kind,
        scene,
        values,
    })
}

fn named(path: &Path) -> SceneBuilder {
    SceneBuilder::new(path.file_stem().unwrap_or_default().to_string_lossy())
}

fn mesh(path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    let content = files.read("mesh", path)?;
    let encoding = ColorEncoding::default();
    let mesh = match extension(path).as_str() {
        "ply" => {
            let palette = None;
            let coloring = ply::Coloring { palette, encoding };
            ply::read(&content, path, &coloring, files)
        }
        "stl" => stl::read(&content, path, files),
        _ => obj::read(&content, path, encoding, files),
    }?;
    mesh.check()?;
    Ok(named(path).mesh(mesh))
}

fn volumes(path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    let fields = match extension(path).as_str() {
        "vdb" => vdb::read(
            files.map("volume", path)?,
            path,
            vdb::Wanted::All,
            None,
            files,
        ),
        kind => {
            let content = files.read("volume", path)?;
            read_field(kind, content, path, files).map(|field| vec![field])
        }
    };
    let fields = fields.map_err(|e| e.at(path.display()))?;
    if fields.is_empty() {
        return Err(Error::input(format!(
            "{}: no voxel is active: there is nothing to render",
            path.display()
        )));
    }
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut builder = named(path);
    for field in fields {
        let name = field.name.clone().unwrap_or_else(|| stem.to_string());
        let volume = volume(name, &field, path, files).map_err(|e| e.at(path.display()))?;
        builder = builder.volume(volume);
    }
    Ok(builder)
}

/// A volume of which nothing is said but what is in its file.
fn volume(name: String, field: &Field, path: &Path, files: &mut Files) -> Result<VolumeInput> {
    field.note_values(path, files)?;
    let values = files.values.iter().flatten().last();
    let mut scale = Scale::plain(1.0);
    // As it is, a negative value cannot be an extinction.
    if let Some(values) = values
        && values.min < 0.0
    {
        let ends = [values.min, values.max.max(0.0)].map(f64::from);
        scale.density = Density::Window(ends);
        files.warn(format!(
            "{}: values below 0 need a `window` in the scene file; here it is [{}, {}]",
            path.display(),
            ends[0],
            ends[1]
        ));
    }
    let world_from_grid = field.placed(None).unwrap_or_else(|| {
        files.warn(format!(
            "{}: the file does not say where the volume is: voxels are taken as 1 unit wide",
            path.display()
        ));
        field.file_from_grid()
    });
    let sigma_t = field.grid(&scale, path, files)?;
    Ok(VolumeInput::new(name, sigma_t, [1.0; 3], world_from_grid))
}
