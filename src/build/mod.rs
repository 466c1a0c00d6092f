//! Cloud to tree: a sort along a Morton curve, then one sweep from the leaves up that writes pages.
//!
//! In: a cloud file and [`Settings`]. Out: a tree file.
//!
//! - `morton`: cells of the octree and their keys.
//! - `feed`: surfels in Morton order out of a cloud of any size, by way of `spill`, a temporary
//!   file, if they do not fit in memory; `frontier`: the cells that do.
//! - `subtree`: nodes from the leaves up, and pages of them.
//! - `join`: the parts of a bake as one cloud.
//! - `lvoxels`: lvoxels by volume and brick, in pages.
//! - `plan`: what a build will take, from a sample of the cloud.
//!
//! Memory: the surfels of one bucket are decoded at a time, beside the paths from it to the root
//! and one small buffer per bucket while the cloud is dealt out to them. A bucket is a run of
//! octree cells, so what is written depends on the octree alone: the same bytes for any memory
//! limit and any number of threads.

mod feed;
mod frontier;
mod join;
mod lvoxels;
mod morton;
mod plan;
mod spill;
mod subtree;

use crate::formats::{
    CHUNK_RECORDS, Cloud, MappedFile, Overwrite, Sums, Tree, TreeMeta, TreeSummary, TreeWriter,
};
use crate::run::{Job, size};
use crate::{Error, Result};
pub use join::join;
pub use plan::{Plan, plan};
use std::path::{Path, PathBuf};

/// Settings of a build.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Settings {
    /// Size that pages should have before compression, bytes.
    pub page_bytes: u32,
    /// Most surfels to hold at a time, if that is fewer than the memory limit allows.
    pub bucket_surfels: Option<u64>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            page_bytes: 16384,
            bucket_surfels: None,
        }
    }
}

impl Settings {
    /// Names and values, as they are kept in the tree.
    #[must_use]
    pub fn listed(&self) -> Vec<(String, String)> {
        vec![("page_bytes".into(), self.page_bytes.to_string())]
    }
}

/// The outcome of a build.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Summary of the tree file.
    pub summary: TreeSummary,
    /// Bytes written to temporary files; 0 if the cloud fitted in memory.
    pub spilled_bytes: u64,
}

/// The least memory limit: below this, chunks and pages in work would not fit.
pub const MIN_MEMORY: u64 = 64 << 20;
/// The limit where none is given.
pub const DEFAULT_MEMORY: u64 = 4 << 30;
/// Memory that is needed whatever the size of the cloud.
const FIXED_MEMORY: u64 = 28 << 20;
/// Per surfel of a bucket: the record, its sort key, its share of pages and nodes in work.
const SURFEL_MEMORY: u64 = 192;
/// Per page that was written, until all are.
const PAGE_MEMORY: u64 = 40;
/// Bytes of a surfel and its share of nodes in a page before compression, at most.
const SURFEL_PAGE_BYTES: u64 = 100;

