//! Indirect light in media by discrete ordinates (Chandrasekhar 1950): along each of a few dozen directions, parallel rays
//! pass the whole volume once and leave at the vertices beside them what the medium sends and what it lets through.
//!
//! A ray on its own serves one vertex, a swept one serves all on its way. Surfaces beyond the medium come from the probes
//! of the far field, at each vertex, so that they keep their parallax.

mod rays;

use super::bricks::BrickTable;
use super::far_field::{FarField, Surroundings};
use super::sparse::SparseLattice;
use super::vertices::Vertices;
use crate::Result;
use crate::gather::{Gatherer, Medium, Pages};
use crate::image::Region;
use crate::math::Rgb;
use crate::math::segment::Composite;
use crate::run::Cancel;
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use crate::shade::view::View;
use crate::trace::media_bounds;
use glam::Vec3;
use rayon::prelude::*;
use rays::{Arriving, Rays};

/// Indirect light at the vertices of one volume that rays of some regions may ask for.
#[derive(Debug)]
pub struct Sweep {
    /// By log2 of the voxels between vertices.
    levels: [Option<Level>; LEVELS],
    /// Which of them serves a brick.
    level_of: BrickTable<Option<u8>>,
}

/// Spacings of 1 to 8 voxels.
const LEVELS: usize = 4;

/// Vertices of one spacing.
#[derive(Debug)]
struct Level {
    set: SparseLattice,
    /// Mean over the sphere of the radiance; `None` where surfaces are too near for probes.
    light: Vec<Option<Rgb>>,
}

/// Box around all media of a scene.
struct MediaBox {
    bounds: (Vec3, Vec3),
    /// Whether surfaces may stand in it.
    has_walls: bool,
}

/// What a sweep looks at.
pub struct Scope<'a, P, M> {
    /// Camera and scene.
    pub view: &'a View<'a>,
    /// Parts of the film.
    pub regions: &'a [Region],
    /// Media and surfaces.
    pub gatherer: &'a Gatherer<'a, P, M>,
    /// Which of the scene's volumes.
    pub volume: &'a Volume,
    /// What is around it.
    pub far_field: &'a FarField,
    /// For cancelling.
    pub cancel: &'a Cancel,
}

impl Sweep {
    /// Pixels around a region from which corners may look.
    const MARGIN: f32 = 4.0;
    /// Directions that are held in memory together.
    const BATCH: u32 = 8;

    /// Optical depth between vertices in bricks that the camera sees, at most, and in those that it hardly sees: light is not
    /// linear along an optical depth, and is least so where a medium begins.
    const SPACING: [f32; 2] = [0.7, 2.0];
    /// Transmittance to the camera below which a brick is hardly seen.
    const SEEN: f32 = 0.05;

    /// Sweeps the bricks of a volume that the camera may see. `depth_of(brick)` is the optical depth of the densest voxel in one,
    /// if it is to be swept.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new<P: Pages, M: Medium>(
        scope: &Scope<P, M>,
        depth_of: impl Fn([usize; 3]) -> Option<f32> + Sync,
    ) -> Result<Self> {
        let grid = &scope.volume.sigma_t;
        let [nx, ny, nz] = grid.brick_dims();
        let corners = Vertices::new(grid.dims(), BRICK_CELLS);
        let chosen: Vec<([usize; 3], usize)> = (0..nx * ny * nz)
            .into_par_iter()
            .filter_map(|i| {
                let b = [i % nx, i / nx % ny, i / nx / ny];
                let depth = grid.brick(b).and_then(|_| depth_of(b))?;
                scope.may_see(b).then(|| {
                    let is_seen = scope.transmittance_to(b, &corners) > Self::SEEN;
                    (b, Self::level(depth, is_seen))
                })
            })
            .collect();
        let mut level_of = BrickTable::new(grid, |_| None);
        let mut needed: [Vec<[usize; 3]>; LEVELS] = Default::default();
        for (brick, level) in chosen {
            *level_of.of_mut(brick) = Some(level as u8);
            needed[level].push(brick);
        }
        let bounds = media_bounds(scope.view.tracer.scene);
        let media = MediaBox {
            bounds,
            has_walls: scope.has_walls(bounds),
        };
        let mut levels = [const { None }; LEVELS];
        for (level, bricks) in needed.iter().enumerate() {
            if !bricks.is_empty() {
                levels[level] = Some(Level::new(scope, level, bricks, &media)?);
            }
        }
        Ok(Self { levels, level_of })
    }

    /// Log2 of the voxels between the vertices of a brick.
    fn level(depth_of_voxel: f32, is_seen: bool) -> usize {
        let [seen, hidden] = Self::SPACING;
        let most = if is_seen { seen } else { hidden };
        let levels = (0..LEVELS).rev();
        let fits = |&l: &usize| depth_of_voxel * (1 << l) as f32 <= most;
        levels.into_iter().find(fits).unwrap_or(0)
    }

    /// The level of the brick around a point of index space; `None` if it was not swept.
    #[inline]
    pub fn level_at(&self, point_in_index: Vec3) -> Option<usize> {
        self.level_of.at(point_in_index).map(usize::from)
    }

    /// Mean over the sphere of the indirect radiance at a vertex of a level; `None` if it was not swept.
    #[inline]
    pub fn get(&self, level: usize, v: [usize; 3]) -> Option<Rgb> {
        let level = self.levels.get(level)?.as_ref()?;
        level.light[level.set.index(v)?]
    }
}

