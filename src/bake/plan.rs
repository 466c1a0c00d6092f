//! What a bake will write and take, from a pilot that makes some of the points: known before
//! anything is written.

use super::lvoxels::LvoxelMaker;
use super::prepared::Prepared;
use super::surfels::SurfelSource;
use super::{BATCH_BRICKS, Settings, check_input, check_lvoxels, memory, origin, share};
use crate::Result;
use crate::formats::{CHUNK_RECORDS, CloudSample, Lvoxel, Surfel};
use crate::math::{Rgb, Spectrum, unflatten};
use crate::run::memory::give_back_freed;
use crate::run::{Job, Part, Resident, usage};
use crate::scene::{Scene, Volume};
use rayon::prelude::*;
use serde::Serialize;
use std::ops::Range;
use std::path::Path;
use std::time::{Duration, Instant};

/// Spans of surfels that a pilot looks at, spread over all.
const SPANS: u64 = 32;
/// Surfels that it makes in each, in runs that are spread over a chunk.
const SPAN_SURFELS: u64 = 8192;
const RUNS_IN_SPAN: u64 = 4;
/// Spans of bricks that a pilot looks at in all volumes together, and bricks in each.
const BRICK_SPANS: u64 = 256;
const SPAN_BRICKS: u64 = 8;
/// Where points take long, a pilot ends after this time, each kind for itself.
const LONG: Duration = Duration::from_secs(1);
/// But not before it has looked at a few spans of surfels, and of bricks, which are all in work at
/// a time: threads that wait take CPU seconds, too.
const SPANS_AT_A_TIME: usize = 4;
const BRICK_SPANS_AT_A_TIME: usize = 16;
/// A bake of fewer points begins without a look at the disk: it takes less than a gigabyte.
const MIN_POINTS_TO_CHECK: u64 = 1024 * CHUNK_RECORDS as u64;

/// What a bake will write and take, about.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Plan {
    /// Surfels in the cloud.
    pub surfels: u64,
    /// Lvoxels in the cloud.
    pub lvoxels: u64,
    /// Bytes of the cloud.
    pub cloud_bytes: u64,
    /// Most bytes of memory at a time, those that the process holds already among them.
    pub memory_bytes: u64,
    /// CPU seconds of all threads on this machine.
    pub cpu_secs: f64,
}

/// Says what a bake will write and take, from some of its points; writes nothing.
///
/// # Errors
/// As [`super::run`], but for what concerns the cloud's file.
pub fn plan(scene: &Scene, settings: &Settings, job: &Job) -> Result<Plan> {
    check_input(scene, settings)?;
    let budget = memory::check(scene, settings, job)?;
    job.hold(&budget);
    let plan = match scene.volumes.iter().all(Volume::is_grey) {
        true => planned::<f32>(scene, settings, job)?,
        false => planned::<Rgb>(scene, settings, job)?,
    };
    let memory_bytes = match plan.memory_bytes {
        0 => budget.bytes(),
        bytes => bytes,
    };
    // What is mapped beyond a limit is the system's to take back.
    let memory_bytes = memory_bytes.min(job.memory_limit.unwrap_or(u64::MAX));
    Ok(Plan {
        memory_bytes,
        ..plan
    })
}

fn planned<K: Spectrum>(scene: &Scene, settings: &Settings, job: &Job) -> Result<Plan> {
    let before = usage::cpu_secs();
    Prepared::<K>::with(scene, settings, job, |prepared, _| {
        let mut sizes = CloudSample::new(&origin(scene, settings)?)?;
        let (all_but_points, memory, surfels) = prepared.with_surfels(|source| {
            let all_but_points = usage::cpu_secs() - before;
            // Before the pilot, which holds more surfels than a batch has.
            let memory = Memory::now();
            let pilot = Pilot::of_surfels(prepared, source, &mut sizes)?;
            Ok((all_but_points, memory, pilot))
        })?;
        let lvoxels = Pilot::of_lvoxels(prepared, &mut sizes)?;
        let in_work = memory::of_surfels(scene, settings).max(lvoxels.in_work);
        Ok(Plan {
            surfels: surfels.points,
            lvoxels: lvoxels.points,
            cloud_bytes: sizes.file_bytes(surfels.points, lvoxels.points),
            memory_bytes: memory.most_with(in_work),
            cpu_secs: all_but_points + surfels.cpu_secs + lvoxels.cpu_secs,
        })
    })
}

