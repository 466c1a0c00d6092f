//! Indirect light in media by discrete ordinates (Chandrasekhar 1950): along each of a few dozen
//! directions, parallel rays pass the whole volume once and leave at the vertices beside them what
//! the medium sends and what it lets through.
//!
//! A ray on its own serves one vertex, a swept one serves all on its way. Surfaces beyond the
//! medium come from the probes of the far field, at each vertex, so that they keep their parallax.
//!
//! A lone medium is swept layer by layer of cells (`layered`, `cells`), all rays of a direction at
//! once, and so is a thin one with others on its grid alone; one with surfaces or other media in
//! its box ray by ray through its lvoxels (`rays`), whose rows `rows` interpolates. `weights` tell
//! what of each direction's light a phase function scatters towards the camera.

mod cells;
mod layered;
mod rays;
mod rows;
mod weights;

use super::bricks::BrickTable;
use super::counts::{self, Counters};
use super::far_field::{FarField, Surroundings};
use super::gatherer::GatherInMedia;
use super::spacing::LeastSpacing;
use super::sparse::{SparseLattice, SparseValues};
use super::{memory, occupied, walls};
use crate::Result;
use crate::math::{Aabb, Ray, Rgb, Spectrum};
use crate::run::Job;
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use crate::view::{View, VisibleMedia};
use glam::Vec3;
use layered::LayeredSweep;
use rayon::prelude::*;
use rays::SweepRays;
use rows::Arriving;
use weights::{Look, ScatteringWeights};

/// Indirect light at the vertices of one volume that rays may ask for.
#[derive(Debug)]
pub struct Sweep {
    levels: SweptLevels,
    /// Which of them serves a brick.
    level_of: BrickTable<Option<u8>>,
    /// Whether a lone medium was swept, layer by layer.
    pub in_layers: bool,
}

/// Means over the sphere of the radiance at vertices, by log2 of the voxels between them; `None`
/// where surfaces are too near for probes.
pub type SweptLevels = [Option<SparseValues<Option<Rgb>>>; SWEPT_LEVELS];

/// Spacings of 1 to 128 voxels.
pub const SWEPT_LEVELS: usize = 8;

/// Of those, spacings that vertices of thin media have whatever camera looks.
const NEAR_LEVELS: usize = 4;

/// Vertices of one spacing, to be swept.
struct LevelSweep;

/// Boxes around all media of a scene, and around the swept volume.
struct MediaBox {
    bounds: Aabb,
    own: Aabb,
    /// Whether surfaces may stand in it.
    has_walls: bool,
}

/// What a sweep looks at.
pub struct SweepScope<'a, G> {
    /// Camera and scene.
    pub view: &'a View<'a>,
    /// The part of the volume that has to be lit.
    pub visible: VisibleMedia<'a>,
    /// Media and surfaces.
    pub gatherer: &'a G,
    /// Which of the scene's volumes.
    pub volume: &'a Volume,
    /// What is around it.
    pub far_field: &'a FarField,
    /// For cancelling, and for the memory limit.
    pub job: &'a Job,
    /// What it takes.
    pub counters: &'a Counters,
}

impl Sweep {
    /// Pixels around a region from which corners may look.
    pub const MARGIN_PIXELS: f32 = 4.0;
    /// Directions that are held in memory together.
    const DIRECTIONS_TOGETHER: u32 = 8;

    /// Optical depth between vertices, at most.
    const MAX_SWEPT_DEPTH: f32 = 1.4;
    /// The same where each voxel has a vertex: deeper ones are lit at points of each ray.
    const MAX_VOXEL_DEPTH: f32 = 2.0;

    /// Tells of a volume that was swept beforehand which vertices serve a brick, without their
    /// light. `depth_of` is that of [`Self::new`].
    pub fn made_beforehand(
        volume: &Volume,
        is_alone: bool,
        depth_of: impl Fn([usize; 3], f32) -> f32,
    ) -> Self {
        let grid = &volume.sigma_t;
        let level_of = BrickTable::new(grid, |b| {
            Some(Self::level(depth_of(b, grid.brick(b)?.max), 0)? as u8)
        });
        Self {
            levels: SweptLevels::default(),
            level_of,
            in_layers: is_alone,
        }
    }

