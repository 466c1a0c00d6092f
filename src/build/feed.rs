//! Surfels in Morton order out of a cloud of any size, and the sweep over them.
//!
//! A cloud that fits in memory is sorted there. Otherwise a first pass over the positions counts
//! the surfels of the octree's cells some levels down, which gives the frontier: cells that fit in
//! memory each. Runs of them are the buckets, to which a second pass deals the surfels; then one
//! bucket after the other is read and built. A cell that is too large at the last counted level
//! goes through the same again, further down.

use super::frontier::{Bucket, Cell, Frontier};
use super::morton::{self, Cube};
use super::spill::{self, Dealer, Spill, SpillRange};
use super::subtree::{self, PageSettings, Pages, Pending, Sorted};
use super::{Limits, MappedCloud};
use crate::formats::{Bounds, Surfel, TreeLevel, TreeWriter};
use crate::run::{Job, Task};
use crate::{Error, Result};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Levels that a counting pass looks down: 8^6 counts of 8 bytes.
const COUNTED_LEVELS: u32 = 6;
/// Buckets that surfels are dealt to at a time, at least.
const MIN_BUCKETS_DEALT: u64 = 256;
/// The same, at most.
const MAX_BUCKETS_DEALT: u64 = 4096;
/// Bytes of the buffer of a bucket, at least, where they are dealt to more than the fewest.
const BUFFER_BYTES: u64 = 1 << 16;

/// Most buckets that surfels are dealt to at a time.
fn buckets_dealt(limits: &Limits) -> u64 {
    (limits.buffers / BUFFER_BYTES).clamp(MIN_BUCKETS_DEALT, MAX_BUCKETS_DEALT)
}

/// How often surfels go to the temporary file, about.
pub fn deals(surfels: u64, limits: &Limits) -> u64 {
    /// Cells of which several fill a bucket leave some of it empty.
    const FILLED: f64 = 0.8;
    if surfels <= limits.surfels {
        return 0;
    }
    let mut buckets = surfels as f64 / (limits.surfels as f64 * FILLED);
    let mut deals = 0;
    while buckets > 1.0 {
        buckets /= buckets_dealt(limits) as f64;
        deals += 1;
    }
    deals
}

/// The place of surfels, in the order of the cloud.
#[derive(Clone)]
enum SurfelSource {
    Cloud,
    Spilled(Vec<SpillRange>),
}

/// The sweep over a cloud.
pub struct Feed<'a> {
    cloud: &'a MappedCloud,
    limits: &'a Limits,
    settings: PageSettings,
    job: &'a Job,
    cube: Cube,
    spill: Option<Spill>,
    /// Surfels of the bucket in work and their order. Kept from one to the next: given back and
    /// taken again, memory of this size would be scattered.
    surfels: Vec<Surfel>,
    order: Vec<(u64, u32)>,
    built: Task,
}

/// The frontier's cells in Morton order, each as it is built.
struct Ready {
    /// Buckets that are still to be dealt out or built, the next one last.
    waiting: Vec<(SurfelSource, Vec<Bucket>)>,
    built: VecDeque<(Pending, Pages)>,
    /// The last counted level, and how far that is below the first.
    level: u32,
    depth: u32,
}

impl<'a> Feed<'a> {
    pub fn new(
        cloud: &'a MappedCloud,
        limits: &'a Limits,
        settings: PageSettings,
        job: &'a Job,
    ) -> Self {
        let bounds = cloud.summary().bounds.unwrap_or(Bounds::EMPTY);
        let count = cloud.summary().sums.surfels;
        Self {
            cloud,
            limits,
            settings,
            job,
            cube: Cube::around(&bounds),
            spill: None,
            surfels: Vec::new(),
            order: Vec::new(),
            built: job.progress.task("build", count, "surfels"),
        }
    }

    /// Bytes that went to the temporary file.
    pub fn spilled_bytes(&self) -> u64 {
        self.spill.as_ref().map_or(0, Spill::len)
    }

    /// Writes all pages; returns the root's id and the counts by steps below it.
    pub fn sweep(&mut self, writer: &mut TreeWriter) -> Result<(u32, Vec<TreeLevel>)> {
        let count = self.cloud.summary().sums.surfels;
        let mut pages = Pages::new(0, self.settings);
        let root = self.cell(&SurfelSource::Cloud, 0, count, &mut pages, writer)?;
        let root = pages.cut(root)?;
        write_done(&mut pages, writer)?;
        Ok((writer.surfel_pages() - 1, root.levels()))
    }