/// Memory of the process before it makes points.
struct Memory {
    anonymous: u64,
    /// The most so far; 0 where the system does not tell.
    peak: u64,
}

impl Memory {
    fn now() -> Self {
        // What loading has freed is taken again before anything else is.
        give_back_freed();
        Self {
            anonymous: Resident::now().map_or(0, |now| now.anonymous),
            peak: usage::peak_memory_bytes().unwrap_or(0),
        }
    }

    /// Most bytes of memory with so many of points in work, and the files that are mapped now; 0
    /// where the system does not tell.
    fn most_with(&self, in_work: u64) -> u64 {
        /// Of the writer, and of threads while they compress.
        const WRITER: u64 = 6 << 20;
        let mapped = Resident::now().map_or(0, |now| now.mapped);
        match self.peak {
            0 => 0,
            peak => peak.max(self.anonymous + mapped + in_work + WRITER),
        }
    }
}

/// An error if the disk of a cloud cannot hold it, where it is large.
pub fn check_room<K: Spectrum>(
    prepared: &Prepared<K>,
    surfels: &SurfelSource,
    cloud: &Path,
) -> Result<()> {
    let part = prepared.settings.part;
    let own = share(surfels.samples, part);
    let voxels = |v: &Volume| v.sigma_t.bytes() as u64 / size_of::<f32>() as u64;
    let voxels: u64 = prepared.scene.volumes.iter().map(voxels).sum();
    if own.end - own.start + voxels < MIN_POINTS_TO_CHECK {
        return Ok(());
    }
    let mut sizes = CloudSample::new(&origin(prepared.scene, prepared.settings)?)?;
    let surfels = Pilot::of_surfels(prepared, surfels, &mut sizes)?.points;
    let lvoxels = Pilot::of_lvoxels(prepared, &mut sizes)?.points;
    usage::check_room(
        "the cloud",
        usage::folder_of(cloud),
        sizes.file_bytes(surfels, lvoxels),
        "free some of the disk, write elsewhere, or bake fewer `surfels`",
    )
}

/// What all points of a kind will come to, by some of them.
#[derive(Debug, Default)]
struct Pilot {
    points: u64,
    cpu_secs: f64,
    /// Bytes of a batch in work.
    in_work: u64,
}

impl Pilot {
    fn of_surfels<K>(
        prepared: &Prepared<K>,
        source: &SurfelSource,
        sizes: &mut CloudSample,
    ) -> Result<Self> {
        let Range { start, end } = share(source.samples, prepared.settings.part);
        let (all, before) = (end - start, usage::cpu_secs());
        let mut looked = 0;
        let spans = looked_at(all, SPANS, SPANS_AT_A_TIME, |spans| {
            let surfels = |span: &Range<u64>| {
                let mut surfels = Vec::new();
                for run in runs(span) {
                    looked += run.end - run.start;
                    let run = start + run.start..start + run.end;
                    surfels.extend(source.batch(run, &prepared.job.cancel)?);
                }
                Ok(surfels)
            };
            spans.iter().map(surfels).collect()
        })?;
        let made: usize = spans.iter().map(|(_, surfels)| surfels.len()).sum();
        let factor = all as f64 / (looked as f64).max(1.0);
        let points = (made as f64 * factor).round() as u64;
        for (mut sample, chunk) in by_chunk::<Surfel>(spans, all, points) {
            sizes.add_surfels(&mut sample, chunk)?;
        }
        Ok(Self {
            points,
            cpu_secs: (usage::cpu_secs() - before) * factor,
            in_work: 0,
        })
    }

