//! How dense all media together are in the bricks of one volume: light in a haze changes as fast as
//! in the cloud that stands in it.

use super::bricks::{BrickTable, brick_around};
use crate::math::{Aabb, Boxes};
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use glam::{DVec3, Vec3};

/// How fast light in each brick of a volume may change, as an extinction per scene unit; 0 where
/// the volume is empty.
///
/// It is the geometric mean of the extinctions of the volume and of all media together: an error of
/// the light that one medium scatters matters by its share of all extinction, and goes by the
/// square of the depth between vertices.
#[derive(Debug)]
pub struct Densities(BrickTable<f32>);

impl Densities {
    /// Densities of the bricks of the volume at an index; `boxes` are those of all volumes.
    pub fn new(volumes: &[Volume], boxes: &Boxes, index: usize) -> Self {
        let volume = &volumes[index];
        Self(BrickTable::new(&volume.sigma_t, |b| {
            let own = volume.sigma_t.brick(b).map_or(0.0, |brick| brick.max);
            if own > 0.0 {
                let corners = corners(volume, b);
                let around = corners.map(|c| c.as_vec3()).into_iter();
                let around = boxes.around(&around.fold(Aabb::EMPTY, Aabb::with));
                let others = around.filter(|&i| i != index).map(|i| &volumes[i]);
                let rest: f32 = others.map(|other| most_around(corners, other)).sum();
                own * (1.0 + rest / own).sqrt()
            } else {
                0.0
            }
        }))
    }

    /// The density of a brick.
    pub fn of(&self, brick: [usize; 3]) -> f32 {
        *self.0.of(brick)
    }

    /// Extinction of all media together in a brick of the volume whose own densest sample is `own`.
    pub fn of_all(&self, brick: [usize; 3], own: f32) -> f32 {
        if own == 0.0 {
            return 0.0;
        }
        let of_brick = self.of(brick);
        of_brick * (of_brick / own)
    }

    /// The density of the brick around a point of index space, or of the nearest.
    #[inline]
    pub fn at(&self, point_in_index: Vec3) -> f32 {
        *self.0.at(point_in_index)
    }
}

/// Corners of the cells of a brick, in the scene.
fn corners(volume: &Volume, brick: [usize; 3]) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let corner: [f32; 3] =
            std::array::from_fn(|a| ((brick[a] + (i >> a & 1)) * BRICK_CELLS) as f32 - 0.5);
        let corner = Vec3::from(corner).as_dvec3();
        volume.scene_from_index.transform_point3(corner)
    })
}

/// The largest sample of the bricks of another volume that may touch a box with these corners.
fn most_around(corners: [DVec3; 8], other: &Volume) -> f32 {
    let (mut lower, mut upper) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for in_scene in corners {
        let p = other
            .index_from_scene_f64
            .transform_point3(in_scene)
            .as_vec3();
        (lower, upper) = (lower.min(p), upper.max(p));
    }
    let dims = Vec3::from(other.sigma_t.dims().map(|n| n as f32));
    if !(lower.cmple(dims).all() && upper.cmpge(Vec3::ZERO).all()) {
        return 0.0;
    }
    let bricks = other.sigma_t.brick_dims();
    let (first, last) = (brick_around(lower, bricks), brick_around(upper, bricks));
    let mut most = 0.0_f32;
    for z in first[2]..=last[2] {
        for y in first[1]..=last[1] {
            for x in first[0]..=last[0] {
                most = most.max(other.sigma_t.brick([x, y, z]).map_or(0.0, |b| b.max));
            }
        }
    }
    most
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::{DAffine3, DVec3};

    /// A homogeneous cube of 32 voxels an edge.
    fn cube(sigma_t: f32, scale: f64, lower: DVec3) -> Volume {
        let grid = Grid::from_fn([32; 3], |_| sigma_t);
        let place = DAffine3::from_translation(lower) * DAffine3::from_scale(DVec3::splat(scale));
        Volume::new(String::new(), grid, [0.5; 3], place)
    }

    #[test]
    fn a_cloud_counts_in_the_bricks_of_a_haze_that_it_stands_in() {
        let haze = cube(0.1, 1.0, DVec3::ZERO);
        let cloud = cube(10.0, 0.25, DVec3::new(20.0, 20.0, 20.0));
        let volumes = [haze, cloud];
        let densities = |volumes: &[Volume], index| {
            let boxes = Boxes::new(volumes.iter().map(Volume::bounds));
            Densities::new(volumes, &boxes, index)
        };
        let of_haze = densities(&volumes, 0);
        let within = (0.1_f32 * 10.1).sqrt();
        for (at, expected) in [
            (Vec3::splat(4.0), 0.1),
            (Vec3::new(24.0, 24.0, 4.0), 0.1),
            (Vec3::splat(24.0), within),
            // Beyond the border the nearest brick tells.
            (Vec3::splat(-9.0), 0.1),
        ] {
            let found = of_haze.at(at);
            assert!((found / expected - 1.0).abs() < 1e-5, "{at}: {found}");
        }
        // To the cloud the haze is next to nothing.
        let found = densities(&volumes, 1).at(Vec3::splat(16.0));
        assert!((found / 10.05 - 1.0).abs() < 1e-3, "{found}");
        // Alone, a volume has its own extinction.
        assert_eq!(densities(&volumes[1..], 0).at(Vec3::splat(16.0)), 10.0);
        let of_all = of_haze.of_all([3; 3], 0.1);
        assert!((of_all / 10.1 - 1.0).abs() < 1e-5, "{of_all}");
    }
}
