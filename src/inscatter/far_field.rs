//! What the surfaces around a medium send into it, by direction: smooth in space where they are far
//! away, so that a few probes tell it for all points of the medium, which then look through the
//! medium only.

use super::counts::{self, Counters};
use super::gatherer::GatherInMedia;
use super::vertices::{Vertices, inside};
use crate::gather::UnknownPatches;
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb, SeenPhase, Spectrum, sampling};
use crate::scene::Volume;
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::ops::{AddAssign, Mul};

/// Probes in and around one volume.
#[derive(Debug)]
pub struct FarField {
    probes: Vertices<Probe>,
    /// Cells of the sphere, all of one solid angle: rings by the height, and sectors of each. Each
    /// is cut into four.
    rings: u32,
    sectors: u32,
    /// Distance to surfaces, as a harmonic mean over the sphere, from which a probe stands for
    /// points near it.
    clear: f32,
    /// Key of the probes' rays.
    seed: u64,
}

/// What a probe sees of the surfaces, as if there were no media.
#[derive(Debug)]
struct Probe {
    harmonic_distance: f32,
    /// By quarter of a cell.
    quarters: Box<[Quarter]>,
}

/// Means over a quarter of a cell of the sphere.
#[derive(Clone, Copy, Debug, Default)]
struct Quarter {
    radiance: Rgb,
    /// To surfaces; infinite if there are none in some direction.
    distance: f32,
}

/// The probes around a point, weighted.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a>([(Option<&'a Probe>, f32); 8]);

impl Surroundings<'_> {
    /// Sum over quarters in a row, from `first` on, of the radiance of surfaces through what is
    /// before them.
    #[must_use]
    pub fn radiance_through<K: Spectrum>(&self, first: u32, transmittances: &[K]) -> Rgb {
        let mut sum = Rgb::BLACK;
        for (probe, weight) in &self.0 {
            let Some(probe) = probe else {
                continue;
            };
            let mut light = Rgb::BLACK;
            let quarters = &probe.quarters[first as usize..];
            for (quarter, through) in quarters.iter().zip(transmittances) {
                light += through.filter(quarter.radiance);
            }
            sum += light * *weight;
        }
        sum
    }

    /// Radiance of surfaces, a mean over a quarter of a cell.
    #[must_use]
    pub fn radiance(&self, quarter: u32) -> Rgb {
        self.mean(quarter, |q| q.radiance, Rgb::BLACK)
    }

    /// Distance to them, infinite if some direction has none.
    fn distance(&self, quarter: u32) -> f32 {
        self.mean(quarter, |q| q.distance, 0.0)
    }

    fn mean<T: AddAssign + Mul<f32, Output = T>>(
        &self,
        quarter: u32,
        of: impl Fn(&Quarter) -> T,
        mut sum: T,
    ) -> T {
        for (probe, weight) in &self.0 {
            if let Some(probe) = probe {
                sum += of(&probe.quarters[quarter as usize]) * *weight;
            }
        }
        sum
    }
}

/// A point of a medium whose light is asked for.
#[derive(Clone, Copy, Debug)]
pub struct AskedPoint {
    /// Its place in the volume's index space, and in scene space.
    pub in_index: Vec3,
    pub in_scene: Vec3,
    /// How a ray sees the phase function there, if that is not isotropic.
    pub seen: Option<SeenPhase>,
    /// Key of its directions.
    pub seed: u64,
}

impl FarField {
    /// Voxels between probes, at least.
    const MIN_STEP_VOXELS: usize = 8;
    /// Probe spacings along a volume, at most.
    const MAX_STEPS_ALONG: usize = 16;
    /// Rays of a probe, at least.
    const MIN_RAYS: u32 = 16;
    /// Probe spacings that surfaces must be away.
    const CLEAR_STEPS: f32 = 4.0;

    /// Cells of the sphere, at most: what is far away needs no more.
    const MAX_CELLS: u32 = 64;

