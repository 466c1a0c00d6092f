//! Indirect light in media by discrete ordinates (Chandrasekhar 1950): along each of a few dozen directions, parallel rays
//! pass the whole volume once and leave at the vertices beside them what the medium sends and what it lets through.
//!
//! A ray on its own serves one vertex, a swept one serves all on its way. Surfaces beyond the medium come from the probes
//! of the far field, at each vertex, so that they keep their parallax.

use super::far_field::{FarField, Surroundings};
use super::inscatter::LEVELS;
use super::sparse::SparseLattice;
use crate::Result;
use crate::gather::{Gatherer, Medium, Pages};
use crate::image::Region;
use crate::math::Rgb;
use crate::math::dda::leave_box;
use crate::math::exp::exp_neg_and_rest;
use crate::math::segment::Segment;
use crate::math::sheared::Sheared;
use crate::run::Cancel;
use crate::scene::Volume;
use crate::scene::grid::BRICK_CELLS;
use crate::shade::view::View;
use crate::trace::{media_bounds, offset};
use glam::Vec3;
use rayon::prelude::*;

/// Indirect light at the vertices of one volume that rays of some regions may ask for.
#[derive(Debug)]
pub struct Sweep {
    /// By log2 of half the voxels between vertices.
    levels: Vec<Option<Level>>,
}

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

/// What arrives at a vertex from one direction: the medium's own light, and the share of light from beyond.
#[derive(Clone, Copy, Debug, Default)]
struct Arriving {
    radiance: Rgb,
    transmittance: f32,
}

impl Sweep {
    /// Pixels around a region from which corners may look.
    const MARGIN: f32 = 4.0;
    /// Directions that are held in memory together.
    const BATCH: u32 = 8;

