//! What gathering and lights see of a scene and a tree that they do not know themselves.

use crate::gather::medium::Source;
use crate::gather::{Geometry, Media};
use crate::light::OpticalDepth;
use crate::math::Hit;
use crate::scene::Volume;
use crate::trace::{Cells, Tracer, unit_normal};
use glam::Vec3;

impl Geometry for Tracer<'_> {
    fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        self.closest(origin, direction, t_max)
    }

    fn triangles(&self) -> u32 {
        self.scene.mesh.triangles.len() as u32
    }

    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.scene.mesh.corners(triangle as usize)
    }

    fn normal(&self, triangle: u32) -> Vec3 {
        unit_normal(Geometry::corners(self, triangle))
    }

    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32> {
        let material = self.scene.mesh.material[triangle as usize];
        self.pieces.area_over_mean(material)
    }
}

/// Media as shadow rays to lamps meet them, whose shadows are soft: volumes of many voxels as the tree's lvoxels. Of small ones
/// those are few, and their faces would be seen.
#[derive(Debug)]
pub(super) struct SoftShadows<'a, S> {
    pub volumes: &'a [Volume],
    pub media: &'a Media<S>,
}

impl<S> SoftShadows<'_, S> {
    /// Most voxels along an edge of a small volume.
    const SMALL: usize = 128;
}

impl<S: Source> OpticalDepth for SoftShadows<'_, S> {
    fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        let of_volume = |(index, volume): (usize, &Volume)| {
            if volume.sigma_t.dims().iter().any(|&n| n > Self::SMALL) {
                return self.media.optical_depth(index, origin, direction, t_max);
            }
            let cells = Cells::new(volume, origin, direction, t_max);
            cells.map_or(0.0, |c| c.optical_depth_by_middles() as f32)
        };
        self.volumes.iter().enumerate().map(of_volume).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    #[test]
    fn small_volumes_are_passed_by_cells_and_large_ones_by_lvoxels() {
        const SIGMA_T: f32 = 0.5;
        let far = SoftShadows::<f32>::SMALL + 1;
        let volumes = [[8, 1, 1], [far, 1, 1]].map(|dims| {
            let grid = Grid::from_fn(dims, |_| SIGMA_T);
            Volume::new("fog".into(), grid, [0.5; 3], DAffine3::IDENTITY)
        });
        let infos = volumes.each_ref().map(|volume| VolumeInfo {
            name: volume.name.clone(),
            dims: volume.sigma_t.dims().map(|n| n as u32),
            index_from_scene: volume.index_from_scene_f64.to_cols_array_2d(),
            albedo: volume.albedo,
        });
        // The tree has the first voxel of each alone.
        let lvoxels = [0, 1].map(|volume| Lvoxel {
            volume,
            level: 0,
            block: [0; 3],
            sigma_t: SIGMA_T,
            source: [0.0; 3],
        });
        let media = Media::<f32>::new(&infos, lvoxels);
        let along = |volumes: &[Volume]| {
            let shadows = SoftShadows {
                volumes,
                media: &media,
            };
            shadows.optical_depth(Vec3::new(-1.0, 0.5, 0.5), Vec3::X, f32::INFINITY)
        };
        assert!((along(&volumes[..1]) - 8.0 * SIGMA_T).abs() < 1e-5);
        assert!((along(&volumes) - (8.0 + 1.0) * SIGMA_T).abs() < 1e-5);
    }
}
