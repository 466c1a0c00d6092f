//! Blocks of medium, walked in the volume's own index space, each with its mean extinction and its source function.

use crate::light::{Lights, ShadowRays};
use crate::math::{Rgb, sampling};
use crate::scene::{Grid, Volume};
use glam::{DVec3, Vec3};
use lvox_formats::record::{Lvoxel, MAX_LEVEL};

/// Edge of the brick in which all blocks have one size, voxels.
pub const BRICK: usize = 1 << MAX_LEVEL;

/// How large blocks are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlockSize {
    /// The largest whose optical depth along an edge stays below this: the error of transmittance follows the depth of
    /// a block, not its size in voxels.
    OpticalDepth(f32),
    /// The paper's: a fixed number of voxels (1, 2, 4 or 8) a side with so many coefficient samples in each block.
    Fixed {
        /// log2 of the voxels a side.
        level: u8,
        /// Coefficient samples a block.
        samples: u32,
    },
}

/// Makes the lvoxels of one volume, brick by brick.
#[derive(Debug)]
pub struct LvoxelMaker<'a> {
    /// The medium.
    pub volume: &'a Volume,
    /// Its index in the scene.
    pub index: u16,
    /// Light at its blocks.
    pub lights: &'a Lights<'a>,
    /// Size of blocks.
    pub size: BlockSize,
    /// Shadow rays to each area light.
    pub shadow_rays: u32,
    /// Key of the bake.
    pub seed: u64,
}

impl LvoxelMaker<'_> {
    /// Bricks per axis.
    #[must_use]
    pub fn bricks(&self) -> [usize; 3] {
        self.volume.sigma_t.dims().map(|n| n.div_ceil(BRICK))
    }

    /// All non-empty blocks of the brick at brick coordinates `b`.
    #[must_use]
    pub fn make(&self, b: [usize; 3]) -> Vec<Lvoxel> {
        let grid = &self.volume.sigma_t;
        let max = brick_max(grid, b);
        if max == 0.0 {
            return Vec::new();
        }
        let level = match self.size {
            BlockSize::Fixed { level, .. } => level,
            BlockSize::OpticalDepth(limit) => {
                let voxel = self.volume.longest_voxel_edge();
                let max = if max * voxel * BRICK as f32 <= limit {
                    max
                } else {
                    near_max(grid, b)
                };
                (0..=MAX_LEVEL)
                    .rev()
                    .find(|&l| max * voxel * (1 << l) as f32 <= limit)
                    .unwrap_or(0)
            }
        };
        let edge = 1_usize << level;
        let per_axis = BRICK / edge;
        let dims = grid.dims();
        let mut out = Vec::new();
        for i in 0..per_axis * per_axis * per_axis {
            let local = [
                i % per_axis,
                i / per_axis % per_axis,
                i / (per_axis * per_axis),
            ];
            let block: [usize; 3] = std::array::from_fn(|a| b[a] * per_axis + local[a]);
            if (0..3).any(|a| block[a] * edge >= dims[a]) {
                continue;
            }
            let (mean, centroid) = self.coefficients(block, edge);
            if mean > 0.0 {
                let point = self
                    .volume
                    .scene_from_index
                    .transform_point3(centroid)
                    .as_vec3();
                let key = [
                    self.seed,
                    u64::from(self.index),
                    block[0] as u64,
                    block[1] as u64,
                    block[2] as u64,
                ];
                let sequence = |per_light| ShadowRays::Sequence {
                    per_light,
                    first: 0,
                    seed: sampling::hash(&key),
                };
                let (rays, all_round) =
                    (sequence(self.shadow_rays), sequence(4 * self.shadow_rays));
                let light = self.lights.mean_radiance(point, rays).light()
                    + self.lights.environment_mean_radiance(point, all_round);
                out.push(Lvoxel {
                    volume: self.index,
                    level,
                    block: block.map(|v| v as u16),
                    sigma_t: mean,
                    source: (Rgb(self.volume.albedo) * light).0,
                });
            }
        }
        out
    }

    /// Mean extinction of the part of a block that is inside the grid, and the extinction-weighted mean of its points in
    /// index space.
    fn coefficients(&self, block: [usize; 3], edge: usize) -> (f32, DVec3) {
        let base = Vec3::from(block.map(|v| (v * edge) as f32));
        let dims = self.volume.sigma_t.dims();
        // Voxels of the block inside the grid, on each axis.
        let inside: [usize; 3] = std::array::from_fn(|a| edge.min(dims[a] - block[a] * edge));
        let (mut sum, mut moment) = (0.0_f64, DVec3::ZERO);
        let mut add = |offset: Vec3| {
            let sigma = f64::from(self.volume.sigma_t.sample(base + offset));
            sum += sigma;
            moment += (base + offset).as_dvec3() * sigma;
        };
        let count = match self.size {
            BlockSize::OpticalDepth(_) => {
                // Two points a voxel on each axis: between them and the knees at voxel centres and borders the
                // trilinear field is linear, so their mean is the block's exact mean.
                let [x, y, z] = inside.map(|n| 2 * n);
                for i in 0..x * y * z {
                    let at = [i % x, i / x % y, i / (x * y)].map(|k| (k as f32 + 0.5) * 0.5);
                    add(Vec3::from(at));
                }
                x * y * z
            }
            BlockSize::Fixed { samples, .. } => {
                let key =
                    sampling::hash(&[self.seed, block[0] as u64, block[1] as u64, block[2] as u64]);
                for i in 0..samples {
                    let u = sobol_burley::sample_4d(i, 0, key as u32);
                    add(Vec3::new(u[0], u[1], u[2]) * Vec3::from(inside.map(|n| n as f32)));
                }
                samples.max(1) as usize
            }
        };
        let mean = (sum / count as f64) as f32;
        (
            mean,
            if sum > 0.0 {
                moment / sum
            } else {
                base.as_dvec3()
            },
        )
    }
}

/// No sample that the field inside a brick of voxels depends on is above this.
fn brick_max(grid: &Grid, b: [usize; 3]) -> f32 {
    // Voxels 8b..8b+8 lie in cells 8b..=8b+8 of the grid's bricks, which are shifted by half a voxel.
    let bricks = grid.brick_dims();
    let mut max = 0.0_f32;
    for corner in 0..8 {
        let at: [usize; 3] = std::array::from_fn(|a| b[a] + (corner >> a & 1));
        if (0..3).all(|a| at[a] < bricks[a])
            && let Some(brick) = grid.brick(at)
        {
            max = max.max(brick.max);
        }
    }
    max
}

/// The largest sample that the field inside a brick of voxels depends on.
fn near_max(grid: &Grid, b: [usize; 3]) -> f32 {
    const N: usize = BRICK + 2;
    let dims = grid.dims();
    (0..N * N * N)
        .map(|i| {
            let local = [i % N, i / N % N, i / (N * N)];
            let voxel: [usize; 3] = std::array::from_fn(|a| {
                (b[a] * BRICK + local[a]).saturating_sub(1).min(dims[a] - 1)
            });
            grid.sample(Vec3::from(voxel.map(|v| v as f32 + 0.5)))
        })
        .fold(0.0, f32::max)
}
