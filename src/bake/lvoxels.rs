//! Blocks of medium, walked in the volume's own index space, each with its mean extinction and its
//! source function.

use super::brick::{BRICK_EDGE, Block, BrickField};
use super::cover::Cover;
use crate::light::{KeptLight, Lights, SceneMedia, ShadowRays, VoxelLight};
use crate::math::exp::{exp_neg, one_minus_exp_neg};
use crate::math::{Rgb, Spectrum, sampling, unflatten};
use crate::run::Cancel;
use crate::scene::{Grid, Volume};
use crate::{Error, Result};
use glam::{DVec3, Vec3};
use lvox_formats::record::{Lvoxel, MAX_LEVEL};
use std::cell::LazyCell;
use std::ops::{AddAssign, Mul};
use std::sync::Arc;

const _: () = assert!(BRICK_EDGE == VoxelLight::<f32>::VOXELS);

/// Optical depth of an edge above which a block is not lit at one point, unless the block depth
/// allows more.
const MAX_DEPTH_LIT_AT_ONE_POINT: f32 = 0.7;
/// Rays into each face of a block that is too deep to be lit at one point.
const FACE_RAYS: u32 = 8;
/// Steps in which the depth of such a block is summed.
const DEPTH_STEPS: usize = 8;
/// Share of a ray's light from a block below which it is left out.
const MIN_RAY_WEIGHT: f32 = 1e-2;

/// The size of the blocks that media are divided into.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BlockSize {
    /// The largest that no surface cuts and whose optical depth along an edge stays below this: the
    /// error of transmittance follows the depth of a block, not its size in voxels.
    OpticalDepth(f32),
    /// The paper's: a fixed number of voxels (1, 2, 4 or 8) a side with so many coefficient samples
    /// in each block.
    Fixed {
        /// log2 of the voxels a side.
        level: u8,
        /// Coefficient samples a block.
        samples: u32,
    },
}

/// Blocks on each axis that files can number: their coordinates have 16 bits.
const MAX_BLOCKS_ALONG: usize = 1 << 16;

impl BlockSize {
    /// Refuses a volume that has more blocks along an axis than files can number.
    ///
    /// # Errors
    /// [`crate::Kind::Input`], with the volume, its size, the limit and blocks that would do.
    pub fn check(self, volume: &Volume) -> Result<()> {
        let dims = volume.sigma_t.dims();
        let fits = |level: u8| {
            dims.iter()
                .all(|n| n.div_ceil(1 << level) <= MAX_BLOCKS_ALONG)
        };
        let (least, blocks) = match self {
            // Depth may ask for single voxels anywhere.
            Self::OpticalDepth(_) => (0, "`block_depth` may make blocks of 1 voxel".into()),
            Self::Fixed { level, .. } => (level, format!("`block_voxels` is {}", 1 << level)),
        };
        if fits(least) {
            return Ok(());
        }
        let error = Error::input(format!(
            "the volume `{}` of {} x {} x {} voxels has more than {MAX_BLOCKS_ALONG} blocks along \
             an axis, the most that a cloud can number ({blocks})",
            volume.name, dims[0], dims[1], dims[2]
        ));
        Err(match (least..=MAX_LEVEL).find(|&level| fits(level)) {
            Some(level) => error.hint(format!(
                "use `block_voxels` {}, resample the volume, or cut it in two",
                1 << level
            )),
            None => error.hint("resample the volume, or cut it into parts"),
        })
    }
}

/// Light that arrives in a medium.
#[derive(Clone, Copy, Debug, Default)]
struct Arriving {
    /// Mean over the sphere of the radiance.
    light: Rgb,
    /// The same of its mean channel times the direction in which it travels; 0 where nobody asks.
    way: Vec3,
}

impl Arriving {
    /// The lobe of what a medium scatters of it whose phase function has this mean cosine: that of
    /// the phase function if all light comes from one side, and wider if it does not.
    fn lobe(self, mean_cosine: f32) -> [i8; 3] {
        /// Rounding must not make a lobe longer than it may be.
        const LONGEST: f32 = 125.0;
        let mean = self.light.mean();
        if mean <= 0.0 || mean_cosine == 0.0 {
            return [0; 3];
        }
        let lobe = self.way * (Lvoxel::LOBE_ONE * mean_cosine / mean);
        let lobe = lobe.clamp_length_max(LONGEST).round().to_array();
        lobe.map(|c| c as i8)
    }
}

