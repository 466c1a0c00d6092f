//! What a packed scene says of itself.

use super::text::{Table, bytes, count, extinction_colors};
use crate::Result;
use crate::formats::{BRICK_VOXELS, FileKind, MappedFile, Packed, PackedMeta};
use crate::run::{hex, one_line};
use std::fmt;
use std::path::Path;

/// Header, description and columns of a packed scene. The keys of its JSON do not change within a
/// version.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PackedDescription {
    /// Path of the file, as given.
    pub file: String,
    /// `packed`.
    pub kind: &'static str,
    /// Version of the format that the file has.
    pub version: u32,
    /// Length of the file.
    pub bytes: u64,
    /// Identity of the content.
    pub content_hash: String,
    /// Identity of the scene.
    pub scene_hash: String,
    /// The scene, without its columns.
    pub scene: PackedMeta,
    /// Which columns the file has.
    pub parts: Vec<PackedPart>,
    /// Which levels its volumes have.
    pub levels: Vec<PackedLevel>,
}

/// A level of a volume.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PackedLevel {
    /// Name of the volume.
    pub volume: String,
    /// 0 for the voxels themselves, l for means over `2^l` of them along each axis.
    pub level: usize,
    /// Voxels along x, y, z.
    pub voxels: [u32; 3],
    /// Bricks of 8^3 voxels that are stored.
    pub bricks: u64,
    /// Bytes in the file, the table of bricks included.
    pub stored_bytes: u64,
}

/// Columns of one kind.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PackedPart {
    /// Name, as in the format's specification.
    pub name: &'static str,
    /// How many columns.
    pub count: u64,
    /// Rows of all of them.
    pub rows: u64,
    /// Bytes in the file, without those that fill up pages.
    pub stored_bytes: u64,
}

/// Describes a packed scene, of which no column is read; `None` if it is another kind of file.
///
/// # Errors
/// A file that cannot be read, that is none of ours, or a packed scene that is damaged in its
/// tables.
pub fn packed(path: &Path) -> Result<Option<PackedDescription>> {
    let file = MappedFile::open(path)?;
    if FileKind::of(file.as_ref()).map_err(|e| e.at(path))? != FileKind::Packed {
        return Ok(None);
    }
    let packed = Packed::open_path(path)?;
    let mut parts: Vec<PackedPart> = Vec::new();
    for (column, blocks) in packed.columns() {
        let stored = &packed.blocks()[blocks.clone()];
        add(
            &mut parts,
            column.column.name(),
            column.rows,
            stored.iter().map(|b| u64::from(b.stored_bytes)).sum(),
        );
    }
    let mut levels = Vec::new();
    for (v, volume) in packed.meta().volumes.iter().enumerate() {
        for (l, bricks) in volume.levels.iter().enumerate() {
            let stored = &packed.blocks()[packed.level_blocks(v, l)?];
            let stored_bytes = stored.iter().map(|b| u64::from(b.stored_bytes)).sum();
            levels.push(PackedLevel {
                volume: volume.name.clone(),
                level: l,
                voxels: volume.dims_of_level(l),
                bricks: *bricks,
                stored_bytes,
            });
        }
    }
    Ok(Some(PackedDescription {
        file: path.display().to_string(),
        kind: "packed",
        version: packed.version(),
        bytes: packed.file_bytes(),
        content_hash: hex(&packed.content_hash()),
        scene_hash: hex(&packed.meta().scene_hash),
        scene: packed.meta().clone(),
        parts,
        levels,
    }))
}

fn add(parts: &mut Vec<PackedPart>, name: &'static str, rows: u64, stored_bytes: u64) {
    match parts.iter_mut().find(|p| p.name == name) {
        Some(part) => {
            part.count += 1;
            part.rows += rows;
            part.stored_bytes += stored_bytes;
        }
        None => parts.push(PackedPart {
            name,
            count: 1,
            rows,
            stored_bytes,
        }),
    }
}

impl fmt::Display for PackedDescription {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let scene = &self.scene;
        writeln!(
            f,
            "{}: packed scene, version {}, {}",
            one_line(&self.file),
            self.version,
            bytes(self.bytes)
        )?;
        writeln!(f, "content {}", self.content_hash)?;
        writeln!(f, "scene   {:?} {}", scene.scene_name, self.scene_hash)?;
        let film = &scene.film;
        let size = format_args!("{} x {} pixels", film.width, film.height);
        writeln!(f, "film    {size}, exposure {}", film.exposure)?;
        let cameras = scene.cameras.iter().map(|c| one_line(&c.name));
        let cameras = cameras.collect::<Vec<_>>().join(", ");
        writeln!(f, "cameras {cameras}")?;
        let has = [
            (scene.mesh.vertices, "vertices"),
            (scene.mesh.triangles, "triangles"),
            (scene.materials.len() as u64, "materials"),
            (scene.textures.len() as u64, "textures"),
            (scene.lights.len() as u64, "lights"),
            (scene.volumes.len() as u64, "volumes"),
        ];
        let has = has.map(|(n, what)| format!("{} {what}", count(n)));
        writeln!(f, "has     {}", has.join(", "))?;
        let mut levels = Table::new(&["volume", "level", "voxels", "bricks", "stored", "a voxel"]);
        for l in &self.levels {
            let [x, y, z] = l.voxels;
            let voxels = (l.bricks * BRICK_VOXELS as u64).max(1);
            levels.row(vec![
                l.volume.clone(),
                l.level.to_string(),
                format!("{x} x {y} x {z}"),
                count(l.bricks),
                bytes(l.stored_bytes),
                format!("{:.2} B", l.stored_bytes as f64 / voxels as f64),
            ]);
        }
        let colors = scene.parts.extinction_colors.iter().filter_map(|of| {
            let volume = scene.volumes.get(of.volume as usize)?;
            Some((&volume.name, of.color))
        });
        let colors = extinction_colors(colors);
        let mut parts = Table::new(&["part", "count", "rows", "stored", "a row"]);
        for p in &self.parts {
            parts.row(vec![
                p.name.into(),
                count(p.count),
                count(p.rows),
                bytes(p.stored_bytes),
                format!("{:.1} B", p.stored_bytes as f64 / p.rows.max(1) as f64),
            ]);
        }
        for table in [levels, colors, parts] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
