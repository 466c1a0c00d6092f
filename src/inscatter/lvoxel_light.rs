//! Light that the lvoxels of a medium send each other, between their middles.
//!
//! A tree whose light has bounced tells what arrives in each lvoxel: a mean over it, which says
//! more of the light near a hard edge than any point does. Vertices stand at the corners of
//! lvoxels.

use super::vertices::{CellCache, Vertices, blend};
use crate::math::Rgb;
use crate::tree::IncidentGrid;
use glam::Vec3;
use lvox_formats::record::MAX_LEVEL;
use wide::f32x4;

/// Sizes of lvoxels.
const LEVELS: usize = MAX_LEVEL as usize + 1;

/// Light between the lvoxels of one volume.
#[derive(Debug)]
pub struct LvoxelLight<'a> {
    grid: IncidentGrid<'a>,
    /// Shortest edge of a voxel of the grid, scene units.
    voxel: f32,
    /// By log2 of the voxels between vertices. With a weight, which is 0 where no lvoxel is near.
    levels: [Vertices<f32x4>; LEVELS],
}

/// What one ray found at vertices last, by size of lvoxels.
pub type LvoxelMemo = [CellCache<(), f32x4>; LEVELS];

impl<'a> LvoxelLight<'a> {
    /// Of the lvoxels of a grid.
    pub fn new(grid: IncidentGrid<'a>) -> Self {
        let dims = grid.dims();
        let origin = grid.in_index(Vec3::ZERO);
        let voxels = |axis: Vec3| (grid.in_index(axis) - origin).length();
        Self {
            voxel: 1.0 / Vec3::AXES.map(voxels).into_iter().fold(0.0, f32::max),
            grid,
            levels: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
        }
    }

    /// Mean over the sphere of the radiance that arrives from lvoxels at a point of the scene, and
    /// scene units between the vertices that it is found between.
    pub fn at(&self, point: Vec3, memo: &mut LvoxelMemo) -> (Rgb, f32) {
        let p = self.grid.in_index(point);
        let level = self.level(p);
        let around = self.levels[level].around(p);
        let vertex = |v| *self.levels[level].get(v, &|_, v| self.vertex(level, v));
        let values = memo[level].values((), &around, vertex);
        let [r, g, b, weight] = blend(values, &around.weights, |v| *v).to_array();
        let light = if weight > 0.0 {
            Rgb([r, g, b]) * (1.0 / weight)
        } else {
            Rgb::BLACK
        };
        (light, self.voxel * (1 << level) as f32)
    }

    /// Log2 of the voxels between the vertices around a point: those of its brick, or of one that
    /// begins half a voxel away, or the coarsest.
    fn level(&self, p: Vec3) -> usize {
        let level_at = |p: Vec3| {
            self.grid
                .level(p.max(Vec3::ZERO).to_array().map(|c| c as usize))
        };
        let near = || {
            let corner = |i: u32| {
                let upper = Vec3::from([0, 1, 2].map(|a| (i >> a & 1) as f32));
                level_at(p + upper - 0.5)
            };
            (0..8).find_map(corner)
        };
        let level = level_at(p).or_else(near);
        level.map_or(LEVELS - 1, usize::from)
    }

    /// The light at a vertex, and its weight.
    fn vertex(&self, level: usize, v: [usize; 3]) -> f32x4 {
        match self.grid.corner(level as u8, v) {
            Some(Rgb([r, g, b])) => f32x4::new([r, g, b, 1.0]),
            None => f32x4::ZERO,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tree::Media;
    use glam::DAffine3;
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    #[test]
    fn light_between_lvoxels_is_linear_where_theirs_is() {
        let info = VolumeInfo {
            name: String::new(),
            dims: [8; 3],
            index_from_scene: DAffine3::IDENTITY.to_cols_array_2d(),
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        };
        let lvoxels = (0..512_u16).map(|i| {
            let block = [i % 8, i / 8 % 8, i / 64];
            Lvoxel {
                block,
                sigma_t: 1.0,
                incident: [f32::from(block[0]) + 0.5, 1.0, 0.0],
                ..Lvoxel::default()
            }
        });
        let media = Media::new(&[info], lvoxels);
        let light = LvoxelLight::new(media.incident(0).unwrap());
        let mut memo = LvoxelMemo::default();
        for x in [1.0_f32, 1.3, 2.0, 4.9, 6.9] {
            let (Rgb([r, g, b]), between) = light.at(Vec3::new(x, 3.1, 4.7), &mut memo);
            assert_eq!(between, 1.0);
            assert!(
                (r - x).abs() < 1e-5 && (g - 1.0).abs() < 1e-6 && b == 0.0,
                "{x} {r} {g} {b}"
            );
        }
        // A point at the rim has the light of what is next to it.
        let (Rgb([r, ..]), _) = light.at(Vec3::new(8.4, 3.0, 3.0), &mut memo);
        assert!((r - 7.5).abs() < 1e-5, "{r}");
    }
}
