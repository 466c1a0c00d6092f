//! Gathers of surface points near each other, ray by ray in an order in which those after each
//! other meet nearly the same.

use super::crossing::Crossing;
use super::directions::{Hemisphere, SEQUENCES};
use super::gatherer::{Gathered, Gatherer, Incident, IncidentSum, SampleRange};
use super::medium::Medium;
use super::patch_radiance::UnknownPatches;
use crate::math::Ray;
use crate::math::sampling::{self, sobol2, sphere};
use glam::Vec3;
use lvox_formats::morton::interleave;
use std::sync::OnceLock;

/// A surface point that gathers.
#[derive(Clone, Copy, Debug)]
pub struct SurfacePoint {
    /// Position in scene space, already off its own surface.
    pub position: Vec3,
    /// Unit normal about which it gathers.
    pub normal: Vec3,
    /// Unit geometric normal: what is behind the facet of a smooth mesh does not reach it.
    pub face_normal: Vec3,
    /// Number of its range of the directions that all points share.
    pub range: u32,
}

/// What is around a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Around {
    /// The light that arrives.
    pub gathered: Gathered,
    /// Share of the directions, by their weights, in which there are surfaces.
    pub covered: f32,
}

/// The sum over the rays of one point.
#[derive(Clone, Copy, Debug, Default)]
struct AroundSum {
    light: IncidentSum,
    covered: f32,
}

impl AroundSum {
    fn add(&mut self, seen: Incident, crossings: &[Crossing]) {
        self.light.add(seen);
        let is_ended = seen.distance < f32::INFINITY;
        let open = |open, c: &Crossing| open * (1.0 - c.opacity);
        self.covered += match is_ended {
            true => 1.0,
            false => 1.0 - crossings.iter().fold(1.0, open),
        };
    }
}

/// The order of the directions of each sequence by where they point.
#[derive(Debug)]
pub struct DirectionOrder {
    ranges: u32,
    samples: u32,
    of: [OnceLock<Vec<u32>>; SEQUENCES],
}

impl DirectionOrder {
    /// Cells along each axis of the disk below the hemisphere.
    const CELLS_ALONG_AXIS: f32 = 32.0;
    /// Most directions of a sequence that are put in order: more rays of one gather are alike as
    /// they are.
    const MAX_ORDERED: u32 = 1 << 16;

    /// Returns the order of a hemisphere's directions, unless they are too many.
    fn of(&self, hemisphere: &Hemisphere) -> Option<&[u32]> {
        let count = self.ranges.saturating_mul(self.samples);
        let make = || {
            let cell = |c: f32| {
                ((0.5 * c + 0.5) * Self::CELLS_ALONG_AXIS).min(Self::CELLS_ALONG_AXIS - 1.0) as u64
            };
            // The curve that fills each quarter of the disk's square before the next.
            let place = |i: &u32| {
                let d = hemisphere.local_direction(*i);
                interleave([cell(d.x), cell(d.y), 0])
            };
            let mut order: Vec<u32> = (0..count).collect();
            order.sort_by_cached_key(place);
            order
        };
        let kept = &self.of[hemisphere.sequence()];
        (count <= Self::MAX_ORDERED).then(|| kept.get_or_init(make).as_slice())
    }
}

