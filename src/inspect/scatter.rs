//! What a file of scattered light says of itself.

use super::describe::BlockSizes;
use super::text::{Table, bytes, count, extinction_colors};
use crate::Result;
use crate::formats::{
    BlockKind, ClusterId, ColumnBytes, FileKind, LeftOut, MappedFile, Scatter, VolumeInfo,
};
use crate::run::{hex, one_line};
use std::fmt;
use std::path::Path;

/// Header, counts and columns of scattered light. The keys of its JSON do not change within a
/// version.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Scattered {
    /// Path of the file, as given.
    pub file: String,
    /// `scatter`.
    pub kind: &'static str,
    /// Version of the format that the file has.
    pub version: u32,
    /// Length of the file.
    pub bytes: u64,
    /// Identity of the content.
    pub content_hash: String,
    /// Identity of the tree that light was gathered from.
    pub tree_hash: String,
    /// Name of the scene.
    pub scene_name: String,
    /// Identity of the scene.
    pub scene_hash: String,
    /// Volumes, in the order that clusters refer to.
    pub volumes: Vec<VolumeInfo>,
    /// Settings that the light was made with.
    pub settings: Vec<(String, String)>,
    /// Vertices, by volume, light and spacing.
    pub lattices: Vec<Lattice>,
    /// Clusters of all lattices.
    pub clusters: u64,
    /// Stored bytes of a cluster.
    pub stored_cluster: BlockSizes,
    /// Columns that are present.
    pub columns: Vec<ColumnBytes>,
    /// Columns that were not needed, everywhere or in places, and what that saved before
    /// compression.
    pub left_out: Vec<LeftOut>,
}

/// Vertices of one spacing.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Lattice {
    /// Number of the volume.
    pub volume: u16,
    /// `direct` or `indirect`.
    pub light: &'static str,
    /// Voxels between vertices.
    pub spacing: u32,
    /// Number of vertices.
    pub vertices: u64,
    /// Bytes in the file.
    pub stored_bytes: u64,
}

/// Describes scattered light, of which no vertex is read; `None` if it is another kind of file.
///
/// # Errors
/// A file that cannot be read, that is none of ours, or scattered light that is damaged in its
/// tables.
pub fn scattered(path: &Path) -> Result<Option<Scattered>> {
    let file = MappedFile::open(path)?;
    let length = file.as_ref().len() as u64;
    if FileKind::of(file.as_ref()).map_err(|e| e.at(path))? != FileKind::Scatter {
        return Ok(None);
    }
    let scatter = Scatter::open_path(path)?;
    let (meta, summary) = (scatter.meta(), scatter.summary());
    let mut lattices: Vec<Lattice> = Vec::new();
    for (block, &ClusterId { volume, level, .. }) in scatter.blocks().iter().zip(&summary.clusters)
    {
        let light = match block.kind {
            BlockKind::Direct => "direct",
            _ => "indirect",
        };
        let spacing = 1 << level;
        let same = |l: &&mut Lattice| (l.volume, l.light, l.spacing) == (volume, light, spacing);
        if lattices.last_mut().filter(same).is_none() {
            lattices.push(Lattice {
                volume,
                light,
                spacing,
                vertices: 0,
                stored_bytes: 0,
            });
        }
        if let Some(lattice) = lattices.last_mut() {
            lattice.vertices += u64::from(block.records);
            lattice.stored_bytes += u64::from(block.stored_bytes);
        }
    }
    Ok(Some(Scattered {
        file: path.display().to_string(),
        kind: "scatter",
        version: scatter.version(),
        bytes: length,
        content_hash: hex(&scatter.content_hash()),
        tree_hash: hex(&meta.tree_hash),
        scene_name: meta.scene_name.clone(),
        scene_hash: hex(&meta.scene_hash),
        volumes: meta.volumes.clone(),
        settings: meta.settings.clone(),
        lattices,
        clusters: scatter.blocks().len() as u64,
        stored_cluster: BlockSizes::of(scatter.blocks(), |b| b.stored_bytes),
        columns: summary.columns.clone(),
        left_out: summary.left_out.clone(),
    }))
}

impl fmt::Display for Scattered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: scattered light, version {}, {}",
            one_line(&self.file),
            self.version,
            bytes(self.bytes)
        )?;
        writeln!(f, "content {}", self.content_hash)?;
        writeln!(f, "of tree {}", self.tree_hash)?;
        writeln!(f, "scene   {:?} {}", self.scene_name, self.scene_hash)?;
        let settings = self
            .settings
            .iter()
            .map(|(name, value)| one_line(format_args!("{name} {value}")));
        writeln!(f, "made with {}", settings.collect::<Vec<_>>().join(", "))?;
        let sizes = self.stored_cluster;
        writeln!(
            f,
            "{} clusters of {} to {}, half of them at most {}",
            count(self.clusters),
            bytes(sizes.min.into()),
            bytes(sizes.max.into()),
            bytes(sizes.median.into())
        )?;
        let mut lattices =
            Table::new(&["volume", "light", "spacing", "vertices", "stored", "each"]);
        for l in &self.lattices {
            let name = self
                .volumes
                .get(usize::from(l.volume))
                .map_or("", |v| &v.name);
            lattices.row(vec![
                name.into(),
                l.light.into(),
                l.spacing.to_string(),
                count(l.vertices),
                bytes(l.stored_bytes),
                format!("{:.1} B", l.stored_bytes as f64 / l.vertices.max(1) as f64),
            ]);
        }
        let colors = self.volumes.iter().map(|v| (&v.name, v.extinction_color));
        let colors = extinction_colors(colors);
        let mut columns = Table::new(&["column", "raw", "stored"]);
        for c in &self.columns {
            columns.row(vec![
                c.name.clone(),
                bytes(c.raw_bytes),
                bytes(c.stored_bytes),
            ]);
        }
        let mut left_out = Table::new(&["left out", "because", "saves"]);
        for l in &self.left_out {
            left_out.row(vec![l.name.clone(), l.because.clone(), bytes(l.raw_bytes)]);
        }
        for table in [lattices, colors, columns, left_out] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
