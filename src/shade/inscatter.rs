//! In-scattered light inside media, interpolated from vertices on the volume's own grid.
//!
//! A vertex is evaluated when a ray first needs it and depends on its coordinates alone, so it does not matter which
//! tile or thread asks. Direct light is smooth at the scale of an optical depth, indirect light at twice that, so each
//! brick of a volume has the spacing that its own density asks for. Vertices
//! in empty space around the medium are evaluated like any other: leaving them dark would darken its rim.

use crate::gather::{Gatherer, Pages};
use crate::light::{InMedium, Lights, ShadowRays};
use crate::math::exp::mean_reach;
use crate::math::{Rgb, sampling};
use crate::scene::Volume;
use glam::Vec3;
use std::ops::{AddAssign, Mul};
use std::sync::OnceLock;

const BRICK: usize = 8;

/// Vertices of one lattice, made on demand.
#[derive(Debug)]
struct Vertices<T> {
    /// Voxels between vertices.
    step: f32,
    count: [usize; 3],
    bricks: [usize; 3],
    values: Vec<OnceLock<Box<[OnceLock<T>]>>>,
}

impl<T: Copy + Default + AddAssign + Mul<f32, Output = T>> Vertices<T> {
    fn new(dims: [usize; 3], step: usize) -> Self {
        let count = dims.map(|n| n.div_ceil(step) + 1);
        let bricks = count.map(|n| n.div_ceil(BRICK));
        let values = (0..bricks[0] * bricks[1] * bricks[2])
            .map(|_| OnceLock::new())
            .collect();
        Self {
            step: step as f32,
            count,
            bricks,
            values,
        }
    }

    fn vertex(&self, v: [usize; 3], evaluate: &impl Fn(Vec3, [usize; 3]) -> T) -> T {
        let b = v.map(|c| c / BRICK);
        let l = v.map(|c| c % BRICK);
        let brick = self.values[(b[2] * self.bricks[1] + b[1]) * self.bricks[0] + b[0]]
            .get_or_init(|| {
                (0..BRICK * BRICK * BRICK)
                    .map(|_| OnceLock::new())
                    .collect()
            });
        *brick[(l[2] * BRICK + l[1]) * BRICK + l[0]]
            .get_or_init(|| evaluate(Vec3::from(v.map(|c| c as f32)) * self.step, v))
    }

    fn sample(&self, point_in_index: Vec3, evaluate: impl Fn(Vec3, [usize; 3]) -> T) -> T {
        let p = (point_in_index / self.step).to_array();
        let mut base = [0; 3];
        let mut f = [0.0; 3];
        for a in 0..3 {
            let at = p[a].clamp(0.0, (self.count[a] - 1) as f32);
            base[a] = (at as usize).min(self.count[a].saturating_sub(2));
            f[a] = at - base[a] as f32;
        }
        let mut sum = T::default();
        for corner in 0..8_usize {
            let mut weight = 1.0;
            let v = std::array::from_fn(|a| {
                let upper = corner >> a & 1;
                weight *= if upper == 1 { f[a] } else { 1.0 - f[a] };
                base[a] + upper
            });
            if weight > 0.0 {
                sum += self.vertex(v, &evaluate) * weight;
            }
        }
        sum
    }
}

/// In-scattered light of one volume: a lattice for each spacing, of which each brick of the volume uses one.
#[derive(Debug)]
struct Lattices {
    /// By log2 of the voxels between vertices.
    direct: [Vertices<InMedium>; LEVELS],
    indirect: [Vertices<Rgb>; LEVELS],
    /// Longest edge of a voxel, scene units.
    voxel: f32,
}

/// Spacings of 1, 2 and 4 voxels.
const LEVELS: usize = 3;

/// In-scattered light of all volumes of a scene.
pub struct InScatter<'a, P> {
    volumes: &'a [Volume],
    lights: &'a Lights<'a>,
    gatherer: Option<&'a Gatherer<'a, P>>,
    lattices: Vec<Lattices>,
    shadow_rays: u32,
    seed: u64,
}

impl<'a, P: Pages> InScatter<'a, P> {
    /// Optical depth between vertices of the direct lattice. Cells deeper than this are lit at their own point.
    const DEPTH: f32 = 0.7;

    /// Empty lattices. Without a gatherer there is direct light only.
    #[must_use]
    pub fn new(
        volumes: &'a [Volume],
        lights: &'a Lights<'a>,
        gatherer: Option<&'a Gatherer<'a, P>>,
        shadow_rays: u32,
        seed: u64,
    ) -> Self {
        let lattices = volumes
            .iter()
            .map(|v| {
                let axes = v.scene_from_index.matrix3;
                let voxel = axes
                    .x_axis
                    .length()
                    .max(axes.y_axis.length())
                    .max(axes.z_axis.length());
                let dims = v.sigma_t.dims();
                Lattices {
                    direct: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
                    indirect: std::array::from_fn(|level| Vertices::new(dims, 2 << level)),
                    voxel: voxel as f32,
                }
            })
            .collect();
        Self {
            volumes,
            lights,
            gatherer,
            lattices,
            shadow_rays,
            seed,
        }
    }

    /// Source function of a volume along a stretch of a ray, given its ends in scene space, its optical depth, and that
    /// of the cell that it is in.
    #[must_use]
    pub fn source(&self, volume: usize, [from, to]: [Vec3; 2], depth: f32, tau: f32) -> Rgb {
        let medium = &self.volumes[volume];
        let lattices = &self.lattices[volume];
        // Where its light comes from on average: near its front if it is dense.
        let point = from + (to - from) * mean_reach(depth);
        let at = medium.index_from_scene.transform_point3(point);
        let to_scene = |p: Vec3| {
            medium
                .scene_from_index
                .transform_point3(p.as_dvec3())
                .as_vec3()
        };
        // Thin parts of a volume are lit from few vertices, whatever its densest part needs.
        let densest = medium.sigma_t.brick_max_at(at) * lattices.voxel;
        let level = (0..LEVELS)
            .rev()
            .find(|&l| densest * (1 << l) as f32 <= Self::DEPTH)
            .unwrap_or(0);
        let key = |v: [usize; 3]| {
            sampling::hash(&[
                self.seed,
                volume as u64,
                level as u64,
                v[0] as u64,
                v[1] as u64,
                v[2] as u64,
            ])
        };
        let direct = if tau > Self::DEPTH {
            let bits = point.to_array().map(|c| u64::from(c.to_bits()));
            let seed = sampling::hash(&[self.seed, bits[0], bits[1], bits[2]]);
            let light = self.direct(point, seed);
            light.share * self.lights.sent(point, point) + light.rest
        } else {
            let light = lattices.direct[level].sample(at, |p, v| self.direct(to_scene(p), key(v)));
            light.share * self.lights.sent(from, to) + light.rest
        };
        let indirect = self.gatherer.map_or(Rgb::BLACK, |gatherer| {
            lattices.indirect[level]
                .sample(at, |p, v| gatherer.mean_radiance(to_scene(p), key(v)).light)
        });
        Rgb(medium.albedo) * (direct + indirect)
    }

    fn direct(&self, point: Vec3, seed: u64) -> InMedium {
        self.lights.in_medium(
            point,
            ShadowRays {
                per_light: self.shadow_rays,
                first: 0,
                seed,
            },
        )
    }
}