impl Level {
    fn new<P: Pages, M: Medium>(
        scope: &Scope<P, M>,
        level: usize,
        bricks: &[[usize; 3]],
        media: &MediaBox,
    ) -> Result<Self> {
        let step = 1 << level;
        let count = scope.volume.sigma_t.dims().map(|n| n.div_ceil(step) + 1);
        let set = SparseLattice::new(count, |choose| {
            for brick in bricks {
                // A brick's samples stand half a voxel from its cells' corners.
                let first = brick.map(|b| (b * BRICK_CELLS).saturating_sub(1) / step);
                let last: [usize; 3] = std::array::from_fn(|a| {
                    (((brick[a] + 1) * BRICK_CELLS).div_ceil(step)).min(count[a] - 1)
                });
                for z in first[2]..=last[2] {
                    for y in first[1]..=last[1] {
                        for x in first[0]..=last[0] {
                            choose([x, y, z]);
                        }
                    }
                }
            }
        });
        eprintln!("level {level} bricks {} vertices {}", bricks.len(), set.len());
        let vertices: Vec<[usize; 3]> = set.vertices().collect();
        let to_index = |v: [usize; 3]| Vec3::from(v.map(|c| (c * step) as f32));
        let surroundings: Vec<Option<Surroundings>> = vertices
            .par_iter()
            .map(|&v| {
                scope.cancel.check()?;
                let field = scope.far_field;
                Ok(field.around(scope.volume, scope.gatherer, to_index(v)))
            })
            .collect::<Result<_>>()?;
        let mut sums = vec![Rgb::BLACK; vertices.len()];
        let directions = scope.far_field.quarters();
        for first in (0..directions).step_by(Sweep::BATCH as usize) {
            let batch = first..(first + Sweep::BATCH).min(directions);
            let arriving: Vec<Vec<Arriving>> = batch
                .clone()
                .into_par_iter()
                .map(|q| Rays::new(scope, &set, step, scope.far_field.direction(q), media).pass())
                .collect::<Result<_>>()?;
            sums.par_iter_mut().enumerate().for_each(|(i, sum)| {
                if let Some(around) = &surroundings[i] {
                    let mut through = [0.0; Sweep::BATCH as usize];
                    for (through, arriving) in through.iter_mut().zip(&arriving) {
                        let a = &arriving[i];
                        *sum += a.radiance;
                        *through = a.transmittance;
                    }
                    *sum += around.radiance_through(first, &through[..arriving.len()]);
                }
            });
        }
        let scale = 1.0 / directions as f32;
        let light = sums
            .into_iter()
            .zip(surroundings)
            .map(|(sum, around)| around.map(|_| sum * scale))
            .collect();
        Ok(Self { set, light })
    }
}

impl<P: Pages, M: Medium> Scope<'_, P, M> {
    /// Whether rays of the regions may pass a brick of the volume.
    fn may_see(&self, brick: [usize; 3]) -> bool {
        let corners = std::array::from_fn(|i| {
            let p: [f32; 3] = std::array::from_fn(|a| {
                let voxel = ((brick[a] + (i >> a & 1)) * BRICK_CELLS) as f32;
                voxel + if i >> a & 1 == 1 { 1.0 } else { -1.5 }
            });
            self.to_scene(p.into())
        });
        let sees = |&region: &Region| self.view.may_see(region, Sweep::MARGIN, corners);
        self.regions.iter().any(sees)
    }

    /// Share of light that gets through the media from a brick to the camera, from whichever of its corners it sees best.
    fn transmittance_to(&self, brick: [usize; 3], corners: &Vertices<f32>) -> f32 {
        let last = self.volume.sigma_t.dims().map(|n| n.div_ceil(BRICK_CELLS));
        let through = |p: Vec3| {
            let origin = self.view.camera.origin();
            let to_corner = self.to_scene(p) - origin;
            let distance = to_corner.length();
            let mut passed = Composite::default();
            if distance > 0.0 {
                let media = self.gatherer.media;
                media.pass(origin, to_corner / distance, distance, &[], &mut passed);
            }
            passed.transmittance
        };
        let of_corner = |i: usize| {
            let v = std::array::from_fn(|a| (brick[a] + (i >> a & 1)).min(last[a]));
            *corners.get(v, &|p, _| through(p))
        };
        (0..8).map(of_corner).fold(0.0, f32::max)
    }

    fn to_scene(&self, point_in_index: Vec3) -> Vec3 {
        self.volume
            .scene_from_index
            .transform_point3(point_in_index.as_dvec3())
            .as_vec3()
    }

    /// Whether any surface may stand among the media.
    fn has_walls(&self, (lower, upper): (Vec3, Vec3)) -> bool {
        let mesh = &self.view.tracer.scene.mesh;
        (0..mesh.triangles.len()).into_par_iter().any(|i| {
            let [a, b, c] = mesh.corners(i);
            a.min(b).min(c).cmple(upper).all() && a.max(b).max(c).cmpge(lower).all()
        })
    }
}
