//! Header, counts, columns and levels of a file: nothing here reads a point.

use super::File;
use super::text::{Table, bytes, count, extinction_colors};
use crate::Result;
use crate::formats::{
    Block, Bounds, CloudMeta, ColumnBytes, LeftOut, Sums, TreeLevel, VolumeInfo, WorstError,
};
use crate::run::{hex, one_line};
use std::fmt;
use std::path::Path;

/// Description of a cloud or a tree. The keys of its JSON do not change within a version.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Description {
    /// Path of the file, as given.
    pub file: String,
    /// `cloud` or `tree`.
    pub kind: &'static str,
    /// Version of the format that the file has.
    pub version: u32,
    /// Length of the file.
    pub bytes: u64,
    /// Identity of the content.
    pub content_hash: String,
    /// Identity of the cloud that a tree was built from.
    pub cloud_hash: Option<String>,
    /// Name of the scene.
    pub scene_name: String,
    /// Identity of the scene.
    pub scene_hash: String,
    /// World space is scene space plus this.
    pub world_from_scene: [f64; 3],
    /// k in `radius = k sqrt(area / pi)`; 0 if radii are free.
    pub disk_overlap: f32,
    /// Volumes, in the order that lvoxels refer to.
    pub volumes: Vec<VolumeInfo>,
    /// Settings that the cloud was baked with.
    pub bake_settings: Vec<(String, String)>,
    /// Settings that the tree was built with.
    pub build_settings: Vec<(String, String)>,
    /// Box of the surfels, in scene space.
    pub bounds: Option<Bounds>,
    /// Counts and sums of the points.
    pub sums: Sums,
    /// Counts and sums of the cloud that a tree was built from.
    pub cloud_sums: Option<Sums>,
    /// Surfels, with their nodes in a tree.
    pub surfels: PointKind,
    /// Lvoxels of all volumes.
    pub lvoxels: PointKind,
    /// Nodes of a tree; one that links to a page counts there too.
    pub nodes: u64,
    /// Columns that are present.
    pub columns: Vec<ColumnBytes>,
    /// Columns that were not needed, everywhere or in places, and what that saved before
    /// compression; and kinds of points that there are none of, with 0 bytes: what they would take
    /// depends on how many there would be.
    pub left_out: Vec<LeftOut>,
    /// Levels of a tree, by steps below the root.
    pub levels: Vec<TreeLevel>,
    /// The worst differences between stored and given values of a tree.
    pub errors: Vec<WorstError>,
}

/// Bytes of one kind of point.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PointKind {
    /// Points of this kind.
    pub count: u64,
    /// Bytes in the file, nodes included.
    pub stored_bytes: u64,
    /// Stored bytes over count.
    pub bytes_each: f64,
    /// Chunks of a cloud, pages of a tree.
    pub blocks: u64,
    /// Stored bytes of a block.
    pub stored_block: BlockSizes,
    /// Bytes of a block before compression.
    pub raw_block: BlockSizes,
    /// Points of a block.
    pub block_records: BlockSizes,
}

/// A distribution over blocks.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct BlockSizes {
    /// The smallest.
    pub min: u32,
    /// The one in the middle.
    pub median: u32,
    /// The largest.
    pub max: u32,
}

impl BlockSizes {
    pub(super) fn of(blocks: &[Block], size: fn(&Block) -> u32) -> Self {
        let mut sizes: Vec<u32> = blocks.iter().map(size).collect();
        sizes.sort_unstable();
        match sizes[..] {
            [] => Self::default(),
            [min, ..] => Self {
                min,
                median: sizes[sizes.len() / 2],
                max: sizes[sizes.len() - 1],
            },
        }
    }
}

