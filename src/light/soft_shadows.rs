//! Media as shadow rays to lamps meet them. Shadows of lamps are soft, so that media need not be
//! passed voxel by voxel.

use super::OpticalDepth;
use crate::math::exp::exp_neg;
use crate::math::sampling;
use crate::scene::{Material, Scene, Volume};
use crate::trace::SteppedVolume;
use glam::{DVec3, Vec3};

/// The scene's media on few voxels, passed in steps as long as leaves rays nearly the same.
#[derive(Debug)]
pub struct SoftShadows {
    volumes: Vec<SteppedVolume>,
}

impl SoftShadows {
    /// Most voxels along an edge of a volume.
    const MOST: usize = 128;
    /// Most voxels of all volumes together: 64 MiB.
    const MOST_OF_ALL: usize = 1 << 24;

    /// Those of a scene; `None` if it has no lamps.
    #[must_use]
    pub fn new(scene: &Scene) -> Option<Self> {
        let emits = |m: &Material| m.emission != [0.0; 3];
        let most = Self::most(scene.volumes.len());
        scene.materials.iter().any(emits).then(|| Self {
            volumes: scene.volumes.iter().map(|v| stepped(v, most)).collect(),
        })
    }

    /// Most voxels along an edge of each of so many volumes.
    fn most(volumes: usize) -> usize {
        let edge = libm::cbrt(Self::MOST_OF_ALL as f64 / volumes as f64);
        (edge as usize).clamp(1, Self::MOST)
    }
}

impl OpticalDepth for SoftShadows {
    fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        let volumes = self.volumes.iter();
        volumes
            .map(|v| v.optical_depth(origin, direction, t_max))
            .sum()
    }
}

/// A volume on at most so many voxels along an edge, passed in the longest steps that do.
fn stepped(volume: &Volume, most: usize) -> SteppedVolume {
    /// Voxels.
    const STEPS: [f32; 2] = [4.0, 2.0];
    /// Most by which transmittances may differ from those in steps of one voxel, in the root mean
    /// square: where shadows of dense media are all that a picture shows, twice as much can be
    /// seen.
    const OFF: f64 = 0.006;
    let mut stepped = SteppedVolume::new(volume, most);
    let rays = rays_through(volume, &stepped);
    let off = |stepped: &SteppedVolume| {
        let squared = |&([origin, direction], expected): &([Vec3; 2], f64)| {
            let depth = stepped.optical_depth(origin, direction, f32::INFINITY);
            (f64::from(exp_neg(depth)) - expected).powi(2)
        };
        let count = rays.len().max(1) as f64;
        (rays.iter().map(squared).sum::<f64>() / count).sqrt()
    };
    let does = |&step: &f32| {
        stepped.step = step;
        off(&stepped) < OFF
    };
    stepped.step = STEPS.into_iter().find(does).unwrap_or(1.0);
    stepped
}

/// Origins and directions of rays that start in a volume's box and meet something, and what it lets
/// through of each.
fn rays_through(volume: &Volume, stepped: &SteppedVolume) -> Vec<([Vec3; 2], f64)> {
    const RAYS: usize = 256;
    /// Most of a volume may be empty.
    const TRIES: u64 = 1 << 14;
    let dims = DVec3::from_array(volume.sigma_t.dims().map(|n| n as f64));
    let ray = |i: u64| {
        let along = |axis: u64| f64::from(sampling::unit(sampling::hash(&[i, axis])));
        let in_index = dims * DVec3::new(along(0), along(1), along(2));
        let origin = volume.scene_from_index.transform_point3(in_index).as_vec3();
        let direction = sampling::sphere(sampling::r2(i, [0.5; 2]));
        let depth = stepped.optical_depth(origin, direction, f32::INFINITY);
        (depth > 0.0).then(|| ([origin, direction], f64::from(exp_neg(depth))))
    };
    (0..TRIES).filter_map(ray).take(RAYS).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;

    fn volume(dims: [usize; 3], sigma_t: impl Fn([usize; 3]) -> f32 + Sync) -> Volume {
        let grid = Grid::from_fn(dims, sigma_t);
        Volume::new("fog".into(), grid, [0.5; 3], DAffine3::IDENTITY)
    }

    #[test]
    fn smooth_media_are_passed_in_long_steps_and_rough_ones_are_not() {
        let cloud = |period: f32| {
            move |[i, j, k]: [usize; 3]| {
                let wave = |i: usize| (std::f32::consts::TAU * i as f32 / period).sin();
                0.03 * (1.0 + wave(i) * wave(j) * wave(k))
            }
        };
        let speckled = |v: [usize; 3]| {
            let bits = sampling::hash(&v.map(|i| i as u64));
            if bits.is_multiple_of(16) { 5.0 } else { 0.0 }
        };
        // A small ball tells of itself, however large the box is that it is in.
        let ball = |v: [usize; 3]| {
            let off = Vec3::from_array(v.map(|i| i as f32 - 40.0)).length();
            if off < 5.0 { 2.0 } else { 0.0 }
        };
        let step = |v: &Volume| stepped(v, SoftShadows::MOST).step;
        assert_eq!(step(&volume([64, 48, 40], cloud(60.0))), 4.0);
        assert!((2.0..4.0).contains(&step(&volume([64, 48, 40], cloud(6.0)))));
        assert_eq!(step(&volume([64; 3], speckled)), 1.0);
        assert_eq!(step(&volume([80; 3], ball)), 1.0);
    }

    #[test]
    fn many_volumes_share_the_memory_of_a_few() {
        assert_eq!(SoftShadows::most(1), SoftShadows::MOST);
        assert_eq!(SoftShadows::most(8), SoftShadows::MOST);
        assert!(SoftShadows::most(1000).pow(3) * 1000 <= SoftShadows::MOST_OF_ALL);
        assert_eq!(SoftShadows::most(usize::MAX), 1);
    }

    #[test]
    fn a_scene_without_lamps_has_no_soft_shadows() {
        let mut scene = Scene::demo().expect("the demo can be read");
        assert!(SoftShadows::new(&scene).is_some());
        for material in &mut scene.materials {
            material.emission = [0.0; 3];
        }
        assert!(SoftShadows::new(&scene).is_none());
    }
}