    /// Builds a cell of any size.
    fn cell(
        &mut self,
        source: &SurfelSource,
        level: u32,
        count: u64,
        pages: &mut Pages,
        writer: &mut TreeWriter,
    ) -> Result<Pending> {
        if count <= self.limits.surfels {
            self.load(source, count)?;
            let built = self.build(&[Cell::whole(level, count)])?;
            return take(&mut built.into(), pages, writer);
        }
        if level == morton::LEVELS {
            let mut reader = Reader {
                source: source.clone(),
                next: 0,
                surfels: VecDeque::new(),
            };
            return self.one_spot(&mut reader, count, pages, writer);
        }
        let depth = COUNTED_LEVELS.min(morton::LEVELS - level);
        let counts = self.count(source, level, depth)?;
        let frontier = Frontier {
            counts: &counts,
            depth,
            level,
            most: self.limits.surfels,
        };
        let mut ready = Ready {
            waiting: vec![(source.clone(), frontier.buckets())],
            built: VecDeque::new(),
            level: level + depth,
            depth,
        };
        self.above(&frontier, 0, 0, &mut ready, pages, writer)
    }

    /// The part of the octree above the frontier: the cell `at` of `depth` levels below the counted
    /// one.
    fn above(
        &mut self,
        frontier: &Frontier<'_>,
        depth: u32,
        at: u32,
        ready: &mut Ready,
        pages: &mut Pages,
        writer: &mut TreeWriter,
    ) -> Result<Pending> {
        if frontier.is_cut(depth, at) {
            return self.next_cell(ready, pages, writer);
        }
        let children: Vec<u32> = (8 * at..8 * at + 8)
            .filter(|child| frontier.count(depth + 1, *child) > 0)
            .collect();
        if let [only] = children[..] {
            return self.above(frontier, depth + 1, only, ready, pages, writer);
        }
        let children = children
            .into_iter()
            .map(|child| self.above(frontier, depth + 1, child, ready, pages, writer))
            .collect::<Result<_>>()?;
        let node = subtree::join(children, pages)?;
        write_done(pages, writer)?;
        Ok(node)
    }

    fn next_cell(
        &mut self,
        ready: &mut Ready,
        pages: &mut Pages,
        writer: &mut TreeWriter,
    ) -> Result<Pending> {
        while ready.built.is_empty() {
            let Some((source, mut buckets)) = ready.waiting.pop() else {
                return Err(Error::failed("the cloud changed while it was read"));
            };
            if buckets.len() > 1 {
                // Very many are dealt out in two goes, so that their buffers stay large.
                let per_group = buckets.len().div_ceil(buckets_dealt(self.limits) as usize);
                let mut groups: Vec<Vec<Bucket>> = Vec::new();
                while !buckets.is_empty() {
                    let rest = buckets.split_off(per_group.min(buckets.len()));
                    groups.push(std::mem::replace(&mut buckets, rest));
                }
                let ranges = self.deal(&source, &groups, ready.level, ready.depth)?;
                let dealt = ranges.into_iter().map(SurfelSource::Spilled).zip(groups);
                ready.waiting.extend(dealt.rev());
                continue;
            }
            let cells = buckets.pop().unwrap_or_default();
            let count: u64 = cells.iter().map(|c| c.count).sum();
            if count <= self.limits.surfels {
                self.load(&source, count)?;
                ready.built.extend(self.build(&cells)?);
            } else if let [cell] = cells[..] {
                return self.cell(&source, cell.level, cell.count, pages, writer);
            }
        }
        take(&mut ready.built, pages, writer)
    }

    /// Sorts the surfels in work and builds the cells that they make up.
    fn build(&mut self, cells: &[Cell]) -> Result<Vec<(Pending, Pages)>> {
        let surfels = &self.surfels;
        sort(self.cube, surfels, &mut self.order);
        let mut rest = self.order.as_slice();
        let mut parts = Vec::with_capacity(cells.len());
        for cell in cells {
            let Some((own, others)) = rest.split_at_checked(cell.count as usize) else {
                return Err(Error::failed("the cloud changed while it was read"));
            };
            parts.push((cell.level, own));
            rest = others;
        }
        parts
            .par_iter()
            .map(|(level, order)| {
                let mut pages = Pages::new(0, self.settings);
                let sorted = Sorted { surfels, order };
                let pending = subtree::build(&sorted, *level, &mut pages, &self.job.cancel)?;
                self.built.add(order.len() as u64);
                Ok((pending, pages))
            })
            .collect()
    }

    /// More surfels of one last-level cell than fit in memory.
    fn one_spot(
        &mut self,
        reader: &mut Reader,
        count: u64,
        pages: &mut Pages,
        writer: &mut TreeWriter,
    ) -> Result<Pending> {
        let level = morton::LEVELS;
        if count <= self.limits.surfels {
            self.read(reader, count)?;
            let built = self.build(&[Cell::whole(level, count)])?;
            return take(&mut built.into(), pages, writer);
        }
        let children = subtree::eighths(count)
            .map(|range| self.one_spot(reader, range.end - range.start, pages, writer))
            .collect::<Result<_>>()?;
        let node = subtree::join(children, pages)?;
        write_done(pages, writer)?;
        Ok(node)
    }

