//! Gathers at the points of a file, chunk by chunk.

use super::file::PointFile;
use super::receivers::{Receiver, Receivers};
use super::rows::Rows;
use super::settings::{Over, Settings};
use super::write::Writer;
use super::{CHUNK_BYTES, MAX_CHUNK, PATCH_RAYS};
use crate::Result;
use crate::gather::{
    Around, DirectionOrder, Gatherer, Medium, PatchRadiance, RayKernel, RaySettings, SampleRange,
    SurfacePoint, TreeTask, UnknownPatches, in_order_of_places,
};
use crate::math::{Environment, Rgb, sampling};
use crate::run::Job;
use crate::trace::Tracer;
use crate::tree::{OpenTree, SurfelStore};
use rayon::prelude::*;
use std::ops::Range;

/// Rays that points near each other cast together.
const GROUP_RAYS: u32 = 1024;
/// Directions that all points share: each looks along one range of them.
const SHARED_DIRECTIONS: u32 = 1 << 14;
/// Most rays whose patches are found before they are evaluated, where pages live in a cache.
const UNKNOWN_RAYS: u32 = 1 << 18;
/// Bytes of a point in a chunk, beside its own numbers: its receiver, its place in the order, and
/// what is around it twice.
const POINT_BYTES: u64 =
    (size_of::<Receiver>() + 3 * size_of::<u32>() + 2 * size_of::<Around>()) as u64;

/// The gathers of a part of a file.
pub(super) struct Gathers<'a> {
    pub points: &'a PointFile,
    pub receivers: &'a Receivers<'a>,
    pub part: Range<u64>,
    pub settings: &'a Settings,
    pub over: Over,
    pub job: &'a Job,
}

/// The same, with what they look at and where results go.
pub(super) struct GatherTask<'a, 'w> {
    gathers: Gathers<'a>,
    tree: &'a OpenTree,
    tracer: Option<&'a Tracer<'a>>,
    writer: &'a mut Writer<'w>,
}

impl<'a> Gathers<'a> {
    /// Points of a chunk.
    fn chunk(&self) -> usize {
        let own = size_of::<f64>() + self.points.row_bytes() / self.points.columns.len().max(1);
        let bytes = (own * self.points.columns.len()) as u64 + POINT_BYTES;
        ((CHUNK_BYTES / bytes) as usize).clamp(1, MAX_CHUNK)
    }

    /// Gives all points to `take`, a chunk at a time: their rows, and each as it gathers.
    fn each_chunk(&self, mut take: impl FnMut(&[f64], &[Receiver]) -> Result<()>) -> Result<()> {
        let columns = self.points.columns.len();
        let mut rows = Rows::open(self.points, self.part.start)?;
        let mut first = self.part.start;
        while first < self.part.end {
            self.job.cancel.check()?;
            let count = (self.chunk() as u64).min(self.part.end - first) as usize;
            let values = rows.read(count)?;
            let receivers = values
                .chunks_exact(columns)
                .zip(first..)
                .map(|(row, point)| self.receivers.receiver(row, point))
                .collect::<Result<Vec<_>>>()?;
            take(&values, &receivers)?;
            first += count as u64;
        }
        Ok(())
    }

    /// Refuses points that are none before the first gathers.
    pub(super) fn check_points(&self) -> Result<()> {
        self.each_chunk(|_, _| Ok(()))
    }

    pub(super) fn into_task<'w>(
        self,
        tree: &'a OpenTree,
        tracer: Option<&'a Tracer<'a>>,
        writer: &'a mut Writer<'w>,
    ) -> GatherTask<'a, 'w> {
        GatherTask {
            gathers: self,
            tree,
            tracer,
            writer,
        }
    }

    /// Ranges of the shared directions.
    fn ranges(&self) -> u32 {
        (SHARED_DIRECTIONS / self.settings.samples).clamp(1, 64)
    }

    /// The range of a point, which belongs to its place.
    fn range(&self, receiver: &Receiver) -> u32 {
        let [x, y, z] = receiver.position.to_array().map(|v| u64::from(v.to_bits()));
        let [nx, ny, nz] = receiver.normal.to_array().map(|v| u64::from(v.to_bits()));
        let hash = sampling::hash(&[x << 32 | y, z << 32 | nx, ny << 32 | nz]);
        (hash % u64::from(self.ranges())) as u32
    }
}