    /// Sweeps the bricks of a volume that matter, but those where a single voxel is too deep;
    /// `depth_of(brick, own)` is the optical depth that counts for one, other media considered,
    /// given the largest extinction of this one; infinite where nothing is to be swept.
    ///
    /// # Errors
    /// If cancelled, or if that takes more than the memory limit by itself.
    pub fn new<G: GatherInMedia>(
        scope: &SweepScope<G>,
        least: &LeastSpacing,
        depth_of: impl Fn([usize; 3], f32) -> f32,
    ) -> Result<Self> {
        let grid = &scope.volume.sigma_t;
        let mut needed: [Vec<[usize; 3]>; SWEPT_LEVELS] = Default::default();
        let is_opaque = scope.is_opaque();
        // Of all bricks, seen or not: what depends on it must not depend on the region.
        let (mut coarsest, mut densest) = (0, 0.0_f32);
        let level_of = BrickTable::new(grid, |b| {
            let own = grid.brick(b)?.max;
            let level = Self::level(depth_of(b, own), least.of(b))?;
            coarsest = coarsest.max(level);
            densest = densest.max(own);
            scope.may_see(b, is_opaque).then(|| {
                needed[level].push(b);
                level as u8
            })
        });
        let sets: [_; SWEPT_LEVELS] = std::array::from_fn(|level| {
            let bricks = &needed[level];
            (!bricks.is_empty()).then(|| scope.vertices(bricks, 1 << level))
        });
        let bounds = scope.view.tracer.media_bounds();
        let media = MediaBox {
            bounds,
            own: scope.volume.bounds(),
            has_walls: walls::are_within(&scope.view.tracer.scene.mesh, bounds),
        };
        let is_layered = |level: usize| {
            LayeredSweep::is_for(scope, &media, densest) && LayeredSweep::serves(scope, 1 << level)
        };
        let of_levels = || sets.iter().enumerate();
        let count = |set: &Option<SparseLattice>| set.as_ref().map_or(0, |s| s.len() as u64);
        let vertices: u64 = sets.iter().map(count).sum();
        let in_layers = of_levels().filter(|(level, _)| is_layered(*level));
        let in_layers: u64 = in_layers.map(|(_, set)| count(set)).sum();
        let by_rays = of_levels().filter(|(level, _)| !is_layered(*level));
        let by_rays = by_rays.filter_map(|(level, set)| {
            let set = set.as_ref()?;
            let rays = LevelSweep::bytes_of_rays(scope, set, 1 << level);
            let a_vertex = LevelSweep::bytes_of_vertex::<G::Share>();
            Some(rays.saturating_add(a_vertex * set.len() as u64))
        });
        let by_layers = match in_layers {
            0 => 0,
            _ => LayeredSweep::bytes(scope, 1 << coarsest, in_layers),
        };
        memory::check_sweep(
            scope.volume,
            scope.visible,
            vertices,
            (by_rays.max().unwrap_or(0))
                .max(by_layers)
                .saturating_add(LevelSweep::BYTES_A_VERTEX * vertices),
            scope.job,
        )?;
        let layered = (in_layers > 0)
            .then(|| LayeredSweep::new(scope, 1 << coarsest))
            .flatten();
        let mut levels = [const { None }; SWEPT_LEVELS];
        let are_layers = |level: usize| layered.is_some() && is_layered(level);
        // Of all levels together: each part of the tree is asked for once.
        let places = of_levels().filter(|(level, _)| !are_layers(*level));
        let places = places.flat_map(|(level, set)| {
            let vertices = set.iter().flat_map(SparseLattice::vertices);
            vertices.map(move |v| to_index(v, 1 << level))
        });
        (scope.far_field).foresee(scope.volume, scope.gatherer, places);
        let (mut numbers, mut together) = (Vec::new(), Vec::new());
        for (level, set) in sets.into_iter().enumerate() {
            let Some(set) = set else {
                continue;
            };
            if are_layers(level) {
                numbers.push(level);
                together.push((1 << level, set));
            } else {
                levels[level] = Some(LevelSweep::sweep(scope, set, 1 << level, &media)?);
            }
        }
        if let Some(layered) = layered {
            for (level, swept) in numbers.into_iter().zip(layered.sweep(together)?) {
                levels[level] = Some(swept);
            }
        }
        scope.job.held.set_for_now(0);
        Ok(Self {
            levels,
            level_of,
            in_layers: is_layered(coarsest),
        })
    }

