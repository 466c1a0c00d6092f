//! Where surfaces leave the sky open to the points of a volume: known on a few points of the box,
//! by direction, and interpolated between.

use crate::math::unflatten;
use crate::scene::Volume;
use glam::DVec3;
use glam::Vec3;
use rayon::prelude::*;

/// The share of each of some directions that surfaces leave open.
#[derive(Debug)]
pub struct OpenSky {
    /// Points of the box along x, y and z.
    count: [usize; 3],
    /// Of these per voxel.
    per_voxel: [f32; 3],
    /// By direction, then by point, x fastest.
    shares: Vec<f32>,
}

impl OpenSky {
    /// Cells between points along the longest edge of the box.
    const CELLS: usize = 24;

    /// Asks `is_open` for points all over the box of a volume, and for all directions.
    pub fn new(
        volume: &Volume,
        directions: &[Vec3],
        is_open: impl Fn(Vec3, Vec3) -> bool + Sync,
    ) -> Self {
        let dims = volume.sigma_t.dims();
        let longest = dims.into_iter().max().unwrap_or(1);
        let cells = dims.map(|n| (n * Self::CELLS).div_ceil(longest).min(n));
        let count = cells.map(|n| n + 1);
        let points: usize = count.iter().product();
        let share = |i: usize| {
            let place = DVec3::from(unflatten(i % points, count).map(|c| c as f64));
            let share = place / DVec3::from(cells.map(|n| n as f64));
            let at = share * DVec3::from(dims.map(|n| n as f64));
            let point = volume.scene_from_index.transform_point3(at).as_vec3();
            f32::from(u8::from(is_open(point, directions[i / points])))
        };
        let all = (0..directions.len() * points).into_par_iter();
        Self {
            count,
            per_voxel: [0, 1, 2].map(|a| cells[a] as f32 / dims[a] as f32),
            shares: all.map(share).collect(),
        }
    }

    /// What is open of a direction, by its number, at a place in voxels.
    #[inline]
    pub fn share(&self, direction: usize, place: [f32; 3]) -> f32 {
        let [width, height, depth] = self.count;
        let mut first = [0; 3];
        let mut part = [0.0; 3];
        for a in 0..3 {
            let last = self.count[a] - 1;
            let at = (place[a] * self.per_voxel[a]).clamp(0.0, last as f32);
            first[a] = (at as usize).min(last.saturating_sub(1));
            part[a] = at - first[a] as f32;
        }
        let shares = &self.shares[direction * width * height * depth..];
        let [x, y, z] = first;
        let row = |y: usize, z: usize| {
            let row = &shares[(z * height + y) * width + x..];
            row[0] * (1.0 - part[0]) + row[1] * part[0]
        };
        let face = |z: usize| row(y, z) * (1.0 - part[1]) + row(y + 1, z) * part[1];
        face(z) * (1.0 - part[2]) + face(z + 1) * part[2]
    }
}