impl PointKind {
    fn of(blocks: &[Block]) -> Self {
        let count: u64 = blocks.iter().map(|b| u64::from(b.records)).sum();
        let stored_bytes: u64 = blocks.iter().map(|b| u64::from(b.stored_bytes)).sum();
        Self {
            count,
            stored_bytes,
            bytes_each: stored_bytes as f64 / count.max(1) as f64,
            blocks: blocks.len() as u64,
            stored_block: BlockSizes::of(blocks, |b| b.stored_bytes),
            raw_block: BlockSizes::of(blocks, |b| b.raw_bytes),
            block_records: BlockSizes::of(blocks, |b| b.records),
        }
    }
}

/// Describes a cloud or a tree.
///
/// # Errors
/// Wrong input for a file that is neither, or damaged in its tables.
pub fn describe(path: &Path) -> Result<Description> {
    let bytes = std::fs::metadata(path).map_or(0, |m| m.len());
    let file = path.display().to_string();
    let mut description = match File::open(path)? {
        File::Cloud(cloud) => {
            let summary = cloud.summary().clone();
            Description {
                surfels: PointKind::of(cloud.surfel_blocks()),
                lvoxels: PointKind::of(cloud.lvoxel_blocks()),
                bounds: summary.bounds,
                sums: summary.sums,
                columns: summary.columns,
                left_out: summary.left_out,
                content_hash: hex(&cloud.content_hash()),
                ..base(file, bytes, "cloud", cloud.version(), cloud.meta())
            }
        }
        File::Tree(tree) => {
            let summary = tree.summary().clone();
            Description {
                cloud_hash: Some(hex(&tree.meta().cloud_hash)),
                build_settings: tree.meta().settings.clone(),
                surfels: PointKind::of(tree.surfel_blocks()),
                lvoxels: PointKind::of(tree.lvoxel_blocks()),
                bounds: summary.bounds,
                sums: summary.sums,
                cloud_sums: Some(summary.cloud_sums),
                nodes: summary.nodes,
                columns: summary.columns,
                left_out: summary.left_out,
                levels: summary.levels,
                errors: summary.errors,
                content_hash: hex(&tree.content_hash()),
                ..base(file, bytes, "tree", tree.version(), &tree.meta().cloud)
            }
        }
    };
    let absent = description.absent_kinds();
    description.left_out.extend(absent);
    Ok(description)
}

fn base(
    file: String,
    bytes: u64,
    kind: &'static str,
    version: u32,
    meta: &CloudMeta,
) -> Description {
    Description {
        file,
        kind,
        version,
        bytes,
        content_hash: String::new(),
        cloud_hash: None,
        scene_name: meta.scene_name.clone(),
        scene_hash: hex(&meta.scene_hash),
        world_from_scene: meta.world_from_scene,
        disk_overlap: meta.disk_overlap,
        volumes: meta.volumes.clone(),
        bake_settings: meta.settings.clone(),
        build_settings: Vec::new(),
        bounds: None,
        sums: Sums::default(),
        cloud_sums: None,
        surfels: PointKind::of(&[]),
        lvoxels: PointKind::of(&[]),
        nodes: 0,
        columns: Vec::new(),
        left_out: Vec::new(),
        levels: Vec::new(),
        errors: Vec::new(),
    }
}

impl fmt::Display for Description {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} version {}, {}",
            one_line(&self.file),
            self.kind,
            self.version,
            bytes(self.bytes)
        )?;
        writeln!(
            f,
            "scene '{}', {}",
            one_line(&self.scene_name),
            self.scene_hash
        )?;
        writeln!(f, "content {}", self.content_hash)?;
        if let Some(hash) = &self.cloud_hash {
            writeln!(f, "built from cloud {hash}")?;
        }
        if let Some(b) = &self.bounds {
            writeln!(f, "bounds {:?} to {:?}", b.min, b.max)?;
        }
        writeln!(f, "area {:.6}, flux {:?}", self.sums.area, self.sums.flux)?;
        self.fmt_points(f)?;
        self.fmt_settings(f)?;
        self.fmt_columns(f)?;
        self.fmt_tree(f)
    }
}

