//! The stage that packs a scene, and with it a tree and scattered light: one file that moves.
//!
//! In: a [`Scene`], and the files made from it. Out: a packed scene (`.lvp`), which every stage
//! takes in place of the scene.

use crate::formats::{
    MappedFile, Opened, Overwrite, Packed, PackedColumn, PackedWriter, Scatter, ScatterFormat,
    Tree, TreeFormat,
};
use crate::run::{Job, hex};
use crate::scene::{Scene, packed};
use crate::trace::{Pieces, TriangleBvh};
use crate::{Error, Result};
use std::path::Path;

/// What is packed with a scene.
#[derive(Clone, Copy, Debug, Default)]
pub struct Files<'a> {
    /// A tree that was made from the scene, or a packed scene with one.
    pub tree: Option<&'a Path>,
    /// Scattered light that was made from the tree, or a packed scene with it.
    pub light: Option<&'a Path>,
}

/// Whether a packed scene is this one with this film, and holds these files.
///
/// # Errors
/// A file that is no whole packed scene, tree or scattered light.
pub fn has_made(output: &Path, scene: &Scene, files: Files<'_>) -> Result<bool> {
    let found = Packed::open_path(output)?;
    let (meta, film) = (found.meta(), &scene.film);
    let is_scene = meta.scene_hash == scene.hash
        && meta.frame == scene.files_of_frame
        && meta.world_from_scene == scene.world_from_scene.to_array()
        && (meta.film.width, meta.film.height) == (film.width, film.height);
    type Hash = [u8; 16];
    let tree = |path: &Path| -> Result<Hash> {
        Ok(Opened::<MappedFile, TreeFormat>::open_within(path)?.content_hash())
    };
    let light = |path: &Path| -> Result<Hash> {
        Ok(Opened::<MappedFile, ScatterFormat>::open_within(path)?.content_hash())
    };
    let held = |bytes: u64| (bytes > 0).then_some(output);
    Ok(is_scene
        && files.tree.map(tree).transpose()? == held(meta.tree_bytes).map(tree).transpose()?
        && files.light.map(light).transpose()? == held(meta.light_bytes).map(light).transpose()?)
}

/// CPU seconds that packing a scene takes, about: by its triangles, over which a hierarchy is
/// built, and its voxels, which are coded. `None` for a packed scene, which is copied.
#[must_use]
pub fn expected_cpu_secs(scene: &Scene) -> Option<f64> {
    // Measured on terrain of 0.4 to 10.6 million triangles and clouds of 1 to 46 million voxels; on
    // other scenes of more than 0.03 seconds they are off by a fifth at most.
    const PER_TRIANGLE: f64 = 0.62e-6;
    const PER_VOXEL: f64 = 14.5e-9;
    /// For errors of bricks, of volumes that have many.
    const PER_VOXEL_OF_MANY: f64 = 4.5e-9;
    let volumes = scene.volumes.iter().map(|v| {
        let voxels = (v.sigma_t.bytes() / size_of::<f32>()) as f64;
        let of_many = match v.has_many_voxels() && v.albedo_grid.is_none() {
            true => PER_VOXEL_OF_MANY,
            false => 0.0,
        };
        (PER_VOXEL + of_many) * voxels
    });
    let secs = PER_TRIANGLE * scene.mesh.triangles.len() as f64 + volumes.sum::<f64>();
    scene.as_packed().is_none().then_some(secs)
}

/// Packs a scene. Equal scenes and files give equal bytes.
///
/// # Errors
/// Scattered light without its tree, an output that may not be replaced or cannot be written, or a
/// stop on request.
pub fn run(
    scene: &Scene,
    files: Files<'_>,
    output: &Path,
    overwrite: Overwrite,
    job: &Job,
) -> Result<()> {
    let tree = files
        .tree
        .map(Opened::<MappedFile, TreeFormat>::open_within);
    let tree: Option<Tree<MappedFile>> = tree.transpose()?;
    let light = files
        .light
        .map(Opened::<MappedFile, ScatterFormat>::open_within);
    let light: Option<Scatter<MappedFile>> = light.transpose()?;
    if let Some((light, path)) = light.as_ref().zip(files.light) {
        let expected = tree.as_ref().map(Opened::content_hash);
        let found = light.meta().tree_hash;
        if expected != Some(found) {
            let expected = expected.map_or_else(|| "none".to_owned(), |hash| hex(&hash));
            return Err(Error::input(format!(
                "{}: expected light gathered from the tree that is packed, {expected}, \
                 found that of {}",
                path.display(),
                hex(&found)
            ))
            .hint("pack the tree that it was made from, too"));
        }
    }
    job.stage("pack", |counts| {
        let hierarchy = TriangleBvh::of_scene(scene, &job.cancel)?;
        let tables = packed::level_tables(scene)?;
        let mut meta = packed::description(scene, &tables);
        hierarchy.describe(&mut meta);
        meta.areas = Pieces::areas(scene);
        let bytes = |file: Option<&MappedFile>| file.map_or(0, |f| f.as_ref().len() as u64);
        meta.tree_bytes = bytes(tree.as_ref().map(Opened::data));
        meta.light_bytes = bytes(light.as_ref().map(Opened::data));
        let mut writer = PackedWriter::create(output, meta, overwrite)?;
        packed::columns(scene, &tables, &mut writer, &job.cancel)?;
        hierarchy.write(&mut writer, &job.cancel)?;
        for (column, file) in [
            (PackedColumn::Tree, tree.as_ref().map(Opened::data)),
            (PackedColumn::Light, light.as_ref().map(Opened::data)),
        ] {
            if let Some(file) = file {
                writer.column(column, 0, file.as_ref(), || job.cancel.check())?;
            }
        }
        packed::media(scene, &tables, &mut writer, &job.cancel)?;
        // What was cut while it was copied may have been read as zeros.
        scene.check_file()?;
        let parts = [
            (tree.as_ref().map(Opened::data), files.tree),
            (light.as_ref().map(Opened::data), files.light),
        ];
        for (file, path) in parts {
            if let Some((file, path)) = file.zip(path) {
                file.check_length().map_err(|e| e.at(path))?;
            }
        }
        writer.finish()?;
        let written = std::fs::metadata(output).map_err(|e| Error::io("read", output, &e))?;
        counts.insert("bytes".into(), written.len() as f64);
        Ok(())
    })
}