/// Builds the tree of a cloud.
///
/// # Errors
/// Wrong input for a cloud that cannot be read or a limit that is too low; failed if a disk is
/// full; cancelled.
pub fn run(
    cloud_path: &Path,
    tree_path: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<Outcome> {
    job.stage("build", |counts| {
        let outcome = build(cloud_path, tree_path, settings, overwrite, job)?;
        let sums = &outcome.summary.sums;
        for (name, count) in [
            ("surfels", sums.surfels),
            ("lvoxels", sums.lvoxels()),
            ("nodes", outcome.summary.nodes),
            ("surfel pages", outcome.summary.surfel_pages),
            ("lvoxel pages", outcome.summary.lvoxel_pages),
            ("spilled bytes", outcome.spilled_bytes),
        ] {
            counts.insert(name.into(), count as f64);
        }
        Ok(outcome)
    })
}

/// Builds the tree over all parts of a bake, to the bytes that [`run`] writes for the undivided
/// cloud; of a single cloud, that cloud's. Parts are joined in the folder for temporary files.
///
/// # Errors
/// As [`run`] and [`join`].
pub fn run_parts(
    clouds: &[PathBuf],
    tree_path: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<Outcome> {
    if let [cloud] = clouds {
        return run(cloud, tree_path, settings, overwrite, job);
    }
    let folder = job.temporary_folder()?;
    let joined = folder.path().join("joined.lvc");
    job.stage("join", |counts| {
        let summary = join(clouds, &joined, Overwrite::Replace, job)?;
        counts.insert("parts".into(), clouds.len() as f64);
        counts.insert("surfels".into(), summary.sums.surfels as f64);
        Ok::<_, Error>(())
    })?;
    run(&joined, tree_path, settings, overwrite, job)
}

/// Whether a tree was built with these settings from this cloud, or from the bake whose parts these
/// are.
///
/// # Errors
/// A file that is no whole tree or cloud, or clouds that [`join`] would refuse.
pub fn has_made(tree: &Path, clouds: &[PathBuf], settings: &Settings) -> Result<bool> {
    let tree = Tree::open_path(tree)?;
    let found = tree.meta();
    if found.settings != settings.listed() {
        return Ok(false);
    }
    if let [cloud] = clouds {
        let cloud = Cloud::open_path(cloud)?;
        return Ok(found.cloud_hash == cloud.content_hash() && found.cloud == *cloud.meta());
    }
    Ok(found.cloud == join::meta_of(clouds)?)
}

fn build(
    cloud_path: &Path,
    tree_path: &Path,
    settings: &Settings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<Outcome> {
    let cloud = Cloud::open_path(cloud_path)?;
    let limits = Limits::new(settings, &[&cloud], job)?;
    if let Some((index, count)) = join::part(cloud.meta())? {
        return Err(Error::input(format!(
            "{}: expected a whole cloud, found part {index} of {count}",
            cloud_path.display()
        ))
        .hint("give all parts of the bake"));
    }
    let meta = TreeMeta {
        cloud: cloud.meta().clone(),
        cloud_hash: cloud.content_hash(),
        settings: settings.listed(),
    };
    let overlap = meta.cloud.disk_overlap;
    plan::check_room(&cloud, tree_path, settings, &limits, job)?;
    let mut writer = TreeWriter::create(tree_path, meta, overwrite)?;
    let mut spilled_bytes = 0;
    let mut root = None;
    let mut levels = Vec::new();
    let sums = cloud.summary().sums.clone();
    if sums.surfels > 0 {
        let pages = subtree::PageSettings {
            bytes: settings.page_bytes,
            overlap,
        };
        let mut feed = feed::Feed::new(&cloud, &limits, pages, job);
        let (last, counted) = feed.sweep(&mut writer)?;
        root = Some(last);
        levels = counted;
        spilled_bytes += feed.spilled_bytes();
    }
    if sums.lvoxels() > 0 {
        spilled_bytes += lvoxels::write(&cloud, &mut writer, settings.page_bytes, &limits, job)?;
    }
    job.cancel.check()?;
    let written = writer.sums();
    if (written.surfels, written.lvoxels()) != (sums.surfels, sums.lvoxels()) {
        return Err(Error::failed(format!(
            "expected {} surfels and {} lvoxels in the tree, found {} and {}",
            sums.surfels,
            sums.lvoxels(),
            written.surfels,
            written.lvoxels()
        ))
        .hint("this is a fault of lvox, or the cloud changed while it was read"));
    }
    let summary = writer.finish(root, sums, levels)?;
    Ok(Outcome {
        summary,
        spilled_bytes,
    })
}

/// How much a build may hold in memory.
struct Limits {
    /// Surfels of a bucket.
    surfels: u64,
    /// Bytes for the buffers of all buckets.
    buffers: u64,
    /// Chunks of the cloud that are decoded at a time.
    chunks: usize,
    /// Ranges of the temporary file that are unpacked at a time: together no larger than the
    /// chunks.
    ranges: usize,
    /// Whether there is room to read the next chunks or ranges while others are in work.
    reads_ahead: bool,
    /// Lvoxels that are sorted at a time.
    lvoxels: u64,
}

/// Bytes of memory for what is known of the pages of a tree, at most.
fn table_memory(sums: &Sums, page_bytes: u32) -> u64 {
    let bytes =
        sums.surfels * SURFEL_PAGE_BYTES + sums.lvoxels() * u64::from(lvoxels::LVOXEL_PAGE_BYTES);
    bytes / u64::from(page_bytes) * PAGE_MEMORY
}

/// Checks that a tree can be built within a limit of memory, before there is a cloud.
///
/// # Errors
/// A limit below [`MIN_MEMORY`].
pub fn check_memory(limit: Option<u64>) -> Result<()> {
    size::within("building a tree", MIN_MEMORY, limit)
}

impl Limits {
    /// For all of these clouds together.
    fn new(settings: &Settings, clouds: &[&MappedCloud], job: &Job) -> Result<Self> {
        if !(4096..=262_144).contains(&settings.page_bytes) {
            return Err(Error::input(format!(
                "page size: expected 4096 to 262144 bytes, found {}",
                settings.page_bytes
            )));
        }
        let sums = clouds.iter().map(|c| &c.summary().sums);
        let table: u64 = sums.map(|s| table_memory(s, settings.page_bytes)).sum();
        // As much for surfels as for pages, at least.
        let least = MIN_MEMORY.max(FIXED_MEMORY + 2 * table);
        size::within("building a tree of this cloud", least, job.memory_limit)?;
        let memory = job.memory_limit.unwrap_or(DEFAULT_MEMORY.max(least));
        let free = memory - FIXED_MEMORY - table;
        let most = settings.bucket_surfels.unwrap_or(u64::MAX).max(64);
        let room = (free / 3 / CHUNK_MEMORY) as usize;
        let chunks = room.clamp(1, rayon::current_num_threads());
        Ok(Self {
            // Indices within a bucket are 32 bits.
            surfels: (free / SURFEL_MEMORY).min(most).min(1 << 31),
            buffers: free / 8,
            chunks,
            ranges: 4 * chunks,
            reads_ahead: room >= 2 * chunks,
            lvoxels: (free / lvoxels::LVOXEL_MEMORY).min(most).min(1 << 31),
        })
    }
}

/// A chunk of surfels while it is decoded and dealt out: the records and its longest columns twice,
/// or the records, their rows and the planes of these.
const CHUNK_MEMORY: u64 = CHUNK_RECORDS as u64 * 206;

type MappedCloud = Cloud<MappedFile>;