    /// No probe yet. A point of the medium is to look along about `samples` directions. Volumes
    /// differ in their `seed`.
    pub fn new(volume: &Volume, samples: u32, seed: u64) -> Self {
        let samples = samples.min(Self::MAX_CELLS);
        let rings = 1 << (samples.max(1).ilog2() / 2);
        let dims = volume.sigma_t.dims();
        let longest = dims.into_iter().max().unwrap_or(1);
        let step = longest
            .div_ceil(Self::MAX_STEPS_ALONG)
            .max(Self::MIN_STEP_VOXELS);
        Self {
            probes: Vertices::new(dims, step),
            rings,
            sectors: samples.div_ceil(rings),
            clear: Self::CLEAR_STEPS * step as f32 * volume.longest_voxel_edge(),
            seed,
        }
    }

    /// Quarters of cells of the sphere.
    #[must_use]
    pub fn quarters(&self) -> u32 {
        4 * self.rings * self.sectors
    }

    /// Quarters of cells along both axes of the unit square that becomes the sphere.
    #[must_use]
    pub fn rows_and_columns(&self) -> [usize; 2] {
        [self.rings, self.sectors].map(|n| 2 * n as usize)
    }

    /// The direction in the middle of a quarter of a cell, of unit length.
    #[must_use]
    pub fn direction(&self, quarter: u32) -> Vec3 {
        sampling::sphere(self.within_quarter(quarter, [0.5; 2]))
    }

