//! Parallel rays through one volume that are kept: what it lets through of light from one direction
//! is marched once, on coarse cells, and interpolated between rays (deep shadow maps, Lokovic &
//! Veach 2000).

use super::coarse::{CoarseVolume, Layers};
use crate::Result;
use crate::math::exp::{exp_neg, exp_neg_in_place};
use crate::math::ray_lattice::RayLattice;
use crate::run::List;
use glam::{Affine3A, Vec3};
use rayon::prelude::*;

/// Optical depths between a light and the points of a volume, along rays one cell apart.
///
/// Mean voxels darken and rays that stand apart brighten: at one cell a ray both are nearly even.
#[derive(Debug)]
pub struct KeptRays {
    index_from_scene: Affine3A,
    /// Cells per voxel.
    per_voxel: f32,
    rays: RayLattice,
    extent: [(i32, usize); 2],
    /// Layers of cells along the rays' first axis; there is a plane before and behind each.
    layers: usize,
    /// Depth between the light and each plane, by row of rays, then by plane, then by ray.
    depths: List<f32>,
}

/// The lattice of rays to a light in a unit direction of scene space.
#[must_use]
pub fn lattice(coarse: &CoarseVolume, to_light: Vec3) -> RayLattice {
    let direction = coarse.volume.index_from_scene.transform_vector3(to_light);
    RayLattice::new(direction, coarse.edge)
}

impl KeptRays {
    /// Bytes for each cell, about: rays slant, so that there are twice as many depths.
    pub const CELL_BYTES: usize = 10;

    /// Marches rays to a light through the layers of a volume along the lattice's axes.
    ///
    /// # Errors
    /// No room for them.
    pub fn new(coarse: &CoarseVolume, layers: &Layers, rays: RayLattice) -> Result<Self> {
        let depths = Self::depths_for(coarse, &[rays])?;
        Ok(Self::in_place(depths, coarse, layers, rays))
    }

    /// A place for the depths of the rays to any of some lights.
    ///
    /// # Errors
    /// No room for it.
    pub fn depths_for(coarse: &CoarseVolume, rays: &[RayLattice]) -> Result<List<f32>> {
        let count = |rays: &RayLattice| {
            let [(_, width), (_, rows)] = rays.extent([[0; 3], coarse.dims]);
            rows * (coarse.dims[rays.axes[0]] + 1) * width
        };
        let most = rays.iter().map(count).fold(0, usize::max);
        let lists = coarse.volume.sigma_t.lists();
        lists.zeros("light that is kept in media", most)
    }

    /// The place of the depths, when the rays are no longer needed.
    pub fn into_depths(self) -> List<f32> {
        self.depths
    }

    /// Marches rays as [`Self::new`] does, in a place that is large enough for their depths.
    #[must_use]
    pub fn in_place(
        mut depths: List<f32>,
        coarse: &CoarseVolume,
        layers: &Layers,
        rays: RayLattice,
    ) -> Self {
        let count = coarse.dims[rays.axes[0]];
        let extent = rays.extent([[0; 3], coarse.dims]);
        let [(_, width), (first_row, rows_of_rays)] = extent;
        depths.write_pieces((count + 1) * width, |j, row| {
            if j < rows_of_rays {
                let first = [extent[0].0 as f32, (first_row + j as i32) as f32];
                march(layers, &rays, count, first, row);
            }
        });
        Self {
            index_from_scene: coarse.volume.index_from_scene,
            per_voxel: 1.0 / coarse.edge,
            rays,
            extent,
            layers: count,
            depths,
        }
    }

    /// Optical depth from a point of the scene to the light.
    #[must_use]
    pub fn depth(&self, point: Vec3) -> f32 {
        let p = self.index_from_scene.transform_point3(point) * self.per_voxel;
        let (along, [x, y]) = self.rays.place(p.to_array());
        let along = along.clamp(0.0, self.layers as f32);
        let plane = (along as usize).min(self.layers - 1);
        let f = along - plane as f32;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let depths = &self.depths[..];
        let ray = |cx: f32, cy: f32| {
            let [near, far] = [plane, plane + 1].map(|plane| self.at(depths, [cx, cy], plane));
            near * (1.0 - f) + far * f
        };
        mean_depth([
            ((1.0 - fx) * (1.0 - fy), ray(x0, y0)),
            (fx * (1.0 - fy), ray(x0 + 1.0, y0)),
            ((1.0 - fx) * fy, ray(x0, y0 + 1.0)),
            (fx * fy, ray(x0 + 1.0, y0 + 1.0)),
        ])
    }

    /// Whether all eight depths between which that of a point lies are more than `depth`.
    #[must_use]
    pub fn is_beyond(&self, point: Vec3, depth: f32) -> bool {
        let p = self.index_from_scene.transform_point3(point) * self.per_voxel;
        let (along, [x, y]) = self.rays.place(p.to_array());
        let plane = (along.clamp(0.0, self.layers as f32) as usize).min(self.layers - 1);
        let (x0, y0) = (x.floor(), y.floor());
        let depths = &self.depths[..];
        (0..8).all(|i| {
            let [dx, dy] = [i & 1, i >> 1 & 1].map(|n| n as f32);
            self.at(depths, [x0 + dx, y0 + dy], plane + (i >> 2)) > depth
        })
    }