    fn of_lvoxels<K: Spectrum>(prepared: &Prepared<K>, sizes: &mut CloudSample) -> Result<Self> {
        let mut sum = Self::default();
        for maker in prepared.lvoxel_makers() {
            let own = Self::of_volume(prepared, &maker, sizes)?;
            sum.points += own.points;
            sum.cpu_secs += own.cpu_secs;
            sum.in_work = sum.in_work.max(own.in_work);
        }
        Ok(sum)
    }

    fn of_volume<K: Spectrum>(
        prepared: &Prepared<K>,
        maker: &LvoxelMaker<K>,
        sizes: &mut CloudSample,
    ) -> Result<Self> {
        let Prepared { scene, job, .. } = *prepared;
        let before = usage::cpu_secs();
        let filled = Filled::of(maker, prepared.settings.part);
        let all = filled.bricks.len() as u64;
        let to_find = usage::cpu_secs() - before;
        let spans = (BRICK_SPANS / scene.volumes.len() as u64).max(4);
        let mut found = Counts::default();
        let spans = looked_at(all, spans, BRICK_SPANS_AT_A_TIME, |spans| {
            let lvoxels = |span: &Range<u64>| {
                let bricks = &filled.bricks[span.start as usize..span.end as usize];
                let bricks = bricks.par_iter().take(SPAN_BRICKS as usize);
                let made = bricks.map(|&(brick, expected)| {
                    let own = maker.make(filled.at(brick), &job.cancel)?;
                    check_lvoxels(&own, &maker.volume.name)?;
                    Ok((expected, own))
                });
                made.collect::<Result<Vec<_>>>()
            };
            let made = spans.par_iter().map(lvoxels).collect::<Result<Vec<_>>>()?;
            let all_of = |bricks: Vec<(u32, Vec<Lvoxel>)>| {
                let add = |(expected, own): &(u32, Vec<Lvoxel>)| {
                    found.add(*expected, own.len() as u64);
                };
                bricks.iter().for_each(add);
                bricks
                    .into_iter()
                    .flat_map(|(_, own)| own)
                    .collect::<Vec<_>>()
            };
            Ok(made.into_iter().map(all_of).collect())
        })?;
        let made: usize = spans.iter().map(|(_, lvoxels)| lvoxels.len()).sum();
        let points = found.of_all(&filled.bricks);
        for (sample, chunk) in by_chunk::<Lvoxel>(spans, all, points) {
            sizes.add_lvoxels(&sample, chunk)?;
        }
        let factor = points as f64 / (made as f64).max(1.0);
        let in_brick = points as f64 / (all as f64).max(1.0);
        let in_batch = in_brick * all.min(BATCH_BRICKS as u64) as f64;
        Ok(Self {
            points,
            cpu_secs: to_find + (usage::cpu_secs() - before - to_find) * factor,
            in_work: in_batch as u64 * size_of::<Lvoxel>() as u64,
        })
    }
}

/// The bricks of a volume that are not empty, of a part of a bake.
struct Filled {
    along: [usize; 3],
    /// Each with about how many lvoxels it has.
    bricks: Vec<(u64, u32)>,
}

impl Filled {
    fn of<K: Spectrum>(maker: &LvoxelMaker<K>, part: Part) -> Self {
        let along = maker.bricks();
        let own = part.of(along.iter().product::<usize>() as u64);
        let bricks = own.into_par_iter().filter_map(|brick| {
            let expected = maker.expected(unflatten(brick as usize, along));
            (expected > 0).then_some((brick, expected))
        });
        Self {
            along,
            bricks: bricks.collect(),
        }
    }

    fn at(&self, brick: u64) -> [usize; 3] {
        unflatten(brick as usize, self.along)
    }
}

/// Lvoxels that bricks were expected to have, and those that they have, by how many each was
/// expected to have.
#[derive(Default)]
struct Counts(std::collections::BTreeMap<u32, [u64; 2]>);