    /// Log2 of the voxels between the vertices of a brick whose densest voxel has this optical
    /// depth, and whose vertices are to be so far apart at least; `None` if it is too deep.
    fn level(depth: f32, least: usize) -> Option<usize> {
        if depth.is_infinite() {
            return None;
        }
        let fits = |&l: &usize| {
            let most = if l == 0 {
                Self::MAX_VOXEL_DEPTH
            } else {
                Self::MAX_SWEPT_DEPTH
            };
            depth * (1 << l) as f32 <= most
        };
        let near = (0..NEAR_LEVELS).rev().find(fits);
        near.max((least > 0).then_some(least))
    }

    /// The level of the brick around a point of index space; `None` if it was not swept.
    #[inline]
    pub fn level_at(&self, point_in_index: Vec3) -> Option<usize> {
        self.level_of.at(point_in_index).map(usize::from)
    }

    /// Mean over the sphere of the indirect radiance at a vertex of a level; `None` if it was not
    /// swept.
    #[inline]
    pub fn get(&self, level: usize, v: [usize; 3]) -> Option<Rgb> {
        *self.levels.get(level)?.as_ref()?.get(v)?
    }

    /// All that was swept.
    pub fn into_levels(self) -> SweptLevels {
        self.levels
    }
}

impl LevelSweep {
    /// Bytes a vertex that are kept.
    const BYTES_A_VERTEX: u64 = size_of::<Option<Rgb>>() as u64;

    /// Those that a vertex takes while its level is swept.
    fn bytes_of_vertex<K>() -> u64 {
        let arriving = Sweep::DIRECTIONS_TOGETHER as usize * size_of::<Arriving<K>>();
        let around = size_of::<Option<Surroundings>>() + size_of::<Option<Look>>();
        (size_of::<[usize; 3]>() + around + size_of::<Rgb>() + arriving) as u64
    }

    /// Bytes that rays take while a batch of directions is swept, whatever the number of threads:
    /// little of a volume may be needed, but rays pass all between its ends.
    fn bytes_of_rays<G: GatherInMedia>(
        scope: &SweepScope<G>,
        set: &SparseLattice,
        step: usize,
    ) -> u64 {
        let directions = scope.far_field.quarters();
        let most = (0..directions)
            .map(|q| SweepRays::bytes(scope, set, step, scope.far_field.direction(q)))
            .max();
        u64::from(Sweep::DIRECTIONS_TOGETHER.min(directions)).saturating_mul(most.unwrap_or(0))
    }

    /// Sweeps vertices `step` voxels apart.
    fn sweep<G: GatherInMedia>(
        scope: &SweepScope<G>,
        set: SparseLattice,
        step: usize,
        media: &MediaBox,
    ) -> Result<SparseValues<Option<Rgb>>> {
        let vertices: Vec<[usize; 3]> = set.vertices().collect();
        counts::add(&scope.counters.swept, vertices.len() as u64);
        let to_index = |v| to_index(v, step);
        let surroundings: Vec<Option<Surroundings>> = vertices
            .par_iter()
            .map(|&v| {
                scope.job.cancel.check()?;
                let field = scope.far_field;
                Ok(field.around(scope.volume, scope.gatherer, to_index(v)))
            })
            .collect::<Result<_>>()?;
        let mut sums = vec![Rgb::BLACK; vertices.len()];
        let weights = ScatteringWeights::new(scope.volume.phase, scope.far_field);
        let looks = scope.looks(weights.as_ref(), vertices.iter().map(|&v| to_index(v)));
        let directions = scope.far_field.quarters();
        for first in (0..directions).step_by(Sweep::DIRECTIONS_TOGETHER as usize) {
            let batch = first..(first + Sweep::DIRECTIONS_TOGETHER).min(directions);
            let arriving: Vec<Vec<Arriving<G::Share>>> = batch
                .clone()
                .into_par_iter()
                .map(|q| {
                    SweepRays::new(scope, &set, step, scope.far_field.direction(q), media).pass()
                })
                .collect::<Result<_>>()?;
            sums.par_iter_mut().enumerate().for_each(|(i, sum)| {
                if let Some(around) = &surroundings[i] {
                    let mut through = [G::Share::default(); Sweep::DIRECTIONS_TOGETHER as usize];
                    for ((through, arriving), q) in through.iter_mut().zip(&arriving).zip(first..) {
                        let a = &arriving[i];
                        let weight = scope.weight(weights.as_ref(), looks.get(i), q);
                        *sum += a.radiance * weight;
                        *through = a.transmittance * weight;
                    }
                    *sum += around.radiance_through(first, &through[..arriving.len()]);
                }
            });
        }
        let scale = 1.0 / directions as f32;
        let values = sums
            .into_iter()
            .zip(surroundings)
            .map(|(sum, around)| around.map(|_| sum * scale))
            .collect();
        Ok(SparseValues { set, values })
    }
}