impl AddAssign for Arriving {
    fn add_assign(&mut self, o: Self) {
        self.light += o.light;
        self.way += o.way;
    }
}

impl Mul<f32> for Arriving {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        Self {
            light: self.light * s,
            way: self.way * s,
        }
    }
}

/// Makes the lvoxels of one volume, brick by brick.
#[derive(Debug)]
pub struct LvoxelMaker<'a, K> {
    /// The volume whose extinction is averaged over blocks.
    pub volume: &'a Volume,
    /// Its index in the scene.
    pub index: u16,
    /// Light at its blocks.
    pub lights: &'a Lights<'a, SceneMedia<'a, K>>,
    /// Light of suns and skies that was kept beforehand.
    pub kept: &'a KeptLight<'a>,
    /// How deep its voxels lie in media, where that tells how many rays they need.
    pub cover: Option<Arc<Cover>>,
    /// Voxels a side of blocks: everywhere the same, or by optical depth.
    pub size: BlockSize,
    /// Shadow rays to each area light.
    pub shadow_rays: u32,
    /// Key of the bake.
    pub seed: u64,
}

impl<K: Spectrum> LvoxelMaker<'_, K> {
    /// Bricks along x, y, z that cover the volume.
    #[must_use]
    pub fn bricks(&self) -> [usize; 3] {
        self.volume.sigma_t.dims().map(|n| n.div_ceil(BRICK_EDGE))
    }

    /// About how many lvoxels the brick at brick coordinates `b` has: more where surfaces cut it,
    /// fewer where blocks are empty. 0 of an empty brick, and of no other.
    #[must_use]
    pub fn expected(&self, b: [usize; 3]) -> u32 {
        let max = brick_max(&self.volume.sigma_t, b);
        if max == 0.0 {
            return 0;
        }
        let depth = max * self.volume.longest_voxel_edge();
        let level = match self.size {
            BlockSize::Fixed { level, .. } => level,
            BlockSize::OpticalDepth(limit) => (1..=MAX_LEVEL)
                .rev()
                .find(|&l| depth * (1 << l) as f32 <= limit)
                .unwrap_or(0),
        };
        1 << (3 * (MAX_LEVEL - level))
    }

    /// Makes the lvoxels of the non-empty blocks of the brick at brick coordinates `b`.
    ///
    /// # Errors
    /// If cancelled.
    pub fn make(&self, b: [usize; 3], cancel: &Cancel) -> Result<Vec<Lvoxel>> {
        let grid = &self.volume.sigma_t;
        let max = brick_max(grid, b);
        if max == 0.0 {
            return Ok(Vec::new());
        }
        let field = BrickField::new(grid, b);
        let level = self.level(b, max, &field);
        let edge = 1_usize << level;
        let per_axis = BRICK_EDGE / edge;
        let dims = grid.dims();
        let in_voxels = || {
            let first = b.map(|n| n * BRICK_EDGE);
            VoxelLight::new(self.lights, self.kept, self.volume, first)
        };
        let in_voxels = LazyCell::new(in_voxels);
        let mut out = Vec::new();
        for i in 0..per_axis * per_axis * per_axis {
            // A deep block takes dozens of rays through the whole volume.
            cancel.check()?;
            let local = unflatten(i, [per_axis; 3]);
            let block: [usize; 3] = std::array::from_fn(|a| b[a] * per_axis + local[a]);
            if (0..3).any(|a| block[a] * edge >= dims[a]) {
                continue;
            }
            let part = Block {
                first: local.map(|n| n * edge),
                dims: std::array::from_fn(|a| edge.min(dims[a] - block[a] * edge)),
            };
            let (mean, sampled) = match self.size {
                BlockSize::OpticalDepth(_) => (field.mean(&part), None),
                BlockSize::Fixed { samples, .. } => self.sampled(block, edge, samples),
            };
            if mean > 0.0 {
                let centroid = || {
                    let first = DVec3::from(b.map(|n| (n * BRICK_EDGE) as f64));
                    sampled.unwrap_or_else(|| first + field.centroid(&part).unwrap_or_default())
                };
                let key = [
                    self.seed,
                    u64::from(self.index),
                    block[0] as u64,
                    block[1] as u64,
                    block[2] as u64,
                ];
                let seed = sampling::hash(&key);
                let from_outside = match self.size {
                    BlockSize::OpticalDepth(limit)
                        if mean * self.volume.longest_voxel_edge() * edge as f32
                            > limit.max(MAX_DEPTH_LIT_AT_ONE_POINT) =>
                    {
                        let known = (edge == 1).then(|| in_voxels.as_ref()).flatten();
                        let known = known.map(|light| (light, local));
                        let in_brick = (edge == 1).then_some((&field, local));
                        self.light_from_outside(block, edge, seed, in_brick, known)
                    }
                    _ => None,
                };
                let over = || match self.size {
                    BlockSize::OpticalDepth(_) => self.light_over(block, edge, seed),
                    BlockSize::Fixed { .. } => None,
                };
                let light = from_outside.or_else(over);
                let light = light.unwrap_or_else(|| {
                    let all_round = self.rays_all_round(block.map(|c| c * edge));
                    self.light_at(centroid(), 0, [1, all_round], seed)
                });
                let mean_cosine = self.volume.phase.moment(1);
                out.push(Lvoxel {
                    incident: [0.0; 3],
                    single: Default::default(),
                    volume: self.index,
                    level,
                    block: block.map(|v| v as u16),
                    sigma_t: mean,
                    source: (self.volume.mean_albedo(block.map(|b| b * edge), edge) * light.light)
                        .0,
                    lobe: light.lobe(mean_cosine),
                });
            }
        }
        Ok(out)
    }

    /// Log2 of the voxels along an edge of the blocks of a brick with no sample above `max`.
    fn level(&self, b: [usize; 3], max: f32, field: &BrickField) -> u8 {
        /// Light bends where the albedo steps, and larger blocks blur that.
        const SHARE_AT_STEPS: f32 = 0.5;
        let limit = match self.size {
            BlockSize::Fixed { level, .. } => return level,
            BlockSize::OpticalDepth(limit) => limit,
        };
        let first = b.map(|n| n * BRICK_EDGE);
        let limit = if self.volume.has_albedo_step(first, BRICK_EDGE) {
            limit * SHARE_AT_STEPS
        } else {
            limit
        };
        let voxel = self.volume.longest_voxel_edge();
        let max = if max * voxel * BRICK_EDGE as f32 <= limit {
            max
        } else {
            field.max
        };
        (1..=MAX_LEVEL)
            .rev()
            .filter(|&l| max * voxel * (1 << l) as f32 <= limit)
            .find(|&l| !self.is_cut(b, l))
            .unwrap_or(0)
    }

    /// Rays to an environment from a voxel, for one to each area light: where little light gets
    /// out, little of it is ever seen.
    fn rays_all_round(&self, voxel: [usize; 3]) -> u32 {
        /// Depths from which on one ray of two, and of four, is left.
        const DEEP: [f32; 2] = [1.5, 3.0];
        let depth = self.cover.as_ref().map_or(0.0, |cover| cover.at(voxel));
        4 >> DEEP.into_iter().filter(|d| depth >= *d).count()
    }

    /// In-scattered light at a point of index space, by the rays of an index in a sequence: so many
    /// times those of the bake to each area light, and to the environment.
    fn light_at(&self, at: DVec3, index: u32, times: [u32; 2], seed: u64) -> Arriving {
        let point = self.volume.scene_from_index.transform_point3(at).as_vec3();
        let [rays, all_round] = times.map(|n| {
            let per_light = n * self.shadow_rays;
            ShadowRays::Sequence {
                per_light,
                first: index * per_light,
                seed,
            }
        });
        if self.volume.phase.is_isotropic() {
            let lights = self.lights;
            return Arriving {
                light: lights.mean_radiance_by_kept(point, rays, all_round, self.kept),
                way: Vec3::ZERO,
            };
        }
        let (light, way) = (self.lights).directed_by_kept(point, rays, all_round, self.kept);
        Arriving { light, way }
    }

    /// Mean in-scattered light of a block at several points, by the extinction there. One would
    /// tell of a whole block that it is in a shaft of light, or beside it. `None` where one is
    /// enough, and without extinction at any.
    fn light_over(&self, block: [usize; 3], edge: usize, seed: u64) -> Option<Arriving> {
        /// Points in a volume whose voxels are so few that each is as wide as shafts of light are.
        const POINTS_IN_ALL: usize = 1 << 16;
        const MAX_POINTS_IN_VOXEL: usize = 64;
        /// In a block of several voxels, of which each two differ along two axes.
        const POINTS_IN_BLOCK: [[f64; 3]; 4] = [
            [0.25, 0.25, 0.25],
            [0.25, 0.75, 0.75],
            [0.75, 0.25, 0.75],
            [0.75, 0.75, 0.25],
        ];
        let voxels = self.volume.sigma_t.dims().iter().product::<usize>();
        let count = match edge {
            1 if self.lights.has_sharp_shadows() => {
                (POINTS_IN_ALL / voxels).min(MAX_POINTS_IN_VOXEL)
            }
            1 => 1,
            _ => POINTS_IN_BLOCK.len(),
        };
        if count <= 1 {
            return None;
        }
        let place = |i: u32| {
            if edge > 1 {
                return POINTS_IN_BLOCK[i as usize];
            }
            let [x, y, z, _] = sobol_burley::sample_4d(i, 1, seed as u32);
            [x, y, z].map(f64::from)
        };
        let (mut sum, mut weights) = (Arriving::default(), 0.0);
        for i in 0..count as u32 {
            let local = DVec3::from(place(i));
            let at = (DVec3::from(block.map(|v| v as f64)) + local) * edge as f64;
            let sigma_t = self.volume.sigma_t.sample(at.as_vec3());
            if sigma_t > 0.0 {
                sum += self.light_at(at, i, [1, 1], seed) * sigma_t;
                weights += sigma_t;
            }
        }
        (weights > 0.0).then(|| sum * (1.0 / weights))
    }

    /// Whether surfaces are in a block of a brick, if blocks have this level: on their other side
    /// there may be other light.
    fn is_cut(&self, b: [usize; 3], level: u8) -> bool {
        let (edge, per_axis) = (f64::from(1 << level), BRICK_EDGE >> level);
        let to_scene = |p: DVec3| self.volume.scene_from_index.transform_point3(p).as_vec3();
        let tracer = self.lights.tracer();
        let blocks = (0..per_axis.pow(3)).map(|i| unflatten(i, [per_axis; 3]));
        blocks
            .map(|local| [0, 1, 2].map(|a| ((b[a] * per_axis + local[a]) as f64 + 0.5) * edge))
            .map(DVec3::from)
            .any(|centre| {
                let from = to_scene(centre);
                (0..8).any(|corner| {
                    let side = [0, 1, 2].map(|a| f64::from(corner >> a & 1) - 0.5);
                    tracer.is_between(from, to_scene(centre + edge * DVec3::from(side)))
                })
            })
    }

    /// Mean in-scattered light of a block that is too deep to be lit at one point, as rays see it
    /// that enter through a face from outside at any angle; a face counts by what the medium before
    /// it lets through. `None` if that is next to nothing. A block that is a voxel is `in_brick` in
    /// the field of that, where light may be `known`, too.
    fn light_from_outside(
        &self,
        block: [usize; 3],
        edge: usize,
        seed: u64,
        in_brick: Option<(&BrickField, [usize; 3])>,
        known: Option<(&VoxelLight<K>, [usize; 3])>,
    ) -> Option<Arriving> {
        if known.is_some_and(|(light, voxel)| light.is_dark(voxel)) {
            return Some(Arriving::default());
        }
        let axes = self.volume.scene_from_index.matrix3;
        // Of a voxel: the areas of its faces, and its thickness between each two.
        let areas: [f64; 3] = std::array::from_fn(|a| {
            let (b, c) = ((a + 1) % 3, (a + 2) % 3);
            axes.col(b).cross(axes.col(c)).length()
        });
        let thickness = areas.map(|area| (axes.determinant().abs() / area) as f32);
        let edge = edge as f32;
        let sigma_t = |p: [f32; 3]| self.volume.sigma_t.sample(Vec3::from(p));
        let (mut sum, mut weights) = (Arriving::default(), 0.0);
        for i in 0..6 * FACE_RAYS {
            let (a, upper) = (i as usize % 3, i as usize / 3 % 2);
            let [u, v, slant, share] = sobol_burley::sample_4d(i / 6, i % 6, seed as u32);
            let (face, inward) = if upper == 1 {
                ((block[a] + 1) as f32 * edge, -edge)
            } else {
                (block[a] as f32 * edge, edge)
            };
            // At a depth from the face, in block edges; negative before it.
            let at = |depth: f32| {
                let mut p = [0.0; 3];
                p[a] = face + inward * depth;
                for (b, offset) in [((a + 1) % 3, u), ((a + 2) % 3, v)] {
                    p[b] = (block[b] as f32 + offset) * edge;
                }
                p
            };
            // Faces are seen by the cosine.
            let length = edge * thickness[a] / slant.sqrt().max(1e-3);
            let before = 0.5 * length * (sigma_t(at(-0.25)) + sigma_t(at(-0.75)));
            let through = exp_neg(before);
            if through < MIN_RAY_WEIGHT {
                continue;
            }
            let step = 1.0 / DEPTH_STEPS as f32;
            let middle = |k: usize| (k as f32 + 0.5) * step;
            let depths: [f32; DEPTH_STEPS] = match in_brick {
                None => std::array::from_fn(|k| sigma_t(at(middle(k))) * length * step),
                Some((field, voxel)) => {
                    let column = field.column(voxel, a, [u, v]);
                    let place = |depth: f32| if upper == 1 { 1.0 - depth } else { depth };
                    std::array::from_fn(|k| column.at(place(middle(k))) * length * step)
                }
            };
            let taken = one_minus_exp_neg(depths.iter().sum());
            let seen = through * taken;
            if seen < MIN_RAY_WEIGHT {
                continue;
            }
            let weight = seen * (areas[a] / areas.iter().sum::<f64>()) as f32;
            // The place behind which this share of what the ray sees comes from.
            let mut target = -libm::log1pf(-share * taken);
            let k = depths.iter().position(|&d| {
                let here = target <= d;
                if !here {
                    target -= d;
                }
                here
            });
            let k = k.unwrap_or(DEPTH_STEPS - 1);
            let within = if depths[k] > 0.0 {
                (target / depths[k]).min(1.0)
            } else {
                0.5
            };
            let point = at((k as f32 + within) * step);
            let light = match known {
                Some((known, voxel)) => {
                    let place = [0, 1, 2].map(|a| point[a] - block[a] as f32);
                    let (light, way) = known.at(voxel, place);
                    Arriving { light, way }
                }
                None => self.light_at(DVec3::from(point.map(f64::from)), i, [1, 1], seed),
            };
            sum += light * weight;
            weights += weight;
        }
        (weights > 0.0).then(|| sum * (1.0 / weights))
    }

    /// Mean extinction of the part of a block that is inside the grid, and the extinction-weighted
    /// mean of its points in index space, by so many of them; of no points without extinction.
    fn sampled(&self, block: [usize; 3], edge: usize, samples: u32) -> (f32, Option<DVec3>) {
        let base = Vec3::from(block.map(|v| (v * edge) as f32));
        let dims = self.volume.sigma_t.dims();
        // Voxels of the block inside the grid, on each axis.
        let inside: [usize; 3] = std::array::from_fn(|a| edge.min(dims[a] - block[a] * edge));
        let (mut sum, mut moment) = (0.0_f64, DVec3::ZERO);
        let key = sampling::hash(&[
            self.seed ^ u64::from(self.index) << 48,
            block[0] as u64,
            block[1] as u64,
            block[2] as u64,
        ]);
        for i in 0..samples {
            let [x, y, z, _] = sobol_burley::sample_4d(i, 0, key as u32);
            let at = base + Vec3::new(x, y, z) * Vec3::from(inside.map(|n| n as f32));
            let sigma = f64::from(self.volume.sigma_t.sample(at));
            sum += sigma;
            moment += at.as_dvec3() * sigma;
        }
        let mean = (sum / f64::from(samples.max(1))) as f32;
        (mean, (sum > 0.0).then(|| moment / sum))
    }
}

/// No sample that the field inside a brick of voxels depends on is above this.
fn brick_max(grid: &Grid, b: [usize; 3]) -> f32 {
    // Voxels 8b..8b+8 lie in cells 8b..=8b+8 of the grid's bricks, which are shifted by half a
    // voxel.
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