impl Counts {
    fn add(&mut self, expected: u32, found: u64) {
        let sums = self.0.entry(expected).or_default();
        sums[0] += u64::from(expected);
        sums[1] += found;
    }

    /// Lvoxels of all bricks of a list of which these are some.
    fn of_all(&self, bricks: &[(u64, u32)]) -> u64 {
        let ratio = |[expected, found]: [u64; 2]| found as f64 / (expected as f64).max(1.0);
        let sums = self.0.values();
        let of_any = ratio(sums.fold([0; 2], |a, b| [a[0] + b[0], a[1] + b[1]]));
        let own = |expected| self.0.get(&expected).map_or(of_any, |sums| ratio(*sums));
        let mut all = std::collections::BTreeMap::<u32, u64>::new();
        for (_, expected) in bricks {
            *all.entry(*expected).or_default() += u64::from(*expected);
        }
        let count = |(expected, sum): (&u32, &u64)| own(*expected) * *sum as f64;
        all.iter().map(count).sum::<f64>().round() as u64
    }
}

/// What `look` says of spans that share all of `count`, some at a time, in their order, each with
/// its start: of all, or of those that are looked at before it takes long.
fn looked_at<T>(
    count: u64,
    spans: u64,
    at_a_time: usize,
    mut look: impl FnMut(&[Range<u64>]) -> Result<Vec<T>>,
) -> Result<Vec<(u64, T)>> {
    let spans = spans.min(count);
    let started = Instant::now();
    // Wherever it ends, those before are spread over all.
    let bits = spans.max(1).next_power_of_two().trailing_zeros();
    let order = (0..1_u64 << bits).map(|i| i.reverse_bits() >> 1 >> (63 - bits));
    let order = order.filter(|i| *i < spans);
    let order: Vec<_> = order
        .map(|i| i * count / spans..(i + 1) * count / spans)
        .collect();
    let mut looked = Vec::new();
    for some in order.chunks(at_a_time) {
        if !looked.is_empty() && started.elapsed() > LONG {
            break;
        }
        looked.extend(some.iter().map(|span| span.start).zip(look(some)?));
    }
    looked.sort_by_key(|(start, _)| *start);
    Ok(looked)
}

/// The runs of a span of surfels that are made.
fn runs(span: &Range<u64>) -> impl Iterator<Item = Range<u64>> + use<> {
    const RUN: u64 = SPAN_SURFELS / RUNS_IN_SPAN;
    let len = (span.end - span.start).min(CHUNK_RECORDS as u64);
    let (count, run) = match len {
        ..=SPAN_SURFELS => (1, len),
        _ => (RUNS_IN_SPAN, RUN),
    };
    let start = span.start;
    (0..count).map(move |i| {
        let first = start + i * len / count;
        first..first + run
    })
}

/// The points of spans of a list of `all`, which makes `points` points, each with the others of its
/// chunk, and the points of that.
fn by_chunk<T>(spans: Vec<(u64, Vec<T>)>, all: u64, points: u64) -> Vec<(Vec<T>, usize)> {
    let chunk = |start: u64| start as f64 * points as f64 / (all as f64).max(1.0);
    let chunk = |start: u64| chunk(start) as u64 / CHUNK_RECORDS as u64;
    let mut chunks: Vec<(u64, Vec<T>)> = Vec::new();
    for (start, sample) in spans {
        match chunks.last_mut() {
            Some((index, sum)) if *index == chunk(start) => sum.extend(sample),
            _ => chunks.push((chunk(start), sample)),
        }
    }
    let left = |index: u64| points.saturating_sub(index * CHUNK_RECORDS as u64);
    let records = |index: u64| left(index).min(CHUNK_RECORDS as u64) as usize;
    let chunks = chunks.into_iter();
    chunks
        .map(|(index, sample)| (sample, records(index)))
        .collect()
}
