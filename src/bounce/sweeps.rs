//! Light that media and surfaces send through one volume, as means over its blocks: along each of
//! some directions, parallel rays pass all blocks once.
//!
//! Means over blocks are what a block takes and gives back, so that no light is lost or made from
//! one order of scattering to the next, whatever the size of blocks. The method of characteristics
//! of neutron transport does the same (Askew 1972).

use super::blocks::Blocks;
use super::links::Sites;
use crate::Result;
use crate::gather::{PatchRadiance, PatchRequest};
use crate::math::exp::exp_neg_and_rest;
use crate::math::sampling::{hash, unit2};
use crate::math::{Ray, Rgb};
use crate::run::Cancel;
use crate::trace::{Surface, Tracer, offset};
use crate::tree::Pages;
use crate::tree::traversal::OpenNodes;
use glam::{DVec3, Quat, Vec3, Vec3A};
use lvox_formats::record::VolumeInfo;
use rayon::prelude::*;

/// Light, by channel.
pub type Light = Vec3A;

/// A surface from which light enters the rest of a ray.
#[derive(Clone, Copy, Debug)]
struct Wall {
    t: f32,
    /// What it sends of the light in the tree.
    sent: Light,
    /// The share that it sends of what arrives at a receiver.
    albedo: Light,
    receiver: u32,
}

/// A ray through the volume.
#[derive(Clone, Debug)]
struct SweptRay {
    ray: Ray,
    /// Surfaces behind its origin and on its way, by distance.
    walls: Vec<Wall>,
}

/// All rays of one direction.
#[derive(Debug)]
struct Direction {
    rays: Vec<SweptRay>,
    /// Volume of the medium that a ray stands for, voxels per unit of its length.
    section: f32,
}

/// Rays of all directions through one volume.
#[derive(Debug)]
pub struct Sweeps<'a> {
    blocks: &'a Blocks,
    directions: Vec<Direction>,
}

/// What finds the surfaces on rays, and what they send.
pub struct Walls<'a, P> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// What its surfaces send.
    pub patches: &'a PatchRadiance<'a>,
    /// The tree that says so.
    pub pages: &'a P,
    /// Receivers at which light arrives that is not in the tree yet.
    pub sites: &'a Sites<'a>,
    /// Solid angle under which nodes are taken whole, steradians.
    pub max_solid_angle: f32,
}

impl<'a> Sweeps<'a> {
    /// Most rays of a direction along each axis across it.
    const MOST_ALONG: f64 = 256.0;
    /// Edges of blocks between rays: about 16 of all directions together meet each. With a quarter
    /// of them a slab of depth 10 reflects 9 % less: the fewer rays meet a block, the more of what
    /// one loses there it is given back.
    const APART: f64 = 1.5;
    /// Directions that are in memory together.
    pub const TOGETHER: usize = 8;

    /// Bytes that the rays through a volume take, at most.
    pub fn bytes_for(volume: &VolumeInfo) -> u64 {
        /// A lattice is as wide as the box and its shear, across each of two axes.
        const SHEARED: f64 = 4.0;
        let longest = f64::from(volume.dims.into_iter().max().unwrap_or(1));
        let along = (longest / Self::APART).min(Self::MOST_ALONG);
        let rays = (SHEARED * along * along).ceil() as u64;
        directions().len() as u64 * rays * (size_of::<SweptRay>() + size_of::<Wall>()) as u64
    }

    /// The rays through a volume, and the surfaces on them.
    ///
    /// # Errors
    /// A page that cannot be read, or a stop on request.
    pub fn new<P: Pages>(blocks: &'a Blocks, walls: &Walls<P>, cancel: &Cancel) -> Result<Self> {
        let sweeps = Self::of_walls(blocks, |ray| {
            cancel.check()?;
            Ok(walls.on(blocks, ray))
        })?;
        walls.pages.check()?;
        Ok(sweeps)
    }

    /// The rays through a volume without surfaces.
    #[cfg(test)]
    pub fn alone(blocks: &'a Blocks) -> Self {
        Self::of_walls(blocks, |_| Ok(Vec::new())).unwrap()
    }

    fn of_walls(
        blocks: &'a Blocks,
        walls: impl Fn(&Ray) -> Result<Vec<Wall>> + Sync,
    ) -> Result<Self> {
        let directions = directions().into_par_iter().enumerate();
        let directions = directions.map(|(i, direction)| {
            let (rays, section) = lattice(blocks, direction, i as u64);
            let swept = rays.into_iter().map(|ray| {
                let walls = walls(&ray)?;
                Ok(SweptRay { ray, walls })
            });
            Ok(Direction {
                rays: swept.collect::<Result<_>>()?,
                section,
            })
        });
        Ok(Self {
            blocks,
            directions: directions.collect::<Result<_>>()?,
        })
    }

