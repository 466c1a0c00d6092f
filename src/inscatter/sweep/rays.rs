//! The rays of one direction of a sweep.

use super::rows::{Arriving, RayRows};
use super::{MediaBox, SweepScope};
use crate::Result;
use crate::inscatter::counts;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::sparse::SparseLattice;
use crate::math::ray_lattice::RayLattice;
use crate::math::segment::Segment;
use crate::math::{Ray, Rgb, Spectrum};
use crate::trace::offset;
use glam::Vec3;

/// Parallel rays through a volume, between which vertices interpolate.
pub struct SweepRays<'a, G> {
    scope: &'a SweepScope<'a, G>,
    set: &'a SparseLattice,
    /// Unit direction against the light.
    direction: Vec3,
    rays: RayLattice,
    media: &'a MediaBox,
}

impl<'a, G: GatherInMedia> SweepRays<'a, G> {
    /// Rays along a unit `direction` of scene space, against the light, for vertices `step` voxels
    /// apart.
    pub fn new(
        scope: &'a SweepScope<'a, G>,
        set: &'a SparseLattice,
        step: usize,
        direction: Vec3,
        media: &'a MediaBox,
    ) -> Self {
        Self {
            scope,
            set,
            direction,
            rays: Self::along(scope, step, direction),
            media,
        }
    }

    fn along(scope: &SweepScope<G>, step: usize, direction: Vec3) -> RayLattice {
        let d = scope.volume.index_from_scene.transform_vector3(direction);
        RayLattice::new(d, step as f32)
    }

    /// Bytes that passing those along a direction takes, but for what arrives at the vertices.
    pub fn bytes(scope: &SweepScope<G>, set: &SparseLattice, step: usize, direction: Vec3) -> u64 {
        RayRows::bytes::<G::Share>(set, &Self::along(scope, step, direction))
    }

    /// Passes all rays that any vertex needs, and returns what arrives at the vertices.
    ///
    /// # Errors
    /// If cancelled.
    pub fn pass(&self) -> Result<Vec<Arriving<G::Share>>> {
        RayRows::new(self.set, &self.rays).pass(|ray, stops, arrive| {
            self.scope.job.cancel.check()?;
            self.pass_one(ray.map(|c| c as f32), stops, arrive);
            Ok(())
        })
    }

    /// Layers of vertices.
    fn layers(&self) -> usize {
        self.set.count()[self.rays.axes[0]]
    }

    /// Passes one ray, and tells what it brings to some layers, in the order of travel.
    fn pass_one(
        &self,
        at: [f32; 2],
        stops: &[usize],
        arrive: &mut dyn FnMut(usize, Arriving<G::Share>),
    ) {
        // The whole ray is the same whatever part of it is needed.
        let first = if self.rays.upwards {
            self.layers() - 1
        } else {
            0
        };
        let first_point = self.scope.to_scene(self.rays.point(at, first));
        // From the box of this volume on, however far others reach: stops far from the origin would
        // lose their digits.
        let beyond = self.media.own.leave(first_point, self.direction);
        let origin = first_point + self.direction * beyond;
        let stop_at = |i: usize| {
            let stop = stops.get(i);
            stop.map_or(f32::INFINITY, |&layer| {
                beyond + layer.abs_diff(first) as f32 * self.rays.between
            })
        };
        // A layer further than any stop: whether a surface in a layer is met must not depend on
        // which stop is the last.
        let end = stop_at(stops.len() - 1) + self.rays.between;
        let mut cuts = if self.media.has_walls {
            self.walls(origin, end)
        } else {
            Vec::new()
        };
        cuts.reverse();

        let mut light = self.light_of_other_media(origin);
        let mut next = 0;
        let mut passed = 0;
        let mut add = |mut s: Segment<G::Share>| {
            passed += 1;
            let mut next_at = stop_at(next);
            while next < stops.len() {
                let cut = cuts.last().is_some_and(|&c| c <= next_at);
                let t = if cut { cuts[cuts.len() - 1] } else { next_at };
                if t >= s.far {
                    break;
                }
                let share = ((t - s.near) / (s.far - s.near)).max(0.0);
                if cut {
                    if share > 0.0 {
                        s.tau = s.tau * (1.0 - share);
                        s.near = t;
                    }
                    cuts.pop();
                    light = Arriving::none_yet();
                } else {
                    // Of a copy: what the ray goes on with must not depend on where it is asked.
                    let mut here = light;
                    if share > 0.0 {
                        here.pass(s.tau * share, s.source);
                    }
                    arrive(stops[next], here);
                    next += 1;
                    next_at = stop_at(next);
                }
            }
            light.pass(s.tau, s.source);
            next < stops.len()
        };
        self.scope
            .gatherer
            .walk_with(&Ray::endless(origin, -self.direction), &mut add);
        // What is left of the ray is empty.
        add(Segment {
            near: f32::INFINITY,
            far: f32::INFINITY,
            tau: G::Share::splat(0.0),
            source: Rgb::BLACK,
        });
        counts::add(&self.scope.counters.lvoxels, passed);
    }

    /// What a ray brings with it from media around this volume, to where it enters its box.
    fn light_of_other_media(&self, origin: Vec3) -> Arriving<G::Share> {
        let mut light = Arriving::none_yet();
        if self.media.bounds == self.media.own {
            return light;
        }
        let mut way = self.media.bounds.leave(origin, self.direction);
        if self.media.has_walls
            && let Some(hit) =
                self.scope
                    .view
                    .tracer
                    .closest(&Ray::new(origin, self.direction, way))
        {
            way = hit.t;
        }
        // Against the light, so that what is near is as exact as it is far from all ends of the
        // others.
        let mut add = |s: Segment<G::Share>| {
            light.pass_behind(s.tau, s.source);
            true
        };
        self.scope
            .gatherer
            .walk(&Ray::new(origin, self.direction, way), &mut add);
        light
    }

    /// Distances at which a ray passes surfaces.
    fn walls(&self, origin: Vec3, end: f32) -> Vec<f32> {
        let tracer = self.scope.view.tracer;
        let mut walls = Vec::new();
        let mut t = 0.0;
        loop {
            let from = origin - self.direction * t;
            let Some(hit) = tracer.closest(&Ray::new(from, -self.direction, end - t)) else {
                break;
            };
            walls.push(t + hit.t);
            // SweepRays may meet walls at a slant.
            t += hit.t + 4.0 * offset(origin).max(offset(from));
        }
        walls
    }
}

impl<K: Spectrum> Arriving<K> {
    /// What arrives along a ray that has passed nothing.
    pub fn none_yet() -> Self {
        Self {
            radiance: Rgb::BLACK,
            transmittance: K::splat(1.0),
        }
    }

    /// Adds a medium that the light passed before all that it has passed.
    #[inline]
    fn pass_behind(&mut self, tau: K, source: Rgb) {
        let (through, taken) = tau.exp_neg_and_rest();
        self.radiance += self.transmittance.times(taken).filter(source);
        self.transmittance = self.transmittance.times(through);
    }

    /// Passes a medium on the way towards the vertex.
    #[inline]
    fn pass(&mut self, tau: K, source: Rgb) {
        let (through, taken) = tau.exp_neg_and_rest();
        self.radiance = through.filter(self.radiance) + taken.filter(source);
        self.transmittance = self.transmittance.times(through);
    }
}
