//! What a build will take, from a sample of the cloud: known before anything is written.

use super::spill::Run;
use super::subtree::{self, PageSettings, Pages, Sorted};
use super::{FIXED_MEMORY, Limits, MappedCloud, Settings, feed, lvoxels, morton::Cube};
use crate::Result;
use crate::formats::{Bounds, Cloud, Sums, Surfel};
use crate::run::{Job, size, usage};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Chunks of each kind that a plan looks at, spread over the cloud.
const SAMPLED_CHUNKS: usize = 12;
/// A cloud of fewer chunks is built without a look at the disk: it takes less than a gigabyte.
const MIN_CHUNKS_TO_CHECK: usize = 1024;
/// Bytes in memory of a surfel in work: the record, its key, its share of pages and nodes.
const SURFEL_BYTES: f64 = 148.0;

/// What a build will take, about.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Plan {
    /// Surfels in the cloud.
    pub surfels: u64,
    /// Lvoxels in the cloud.
    pub lvoxels: u64,
    /// Bytes of the tree.
    pub tree_bytes: u64,
    /// Bytes of temporary files; 0 if the cloud fits in memory.
    pub temporary_bytes: u64,
    /// Most bytes of memory at a time.
    pub memory_bytes: u64,
    /// Seconds from start to end on this machine, with the threads that there are.
    pub secs: f64,
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "surfels          {}", self.surfels)?;
        writeln!(f, "lvoxels          {}", self.lvoxels)?;
        writeln!(f, "tree             {}", size::format(self.tree_bytes))?;
        writeln!(f, "temporary files  {}", size::format(self.temporary_bytes))?;
        writeln!(f, "memory           {}", size::format(self.memory_bytes))?;
        writeln!(f, "time             {:.1} s", self.secs)
    }
}

/// Says what a build of a cloud, or of the parts of one, will take, from some of its chunks; writes
/// nothing.
///
/// # Errors
/// As [`super::run`], but for what concerns the tree's file.
pub fn plan(clouds: &[PathBuf], settings: &Settings, job: &Job) -> Result<Plan> {
    let opened = clouds
        .iter()
        .map(|path| Ok(Cloud::open_path(path)?))
        .collect::<Result<Vec<_>>>()?;
    let opened: Vec<_> = opened.iter().collect();
    let limits = Limits::new(settings, &opened, job)?;
    let mut plan = of_clouds(&opened, settings, &limits, job)?;
    if clouds.len() > 1 {
        // Parts are joined in a temporary file.
        let bytes = |path: &PathBuf| std::fs::metadata(path).map_or(0, |m| m.len());
        plan.temporary_bytes += clouds.iter().map(bytes).sum::<u64>();
    }
    Ok(plan)
}

/// An error if a disk cannot hold the tree or the temporary files of a large cloud.
pub fn check_room(
    cloud: &MappedCloud,
    tree_path: &Path,
    settings: &Settings,
    limits: &Limits,
    job: &Job,
) -> Result<()> {
    if cloud.surfel_chunks() + cloud.lvoxel_chunks() < MIN_CHUNKS_TO_CHECK {
        return Ok(());
    }
    let plan = of_clouds(&[cloud], settings, limits, job)?;
    let temp_folder = job.temp_dir.clone().unwrap_or_else(std::env::temp_dir);
    usage::check_room(
        "the tree",
        usage::folder_of(tree_path),
        plan.tree_bytes,
        "free some of the disk, or write elsewhere",
    )?;
    usage::check_room(
        "temporary files",
        &temp_folder,
        plan.temporary_bytes,
        "free some of the disk, or choose another folder for temporary files (`temp_dir`)",
    )
}

fn of_clouds(
    clouds: &[&MappedCloud],
    settings: &Settings,
    limits: &Limits,
    job: &Job,
) -> Result<Plan> {
    let sums = || clouds.iter().map(|c| &c.summary().sums);
    let mut plan = Plan {
        surfels: sums().map(|s| s.surfels).sum(),
        lvoxels: sums().map(Sums::lvoxels).sum(),
        ..Plan::default()
    };
    for cloud in clouds {
        let own = &cloud.summary().sums;
        let deals = feed::deals(plan.surfels, limits);
        let mut sample = Sample::of_surfels(cloud, settings, deals > 0, job)?;
        sample.temporary_bytes *= deals;
        plan.add(&sample, own.surfels);
        let spills = plan.lvoxels > limits.lvoxels;
        let sample = Sample::of_lvoxels(cloud, settings, spills, job)?;
        plan.add(&sample, own.lvoxels());
    }
    let surfels = plan.surfels.min(limits.surfels) as f64 * SURFEL_BYTES;
    let lvoxels = plan.lvoxels.min(limits.lvoxels) * lvoxels::LVOXEL_MEMORY;
    let tables = sums().map(|s| super::table_memory(s, settings.page_bytes));
    plan.memory_bytes = FIXED_MEMORY + tables.sum::<u64>() + lvoxels.max(surfels as u64);
    Ok(plan)
}

