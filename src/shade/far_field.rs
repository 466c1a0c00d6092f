//! What the surfaces around a medium send into it, by direction: smooth in space where they are far away, so that a few
//! probes tell it for all points of the medium, which then look through the medium only.

use super::vertices::Vertices;
use crate::gather::{Gatherer, Medium, NoMedia, Pages};
use crate::math::segment::Composite;
use crate::math::{Rgb, sampling};
use crate::scene::Volume;
use glam::Vec3;

/// Probes in and around one volume.
#[derive(Debug)]
pub struct FarField {
    probes: Vertices<Probe>,
    /// Cells of the sphere, all of one solid angle: rings by the height, and sectors of each.
    rings: u32,
    sectors: u32,
    /// Distance to surfaces, as a harmonic mean over the sphere, from which a probe stands for points near it.
    clear: f32,
}

/// What a probe sees of the surfaces, as if there were no media.
#[derive(Debug)]
struct Probe {
    harmonic_distance: f32,
    cells: Box<[Cell]>,
}

/// Means over a cell of the sphere.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    radiance: Rgb,
    /// To surfaces; infinite if there are none in some direction.
    distance: f32,
}

impl FarField {
    /// Voxels between probes.
    const STEP: usize = 8;
    /// Rays of a probe.
    const RAYS: u32 = 64;
    /// Probe spacings that surfaces must be away.
    const CLEAR: f32 = 4.0;

    /// No probe yet. A point of the medium is to look along about `samples` directions.
    pub fn new(volume: &Volume, samples: u32) -> Self {
        let rings = 1 << (samples.max(1).ilog2() / 2);
        Self {
            probes: Vertices::new(volume.sigma_t.dims(), Self::STEP),
            rings,
            sectors: samples.div_ceil(rings),
            clear: Self::CLEAR * Self::STEP as f32 * volume.longest_voxel_edge(),
        }
    }

    /// Mean over the sphere of the radiance at a point of the medium; `None` if surfaces are too near for probes.
    pub fn mean_radiance<P: Pages, M: Medium>(
        &self,
        volume: &Volume,
        gatherer: &Gatherer<P, M>,
        point_in_index: Vec3,
        point: Vec3,
        seed: u64,
    ) -> Option<Rgb> {
        let surfaces = Gatherer {
            pages: gatherer.pages,
            media: NoMedia,
            settings: gatherer.settings,
        };
        let make = |p: Vec3, v: [usize; 3]| {
            let inside = p.min(Vec3::from(volume.sigma_t.dims().map(|n| n as f32)));
            let p = volume
                .scene_from_index
                .transform_point3(inside.as_dvec3())
                .as_vec3();
            self.look_around(&surfaces, p, sampling::hash(&v.map(|c| c as u64)))
        };
        let around = self.probes.around(point_in_index);
        let mut near = [(None, 0.0); 8];
        for (near, (v, weight)) in near.iter_mut().zip(around) {
            if weight > 0.0 {
                let probe = self.probes.get(v, &make);
                if probe.harmonic_distance < self.clear {
                    return None;
                }
                *near = (Some(probe), weight);
            }
        }
        let mut sum = Rgb::BLACK;
        let count = self.rings * self.sectors;
        for c in 0..count {
            let mut cell = Cell::default();
            for (probe, weight) in near {
                if let Some(probe) = probe {
                    let of = &probe.cells[c as usize];
                    cell.radiance += of.radiance * weight;
                    cell.distance += of.distance * weight;
                }
            }
            let direction = sampling::sphere(self.within(c, sampling::hash(&[seed, u64::from(c)])));
            let mut light = Composite::default();
            gatherer.media.pass(
                point,
                direction,
                cell.distance.min(gatherer.settings.max_dist),
                &[],
                &mut light,
            );
            light.surface(1.0, cell.radiance);
            sum += light.radiance;
        }
        Some(sum * (1.0 / count as f32))
    }

    /// A point of the unit square inside a cell.
    fn within(&self, cell: u32, bits: u64) -> [f32; 2] {
        let [u, v] = sampling::unit2(bits);
        [
            ((cell / self.sectors) as f32 + u) / self.rings as f32,
            ((cell % self.sectors) as f32 + v) / self.sectors as f32,
        ]
    }

    fn look_around<P: Pages>(
        &self,
        surfaces: &Gatherer<P, NoMedia>,
        point: Vec3,
        seed: u64,
    ) -> Probe {
        let count = (self.rings * self.sectors) as usize;
        let per_cell = Self::RAYS.div_ceil(count as u32);
        let mut scratch = crate::gather::cone::Scratch::default();
        let mut inverse_distance = 0.0;
        let cells: Box<[Cell]> = (0..count as u32)
            .map(|c| {
                let mut cell = Cell::default();
                for i in 0..per_cell {
                    let bits = sampling::hash(&[seed, u64::from(c), u64::from(i)]);
                    let direction = sampling::sphere(self.within(c, bits));
                    let seen = surfaces.look(point, direction, &mut scratch);
                    cell.radiance += seen.radiance;
                    cell.distance += seen.distance;
                    inverse_distance += 1.0 / seen.distance;
                }
                let scale = 1.0 / per_cell as f32;
                cell.radiance *= scale;
                cell.distance *= scale;
                cell
            })
            .collect();
        Probe {
            harmonic_distance: (count as u32 * per_cell) as f32 / inverse_distance,
            cells,
        }
    }
}
