//! The light that the lvoxels of a scene's only volume send each other in the end: what frames look
//! up there, and gather of surfaces alone.

use super::blocks::Blocks;
use super::lattice::{self, DIRECTIONS};
use super::light::{Light, Share};
use super::media::ScatteringVolume;
use super::walls::WallLight;
use crate::Result;
use crate::math::{Environment, Rgb, sampling};
use crate::run::Cancel;
use crate::trace::Tracer;
use crate::tree::media::{IncidentGrid, MediaLayout};
use glam::Vec3;
use lvox_formats::record::{Lvoxel, MAX_LEVEL, VolumeInfo};
use lvox_formats::{MappedFile, Tree};
use rayon::prelude::*;

/// Sets of directions: what cameras see needs more of them than what is scattered on.
const SETS: u32 = 3;

/// By lvoxel: the mean over the sphere and over itself of what arrives from others, and of the
/// environment where no surface may be before it.
///
/// # Errors
/// A stop on request.
pub fn of_lvoxels<K: Share>(
    volume: &ScatteringVolume<K>,
    blocks: &Blocks,
    tracer: &Tracer,
    environment: Environment,
    cancel: &Cancel,
) -> Result<Vec<Light>> {
    let is_alone = tracer.scene.mesh.triangles.is_empty();
    let mut sum = vec![Light::ZERO; blocks.len()];
    for set in 0..SETS {
        let outside = match is_alone && !environment.is_black() {
            true => from_outside(environment, &lattice::directions(set)),
            false => [[Light::ZERO; 2]; DIRECTIONS],
        };
        let (sweeps, sources) = (volume.sweeps(), volume.sources());
        let means = match set {
            0 => sweeps.means_from(sources, &WallLight::NONE, &outside, cancel),
            _ => sweeps.means_along(tracer, set, sources, &outside, cancel),
        };
        sum.iter_mut().zip(means?).for_each(|(s, m)| *s += m);
    }
    let mean = |l: Light| (l / SETS as f32).max(Light::ZERO) + Light::ZERO;
    Ok(sum.into_iter().map(mean).collect())
}

/// Changes the light of lvoxels so that the mean over each of what is interpolated between its
/// corners, which have the means of the lvoxels around them, is what arrives in it.
///
/// # Errors
/// A page that cannot be read.
pub fn keep_means(tree: &Tree<MappedFile>, light: &mut [Light]) -> Result<()> {
    let mut lvoxels = Vec::with_capacity(light.len());
    for page in 0..tree.lvoxel_pages() {
        lvoxels.extend(tree.lvoxel_page(page)?);
    }
    keep_means_of(&tree.meta().cloud.volumes, &mut lvoxels, light);
    Ok(())
}

fn keep_means_of(volumes: &[VolumeInfo], lvoxels: &mut [Lvoxel], light: &mut [Light]) {
    /// After the second one, a third of what was off is left at a hard edge.
    const STEPS: u32 = 2;
    let arriving = light.to_vec();
    for _ in 0..STEPS {
        for (l, light) in lvoxels.iter_mut().zip(&*light) {
            l.incident = light.to_array();
        }
        let mut layout = MediaLayout::new(volumes);
        lvoxels.iter().for_each(|l| layout.note(l));
        let mut media = layout.allocate();
        lvoxels.iter().for_each(|l| media.place(l));
        let Some(grid) = media.incident(0) else {
            return;
        };
        let runs: Vec<&[Lvoxel]> = lvoxels
            .chunk_by(|a, b| (a.level, brick(a)) == (b.level, brick(b)))
            .collect();
        let between: Vec<_> = runs.into_par_iter().map(|l| between(grid, l)).collect();
        let between = between.into_iter().flatten();
        for ((light, arriving), between) in light.iter_mut().zip(&arriving).zip(between) {
            *light = (*light + *arriving - between).max(Light::ZERO);
            // Not -0.
            *light += Light::ZERO;
        }
    }
}

/// The brick of an lvoxel.
fn brick(l: &Lvoxel) -> [usize; 3] {
    l.block.map(|b| usize::from(b) >> (MAX_LEVEL - l.level))
}