    /// The probes around a point of the medium; `None` if surfaces are too near for them.
    pub fn around<G: GatherInMedia>(
        &self,
        volume: &Volume,
        gatherer: &G,
        point_in_index: Vec3,
    ) -> Option<Surroundings<'_>> {
        let make = |p: Vec3, v: [usize; 3]| {
            let (p, key) = self.place(volume, p, v);
            self.look_around(gatherer, p, key)
        };
        let mut near = [(None, 0.0); 8];
        let around = self.probes.around(point_in_index);
        for (i, near) in near.iter_mut().enumerate() {
            let weight = around.weights[i];
            if weight > 0.0 {
                let probe = self.probes.get(around.vertex(i), &make);
                if probe.harmonic_distance < self.clear {
                    return None;
                }
                *near = (Some(probe), weight);
            }
        }
        Some(Surroundings(near))
    }

    /// Where a probe stands in the scene, and the key of its rays.
    fn place(&self, volume: &Volume, point_in_index: Vec3, v: [usize; 3]) -> (Vec3, u64) {
        let key = sampling::seeded(self.seed, &v.map(|c| c as u64));
        (inside(volume, point_in_index), key)
    }

    /// Evaluates the patches that the probes around some points will ask for, all together.
    pub fn foresee<G: GatherInMedia>(
        &self,
        volume: &Volume,
        gatherer: &G,
        points_in_index: impl Iterator<Item = Vec3>,
    ) {
        /// Probes at a time: what they ask for takes memory.
        const TOGETHER: usize = 1 << 14;
        if !gatherer.has_unknown() {
            return;
        }
        let around = points_in_index.flat_map(|point| {
            let around = self.probes.around(point);
            let corners = (0..8).filter(move |&i| around.weights[i] > 0.0);
            corners.map(move |i| around.vertex(i))
        });
        let probes: BTreeSet<[usize; 3]> = around.collect();
        let probes: Vec<_> = probes.into_iter().collect();
        let unknown = |&v: &[usize; 3]| {
            let at = self.probes.at(v);
            let (point, key) = self.place(volume, at, v);
            let patterns = self.patterns(key);
            let rays = (0..self.quarters()).flat_map(|c| {
                let directions = self.directions_in(c, &patterns, key);
                directions.map(|d| Ray::endless(point, d))
            });
            gatherer.unknown_along(&rays.collect::<Vec<_>>())
        };
        for probes in probes.chunks(TOGETHER) {
            let unknown = probes.par_iter().map(unknown).collect();
            gatherer.evaluate(UnknownPatches::of_all(unknown));
        }
    }

    /// Mean over the sphere of the radiance at a point of the medium, or what of it is scattered
    /// along a ray; `None` if surfaces are too near for probes.
    pub fn scattered<G: GatherInMedia>(
        &self,
        volume: &Volume,
        gatherer: &G,
        at: AskedPoint,
        counters: &Counters,
    ) -> Option<Rgb> {
        let AskedPoint {
            in_index,
            in_scene: point,
            seen,
            seed,
        } = at;
        let around = self.around(volume, gatherer, in_index)?;
        let (mut sum, mut passed) = (Rgb::BLACK, 0);
        let count = self.rings * self.sectors;
        for c in 0..count {
            let u = self.within(c, sampling::unit2(sampling::hash(&[seed, u64::from(c)])));
            let (direction, of_cell) = match seen {
                None => (sampling::sphere(u), c),
                Some(seen) => {
                    let direction = seen.sample(u);
                    (direction, self.cell_of(direction))
                }
            };
            let mut cell = Quarter::default();
            for quarter in 4 * of_cell..4 * of_cell + 4 {
                cell.radiance += around.radiance(quarter) * 0.25;
                cell.distance += around.distance(quarter) * 0.25;
            }
            let mut light = Composite::<G::Share>::default();
            let max_dist = gatherer.settings().max_dist;
            let end = cell.distance.min(max_dist);
            passed += gatherer.pass(&Ray::new(point, direction, end), &mut light);
            if cell.distance > max_dist {
                // The environment is behind the media that are too far away to send light.
                let mut hidden = Composite::<G::Share>::default();
                let from = point + direction * max_dist;
                let beyond = Ray::new(from, direction, cell.distance - max_dist);
                passed += gatherer.pass(&beyond, &mut hidden);
                light.transmittance = light.transmittance.times(hidden.transmittance);
            }
            light.surface(1.0, cell.radiance);
            sum += light.radiance;
        }
        counts::add(&counters.lvoxels, passed);
        Some(sum * (1.0 / count as f32))
    }

    /// Mean over the sphere of the radiance at places in a medium, given by `place(i)` in index and
    /// scene space for each number below that of quarters: along each direction from another one.
    /// `None` if surfaces are too near for probes.
    pub fn seen<G: GatherInMedia>(
        &self,
        volume: &Volume,
        gatherer: &G,
        place: impl Fn(u32) -> (Vec3, Vec3),
        key: u64,
        counters: &Counters,
    ) -> Option<Rgb> {
        /// Steps from the place of one direction to that of the next.
        const STEP: u32 = 7;
        let (mut sum, mut passed) = (Rgb::BLACK, 0);
        let count = self.quarters();
        for q in 0..count {
            let (in_index, point) = place((q * STEP + (key % u64::from(count)) as u32) % count);
            let around = self.around(volume, gatherer, in_index)?;
            let mut light = Composite::<G::Share>::default();
            let ray = Ray::new(point, self.direction(q), around.distance(q));
            passed += gatherer.pass(&ray, &mut light);
            light.surface(1.0, around.radiance(q));
            sum += light.radiance;
        }
        counts::add(&counters.lvoxels, passed);
        Some(sum * (1.0 / count as f32))
    }

    /// A point of the unit square inside a cell.
    fn within(&self, cell: u32, [u, v]: [f32; 2]) -> [f32; 2] {
        [
            ((cell / self.sectors) as f32 + u) / self.rings as f32,
            ((cell % self.sectors) as f32 + v) / self.sectors as f32,
        ]
    }

    /// The cell that a unit direction is in.
    fn cell_of(&self, direction: Vec3) -> u32 {
        let [u, v] = sampling::square_from_sphere(direction);
        let along = |share: f32, n: u32| ((share * n as f32) as u32).min(n - 1);
        along(u, self.rings) * self.sectors + along(v, self.sectors)
    }

    /// A point of the unit square inside a quarter of a cell.
    fn within_quarter(&self, quarter: u32, [u, v]: [f32; 2]) -> [f32; 2] {
        let [x, y] = Self::halves(quarter).map(|half| half as f32);
        self.within(quarter / 4, [0.5 * (x + u), 0.5 * (y + v)])
    }

    /// Which half of its cell a quarter is in, along both axes.
    fn halves(quarter: u32) -> [u32; 2] {
        [quarter & 1, quarter >> 1 & 1]
    }

    /// Where a quarter is among all, along both axes.
    pub fn row_and_column(&self, quarter: u32) -> [usize; 2] {
        let cell = [quarter / 4 / self.sectors, quarter / 4 % self.sectors];
        let half = Self::halves(quarter);
        std::array::from_fn(|a| (2 * cell[a] + half[a]) as usize)
    }

    /// The sets of directions of a probe, by the key of its rays: of each set one in a quarter.
    fn patterns(&self, seed: u64) -> Vec<MultiJitter> {
        let [rows, columns] = [2 * self.rings, 2 * self.sectors];
        (0..Self::MIN_RAYS.div_ceil(self.quarters()))
            .map(|i| MultiJitter::new(rows, columns, seed, i))
            .collect()
    }

    /// The directions of a probe in a quarter of a cell.
    fn directions_in<'a>(
        &'a self,
        quarter: u32,
        patterns: &'a [MultiJitter],
        seed: u64,
    ) -> impl Iterator<Item = Vec3> + 'a {
        let [row, column] = self.row_and_column(quarter);
        patterns.iter().enumerate().map(move |(i, pattern)| {
            let key = sampling::hash(&[seed, u64::from(quarter), i as u64]);
            let u = pattern.within(row, column, sampling::unit2(key));
            sampling::sphere(self.within_quarter(quarter, u))
        })
    }

    fn look_around<G: GatherInMedia>(&self, surfaces: &G, point: Vec3, seed: u64) -> Probe {
        let count = self.quarters();
        let patterns = self.patterns(seed);
        let per_quarter = patterns.len() as u32;
        let mut scratch = crate::gather::cone::Scratch::default();
        let mut inverse_distance = 0.0;
        let quarters: Box<[Quarter]> = (0..count)
            .map(|c| {
                let mut quarter = Quarter::default();
                for direction in self.directions_in(c, &patterns, seed) {
                    let seen = surfaces
                        .incident_from_surfaces(&Ray::endless(point, direction), &mut scratch);
                    quarter.radiance += seen.radiance;
                    quarter.distance += seen.distance;
                    inverse_distance += 1.0 / seen.distance;
                }
                let scale = 1.0 / per_quarter as f32;
                quarter.radiance *= scale;
                quarter.distance *= scale;
                quarter
            })
            .collect();
        Probe {
            harmonic_distance: (count * per_quarter) as f32 / inverse_distance,
            quarters,
        }
    }
}