    /// The mean over the sphere and over each block of the light that comes from blocks with these
    /// sources and from surfaces, at whose receivers this light arrives beside what is in the tree.
    ///
    /// # Errors
    /// A stop on request.
    pub fn means(&self, sources: &[Light], at: &WallLight, cancel: &Cancel) -> Result<Vec<Light>> {
        let count = self.blocks.len();
        // Side by side, as rays wait for memory.
        let blocks: Vec<(Light, f32)> = sources
            .iter()
            .copied()
            .zip(self.blocks.sigma_t.iter().copied())
            .collect();
        // Light times volume, and volume, of all rays: each counts by what it stands for, so that
        // what blocks take is what rays lose.
        let mut sums = vec![(Light::ZERO, 0.0_f32); count];
        for together in self.directions.chunks(Self::TOGETHER) {
            cancel.check()?;
            let swept: Vec<Vec<(Light, f32)>> = together
                .par_iter()
                .map(|direction| self.sweep(direction, &blocks, at))
                .collect();
            sums.par_iter_mut().enumerate().for_each(|(i, sum)| {
                for (swept, direction) in swept.iter().zip(together) {
                    let (light, length) = swept[i];
                    sum.0 += light * direction.section;
                    sum.1 += length * direction.section;
                }
            });
        }
        let mean = |(light, volume): (Light, f32)| match volume > 0.0 {
            true => light / volume,
            false => Light::ZERO,
        };
        Ok(sums.into_iter().map(mean).collect())
    }

    /// Light times length, and length, of one direction in each block.
    fn sweep(
        &self,
        direction: &Direction,
        blocks: &[(Light, f32)],
        at: &WallLight,
    ) -> Vec<(Light, f32)> {
        let mut sums = vec![(Light::ZERO, 0.0); self.blocks.len()];
        for SweptRay { ray, walls } in &direction.rays {
            let mut light = Light::ZERO;
            let mut walls = walls.iter().peekable();
            self.blocks.walk(ray, |block, near, far| {
                while let Some(wall) = walls.next_if(|w| w.t <= 0.5 * (near + far)) {
                    light = at.sent(wall);
                }
                let (source, sigma_t) = blocks[block];
                let length = far - near;
                let tau = sigma_t * length;
                let (passed, taken) = exp_neg_and_rest(tau);
                // Mean of exp(-t) up to tau.
                let share = if tau > 1e-4 {
                    taken / tau
                } else {
                    1.0 - 0.5 * tau
                };
                let sum = &mut sums[block];
                sum.0 += (source + (light - source) * share) * length;
                sum.1 += length;
                light = light * passed + source * taken;
            });
        }
        sums
    }
}

/// The light of surfaces beside a volume.
pub struct WallLight<'a> {
    /// Whether they send what is in the tree.
    pub sends_tree: bool,
    /// By receiver: irradiance over pi.
    pub light: &'a [Rgb],
}

impl WallLight<'_> {
    /// No light at all.
    pub const NONE: Self = Self {
        sends_tree: false,
        light: &[],
    };

    fn sent(&self, wall: &Wall) -> Light {
        let sent = if self.sends_tree {
            wall.sent
        } else {
            Light::ZERO
        };
        match self.light.get(wall.receiver as usize) {
            Some(light) => sent + wall.albedo * Light::from(light.0),
            None => sent,
        }
    }
}

impl<P: Pages> Walls<'_, P> {
    /// Most surfaces on a ray in a volume: what is behind so many is lit by the last.
    const MOST: usize = 16;

    /// The surfaces from which light enters a ray at its origin and on its way through a volume.
    fn on(&self, blocks: &Blocks, ray: &Ray) -> Vec<Wall> {
        let mut walls = Vec::new();
        let mut open = OpenNodes::default();
        let back = Ray::endless(ray.origin, -ray.direction);
        walls.extend(
            self.seen(&back, &mut open)
                .map(|wall| Wall { t: 0.0, ..wall }),
        );
        let end = blocks.ends(ray).map_or(0.0, |(_, far)| far);
        let mut from = 0.0;
        while walls.len() < Self::MOST {
            let ahead = Ray::new(ray.at(from), ray.direction, end - from);
            let Some(hit) = self.tracer.closest(&ahead) else {
                break;
            };
            let point = ahead.at(hit.t);
            // Beyond it, light comes from its other side.
            let off = 16.0 * offset(point);
            let behind = Ray::new(point + ray.direction * off, -ray.direction, 2.0 * off);
            let t = from + hit.t;
            walls.push(match self.seen(&behind, &mut open) {
                Some(wall) => Wall { t, ..wall },
                None => Wall {
                    t,
                    sent: Light::ZERO,
                    albedo: Light::ZERO,
                    receiver: u32::MAX,
                },
            });
            from = t + off;
            if from >= end {
                break;
            }
        }
        walls
    }

    /// The surface that ends a ray, and what it sends towards its origin.
    fn seen(&self, ray: &Ray, open: &mut OpenNodes<()>) -> Option<Wall> {
        let hit = self.tracer.closest(ray)?;
        let request = PatchRequest {
            max_solid_angle: self.max_solid_angle,
            leave_out_bright: false,
        };
        let sent = self.patches.cast(self.pages, ray, request, open)?;
        let surface = Surface::new(self.tracer.scene, hit.triangle, hit.uv);
        let normal = surface.face_normal * if hit.is_back { -1.0 } else { 1.0 };
        Some(Wall {
            t: hit.t,
            sent: sent.radiance.0.into(),
            albedo: surface.albedo.0.into(),
            receiver: (self.sites.nearest(surface.position, normal)).unwrap_or(u32::MAX),
        })
    }
}

