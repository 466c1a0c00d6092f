//! The complete check of a file: damage, and conservation of what was baked.

use super::text::{Table, count};
use super::{File, packed, refuse_other_formats, samples, scattered};
use crate::formats::{Below, MappedFile, Packed, PackedColumn, Scatter, Tree};
use crate::run::{Job, Task, one_line};
use crate::scene::Scene;
use crate::trace::{Pieces, TriangleBvh};
use crate::{Error, Result};
use std::fmt;
use std::path::Path;

/// What may be verified, for people; images are read elsewhere.
const KINDS: &str = "a .lvc, .lvt, .lvs, .lvp, .exr or .exr.sums file";

/// The outcome of a check that found no damage.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Verification {
    /// Path of the file, as given.
    pub file: String,
    /// `cloud`, `tree`, `scatter`, `packed` or `samples`.
    pub kind: &'static str,
    /// Whether all checks hold.
    pub passed: bool,
    /// Each quantity that a stage must conserve, as found.
    pub checks: Vec<Check>,
    /// Depths of a tree, by steps below the root.
    pub depths: Vec<Depth>,
}

/// A quantity that a stage must conserve.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Check {
    /// Name of the quantity.
    pub name: String,
    /// Its value before the stage.
    pub expected: f64,
    /// Its value in this file.
    pub found: f64,
    /// Most that they may differ by.
    pub tolerance: f64,
    /// Whether they differ by less.
    pub passed: bool,
}

/// The nodes so many steps below the root. With the leaves above them they cover every surfel once.
#[derive(Clone, Copy, Debug, Default, serde::Serialize)]
pub struct Depth {
    /// Nodes at this depth.
    pub nodes: u64,
    /// Surfels in leaves at this depth.
    pub surfels: u64,
    /// Sum of the areas of these nodes and of the leaves above.
    pub area: f64,
}

impl Check {
    fn new(name: impl Into<String>, expected: f64, found: f64, tolerance: f64) -> Self {
        Self {
            name: name.into(),
            expected,
            found,
            tolerance,
            passed: (expected - found).abs() <= tolerance,
        }
    }
}

/// Reads all of a cloud, a tree, scattered light, a packed scene or kept samples: every checksum
/// and every value; and for a tree, that count, area, flux and optical depth are those of the cloud
/// within the bounds of the format, at every depth.
///
/// # Errors
/// Wrong input, for the first damage found; a job that is cancelled. What is not conserved is in
/// the result.
pub fn verify(path: &Path, job: &Job) -> Result<Verification> {
    let file = path.display().to_string();
    let undamaged = |file: String, kind: &'static str| Verification {
        file,
        kind,
        passed: true,
        checks: Vec::new(),
        depths: Vec::new(),
    };
    if samples(path)?.is_some() {
        return Ok(undamaged(file, "samples"));
    }
    refuse_other_formats(path, KINDS)?;
    if scattered(path)?.is_some() {
        let scatter = Scatter::open_path(path)?;
        let task = (job.progress).task("verify", scatter.blocks().len() as u64, "clusters");
        scatter.verify_with(|| next(&task, job))?;
        return Ok(undamaged(file, "scatter"));
    }
    if packed(path)?.is_some() {
        let packed = Packed::open_path(path)?;
        let task = (job.progress).task("verify", packed.blocks().len() as u64, "blocks");
        packed.verify_with(|| next(&task, job))?;
        check_scene(&Scene::open_packed(path, job)?, job).map_err(|e| e.at(&file))?;
        let has = |column| !packed.range(column, 0).is_empty();
        if has(PackedColumn::Tree) {
            Tree::open_within(path)?.verify_with(|| job.cancel.check())?;
        }
        if has(PackedColumn::Light) {
            Scatter::open_within(path)?.verify_with(|| job.cancel.check())?;
        }
        return Ok(undamaged(file, "packed"));
    }
    match File::open(path)? {
        File::Cloud(cloud) => {
            let blocks = cloud.surfel_chunks() + cloud.lvoxel_chunks();
            let task = job.progress.task("verify", blocks as u64, "chunks");
            cloud.verify_with(|| next(&task, job))?;
            Ok(undamaged(file, "cloud"))
        }
        File::Tree(tree) => {
            // Those of surfels are read again for the depths.
            let blocks = 2 * tree.surfel_pages() + tree.lvoxel_pages();
            let task = job.progress.task("verify", blocks as u64, "pages");
            tree.verify_with(|| next(&task, job))?;
            let depths = depths(&tree, || next(&task, job))?;
            let mut checks = conserved(&tree);
            let area = tree.summary().cloud_sums.area;
            for (i, depth) in depths.iter().enumerate() {
                // Aggregates come from unrounded surfels, so only their own rounding to a float
                // counts.
                let name = format!("area at depth {i}");
                checks.push(Check::new(name, area, depth.area, area * 1e-5));
            }
            Ok(Verification {
                file,
                kind: "tree",
                passed: checks.iter().all(|c| c.passed),
                checks,
                depths,
            })
        }
    }
}