/// Points of which each cell of a grid over the unit square has one, and so has each of as many
/// strips of the square along either axis: correlated multi-jittered samples (Kensler 2013).
struct MultiJitter {
    /// By row, the part of its cells along the second axis in which its points are; by column,
    /// along the first.
    part_of_row: Vec<f32>,
    part_of_column: Vec<f32>,
}

impl MultiJitter {
    /// The `i`-th independent set of a seed.
    fn new(rows: u32, columns: u32, seed: u64, i: u32) -> Self {
        let order = |n: u32, axis: u64| {
            let key = |k| sampling::hash(&[seed, axis, u64::from(k), u64::from(i)]);
            let keys: Vec<u64> = (0..n).map(key).collect();
            let rank = |of: &u64| keys.iter().filter(|k| *k < of).count() as f32;
            keys.iter().map(rank).collect()
        };
        Self {
            part_of_row: order(rows, 2),
            part_of_column: order(columns, 1),
        }
    }

    /// Where within a cell its point is, for two numbers in [0,1).
    fn within(&self, row: usize, column: usize, [u, v]: [f32; 2]) -> [f32; 2] {
        [
            (self.part_of_column[column] + u) / self.part_of_column.len() as f32,
            (self.part_of_row[row] + v) / self.part_of_row.len() as f32,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_strip_of_the_square_has_a_point() {
        for (rows, columns) in [(4, 8), (2, 6), (1, 1)] {
            let pattern = MultiJitter::new(rows, columns, 7, 1);
            let all = rows * columns;
            let mut strips = [vec![0; all as usize], vec![0; all as usize]];
            for cell in 0..all {
                let (row, column) = (cell / columns, cell % columns);
                let u = pattern.within(row as usize, column as usize, [0.5; 2]);
                let at = [
                    (row as f32 + u[0]) / rows as f32,
                    (column as f32 + u[1]) / columns as f32,
                ];
                for (strips, at) in strips.iter_mut().zip(at) {
                    strips[(at * all as f32) as usize] += 1;
                }
            }
            assert!(strips.iter().flatten().all(|&n| n == 1), "{strips:?}");
        }
    }
}
