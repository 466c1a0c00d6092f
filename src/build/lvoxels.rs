//! Lvoxels by volume and brick, in pages of whole bricks.

use super::spill::{Dealer, Spill, SpillRange};
use super::{Limits, MappedCloud};
use crate::formats::morton::interleave;
use crate::formats::{EncodedLvoxels, Lvoxel, TreeWriter, VolumeInfo};
use crate::run::{Job, Task};
use crate::{Error, Result};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

/// Per lvoxel that is sorted: the record, and its key with some room.
pub const LVOXEL_MEMORY: u64 = size_of::<Lvoxel>() as u64 + 32;
/// Bytes of an lvoxel in a page before compression, about.
pub const LVOXEL_PAGE_BYTES: u32 = 16;
/// Full pages that are encoded together: some for each of many threads, in a few megabytes.
const PAGES_AT_A_TIME: usize = 32;

/// Volume and Morton code of the 8^3-voxel brick; then Morton code in the brick and level.
type Key = (u64, u16);

fn key(v: &Lvoxel) -> Key {
    let voxel = v.block.map(|b| u64::from(b) << v.level);
    // A brick's coordinates have 16 bits: those of a block of the coarsest level.
    let brick = interleave(voxel.map(|c| c >> 3));
    let inside = interleave(voxel.map(|c| c & 7)) as u16;
    (
        u64::from(v.volume) << 48 | brick,
        inside << 2 | u16::from(v.level),
    )
}

/// Sorts and writes all lvoxels of the cloud; returns the bytes that went to a temporary file.
pub fn write(
    cloud: &MappedCloud,
    writer: &mut TreeWriter,
    page_bytes: u32,
    limits: &Limits,
    job: &Job,
) -> Result<u64> {
    let count = cloud.summary().sums.lvoxels();
    let mut pages = PageCutter {
        writer,
        volumes: &cloud.meta().volumes,
        most: (page_bytes / LVOXEL_PAGE_BYTES) as usize,
        full: Vec::new(),
        page: Vec::new(),
        brick: Vec::new(),
        task: job.progress.task("lvoxels", count, "lvoxels"),
    };
    if count <= limits.lvoxels {
        let mut all = Vec::with_capacity(count as usize);
        for i in 0..cloud.lvoxel_chunks() {
            job.cancel.check()?;
            all.extend(cloud.lvoxel_chunk(i)?);
            cloud.release_lvoxel_chunks(i..i + 1);
        }
        for lvoxel in sorted(&all) {
            pages.push(lvoxel)?;
        }
        pages.finish()?;
        return Ok(0);
    }

    // Sorted runs, then all runs at once.
    let mut spill = Spill::new(job.temp_dir.as_ref())?;
    let mut runs = Vec::new();
    let mut run = Vec::new();
    for i in 0..cloud.lvoxel_chunks() {
        job.cancel.check()?;
        for lvoxel in cloud.lvoxel_chunk(i)? {
            run.push(lvoxel);
            if run.len() as u64 == limits.lvoxels {
                runs.push(write_run(&mut spill, &run)?);
                run.clear();
            }
        }
        cloud.release_lvoxel_chunks(i..i + 1);
    }
    if !run.is_empty() {
        runs.push(write_run(&mut spill, &run)?);
    }
    drop(run);
    merge(&mut spill, runs, &mut pages, job)?;
    pages.finish()?;
    Ok(spill.len())
}

/// In order of key; equal keys in the order of the cloud.
fn sorted(lvoxels: &[Lvoxel]) -> impl Iterator<Item = Lvoxel> + '_ {
    let mut order: Vec<(Key, u32)> = lvoxels
        .par_iter()
        .enumerate()
        .map(|(i, v)| (key(v), i as u32))
        .collect();
    order.par_sort_unstable();
    order.into_iter().map(|(_, i)| lvoxels[i as usize])
}

const RUN_BUFFER_BYTES: u64 = 1 << 16;

fn write_run(spill: &mut Spill, run: &[Lvoxel]) -> Result<VecDeque<SpillRange>> {
    let mut dealer = Dealer::new(1, RUN_BUFFER_BYTES);
    for lvoxel in sorted(run) {
        dealer.push(0, &lvoxel);
        dealer.flush(spill)?;
    }
    Ok(dealer.finish(spill)?.concat().into())
}

