//! The first points of a file.

use super::File;
use super::text::Table;
use crate::Result;
use crate::formats::{ClipEdge, FormatError, Lvoxel, Surfel};
use serde_json::{Value, json};
use std::fmt;
use std::path::Path;

/// The first surfels and lvoxels of a file, as decoded.
#[derive(Clone, Debug, Default)]
pub struct Points {
    /// Surfels, in the order of the file.
    pub surfels: Vec<Surfel>,
    /// Lvoxels, in the order of the file.
    pub lvoxels: Vec<Lvoxel>,
}

/// Reads the first `k` surfels and the first `k` lvoxels.
///
/// # Errors
/// Wrong input for a file that is neither cloud nor tree, or is damaged.
pub fn points(path: &Path, k: usize) -> Result<Points> {
    let mut points = Points::default();
    match File::open(path)? {
        File::Cloud(cloud) => {
            for i in 0..cloud.surfel_chunks() {
                fill(&mut points.surfels, k, || cloud.surfel_chunk(i))?;
            }
            for i in 0..cloud.lvoxel_chunks() {
                fill(&mut points.lvoxels, k, || cloud.lvoxel_chunk(i))?;
            }
        }
        File::Tree(tree) => {
            for i in 0..tree.surfel_pages() {
                fill(&mut points.surfels, k, || Ok(tree.surfel_page(i)?.surfels))?;
            }
            for i in 0..tree.lvoxel_pages() {
                fill(&mut points.lvoxels, k, || tree.lvoxel_page(i))?;
            }
        }
    }
    Ok(points)
}

fn fill<T>(
    points: &mut Vec<T>,
    k: usize,
    more: impl FnOnce() -> std::result::Result<Vec<T>, FormatError>,
) -> Result<()> {
    if points.len() < k {
        let wanted = k - points.len();
        points.extend(more()?.into_iter().take(wanted));
    }
    Ok(())
}

impl Points {
    /// The points as JSON, with stable keys.
    #[must_use]
    pub fn to_json(&self) -> Value {
        let surfel = |s: &Surfel| {
            let edges = &s.clips.edges[..usize::from(s.clips.count)];
            let clip = |e: &ClipEdge| json!({"angle": e.angle, "offset": e.offset});
            json!({
                "position": s.position,
                "normal": s.normal,
                "radius": s.radius,
                "area": s.area,
                "front": s.front,
                "back": s.back,
                "clips": edges.iter().map(clip).collect::<Vec<_>>(),
            })
        };
        let lvoxel = |v: &Lvoxel| {
            json!({
                "volume": v.volume,
                "level": v.level,
                "block": v.block,
                "sigma_t": v.sigma_t,
                "source": v.source,
            })
        };
        json!({
            "surfels": self.surfels.iter().map(surfel).collect::<Vec<_>>(),
            "lvoxels": self.lvoxels.iter().map(lvoxel).collect::<Vec<_>>(),
        })
    }
}

impl fmt::Display for Points {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let three = |v: [f32; 3]| format!("{:.6} {:.6} {:.6}", v[0], v[1], v[2]);
        let mut surfels = Table::new(&[
            "surfel", "position", "normal", "radius", "area", "front", "back", "clips",
        ]);
        for (i, s) in self.surfels.iter().enumerate() {
            surfels.row(vec![
                i.to_string(),
                three(s.position),
                three(s.normal),
                format!("{:.6e}", s.radius),
                format!("{:.6e}", s.area),
                three(s.front),
                three(s.back),
                s.clips.count.to_string(),
            ]);
        }
        let mut lvoxels = Table::new(&["lvoxel", "volume", "level", "block", "sigma_t", "source"]);
        for (i, v) in self.lvoxels.iter().enumerate() {
            lvoxels.row(vec![
                i.to_string(),
                v.volume.to_string(),
                v.level.to_string(),
                format!("{:?}", v.block),
                format!("{:.6e}", v.sigma_t),
                three(v.source),
            ]);
        }
        for table in [surfels, lvoxels] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