impl Description {
    /// The kinds of points that the file has no section, no column and no sum for.
    fn absent_kinds(&self) -> Vec<LeftOut> {
        let mut absent = Vec::new();
        let mut add = |name: &str, because: &str| {
            absent.push(LeftOut {
                name: name.into(),
                because: because.into(),
                raw_bytes: 0,
            });
        };
        if self.surfels.blocks == 0 {
            add("surfels", "no surface was baked");
            if self.kind == "tree" {
                add("nodes", "no surface was baked");
            }
        }
        if self.lvoxels.blocks == 0 {
            let because = if self.volumes.is_empty() {
                "no volume in the scene"
            } else {
                "its volumes are empty"
            };
            add("lvoxels", because);
        }
        absent
    }

    fn fmt_points(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let block = if self.kind == "tree" {
            "pages"
        } else {
            "chunks"
        };
        let mut table = Table::new(&[
            "points", "count", "bytes", "each", block, "stored", "raw", "records",
        ]);
        for (name, kind) in [("surfels", &self.surfels), ("lvoxels", &self.lvoxels)] {
            let range = |s: BlockSizes| format!("{} {} {}", s.min, s.median, s.max);
            table.row(vec![
                name.into(),
                count(kind.count),
                count(kind.stored_bytes),
                format!("{:.1}", kind.bytes_each),
                count(kind.blocks),
                range(kind.stored_block),
                range(kind.raw_block),
                range(kind.block_records),
            ]);
        }
        write!(f, "{table}")?;
        if self.nodes > 0 {
            let share = self.nodes as f64 / self.surfels.count.max(1) as f64;
            writeln!(f, "{} nodes, {share:.3} per surfel", count(self.nodes))?;
        }
        Ok(())
    }

    fn fmt_settings(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut volumes = Table::new(&["volume", "voxels", "lvoxels", "sigma_t x voxels"]);
        for (volume, sums) in self.volumes.iter().zip(&self.sums.volumes) {
            volumes.row(vec![
                volume.name.clone(),
                volume.dims.map(|d| d.to_string()).join(" x "),
                count(sums.lvoxels),
                format!("{:.6}", sums.extinction),
            ]);
        }
        let colors = self.volumes.iter().map(|v| (&v.name, v.extinction_color));
        let colors = extinction_colors(colors);
        let mut settings = Table::new(&["setting", "value"]);
        for (name, value) in self.bake_settings.iter().chain(&self.build_settings) {
            settings.row(vec![name.clone(), value.clone()]);
        }
        for table in [volumes, colors, settings] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }

    fn fmt_columns(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut table = Table::new(&["column", "raw bytes", "stored bytes"]);
        for c in &self.columns {
            table.row(vec![
                c.name.clone(),
                count(c.raw_bytes),
                count(c.stored_bytes),
            ]);
        }
        let mut out = Table::new(&["left out", "bytes saved", "because"]);
        for c in &self.left_out {
            let saved = if c.raw_bytes == 0 {
                "all".into()
            } else {
                count(c.raw_bytes)
            };
            out.row(vec![c.name.clone(), saved, c.because.clone()]);
        }
        for table in [table, out] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }

    fn fmt_tree(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut levels = Table::new(&["level", "nodes", "leaves", "surfels", "bytes"]);
        for (i, l) in self.levels.iter().enumerate().filter(|(_, l)| l.nodes > 0) {
            let numbers = [l.nodes, l.leaves, l.surfels, l.bytes].map(count);
            let mut row = vec![i.to_string()];
            row.extend(numbers);
            levels.row(row);
        }
        let mut errors = Table::new(&["worst error", "found", "bound"]);
        for e in &self.errors {
            errors.row(vec![
                e.name.clone(),
                format!("{:.3e}", e.worst),
                format!("{:.3e}", e.bound),
            ]);
        }
        for table in [levels, errors] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