    /// Counts surfels by cell, `depth` levels below `level`.
    fn count(&mut self, source: &SurfelSource, level: u32, depth: u32) -> Result<Vec<u64>> {
        let mut counts = vec![0u64; 1 << (3 * depth)];
        let cube = self.cube;
        let cell = |position: [f32; 3]| cell_of(cube.key(position), level + depth, depth);
        let mut note = |cells: &[u32]| cells.iter().for_each(|cell| counts[*cell as usize] += 1);
        match source {
            SurfelSource::Cloud => {
                let chunks = self.cloud.surfel_chunks();
                let total = self.cloud.summary().sums.surfels;
                let task = self.job.progress.task("count", total, "surfels");
                for start in (0..chunks).step_by(self.limits.chunks) {
                    self.job.cancel.check()?;
                    let end = (start + self.limits.chunks).min(chunks);
                    let batch: Vec<_> = (start..end)
                        .into_par_iter()
                        .map(|i| {
                            let positions = self.cloud.surfel_positions(i)?;
                            Ok::<Vec<u32>, Error>(positions.into_iter().map(cell).collect())
                        })
                        .collect();
                    self.cloud.release_surfel_chunks(start..end);
                    for cells in batch {
                        let cells = cells?;
                        note(&cells);
                        task.add(cells.len() as u64);
                    }
                }
            }
            SurfelSource::Spilled(ranges) => {
                for some in ranges.chunks(self.limits.ranges) {
                    for surfels in self.read_ranges(some)? {
                        let cells: Vec<_> = surfels.iter().map(|s| cell(s.position)).collect();
                        note(&cells);
                    }
                }
            }
        }
        Ok(counts)
    }

    /// Deals surfels out to groups of buckets.
    fn deal(
        &mut self,
        source: &SurfelSource,
        groups: &[Vec<Bucket>],
        level: u32,
        depth: u32,
    ) -> Result<Vec<Vec<SpillRange>>> {
        let ends: Vec<u32> = groups
            .iter()
            .filter_map(|g| Some(g.last()?.last()?.end))
            .collect();
        let mut dealer = Dealer::new(groups.len(), self.limits.buffers);
        let mut spill = match self.spill.take() {
            Some(spill) => spill,
            None => Spill::new(self.job.temp_dir.as_ref())?,
        };
        let cube = self.cube;
        let bucket_of = |s: &Surfel| {
            let cell = cell_of(cube.key(s.position), level, depth);
            ends.partition_point(|end| *end <= cell) as u16
        };
        let mut deal = |spill: &mut Spill, batch: &[Vec<Surfel>]| -> Result<()> {
            let buckets: Vec<Vec<u16>> = batch
                .par_iter()
                .map(|surfels| surfels.iter().map(bucket_of).collect())
                .collect();
            for (surfels, buckets) in batch.iter().zip(&buckets) {
                for (s, bucket) in surfels.iter().zip(buckets) {
                    let bucket = usize::from(*bucket);
                    if bucket == ends.len() {
                        return Err(Error::failed("the cloud changed while it was read"));
                    }
                    dealer.push(bucket, s);
                }
            }
            dealer.flush(spill)
        };
        match source {
            SurfelSource::Cloud => {
                let chunks = self.cloud.surfel_chunks();
                let total = self.cloud.summary().sums.surfels;
                let task = self.job.progress.task("sort", total, "surfels");
                let starts = (0..chunks).step_by(self.limits.chunks);
                let read = |start: usize| {
                    self.job.cancel.check()?;
                    self.chunks(start..(start + self.limits.chunks).min(chunks))
                };
                let dealt = |batch: Vec<Vec<Surfel>>| {
                    deal(&mut spill, &batch)?;
                    task.add(batch.iter().map(|b| b.len() as u64).sum());
                    Ok(())
                };
                in_turn(starts, self.limits.reads_ahead, read, dealt)?;
            }
            SurfelSource::Spilled(ranges) => {
                for some in ranges.chunks(self.limits.ranges) {
                    self.job.cancel.check()?;
                    let batch = spill::read_all(&mut spill, some)?;
                    deal(&mut spill, &batch)?;
                }
            }
        }
        let ranges = dealer.finish(&mut spill)?;
        self.spill = Some(spill);
        Ok(ranges)
    }

    fn chunks(&self, range: std::ops::Range<usize>) -> Result<Vec<Vec<Surfel>>> {
        let chunks = range
            .clone()
            .into_par_iter()
            .map(|i| Ok(self.cloud.surfel_chunk(i)?))
            .collect();
        self.cloud.release_surfel_chunks(range);
        chunks
    }