/// What is interpolated between the corners of lvoxels of one brick.
fn between(grid: IncidentGrid, lvoxels: &[Lvoxel]) -> Vec<Light> {
    /// Lvoxels of a brick from which on it takes less to ask for all of it.
    const MANY: usize = 32;
    let light = |known: Option<Rgb>| Light::from(known.unwrap_or_default().0);
    let cells = lvoxels.iter().map(|l| (l.level, l.block.map(usize::from)));
    if lvoxels.len() < MANY {
        return cells
            .map(|(level, at)| light(grid.between(level, at)))
            .collect();
    }
    let all = grid.between_in_brick(lvoxels[0].level, brick(&lvoxels[0]));
    let place = |(level, at): (u8, [usize; 3])| {
        let edge = 1 << (MAX_LEVEL - level);
        let [x, y, z] = at.map(|v| v % edge);
        light(all[(z * edge + y) * edge + x])
    };
    cells.map(place).collect()
}

/// Light of the environment that travels along each direction and against it: the mean of all that
/// comes from nearer to that way than to any other.
fn from_outside(
    environment: Environment,
    directions: &[Vec3; DIRECTIONS],
) -> [[Light; 2]; DIRECTIONS] {
    const SAMPLES: u64 = 1 << 16;
    let mut sums = [[Light::ZERO; 2]; DIRECTIONS];
    for i in 0..SAMPLES {
        let from = sampling::sphere(sampling::r2(i, [0.5; 2]));
        let along = directions.map(|d| d.dot(-from));
        let nearest = (0..DIRECTIONS).max_by(|&a, &b| along[a].abs().total_cmp(&along[b].abs()));
        let nearest = nearest.unwrap_or(0);
        let is_against = usize::from(along[nearest] < 0.0);
        sums[nearest][is_against] += Light::from(environment.radiance(from).0);
    }
    let share = 2.0 * DIRECTIONS as f32 / SAMPLES as f32;
    sums.map(|both| both.map(|sum| sum * share))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;
    use crate::tree::Media;
    use glam::DAffine3;

    #[test]
    fn means_are_kept_up_to_a_hard_edge() {
        let volumes = [VolumeInfo {
            name: String::new(),
            dims: [12, 8, 8],
            index_from_scene: DAffine3::IDENTITY.to_cols_array_2d(),
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        }];
        // A row of single voxels, and one twice as wide behind them; light rises along it.
        let lvoxel = |level, block| Lvoxel {
            level,
            block,
            sigma_t: 1.0,
            ..Lvoxel::default()
        };
        let mut lvoxels: Vec<Lvoxel> = (0..8).map(|x| lvoxel(0, [x, 0, 0])).collect();
        lvoxels.push(lvoxel(1, [4, 0, 0]));
        let arriving = [0.5, 0.68, 0.78, 0.84, 0.88, 0.91, 0.93, 0.95, 0.97].map(Light::splat);
        let off = |light: &[Light]| {
            let mut lvoxels = lvoxels.clone();
            for (l, light) in lvoxels.iter_mut().zip(light) {
                l.incident = light.to_array();
            }
            let media = Media::new(&volumes, lvoxels.iter().copied());
            let grid = media.incident(0).unwrap();
            let off = lvoxels.iter().zip(arriving).map(|(l, arriving)| {
                let Rgb([light, ..]) = grid.between(l.level, l.block.map(usize::from)).unwrap();
                (light - arriving.x).abs()
            });
            off.fold(0.0, f32::max)
        };
        let mut light = arriving;
        assert!(off(&light) > 0.04);
        keep_means_of(&volumes, &mut lvoxels.clone(), &mut light);
        assert!(off(&light) < 0.015, "{}", off(&light));
    }

    #[test]
    fn light_of_a_sky_goes_to_the_directions_that_are_nearest_and_none_is_lost() {
        for set in 0..SETS {
            let even = Environment::even(Rgb([1.0, 2.0, 4.0]));
            let light = from_outside(even, &lattice::directions(set));
            for light in light.as_flattened() {
                let off = *light / Light::new(1.0, 2.0, 4.0) - 1.0;
                assert!(off.abs().max_element() < 0.015, "{light}");
            }
            let sum: Light = light.as_flattened().iter().sum();
            assert!((sum.x / 24.0 - 1.0).abs() < 1e-5, "{sum}");
        }
    }
}
