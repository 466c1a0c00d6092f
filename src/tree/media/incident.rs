//! What arrives in lvoxels of the light of the others, and between them.

use super::grid::{BRICK, Block, BlockGrid, Brick};
use crate::math::{Rgb, unflatten};
use glam::Vec3;

/// What arrives in the lvoxels of one volume of the light of the others.
#[derive(Clone, Copy, Debug)]
pub struct IncidentGrid<'a>(pub(super) &'a BlockGrid<Block>);

impl IncidentGrid<'_> {
    /// Voxels along each axis.
    #[must_use]
    pub fn dims(&self) -> [usize; 3] {
        self.0.dims.map(|n| n as usize)
    }

    /// A point of the scene, in voxels.
    #[inline]
    #[must_use]
    pub fn in_index(&self, point: Vec3) -> Vec3 {
        self.0.index_from_scene.transform_point3(point)
    }

    /// Log2 of the voxels along an edge of the lvoxels around a voxel; `None` if there are none in
    /// its brick.
    #[inline]
    #[must_use]
    pub fn level(&self, voxel: [usize; 3]) -> Option<u8> {
        Some(self.brick(voxel)?.level)
    }

    /// The light at a corner of cells `2^level` voxels wide: the mean of those around it that hold
    /// any medium.
    #[must_use]
    pub fn corner(&self, level: u8, corner: [usize; 3]) -> Option<Rgb> {
        mean(|k| {
            let [x, y, z] = [0, 1, 2].map(|a| (corner[a] + (k >> a & 1)).checked_sub(1));
            self.cell(level, [x?, y?, z?])
        })
    }

    /// The mean of the light at the corners of such a cell.
    #[must_use]
    pub fn between(&self, level: u8, cell: [usize; 3]) -> Option<Rgb> {
        mean(|k| {
            let corner = std::array::from_fn(|a| cell[a] + (k >> a & 1));
            self.corner(level, corner)
        })
    }

    /// [`Self::between`] of all cells of a brick, x first: each cell around and each corner is
    /// asked for once.
    #[must_use]
    pub fn between_in_brick(&self, level: u8, brick: [usize; 3]) -> Vec<Option<Rgb>> {
        let edge = BRICK >> level;
        let all = |edge: usize| (0..edge.pow(3)).map(move |i| unflatten(i, [edge; 3]));
        let around = all(edge + 2).map(|at| {
            let [x, y, z] = [0, 1, 2].map(|a| (brick[a] * edge + at[a]).checked_sub(1));
            self.cell(level, [x?, y?, z?])
        });
        let around: Vec<_> = around.collect();
        let corners: Vec<_> = all(edge + 1)
            .map(|at| mean_at(&around, edge + 2, at))
            .collect();
        all(edge)
            .map(|at| mean_at(&corners, edge + 1, at))
            .collect()
    }

    /// The light in a cell `2^level` voxels wide: that of the lvoxel around it, or the mean of
    /// those in it.
    fn cell(&self, level: u8, cell: [usize; 3]) -> Option<Rgb> {
        let brick = self.brick(cell.map(|c| c << level))?;
        if brick.level < level {
            return mean(|k| {
                let part = std::array::from_fn(|a| 2 * cell[a] + (k >> a & 1));
                self.cell(level - 1, part)
            });
        }
        let block = cell.map(|c| ((c << level) % BRICK) >> brick.level);
        let i = self.0.index(brick, block)?;
        Some(self.0.incident[i])
    }

    #[inline]
    fn brick(&self, voxel: [usize; 3]) -> Option<&Brick> {
        let [x, y, z] = voxel.map(|c| c / BRICK);
        let [nx, ny, nz] = self.0.table_dims;
        if x >= nx || y >= ny || z >= nz {
            return None;
        }
        let brick = self.0.table[(z * ny + y) * nx + x];
        self.0.bricks.get(brick as usize)
    }
}

/// The mean of those of eight in a cube of so many along an edge, from one on, that are known.
fn mean_at(cube: &[Option<Rgb>], edge: usize, [x, y, z]: [usize; 3]) -> Option<Rgb> {
    let row = |y: usize, z: usize| (z * edge + y) * edge + x;
    mean(|k| cube[row(y + (k >> 1 & 1), z + (k >> 2)) + (k & 1)])
}

/// The mean of those of eight that are known.
fn mean(of: impl Fn(usize) -> Option<Rgb>) -> Option<Rgb> {
    let (mut sum, mut count) = (Rgb::BLACK, 0.0);
    for light in (0..8).filter_map(of) {
        sum += light;
        count += 1.0;
    }
    (count > 0.0).then(|| sum * (1.0 / count))
}

#[cfg(test)]
mod tests {
    use super::super::Media;
    use super::*;
    use glam::DAffine3;
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    #[test]
    fn corners_have_the_mean_of_the_lvoxels_around_them() {
        let info = VolumeInfo {
            name: String::new(),
            dims: [16, 8, 8],
            index_from_scene: DAffine3::IDENTITY.to_cols_array_2d(),
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        };
        let lvoxel = |level, block, light| Lvoxel {
            level,
            block,
            sigma_t: 1.0,
            incident: [light, 0.0, 0.0],
            ..Lvoxel::default()
        };
        // A brick of four voxels along x, and one in another brick that fills it.
        let mut lvoxels: Vec<Lvoxel> = (4..8).map(|x| lvoxel(0, [x, 0, 0], f32::from(x))).collect();
        lvoxels.push(lvoxel(3, [1, 0, 0], 100.0));
        let media = Media::new(std::slice::from_ref(&info), lvoxels);
        let grid = media.incident(0).unwrap();
        let corner = |level, at| grid.corner(level, at).map(|c| c.0[0]);
        assert_eq!(corner(0, [5, 1, 1]), Some(4.5));
        assert_eq!(corner(0, [4, 0, 0]), Some(4.0));
        assert_eq!(corner(0, [3, 0, 0]), None);
        assert_eq!(corner(0, [5, 2, 0]), None);
        // Beside a coarser one, and as that sees the finer ones.
        assert_eq!(corner(0, [8, 1, 1]), Some((7.0 + 4.0 * 100.0) / 5.0));
        assert_eq!(corner(3, [1, 0, 0]), Some((5.5 + 100.0) / 2.0));
        let levels = [[4, 7, 7], [15, 7, 7], [16, 0, 0]].map(|voxel| grid.level(voxel));
        assert_eq!(levels, [Some(0), Some(3), None]);
        assert_eq!(grid.between(0, [5, 0, 0]).map(|c| c.0[0]), Some(5.0));
        for (level, x) in [(0, 0), (0, 1), (3, 0), (3, 1)] {
            let edge = BRICK >> level;
            let all = grid.between_in_brick(level, [x, 0, 0]);
            for (i, between) in all.into_iter().enumerate() {
                let at = unflatten(i, [edge; 3]);
                let cell = [x * edge + at[0], at[1], at[2]];
                assert_eq!(between, grid.between(level, cell), "{level} {cell:?}");
            }
        }
        // What tells is not sent again.
        let mut sent = 0.0;
        let ray = crate::math::Ray::endless(Vec3::new(-1.0, 0.5, 0.5), Vec3::X);
        media
            .without_incident()
            .walk(&ray, &mut |s: crate::math::segment::Segment| {
                sent += s.source.mean();
                true
            });
        assert_eq!(sent, 0.0);
        let silent = Media::new(&[info], [lvoxel(0, [0; 3], 0.0)]);
        assert!(silent.incident(0).is_none());
    }
}