impl Plan {
    /// Adds what `records` of a cloud take, by a sample of them.
    fn add(&mut self, sample: &Sample, records: u64) {
        let factor = records as f64 / sample.records.max(1) as f64;
        self.tree_bytes += (sample.tree_bytes as f64 * factor) as u64;
        self.temporary_bytes += (sample.temporary_bytes as f64 * factor) as u64;
        self.secs += sample.secs * factor;
    }
}

/// What some chunks took.
struct Sample {
    records: u64,
    tree_bytes: u64,
    temporary_bytes: u64,
    /// Seconds on all threads.
    secs: f64,
}

/// Chunks that are looked at: first to last, evenly.
fn sampled(chunks: usize) -> impl IndexedParallelIterator<Item = usize> {
    let n = chunks.min(SAMPLED_CHUNKS);
    (0..n).into_par_iter().map(move |i| i * chunks / n)
}

impl Sample {
    fn of_surfels(
        cloud: &MappedCloud,
        settings: &Settings,
        spills: bool,
        job: &Job,
    ) -> Result<Self> {
        let cube = Cube::around(&cloud.summary().bounds.unwrap_or(Bounds::EMPTY));
        let pages = PageSettings {
            bytes: settings.page_bytes,
            overlap: cloud.meta().disk_overlap,
        };
        Self::take(cloud.surfel_chunks(), job, |i| {
            let surfels = cloud.surfel_chunk(i)?;
            let temporary_bytes = if spills {
                // A spilled cloud is read twice, and packed and unpacked once.
                cloud.surfel_positions(i)?;
                let run = Run::of(&surfels)?;
                run.unpack::<Surfel>()?;
                run.stored_bytes()
            } else {
                0
            };
            let mut order = Vec::new();
            feed::sort(cube, &surfels, &mut order);
            let sorted = Sorted {
                surfels: &surfels,
                order: &order,
            };
            let mut pages = Pages::new(0, pages);
            let root = subtree::build(&sorted, 0, &mut pages, &job.cancel)?;
            pages.cut(root)?;
            let bytes = pages.done.iter().map(|p| p.stored_bytes() as u64).sum();
            Ok((surfels.len() as u64, bytes, temporary_bytes))
        })
    }

    fn of_lvoxels(
        cloud: &MappedCloud,
        settings: &Settings,
        spills: bool,
        job: &Job,
    ) -> Result<Self> {
        let volumes = &cloud.meta().volumes;
        Self::take(cloud.lvoxel_chunks(), job, |i| {
            let own = cloud.lvoxel_chunk(i)?;
            let bytes = lvoxels::stored_bytes(&own, settings.page_bytes, volumes)?;
            let temporary_bytes = if spills {
                Run::of(&own)?.stored_bytes()
            } else {
                0
            };
            Ok((own.len() as u64, bytes, temporary_bytes))
        })
    }

    /// Adds up what `look` says of chunks: records, bytes in the tree, temporary bytes.
    fn take(
        chunks: usize,
        job: &Job,
        look: impl Fn(usize) -> Result<(u64, u64, u64)> + Sync,
    ) -> Result<Self> {
        let started = Instant::now();
        let found = sampled(chunks)
            .map(|i| {
                job.cancel.check()?;
                look(i)
            })
            .collect::<Result<Vec<_>>>()?;
        Ok(Self {
            records: found.iter().map(|f| f.0).sum(),
            tree_bytes: found.iter().map(|f| f.1).sum(),
            temporary_bytes: found.iter().map(|f| f.2).sum(),
            secs: started.elapsed().as_secs_f64(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfels_are_dealt_once_more_where_there_are_too_many_buckets() {
        let limits = |buffers| Limits {
            surfels: 1000,
            buffers,
            chunks: 1,
            ranges: 1,
            reads_ahead: false,
            lvoxels: 1000,
        };
        let small = limits(1 << 20);
        for (surfels, deals) in [(1000, 0), (1001, 1), (200_000, 1), (300_000, 2)] {
            assert_eq!(feed::deals(surfels, &small), deals, "{surfels}");
        }
        assert_eq!(feed::deals(300_000, &limits(1 << 26)), 1);
    }
}