    /// Depth of a ray at a plane, of all depths; 0 if the ray passes beside the volume.
    fn at(&self, depths: &[f32], ray: [f32; 2], plane: usize) -> f32 {
        let [(first_x, width), (first_y, rows)] = self.extent;
        let (i, j) = (ray[0] - first_x as f32, ray[1] - first_y as f32);
        if !(i >= 0.0 && j >= 0.0 && i < width as f32 && j < rows as f32) {
            return 0.0;
        }
        depths[(j as usize * (self.layers + 1) + plane) * width + i as usize]
    }

    /// Adds what comes through, of a channel whose extinction is `color` times that of the volume,
    /// to the corners of the volume's cells: plane after plane, in rows along the second axis of
    /// the lattice, each times a weight of its plane, row and place in that. `across` is how many
    /// cells there are along both axes.
    pub fn add_to_corners(
        &self,
        across: [usize; 2],
        color: f32,
        sums: &mut [f32],
        weight: impl Fn([usize; 3]) -> f32 + Sync,
    ) {
        let [width, height] = across.map(|n| n + 1);
        let [(first_x, all), (first_y, _)] = self.extent;
        let planes = sums.par_chunks_mut(width * height).enumerate();
        let all_depths = &self.depths[..];
        planes.for_each_init(Vec::new, |rays, (plane, sums)| {
            // The place of the first corner among the rays; the others follow one by one.
            let mut corner = [0.0; 3];
            corner[self.rays.axes[0]] = plane as f32;
            let (_, [x, y]) = self.rays.place(corner);
            let (x0, y0) = (x.floor(), y.floor());
            let (fx, fy) = (x - x0, y - y0);
            let (i, j) = (
                (x0 as i32 - first_x) as usize,
                (y0 as i32 - first_y) as usize,
            );
            rays.clear();
            for j in j..=j + height {
                let first = (j * (self.layers + 1) + plane) * all + i;
                let depths = &all_depths[first..=first + width];
                rays.extend(depths.iter().map(|depth| depth * color));
            }
            exp_neg_in_place(rays);
            let rows = sums.chunks_exact_mut(width).enumerate();
            for (j, sums) in rows {
                let [lower, upper] = [j, j + 1].map(|j| &rays[j * (width + 1)..][..=width]);
                let four = lower.windows(2).zip(upper.windows(2));
                for (i, (sum, (lower, upper))) in sums.iter_mut().zip(four).enumerate() {
                    let lower = lower[0] * (1.0 - fx) + lower[1] * fx;
                    let upper = upper[0] * (1.0 - fx) + upper[1] * fx;
                    *sum += (lower * (1.0 - fy) + upper * fy) * weight([plane, j, i]);
                }
            }
        });
    }
}

/// The depth between four rays, from their weights and depths.
///
/// Light is what is averaged: the mean of depths would darken the rims of shadows.
pub fn mean_depth(rays: [(f32, f32); 4]) -> f32 {
    let (mut through, mut tau) = (0.0, 0.0);
    for (weight, depth) in rays {
        through += weight * exp_neg(depth);
        tau += weight * depth;
    }
    if tau == 0.0 {
        0.0
    } else if through > 1e-20 {
        -libm::logf(through.min(1.0))
    } else {
        tau
    }
}

/// Sums the depths of a row of rays, plane by plane from the light on; the first ray is at `first`
/// in the plane 0.
fn march(layers: &Layers, rays: &RayLattice, count: usize, first: [f32; 2], depths: &mut [f32]) {
    let width = depths.len() / (count + 1);
    let plane_of_light = if rays.upwards { count } else { 0 };
    depths[plane_of_light * width..][..width].fill(0.0);
    for step in 0..count {
        let (layer, from, to) = if rays.upwards {
            (count - 1 - step, count - step, count - 1 - step)
        } else {
            (step, step, step + 1)
        };
        depths.copy_within(from * width..(from + 1) * width, to * width);
        // Where rays pass the middle of the layer, from the middles of cells.
        let [x, y] = rays.across(first, layer as f32 + 0.5).map(|v| v - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        // Rays between a cell of the row and the next; the empty ones at its ends count.
        let start = (-1 - x0 as i32).max(0) as usize;
        let end = (layers.width() as i32 - x0 as i32).clamp(0, width as i32) as usize;
        if start >= end {
            continue;
        }
        let cells = (x0 as i32 + 1 + start as i32) as usize;
        let cells = cells..=cells + (end - start);
        let [lower, upper] = [0, 1].map(|next| &layers.row(layer, y0 as i32 + next)[cells.clone()]);
        let weight = [1.0 - fy, fy].map(|w| w * rays.between);
        let depths = &mut depths[to * width..][start..end];
        let four = lower.windows(2).zip(upper.windows(2));
        for (depth, (lower, upper)) in depths.iter_mut().zip(four) {
            let lower = lower[0] * (1.0 - fx) + lower[1] * fx;
            let upper = upper[0] * (1.0 - fx) + upper[1] * fx;
            *depth += lower * weight[0] + upper * weight[1];
        }
    }
}