/// Checks what of a packed scene was made from the rest of it.
fn check_scene(scene: &Scene, job: &Job) -> Result<()> {
    let wrong = |what: String| Err(Error::input(what).hint("pack the scene again"));
    if !TriangleBvh::of_scene(scene, &job.cancel)?.has_right_blocks(&scene.mesh) {
        return wrong("triangles in the leaves of the hierarchy are not those of the mesh".into());
    }
    let areas = scene.mesh.areas(scene.materials.len());
    if Pieces::areas(scene) != areas {
        return wrong("areas of materials are not those of their triangles".into());
    }
    for volume in &scene.volumes {
        job.cancel.check()?;
        if !volume.has_right_levels()? {
            return wrong(format!(
                "a level of the volume {:?} is not the mean of the one before, or samples beyond \
                 the border of the first are not those at it",
                volume.name
            ));
        }
        if !volume.has_right_errors()? {
            return wrong(format!(
                "errors of bricks of the volume {:?} on coarser levels are not \
                 those of its samples",
                volume.name
            ));
        }
    }
    if !scene.has_right_digests() {
        return wrong("digests are not those of its surfaces, materials and volumes".into());
    }
    Ok(())
}

/// Notes that a chunk or page was read.
fn next(task: &Task, job: &Job) -> Result<()> {
    task.add(1);
    job.cancel.check()
}

fn conserved(tree: &Tree<MappedFile>) -> Vec<Check> {
    let (cloud, found) = (&tree.summary().cloud_sums, &tree.summary().sums);
    let exact = |name: &str, a: u64, b: u64| Check::new(name, a as f64, b as f64, 0.0);
    let mut checks = vec![
        exact("surfels", cloud.surfels, found.surfels),
        exact("lvoxels", cloud.lvoxels(), found.lvoxels()),
        // A radius is off by 2^-11 at most, an area by twice that.
        Check::new("area", cloud.area, found.area, cloud.area / 1024.0),
    ];
    let brightest = cloud.flux.into_iter().fold(0.0, f64::max);
    for (channel, (a, b)) in ["red", "green", "blue"]
        .into_iter()
        .zip(cloud.flux.into_iter().zip(found.flux))
    {
        // A channel is off by 2^-9 of the largest one at most, which may be another in each surfel.
        let tolerance = brightest * (3.0 / 512.0 + 1.0 / 1024.0);
        // Light that has bounced is more than what was baked.
        if tree.meta().bounces().is_none() {
            checks.push(Check::new(format!("flux, {channel}"), a, b, tolerance));
        }
    }
    let names = tree.meta().cloud.volumes.iter().map(|v| &v.name);
    for (name, (a, b)) in names.zip(cloud.volumes.iter().zip(&found.volumes)) {
        let name = format!("sigma_t x voxels of '{name}'");
        let tolerance = a.extinction / 2048.0;
        checks.push(Check::new(name, a.extinction, b.extinction, tolerance));
    }
    checks
}

/// Goes through the pages from the root's down, so that each page's depth is known when it is met.
fn depths(tree: &Tree<MappedFile>, mut read: impl FnMut() -> Result<()>) -> Result<Vec<Depth>> {
    let mut page_depths = vec![0usize; tree.surfel_pages()];
    let mut depths: Vec<Depth> = Vec::new();
    // Area of the leaves at each depth.
    let mut leaves: Vec<f64> = Vec::new();
    for i in (0..tree.surfel_pages()).rev() {
        let page = tree.surfel_page(i)?;
        read()?;
        let mut at = vec![page_depths[i]; page.nodes.len()];
        for (n, node) in page.nodes.iter().enumerate() {
            let depth = at[n];
            if depth >= depths.len() {
                depths.resize(depth + 1, Depth::default());
                leaves.resize(depth + 1, 0.0);
            }
            match node.below {
                // The same node as that page's root, where it is counted.
                Below::Page(link) | Below::EvenPage(link) => {
                    page_depths[link as usize] = depth;
                    continue;
                }
                Below::Nodes { first, count } => {
                    let first = first as usize;
                    at[first..first + usize::from(count)].fill(depth + 1);
                }
                Below::Surfels { count, .. } => {
                    depths[depth].surfels += u64::from(count);
                    leaves[depth] += f64::from(node.aggregate.area);
                }
            }
            depths[depth].nodes += 1;
            depths[depth].area += f64::from(node.aggregate.area);
        }
    }
    let mut above = 0.0;
    for (depth, leaves) in depths.iter_mut().zip(leaves) {
        depth.area += above;
        above += leaves;
    }
    Ok(depths)
}

impl fmt::Display for Verification {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} undamaged{}",
            one_line(&self.file),
            self.kind,
            if self.passed {
                ""
            } else {
                ", but not all is conserved"
            }
        )?;
        let mut checks = Table::new(&["conserved", "expected", "found", "tolerance", ""]);
        for c in &self.checks {
            checks.row(vec![
                c.name.clone(),
                format!("{:.9e}", c.expected),
                format!("{:.9e}", c.found),
                format!("{:.1e}", c.tolerance),
                if c.passed { "ok" } else { "NOT CONSERVED" }.into(),
            ]);
        }
        let mut depths = Table::new(&["depth", "nodes", "surfels in leaves"]);
        for (i, d) in self.depths.iter().enumerate() {
            depths.row(vec![i.to_string(), count(d.nodes), count(d.surfels)]);
        }
        for table in [checks, depths] {
            if !table.is_empty() {
                write!(f, "{table}")?;
            }
        }
        Ok(())
    }
}