/// A vertex in index space, where they are `step` voxels apart.
fn to_index(v: [usize; 3], step: usize) -> Vec3 {
    Vec3::from(v.map(|c| (c * step) as f32))
}

impl<G: GatherInMedia> SweepScope<'_, G> {
    /// Bricks whose cells are held in memory together.
    const PART: usize = 1024;

    /// Optical depth behind which the camera sees nothing.
    const OPAQUE_DEPTH: f32 = 7.0;

    /// Whether bricks may hide others from the camera: one is as deep as that.
    fn is_opaque(&self) -> bool {
        let VisibleMedia::ThroughRegions(_) = self.visible else {
            return false;
        };
        let grid = &self.volume.sigma_t;
        // In the clearest channel.
        let across = BRICK_CELLS as f32 * self.volume.longest_voxel_edge();
        let mut bricks = grid.bricks().filter_map(|b| grid.brick(b));
        let clearest = self.volume.clearest();
        bricks.any(|brick| brick.max * across * clearest >= Self::OPAQUE_DEPTH)
    }

    /// Whether a brick of the volume, which may be opaque, matters.
    fn may_see(&self, brick: [usize; 3], is_opaque: bool) -> bool {
        let corners = std::array::from_fn(|i| {
            let p: [f32; 3] = std::array::from_fn(|a| {
                let voxel = ((brick[a] + (i >> a & 1)) * BRICK_CELLS) as f32;
                voxel + if i >> a & 1 == 1 { 1.0 } else { -1.5 }
            });
            self.to_scene(p.into())
        });
        self.view
            .may_matter(self.visible, Sweep::MARGIN_PIXELS, corners)
            && !(is_opaque && self.is_hidden(corners))
    }

    /// Whether all corners of a brick are behind so much medium that the camera does not see them.
    /// Where it sees in between after all, light is gathered.
    fn is_hidden(&self, corners: [Vec3; 8]) -> bool {
        let camera = self.view.camera.origin();
        corners.iter().all(|&corner| {
            let (way, distance) = (corner - camera, corner.distance(camera));
            if distance == 0.0 {
                return false;
            }
            let mut depth = G::Share::default();
            let ray = Ray::new(camera, way / distance, distance);
            let nothing = |_, _, _| Rgb::BLACK;
            let is_clear = |depth: G::Share| depth.least() < Self::OPAQUE_DEPTH;
            self.view.tracer.march(&ray, nothing, |s| {
                depth += s.tau;
                is_clear(depth)
            });
            !is_clear(depth)
        })
    }

    /// Vertices around the cells of bricks that hold any medium, `step` voxels apart.
    fn vertices(&self, bricks: &[[usize; 3]], step: usize) -> SparseLattice {
        let grid = &self.volume.sigma_t;
        let count = occupied::vertices_along(grid, step);
        SparseLattice::new(count, |choose| {
            // A part at a time: the cells of all take far more memory than their vertices do as
            // bits.
            for part in bricks.chunks(Self::PART) {
                for cell in occupied::filled_cells(grid, part, step) {
                    occupied::around(cell, count).for_each(&mut *choose);
                }
            }
        })
    }

    fn to_scene(&self, point_in_index: Vec3) -> Vec3 {
        self.volume
            .scene_from_index
            .transform_point3(point_in_index.as_dvec3())
            .as_vec3()
    }

    /// The looks of the camera at points in index space; none without weights.
    fn looks(
        &self,
        weights: Option<&ScatteringWeights>,
        points_in_index: impl Iterator<Item = Vec3>,
    ) -> Vec<Look> {
        let Some(weights) = weights else {
            return Vec::new();
        };
        let look = |point| weights.look(self.view, self.to_scene(point));
        points_in_index.filter_map(look).collect()
    }

    /// The weight of what arrives in a quarter of the far field: 1 without weights.
    #[inline]
    fn weight(
        &self,
        weights: Option<&ScatteringWeights>,
        look: Option<&Look>,
        quarter: u32,
    ) -> f32 {
        match (weights, look) {
            (Some(weights), Some(look)) => {
                weights.weight(look, self.far_field.row_and_column(quarter))
            }
            _ => 1.0,
        }
    }
}