impl TreeTask for GatherTask<'_, '_> {
    /// Points whose light is not finite.
    type Output = Result<u64>;

    fn run<M: Medium>(self, pages: &SurfelStore, media: M) -> Result<u64> {
        let Self {
            gathers,
            tree,
            tracer,
            writer,
        } = self;
        let settings = gathers.settings;
        let patches = tracer
            .map(|tracer| PatchRadiance::of_tree(tracer, tree, PATCH_RAYS))
            .transpose()?;
        let gatherer = Gatherer {
            pages,
            media,
            settings: RaySettings {
                samples: settings.samples,
                max_solid_angle: settings.max_solid_angle,
                max_dist: f32::INFINITY,
                kernel: match &patches {
                    Some(patches) => RayKernel::Traced(patches),
                    None => RayKernel::Cone,
                },
                // A light of its own to those who shade.
                environment: Environment::even(Rgb::BLACK),
                leave_out_bright: false,
            },
        };
        let order = gatherer.order(gathers.ranges());
        let all = gathers.part.end - gathers.part.start;
        let task = gathers.job.progress.task("gather", all, "points");
        let mut not_finite = 0;
        gathers.each_chunk(|rows, receivers| {
            let around = gathers.gather(&gatherer, receivers, &order)?;
            pages.check()?;
            let columns = gathers.points.columns.len();
            for (row, around) in rows.chunks_exact(columns).zip(&around) {
                let light = around.gathered.light.0;
                not_finite += u64::from(!light.iter().all(|v| v.is_finite()));
                writer.add(row, around)?;
            }
            task.add(receivers.len() as u64);
            Ok(())
        })?;
        Ok(not_finite)
    }
}

impl Gathers<'_> {
    /// What is around each of some points.
    fn gather<M: Medium>(
        &self,
        gatherer: &Gatherer<M>,
        receivers: &[Receiver],
        order: &DirectionOrder,
    ) -> Result<Vec<Around>> {
        let seed = self.settings.seed;
        let places = (0..receivers.len() as u32).collect();
        let places = in_order_of_places(places, |&i: &u32| receivers[i as usize].position);
        let group = (GROUP_RAYS / self.settings.samples).max(1) as usize;
        let of_group = |group: &[u32]| -> Vec<SurfacePoint> {
            let point = |i: &u32| {
                let receiver = &receivers[*i as usize];
                SurfacePoint {
                    position: receiver.position,
                    normal: receiver.normal,
                    face_normal: receiver.normal,
                    range: self.range(receiver),
                }
            };
            group.iter().map(point).collect()
        };
        let unknown = |group: &[u32]| {
            self.job.cancel.check()?;
            Ok(gatherer.unknown_to_neighbours(&of_group(group), seed, order))
        };
        let gather = |group: &[u32]| {
            self.job.cancel.check()?;
            let points = of_group(group);
            let on_sphere = |p: &SurfacePoint| {
                let index = p.range;
                gatherer.around_sphere(p.position, SampleRange { index, seed })
            };
            Ok(match self.over {
                Over::Hemisphere => gatherer.around_neighbours(&points, seed, order),
                Over::Sphere => points.iter().map(on_sphere).collect(),
            })
        };
        let finds_unknown = gatherer.has_unknown() && self.over == Over::Hemisphere;
        let batch = match finds_unknown {
            true => (UNKNOWN_RAYS / self.settings.samples).max(1) as usize,
            false => places.len().max(1),
        };
        let mut around = vec![Around::default(); receivers.len()];
        for batch in places.chunks(batch) {
            if finds_unknown {
                let found = batch.par_chunks(group).map(unknown);
                let found = found.collect::<Result<Vec<_>>>()?;
                gatherer.evaluate(UnknownPatches::of_all(found));
            }
            let gathered = batch.par_chunks(group).map(gather);
            let gathered = gathered.collect::<Result<Vec<_>>>()?;
            for (place, gathered) in batch.iter().zip(gathered.iter().flatten()) {
                around[*place as usize] = *gathered;
            }
        }
        Ok(around)
    }
}