/// Directions of equal weight whose second and fourth moments are those of the sphere: the
/// level-symmetric set of order 4 (Carlson & Lathrop 1968). It is turned so that the means of
/// |x|, |y| and |z| are a half, too, and as much light leaves through the faces of a box as should:
/// along axes the set lets out 5 % too much.
fn directions() -> Vec<Vec3> {
    const NEAR: f32 = 0.350_021_2;
    const FAR: f32 = 0.868_890_3;
    let turn = Quat::from_xyzw(0.000_403_9, 0.146_452_6, -0.769_206_7, 0.621_990_8).normalize();
    let places = [[NEAR, NEAR, FAR], [NEAR, FAR, NEAR], [FAR, NEAR, NEAR]];
    let signs = (0..8).map(|i| Vec3::from([0, 1, 2].map(|a| 1.0 - 2.0 * (i >> a & 1) as f32)));
    let all = signs.flat_map(|s| places.map(|p| (turn * (Vec3::from(p) * s)).normalize()));
    all.collect()
}

/// Parallel rays through the box of a volume, which start where they enter it, and the volume that
/// each stands for, voxels per unit of its length. Each direction has its lattice in another place.
fn lattice(blocks: &Blocks, direction: Vec3, key: u64) -> (Vec<Ray>, f32) {
    let along = blocks.in_index(direction.as_dvec3());
    let main = (1..3).fold(0, |m, a| {
        if along[a].abs() > along[m].abs() {
            a
        } else {
            m
        }
    });
    let across = [(main + 1) % 3, (main + 2) % 3];
    let dims = blocks.dims.map(f64::from);
    let slope = across.map(|a| along[a] / along[main]);
    let spacing = Sweeps::APART * edge(blocks);
    let spacing = [0, 1].map(|i| {
        let width = dims[across[i]] + slope[i].abs() * dims[main];
        spacing.max(width / Sweeps::MOST_ALONG)
    });
    let shift = unit2(hash(&[key])).map(f64::from);
    // Where rays pass the lower end of the main axis.
    let places = |i: usize| {
        let reach = slope[i] * dims[main];
        let (low, high) = ((-reach).min(0.0), dims[across[i]] + (-reach).max(0.0));
        let first = (low / spacing[i] - shift[i]).floor() as i64;
        let last = (high / spacing[i] - shift[i]).ceil() as i64;
        (first..=last).map(move |n| (n as f64 + shift[i]) * spacing[i])
    };
    let start = if along[main] > 0.0 { 0.0 } else { dims[main] };
    let mut rays = Vec::new();
    for u in places(0) {
        for v in places(1) {
            let mut point = DVec3::ZERO;
            point[main] = start;
            point[across[0]] = u + slope[0] * start;
            point[across[1]] = v + slope[1] * start;
            let origin = blocks.scene_from_index.transform_point3(point).as_vec3();
            // A little before the box, as its end is rounded.
            let origin = origin - direction * (4.0 * offset(origin));
            let ray = Ray::endless(origin, direction);
            if let Some((near, far)) = blocks.ends(&ray) {
                rays.push(Ray::new(ray.at(near), direction, far - near));
            }
        }
    }
    let section = spacing[0] * spacing[1] * along[main].abs();
    (rays, section as f32)
}

/// The edge that half of all blocks are larger than, voxels.
fn edge(blocks: &Blocks) -> f64 {
    let mut counts = [0_usize; 256];
    for level in &blocks.levels {
        counts[usize::from(*level)] += 1;
    }
    let mut smaller = 0;
    let level = counts.iter().position(|n| {
        smaller += n;
        2 * smaller >= blocks.len()
    });
    f64::from(1 << level.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_have_the_moments_of_the_sphere() {
        let directions = directions();
        let mean = |f: &dyn Fn(Vec3) -> f32| {
            directions.iter().map(|d| f(*d)).sum::<f32>() / directions.len() as f32
        };
        for (found, expected) in [
            (mean(&|d| d.x), 0.0),
            (mean(&|d| d.x * d.y), 0.0),
            (mean(&|d| d.z * d.z), 1.0 / 3.0),
            (mean(&|d| d.y.powi(4)), 1.0 / 5.0),
            (mean(&|d| d.x.abs()), 0.5),
            (mean(&|d| d.y.abs()), 0.5),
            (mean(&|d| d.z.abs()), 0.5),
        ] {
            assert!((found - expected).abs() < 1e-3, "{found} {expected}");
        }
    }
}