    /// Takes all surfels of a source that fits in memory into work.
    fn load(&mut self, source: &SurfelSource, count: u64) -> Result<()> {
        self.start(count);
        let limits = self.limits;
        let mut surfels = std::mem::take(&mut self.surfels);
        let take = |batch: Vec<Vec<Surfel>>| {
            batch.into_iter().for_each(|own| surfels.extend(own));
            Ok(())
        };
        let loaded = match source {
            SurfelSource::Cloud => {
                let chunks = self.cloud.surfel_chunks();
                let starts = (0..chunks).step_by(limits.chunks);
                let read = |start: usize| {
                    self.job.cancel.check()?;
                    self.chunks(start..(start + limits.chunks).min(chunks))
                };
                in_turn(starts, limits.reads_ahead, read, take)
            }
            SurfelSource::Spilled(ranges) => {
                let read = |some: &[SpillRange]| self.read_ranges(some);
                in_turn(ranges.chunks(limits.ranges), limits.reads_ahead, read, take)
            }
        };
        self.surfels = surfels;
        loaded
    }

    /// Makes room for a bucket of `count` surfels, and for any other if there are several.
    fn start(&mut self, count: u64) {
        let all = self.cloud.summary().sums.surfels;
        let room = count.max(all.min(self.limits.surfels)) as usize;
        self.surfels.clear();
        self.surfels.reserve_exact(room);
        self.order.clear();
        self.order.reserve_exact(room);
    }

    fn read_ranges(&mut self, ranges: &[SpillRange]) -> Result<Vec<Vec<Surfel>>> {
        self.job.cancel.check()?;
        match &mut self.spill {
            Some(spill) => spill::read_all(spill, ranges),
            None => Err(Error::failed("the temporary file is gone")),
        }
    }

    /// Takes the next `count` surfels into work.
    fn read(&mut self, reader: &mut Reader, count: u64) -> Result<()> {
        self.start(count);
        while (reader.surfels.len() as u64) < count {
            self.job.cancel.check()?;
            let more = match &reader.source {
                SurfelSource::Cloud => self.cloud.surfel_chunk(reader.next)?,
                SurfelSource::Spilled(ranges) => match ranges.get(reader.next) {
                    Some(range) => self.read_ranges(&[*range])?.concat(),
                    None => return Err(Error::failed("the temporary file is too short")),
                },
            };
            reader.surfels.extend(more);
            reader.next += 1;
        }
        self.surfels.extend(reader.surfels.drain(..count as usize));
        Ok(())
    }
}

/// Reads one batch after the other and uses them in order; if `ahead`, one is read while that
/// before it is used.
fn in_turn<B: Send, T: Send>(
    mut batches: impl Iterator<Item = B>,
    ahead: bool,
    mut read: impl FnMut(B) -> Result<T> + Send,
    mut used: impl FnMut(T) -> Result<()> + Send,
) -> Result<()> {
    let mut next = batches.next().map(&mut read).transpose()?;
    while let Some(batch) = next {
        let following = batches.next();
        let read = || following.map(&mut read).transpose();
        next = if ahead {
            let (done, following) = rayon::join(|| used(batch), read);
            done?;
            following?
        } else {
            used(batch)?;
            read()?
        };
    }
    Ok(())
}

/// Puts the indices of surfels in Morton order, with their keys.
pub fn sort(cube: Cube, surfels: &[Surfel], order: &mut Vec<(u64, u32)>) {
    surfels
        .par_iter()
        .enumerate()
        .map(|(i, s)| (cube.key(s.position), i as u32))
        .collect_into_vec(order);
    order.par_sort_unstable();
}

/// Surfels of a source, in order.
struct Reader {
    source: SurfelSource,
    /// The next chunk or range.
    next: usize,
    surfels: VecDeque<Surfel>,
}

/// Which of the 8^depth cells of `level` holds a key, counted from the one `depth` levels up that
/// they share.
fn cell_of(key: u64, level: u32, depth: u32) -> u32 {
    (key >> (3 * (morton::LEVELS - level)) & ((1 << (3 * depth)) - 1)) as u32
}

fn take(
    ready: &mut VecDeque<(Pending, Pages)>,
    pages: &mut Pages,
    writer: &mut TreeWriter,
) -> Result<Pending> {
    let Some((mut pending, own)) = ready.pop_front() else {
        return Err(Error::failed("the cloud changed while it was read"));
    };
    pages.append(own, &mut pending);
    write_done(pages, writer)?;
    Ok(pending)
}

fn write_done(pages: &mut Pages, writer: &mut TreeWriter) -> Result<()> {
    for page in pages.done.drain(..) {
        writer.push_surfel_page(&page)?;
    }
    pages.first = writer.surfel_pages();
    Ok(())
}