/// Takes the smallest of all runs' first lvoxels, again and again; of equal ones that of the
/// earlier run.
fn merge(
    spill: &mut Spill,
    mut runs: Vec<VecDeque<SpillRange>>,
    pages: &mut PageCutter<'_>,
    job: &Job,
) -> Result<()> {
    let mut heads: Vec<VecDeque<Lvoxel>> = vec![VecDeque::new(); runs.len()];
    let mut refill = |run: usize, head: &mut VecDeque<Lvoxel>| -> Result<()> {
        if !head.is_empty() {
            return Ok(());
        }
        if let Some(range) = runs[run].pop_front() {
            job.cancel.check()?;
            head.extend(spill.read(range)?.unpack::<Lvoxel>()?);
        }
        Ok(())
    };
    let mut first = BinaryHeap::new();
    for (i, head) in heads.iter_mut().enumerate() {
        refill(i, head)?;
        first.extend(head.front().map(|v| Reverse((key(v), i))));
    }
    while let Some(Reverse((_, i))) = first.pop() {
        let Some(lvoxel) = heads[i].pop_front() else {
            return Err(Error::failed("the temporary file is too short"));
        };
        pages.push(lvoxel)?;
        refill(i, &mut heads[i])?;
        first.extend(heads[i].front().map(|v| Reverse((key(v), i))));
    }
    Ok(())
}

/// Puts bricks together to pages. A page has lvoxels of one volume.
struct PageCutter<'a> {
    writer: &'a mut TreeWriter,
    volumes: &'a [VolumeInfo],
    most: usize,
    /// Pages that are full, until there are enough of them for all threads.
    full: Vec<Vec<Lvoxel>>,
    page: Vec<Lvoxel>,
    brick: Vec<Lvoxel>,
    task: Task,
}

impl PageCutter<'_> {
    fn push(&mut self, lvoxel: Lvoxel) -> Result<()> {
        // Repeated lvoxels could make a brick longer than a page.
        let ends = |brick: &[Lvoxel]| {
            brick
                .first()
                .is_some_and(|first| key(first).0 != key(&lvoxel).0)
                || brick.len() == self.most
        };
        if ends(&self.brick) {
            self.end_brick()?;
        }
        self.brick.push(lvoxel);
        Ok(())
    }

    fn end_brick(&mut self) -> Result<()> {
        let other_volume = match (self.page.first(), self.brick.first()) {
            (Some(a), Some(b)) => a.volume != b.volume,
            _ => false,
        };
        if other_volume || self.page.len() + self.brick.len() > self.most {
            self.end_page()?;
        }
        self.page.append(&mut self.brick);
        Ok(())
    }

    fn end_page(&mut self) -> Result<()> {
        if !self.page.is_empty() {
            self.full.push(std::mem::take(&mut self.page));
        }
        if self.full.len() >= PAGES_AT_A_TIME {
            self.write_full()?;
        }
        Ok(())
    }

    fn write_full(&mut self) -> Result<()> {
        let encoded: Vec<_> = self
            .full
            .par_iter()
            .map(|page| EncodedLvoxels::new(page, self.volumes))
            .collect();
        for page in encoded {
            self.writer.push_lvoxel_page(&page?)?;
        }
        self.task
            .add(self.full.iter().map(|p| p.len() as u64).sum());
        self.full.clear();
        Ok(())
    }

    fn finish(mut self) -> Result<()> {
        self.end_brick()?;
        self.end_page()?;
        self.write_full()
    }
}

/// The bytes in a tree of some lvoxels of a cloud, sorted and paged by themselves.
///
/// # Errors
/// Values out of range.
pub fn stored_bytes(lvoxels: &[Lvoxel], page_bytes: u32, volumes: &[VolumeInfo]) -> Result<u64> {
    let sorted: Vec<Lvoxel> = sorted(lvoxels).collect();
    let pages = sorted
        .chunk_by(|a, b| a.volume == b.volume)
        .flat_map(|own| own.chunks((page_bytes / LVOXEL_PAGE_BYTES) as usize));
    let mut bytes = 0;
    for page in pages {
        bytes += EncodedLvoxels::new(page, volumes)?.stored_bytes() as u64;
    }
    Ok(bytes)
}
