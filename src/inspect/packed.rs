//! What a packed scene says of itself.

use super::text::{Table, bytes, count};
use crate::Result;
use crate::formats::{FileKind, MappedFile, Packed, PackedMeta};
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
    /// What the file is made of.
    pub parts: Vec<PackedPart>,
}

/// Columns of one kind, or the bricks of all volumes.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PackedPart {
    /// Name, as in the format's specification.
    pub name: &'static str,
    /// Columns, or volumes.
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
    for (i, volume) in (0..).zip(&packed.meta().volumes) {
        let stored = &packed.blocks()[packed.brick_blocks(i)?];
        let stored = stored.iter().map(|b| u64::from(b.stored_bytes)).sum();
        add(&mut parts, "samples", volume.bricks, stored);
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
        let mut volumes = Table::new(&["volume", "voxels", "bricks"]);
        for v in &scene.volumes {
            let [x, y, z] = v.dims;
            volumes.row(vec![
                v.name.clone(),
                format!("{x} x {y} x {z}"),
                count(v.bricks),
            ]);
        }
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
        for table in [volumes, parts] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