impl<M: Medium> Gatherer<'_, M> {
    /// Prepares the order for points that share a number of ranges.
    #[must_use]
    pub fn order(&self, ranges: u32) -> DirectionOrder {
        DirectionOrder {
            ranges,
            samples: self.settings.samples.max(1),
            of: [const { OnceLock::new() }; SEQUENCES],
        }
    }

    /// Gathers what [`Self::irradiance`] does for each of some points, bit for bit. Their rays are
    /// cast in the order of their directions, not point by point, so that those which meet the same
    /// triangles, patches and lvoxels follow one another. All points share the sequence of `seed`,
    /// each with a range of its own.
    ///
    /// # Panics
    /// If a point has a range beyond those that the order, one of this gatherer, was made for.
    #[must_use]
    pub fn irradiance_at_neighbours(
        &self,
        points: &[SurfacePoint],
        seed: u64,
        order: &DirectionOrder,
    ) -> Vec<Gathered> {
        let Some((slots, rays)) = self.rays_in_order(points, seed, order) else {
            let alone = |p: &SurfacePoint| {
                let index = p.range;
                self.irradiance(
                    p.position,
                    p.normal,
                    p.face_normal,
                    SampleRange { index, seed },
                )
            };
            return points.iter().map(alone).collect();
        };
        let samples = order.samples;
        let mut seen: Vec<Option<Incident>> = vec![None; points.len() * samples as usize];
        self.incident_along(&rays, |i, s| seen[slots[i]] = Some(s));
        let environment = &self.settings.environment;
        let mut unhidden = Vec::new();
        if environment.map().is_some() {
            unhidden.resize(seen.len(), None);
            for (slot, ray) in slots.iter().zip(&rays) {
                unhidden[*slot] = Some(environment.radiance(ray.direction));
            }
        }
        let gathered = |(k, of_point): (usize, &[Option<Incident>])| {
            let mut rays = IncidentSum::default();
            of_point.iter().flatten().for_each(|s| rays.add(*s));
            let first = k * samples as usize;
            let sent = unhidden.get(first..first + samples as usize);
            let sent = sent.into_iter().flatten().flatten();
            sent.for_each(|radiance| rays.add_unhidden(*radiance));
            rays.irradiance(samples, points[k].normal, environment)
        };
        let of_points = seen.chunks_exact(samples as usize).enumerate();
        of_points.map(gathered).collect()
    }

    /// Gathers for each of some points near each other what [`Self::irradiance`] does, and what
    /// surfaces cover. All share the sequence of `seed`; of points that have one range each looks
    /// along the same directions of its hemisphere. What a point gets does not depend on the
    /// others.
    ///
    /// # Panics
    /// As [`Self::irradiance_at_neighbours`].
    #[must_use]
    pub fn around_neighbours(
        &self,
        points: &[SurfacePoint],
        seed: u64,
        order: &DirectionOrder,
    ) -> Vec<Around> {
        let samples = self.count();
        let mut sums = vec![AroundSum::default(); points.len()];
        if let Some((slots, rays)) = self.rays_in_order(points, seed, order) {
            self.incident_and_crossings_along(&rays, |i, s, crossings| {
                sums[slots[i] / samples as usize].add(s, crossings);
            });
        } else {
            for (point, sum) in points.iter().zip(&mut sums) {
                let hemisphere = Hemisphere::new(point.normal, seed);
                let rays = self.rays(point.position, point.range, |i| {
                    hemisphere.direction_above(i, point.face_normal)
                });
                self.incident_and_crossings_along(&rays, |_, s, crossings| sum.add(s, crossings));
            }
        }
        let environment = &self.settings.environment;
        let of_points = sums.into_iter().zip(points);
        of_points
            .map(|(sum, point)| Around {
                gathered: (sum.light).irradiance(samples, point.normal, environment),
                covered: sum.covered / samples as f32,
            })
            .collect()
    }

    /// Gathers what [`Self::mean_radiance`] does at a point, and what surfaces cover.
    #[must_use]
    pub fn around_sphere(&self, point: Vec3, range: SampleRange) -> Around {
        let samples = self.count();
        let seed = sampling::mix(range.seed) as u32;
        let rays = self.rays(point, range.index, |i| Some(sphere(sobol2(i, 0, seed))));
        let mut sum = AroundSum::default();
        self.incident_and_crossings_along(&rays, |_, s, crossings| sum.add(s, crossings));
        Around {
            gathered: sum.light.mean(samples),
            covered: sum.covered / samples as f32,
        }
    }

    /// The patches that [`Self::irradiance_at_neighbours`] would evaluate.
    #[must_use]
    pub fn unknown_to_neighbours(
        &self,
        points: &[SurfacePoint],
        seed: u64,
        order: &DirectionOrder,
    ) -> UnknownPatches {
        let rays = self.rays_in_order(points, seed, order);
        self.unknown_along(&rays.map(|(_, rays)| rays).unwrap_or_default())
    }

    /// The rays of points in the order of their directions, and of each its place among all rays,
    /// point by point; `None` where directions are too many to be put in order.
    fn rays_in_order(
        &self,
        points: &[SurfacePoint],
        seed: u64,
        order: &DirectionOrder,
    ) -> Option<(Vec<usize>, Vec<Ray>)> {
        let hemisphere = |p: &SurfacePoint| Hemisphere::new(p.normal, seed);
        let hemispheres: Vec<_> = points.iter().map(hemisphere).collect();
        let in_order = hemispheres.first().and_then(|any| order.of(any))?;
        let samples = order.samples;
        // The last point of each range, and of each point the one before it of the same range.
        let mut with_range = vec![None; order.ranges as usize];
        let mut before = vec![None; points.len()];
        for (k, p) in points.iter().enumerate() {
            before[k] = with_range[p.range as usize].replace(k);
        }
        let reach = self.settings.reach();
        let count = points.len() * samples as usize;
        let (mut slots, mut rays) = (Vec::with_capacity(count), Vec::with_capacity(count));
        for &i in in_order {
            let (range, ray) = ((i / samples) as usize, (i % samples) as usize);
            let mut of_range = with_range[range];
            while let Some(k) = of_range {
                of_range = before[k];
                let SurfacePoint {
                    position,
                    face_normal,
                    ..
                } = points[k];
                if let Some(direction) = hemispheres[k].direction_above(i, face_normal) {
                    slots.push(k * samples as usize + ray);
                    rays.push(Ray::new(position, direction, reach));
                }
            }
        }
        Some((slots, rays))
    }
}