    /// Sweeps the volume. `level_of(brick)` tells the spacing in it, if it is to be swept.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new<P: Pages, M: Medium>(
        scope: &Scope<P, M>,
        level_of: impl Fn([usize; 3]) -> Option<usize>,
    ) -> Result<Self> {
        let mut needed: [Vec<[usize; 3]>; LEVELS] = Default::default();
        let grid = &scope.volume.sigma_t;
        let [nx, ny, nz] = grid.brick_dims();
        for b in (0..nx * ny * nz).map(|i| [i % nx, i / nx % ny, i / nx / ny]) {
            if grid.brick(b).is_some()
                && let Some(level) = level_of(b)
                && scope.sees(b)
            {
                needed[level].push(b);
            }
        }
        let bounds = media_bounds(scope.view.tracer.scene);
        let media = MediaBox {
            bounds,
            has_walls: scope.has_walls(bounds),
        };
        let mut levels = Vec::with_capacity(LEVELS);
        for (level, bricks) in needed.iter().enumerate() {
            levels.push(if bricks.is_empty() {
                None
            } else {
                Some(Level::new(scope, level, bricks, &media)?)
            });
        }
        Ok(Self { levels })
    }

    /// Mean over the sphere of the indirect radiance at a vertex; `None` if it was not swept.
    #[inline]
    pub fn get(&self, level: usize, v: [usize; 3]) -> Option<Rgb> {
        let level = self.levels[level].as_ref()?;
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
        let step = 2 << level;
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
    fn sees(&self, brick: [usize; 3]) -> bool {
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

/// Parallel rays through a volume, between which vertices interpolate.
struct Rays<'a, P, M> {
    scope: &'a Scope<'a, P, M>,
    set: &'a SparseLattice,
    /// Unit direction against the light.
    direction: Vec3,
    rays: Sheared,
    media: &'a MediaBox,
}

impl<'a, P: Pages, M: Medium> Rays<'a, P, M> {
    fn new(
        scope: &'a Scope<'a, P, M>,
        set: &'a SparseLattice,
        step: usize,
        direction: Vec3,
        media: &'a MediaBox,
    ) -> Self {
        let d = scope.volume.index_from_scene.transform_vector3(direction);
        Self {
            scope,
            set,
            direction,
            rays: Sheared::new(d, step as f32),
            media,
        }
    }

    /// Passes all rays that any vertex needs, and returns what arrives at the vertices.
    fn pass(&self) -> Result<Vec<Arriving>> {
        let [(u0, nu), (w0, nw)] = self.rays.extent(self.set.bounds());
        let words = self.layers().div_ceil(64);
        let mut places = Vec::with_capacity(self.set.len());
        places.extend(self.set.vertices().map(|v| {
            let (_, across) = self.rays.place(v.map(|c| c as f32));
            let [x, y] = across.map(f32::floor);
            Place {
                ray: (y as i32 - w0) as usize * nu + (x as i32 - u0) as usize,
                layer: v[self.rays.axes[0]],
                share: [across[0] - x, across[1] - y],
            }
        }));
        // By ray, a bit for each layer in which a vertex needs it.
        let mut needed = vec![0_u64; nu * nw * words];
        for place in &places {
            for (ray, _) in place.rays(nu) {
                needed[ray * words + place.layer / 64] |= 1 << (place.layer % 64);
            }
        }
        let mut arriving: Vec<Arriving> = Vec::new();
        // Where those of each ray begin.
        let mut firsts = Vec::with_capacity(nu * nw);
        let mut stops = Vec::new();
        for (i, needed) in needed.chunks_exact(words).enumerate() {
            self.scope.cancel.check()?;
            firsts.push(arriving.len());
            stops.clear();
            for (word, &bits) in needed.iter().enumerate() {
                let mut bits = bits;
                while bits != 0 {
                    stops.push(word * 64 + bits.trailing_zeros() as usize);
                    bits &= bits - 1;
                }
            }
            if !stops.is_empty() {
                if self.rays.upwards {
                    stops.reverse();
                }
                let at = [(i % nu) as i32 + u0, (i / nu) as i32 + w0];
                self.pass_one(at.map(|c| c as f32), &stops, &mut arriving);
                if self.rays.upwards {
                    arriving[firsts[i]..].reverse();
                }
            }
        }
        let of_ray = |ray: usize, layer: usize| {
            let words_before = &needed[ray * words..ray * words + layer / 64];
            let within = needed[ray * words + layer / 64] & ((1 << (layer % 64)) - 1);
            let before = words_before.iter().map(|w| w.count_ones()).sum::<u32>();
            arriving[firsts[ray] + (before + within.count_ones()) as usize]
        };
        let at_vertex = |place: &Place| {
            let mut sum = Arriving::default();
            for (ray, weight) in place.rays(nu) {
                let light = of_ray(ray, place.layer);
                sum.radiance += light.radiance * weight;
                sum.transmittance += light.transmittance * weight;
            }
            sum
        };
        Ok(places.iter().map(at_vertex).collect())
    }

    /// Layers of vertices.
    fn layers(&self) -> usize {
        self.set.count()[self.rays.axes[0]]
    }

    /// Passes one ray, and appends what it brings to some layers, in the order of travel.
    fn pass_one(&self, at: [f32; 2], stops: &[usize], arriving: &mut Vec<Arriving>) {
        // The whole ray is the same whatever part of it is needed.
        let first = if self.rays.upwards {
            self.layers() - 1
        } else {
            0
        };
        let first_point = self.scope.to_scene(self.rays.point(at, first));
        let beyond = leave_box(first_point, self.direction, self.media.bounds);
        let origin = first_point + self.direction * beyond;
        let stop_at = |i: usize| {
            let stop = stops.get(i);
            stop.map_or(f32::INFINITY, |&layer| {
                beyond + layer.abs_diff(first) as f32 * self.rays.between
            })
        };
        // A layer further than any stop: whether a surface in a layer is met must not depend on which stop is the last.
        let end = stop_at(stops.len() - 1) + self.rays.between;
        let mut cuts = if self.media.has_walls {
            self.walls(origin, end)
        } else {
            Vec::new()
        };
        cuts.reverse();

        let mut light = Arriving {
            radiance: Rgb::BLACK,
            transmittance: 1.0,
        };
        let mut next = 0;
        let mut add = |mut s: Segment| {
            let mut next_at = stop_at(next);
            while next < stops.len() {
                let cut = cuts.last().is_some_and(|&c| c <= next_at);
                let t = if cut { cuts[cuts.len() - 1] } else { next_at };
                if t >= s.far {
                    break;
                }
                let share = ((t - s.near) / (s.far - s.near)).max(0.0);
                if cut {
                    if share > 0.0 {
                        s.tau *= 1.0 - share;
                        s.near = t;
                    }
                    cuts.pop();
                    light = Arriving {
                        radiance: Rgb::BLACK,
                        transmittance: 1.0,
                    };
                } else {
                    // Of a copy: what the ray goes on with must not depend on where it is asked.
                    let mut here = light;
                    if share > 0.0 {
                        here.pass(s.tau * share, s.source);
                    }
                    arriving.push(here);
                    next += 1;
                    next_at = stop_at(next);
                }
            }
            light.pass(s.tau, s.source);
            next < stops.len()
        };
        self.scope
            .gatherer
            .media
            .walk(origin, -self.direction, f32::INFINITY, &mut add);
        // What is left of the ray is empty.
        add(Segment {
            near: f32::INFINITY,
            far: f32::INFINITY,
            tau: 0.0,
            source: Rgb::BLACK,
        });
    }

    /// Distances at which a ray passes surfaces.
    fn walls(&self, origin: Vec3, end: f32) -> Vec<f32> {
        let tracer = self.scope.view.tracer;
        let mut walls = Vec::new();
        let mut t = 0.0;
        loop {
            let from = origin - self.direction * t;
            let Some(hit) = tracer.closest(from, -self.direction, end - t) else {
                break;
            };
            walls.push(t + hit.t);
            // Rays may meet walls at a slant.
            t += hit.t + 4.0 * offset(origin).max(offset(from));
        }
        walls
    }
}

/// A vertex among the rays of a direction.
struct Place {
    /// The nearest ray below it along both axes across.
    ray: usize,
    layer: usize,
    /// How far it is from there to the next ray, along both.
    share: [f32; 2],
}

impl Place {
    /// The rays around the vertex, by their numbers in rows of `nu`, and their weights.
    #[inline]
    fn rays(&self, nu: usize) -> [(usize, f32); 4] {
        let [x, y] = self.share;
        [
            (self.ray, (1.0 - x) * (1.0 - y)),
            (self.ray + 1, x * (1.0 - y)),
            (self.ray + nu, (1.0 - x) * y),
            (self.ray + nu + 1, x * y),
        ]
    }
}

impl Arriving {
    /// Passes a medium on the way towards the vertex.
    #[inline]
    fn pass(&mut self, tau: f32, source: Rgb) {
        let (through, taken) = exp_neg_and_rest(tau);
        self.radiance = self.radiance * through + source * taken;
        self.transmittance *= through;
    }
}
