//! Media as shadow rays to lamps meet them. Shadows of lamps are soft, so that media need not be passed voxel by voxel.

use crate::gather::Media;
use crate::gather::medium::Source;
use crate::light::OpticalDepth;
use crate::math::exp::exp_neg;
use crate::math::sampling;
use crate::scene::{Material, Scene, Volume};
use crate::trace::Cells;
use glam::{DVec3, Vec3};

/// Volumes of many voxels as the tree's lvoxels; of small ones those are few, and their faces would be seen. Small ones cell by
/// cell, on half as many voxels along each axis if rays cannot tell the difference.
#[derive(Debug)]
pub(super) struct SoftShadows<'a, S> {
    volumes: Vec<Passed<'a>>,
    media: &'a Media<S>,
}

/// What is passed of a volume.
#[derive(Debug)]
enum Passed<'a> {
    Lvoxels,
    Cells(&'a Volume),
    CoarseCells(Box<Volume>),
}

impl<'a, S> SoftShadows<'a, S> {
    /// Most voxels along an edge of a small volume.
    const SMALL: usize = 128;

    /// Those of a scene and its tree; `None` if the scene has no lamps.
    pub fn new(scene: &'a Scene, media: &'a Media<S>) -> Option<Self> {
        let emits = |m: &Material| m.emission != [0.0; 3];
        scene.materials.iter().any(emits).then(|| Self {
            volumes: scene.volumes.iter().map(Self::passed).collect(),
            media,
        })
    }

    fn passed(volume: &'a Volume) -> Passed<'a> {
        if longest_edge(volume) > Self::SMALL {
            return Passed::Lvoxels;
        }
        let coarse = coarsened(volume).map(|v| Passed::CoarseCells(Box::new(v)));
        coarse.unwrap_or(Passed::Cells(volume))
    }
}

impl<S: Source> OpticalDepth for SoftShadows<'_, S> {
    fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        let of_volume = |(index, passed): (usize, &Passed)| match passed {
            Passed::Lvoxels => self.media.optical_depth(index, origin, direction, t_max),
            Passed::Cells(volume) => depth_of_cells(volume, origin, direction, t_max),
            Passed::CoarseCells(volume) => depth_of_cells(volume, origin, direction, t_max),
        };
        self.volumes.iter().enumerate().map(of_volume).sum()
    }
}

#[inline]
fn depth_of_cells(volume: &Volume, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
    let cells = Cells::new(volume, origin, direction, t_max);
    cells.map_or(0.0, |c| c.optical_depth_by_middles() as f32)
}

fn longest_edge(volume: &Volume) -> usize {
    volume.sigma_t.dims().into_iter().fold(0, usize::max)
}

/// A volume on half as many voxels along each axis, or a quarter, as long as those are many and let as much through.
fn coarsened(volume: &Volume) -> Option<Volume> {
    /// Fewer voxels along the longest edge are passed fast enough as they are.
    const FEWEST: usize = 32;
    /// Most by which transmittances may differ, in the root mean square. Shadows differ by far less: a lamp is seen along many
    /// rays.
    const OFF: f64 = 0.02;
    let halved = |v: &Volume| {
        let is_fine = longest_edge(v) >= 2 * FEWEST;
        is_fine
            .then(|| v.halved())
            .filter(|halved| rms_difference(volume, halved) < OFF)
    };
    std::iter::successors(halved(volume), halved).last()
}

/// By how much the transmittances of two media in one place differ, in the root mean square over rays that start in them.
fn rms_difference(a: &Volume, b: &Volume) -> f64 {
    const RAYS: u64 = 256;
    let dims = DVec3::from_array(a.sigma_t.dims().map(|n| n as f64));
    let squared = |i: u64| {
        let along = |axis: u64| f64::from(sampling::unit(sampling::hash(&[i, axis])));
        let in_index = dims * DVec3::new(along(0), along(1), along(2));
        let origin = a.scene_from_index.transform_point3(in_index).as_vec3();
        let direction = sampling::sphere(sampling::r2(i, [0.5; 2]));
        let [a, b] = [a, b].map(|volume| {
            let depth = depth_of_cells(volume, origin, direction, f32::INFINITY);
            f64::from(exp_neg(depth))
        });
        (a - b) * (a - b)
    };
    ((0..RAYS).map(squared).sum::<f64>() / RAYS as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    fn volume(dims: [usize; 3], sigma_t: impl Fn([usize; 3]) -> f32 + Sync) -> Volume {
        let grid = Grid::from_fn(dims, sigma_t);
        Volume::new("fog".into(), grid, [0.5; 3], DAffine3::IDENTITY)
    }

    #[test]
    fn small_volumes_are_passed_by_cells_and_large_ones_by_lvoxels() {
        const SIGMA_T: f32 = 0.5;
        let far = SoftShadows::<f32>::SMALL + 1;
        let volumes = [[8, 1, 1], [far, 1, 1]].map(|dims| volume(dims, |_| SIGMA_T));
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
                volumes: volumes.iter().map(SoftShadows::<f32>::passed).collect(),
                media: &media,
            };
            shadows.optical_depth(Vec3::new(-1.0, 0.5, 0.5), Vec3::X, f32::INFINITY)
        };
        assert!((along(&volumes[..1]) - 8.0 * SIGMA_T).abs() < 1e-5);
        assert!((along(&volumes) - (8.0 + 1.0) * SIGMA_T).abs() < 1e-5);
    }

    #[test]
    fn smooth_media_are_coarsened_and_rough_ones_are_not() {
        let cloud = |[i, j, k]: [usize; 3]| {
            let wave = |i: usize| (0.1 * i as f32).sin();
            0.03 * (1.0 + wave(i) * wave(j) * wave(k))
        };
        let speckled = |v: [usize; 3]| {
            let bits = sampling::hash(&v.map(|i| i as u64));
            if bits.is_multiple_of(16) { 5.0 } else { 0.0 }
        };
        let coarse = |v: &Volume| coarsened(v).map(|v| v.sigma_t.dims());
        assert_eq!(coarse(&volume([64, 48, 40], cloud)), Some([32, 24, 20]));
        assert_eq!(coarse(&volume([128, 80, 80], cloud)), Some([32, 20, 20]));
        assert_eq!(coarse(&volume([64; 3], speckled)), None);
        assert_eq!(coarse(&volume([63; 3], cloud)), None);
    }

    #[test]
    fn a_scene_without_lamps_has_no_soft_shadows() {
        let media = Media::<f32>::new(&[], []);
        let mut scene = Scene::demo().expect("the demo can be read");
        assert!(SoftShadows::new(&scene, &media).is_some());
        for material in &mut scene.materials {
            material.emission = [0.0; 3];
        }
        assert!(SoftShadows::new(&scene, &media).is_none());
    }
}
