//! Light that media and surfaces send through one volume, as means over its blocks: along each of
//! some directions, parallel rays pass all blocks once, and light goes along them both ways.
//!
//! Means over blocks are what a block takes and gives back, so that no light is lost or made from
//! one order of scattering to the next, whatever the size of blocks. The method of characteristics
//! of neutron transport does the same (Askew 1972). As light goes both ways along the same rays, as
//! much of what one block sends arrives at another as the other way round: the matrix of all this,
//! weighted by the depth of blocks, is symmetric.

use super::blocks::Blocks;
use super::crossings::{Bundle, Crossing, Room};
use super::lattice::{self, DIRECTIONS};
pub use super::light::{Light, Share};
use super::walls::{self, Wall, WallLight, Walls};
use crate::Result;
use crate::math::Ray;
use crate::run::Cancel;
use crate::trace::Tracer;
use glam::Vec3;
use lvox_formats::record::VolumeInfo;
use rayon::prelude::*;
use std::sync::Mutex;

/// What is carried through a volume.
pub trait Carried: Sync {
    /// What a block sends along a direction.
    fn sent(&self, block: usize, travel: Vec3) -> Light;

    /// The mean of all directions that it sends.
    fn kept(&self, block: usize) -> Light;

    /// What is carried of the light that comes along a direction from surfaces or from outside.
    #[inline]
    fn of_surface(&self, light: Light, _travel: Vec3) -> Light {
        light
    }
}

/// Light of blocks with these sources, which send it alike in all directions.
struct Even<'a>(&'a [Light]);

impl Carried for Even<'_> {
    #[inline]
    fn sent(&self, block: usize, _travel: Vec3) -> Light {
        self.0[block]
    }

    #[inline]
    fn kept(&self, block: usize) -> Light {
        self.0[block]
    }
}

/// All rays of one direction.
#[derive(Debug)]
struct Direction<K> {
    along: Vec3,
    bundles: Vec<Bundle<K>>,
    /// Volume of the medium that a ray stands for, voxels per unit of its length.
    section: f32,
}

/// Rays of all directions through one volume.
#[derive(Debug)]
pub struct Sweeps<'a, K> {
    blocks: &'a Blocks,
    directions: Vec<Direction<K>>,
    /// By block: what all rays in it stand for, volume times extinction.
    depths: Vec<K>,
    /// By block: share of what it sends that arrives in itself.
    kept: Vec<K>,
    /// Sums that are not in use: memory that is new takes long.
    spare: Mutex<Vec<Vec<Light>>>,
}

impl<'a, K: Share> Sweeps<'a, K> {
    /// Directions that are swept one after the other, into the same sums.
    const IN_TURN: usize = 2;
    /// Bytes a block, at most: itself, and its sums of all directions.
    pub const BYTES_A_BLOCK: usize =
        Blocks::BYTES + 2 * size_of::<K>() + size_of::<Light>() * (DIRECTIONS / Self::IN_TURN + 1);

    /// Bytes that the rays through a volume take, at most, without what they cross; walls are on
    /// them in scenes that have surfaces.
    pub fn bytes_for(volume: &VolumeInfo, has_surfaces: bool) -> u64 {
        /// Of a ray, one at each of its ends and one in between.
        const WALLS: usize = 3;
        let [x, y, z] = volume.dims.map(f64::from);
        // A lattice is as wide as the box and its shear, across each of two axes.
        let along = |width: f64| (width / lattice::APART).min(lattice::MOST_ALONG).ceil() + 2.0;
        let across = [[x + y, x + z], [y + x, y + z], [z + x, z + y]];
        let rays = across.map(|[u, v]| along(u) * along(v));
        let rays = DIRECTIONS as u64 * rays.into_iter().fold(0.0, f64::max) as u64;
        let walls = if has_surfaces { WALLS } else { 0 };
        rays * (size_of::<Ray>() + size_of::<u32>() + walls * size_of::<Wall>()) as u64
    }

    /// Bytes that laying down what rays cross takes for so many blocks, about.
    pub fn bytes_laid_down(blocks: u64) -> u64 {
        /// Of a block: 8 where all are of one size.
        const CROSSINGS: u64 = 24;
        blocks.saturating_mul(CROSSINGS * size_of::<Crossing<K>>() as u64)
    }

    /// The rays through a volume, and the surfaces on them. What rays cross is laid down where
    /// there is room.
    ///
    /// # Errors
    /// A stop on request.
    pub fn new(blocks: &'a Blocks, walls: &Walls, room: &Room, cancel: &Cancel) -> Result<Self> {
        Self::of_walls(blocks, |ray| walls.on(ray), room, cancel)
    }

    /// The rays through a volume without surfaces.
    #[cfg(test)]
    pub fn alone(blocks: &'a Blocks, room: &Room) -> Self {
        Self::of_walls(blocks, |_| Vec::new(), room, &Cancel::default()).unwrap()
    }

    fn of_walls(
        blocks: &'a Blocks,
        walls: impl Fn(&Ray) -> Vec<Wall> + Sync,
        room: &Room,
        cancel: &Cancel,
    ) -> Result<Self> {
        let directions = lattice::directions(0).into_par_iter().enumerate();
        let laid = directions.map(|(i, direction)| {
            let (rays, section) = rays(blocks, direction, 0, i);
            let mut sums = vec![Taken::default(); blocks.len()];
            let bundles = rays.chunks(Bundle::<K>::RAYS).map(|rays| {
                cancel.check()?;
                Ok(Bundle::laid_down(
                    blocks,
                    rays,
                    room,
                    &walls,
                    |crossing, tau| {
                        sums[crossing.block as usize].add(crossing, tau, 2.0 * section);
                    },
                ))
            });
            let bundles = bundles.collect::<Result<_>>()?;
            let direction = Direction {
                along: direction,
                bundles,
                section,
            };
            Ok((direction, sums))
        });
        let (directions, sums): (Vec<_>, Vec<_>) =
            laid.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        let of_block = |i: usize| Taken::of_all(sums.iter().map(|s| s[i]));
        let (depths, kept) = (0..blocks.len()).into_par_iter().map(of_block).unzip();
        Ok(Self {
            blocks,
            directions,
            depths,
            kept,
            spare: Mutex::default(),
        })
    }

    /// Whether a surface is on any ray.
    pub fn meet_surfaces(&self) -> bool {
        let mut bundles = self.directions.iter().flat_map(|d| &d.bundles);
        bundles.any(Bundle::has_walls)
    }

    /// By block: what all rays in it stand for, volume times extinction; 0 where none passes.
    pub fn depths(&self) -> &[K] {
        &self.depths
    }

    /// By block: the share of what it sends that arrives in itself.
    pub fn kept(&self) -> &[K] {
        &self.kept
    }

    /// The mean over the sphere and over each block of the light that comes from blocks with these
    /// sources and from surfaces, at whose receivers this light arrives beside what is in the tree.
    ///
    /// # Errors
    /// A stop on request.
    pub fn means(&self, sources: &[Light], at: &WallLight, cancel: &Cancel) -> Result<Vec<Light>> {
        self.means_from(sources, at, &[[Light::ZERO; 2]; DIRECTIONS], cancel)
    }

    /// The same with light that comes from outside along each direction and against it, where there
    /// is no surface.
    ///
    /// # Errors
    /// A stop on request.
    pub fn means_from(
        &self,
        sources: &[Light],
        at: &WallLight,
        outside: &[[Light; 2]; DIRECTIONS],
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        self.swept(&Even(sources), at, outside, cancel)
    }

    /// The same of what is carried, as these say that blocks and surfaces send it.
    ///
    /// # Errors
    /// A stop on request.
    pub fn means_of(
        &self,
        carried: &impl Carried,
        at: &WallLight,
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        self.swept(carried, at, &[[Light::ZERO; 2]; DIRECTIONS], cancel)
    }

    /// The same of these sources alone, along the rays of another set of directions, with surfaces
    /// that send nothing.
    ///
    /// # Errors
    /// A stop on request.
    pub fn means_along(
        &self,
        tracer: &Tracer,
        set: u32,
        sources: &[Light],
        outside: &[[Light; 2]; DIRECTIONS],
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        let (blocks, directions) = (self.blocks, lattice::directions(set));
        let outside = outside.par_chunks(Self::IN_TURN);
        let in_turn = directions.par_chunks(Self::IN_TURN);
        let swept = in_turn
            .zip(outside)
            .enumerate()
            .map(|(turn, (directions, outside))| {
                let mut sums = self.spare_sums();
                let mut taken = vec![Taken::default(); blocks.len()];
                for (i, (direction, outside)) in directions.iter().zip(outside).enumerate() {
                    let (rays, section) = rays(blocks, *direction, set, turn * Self::IN_TURN + i);
                    let sweep = Sweep {
                        carried: &Even(sources),
                        at: &WallLight::NONE,
                        outside: *outside,
                        travel: [*direction, -*direction],
                        section,
                    };
                    for rays in rays.chunks(Bundle::<K>::RAYS) {
                        cancel.check()?;
                        let walls = |ray: &Ray| walls::hiding(tracer, ray);
                        let all = Room::new(u64::MAX);
                        let meet = |crossing: Crossing<K>, tau: K| {
                            taken[crossing.block as usize].add(crossing, tau, 2.0 * section);
                        };
                        let bundle = Bundle::laid_down(blocks, rays, &all, walls, meet);
                        bundle.each(blocks, &mut Vec::new(), |crossings, walls| {
                            sweep.ray(crossings, walls, &mut sums);
                        });
                    }
                }
                Ok((sums, taken))
            });
        let (sums, taken): (Vec<_>, Vec<_>) =
            swept.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        let mean = |i: usize| {
            let (depth, kept) = Taken::of_all(taken.iter().map(|t| t[i]));
            mean_of(sources[i], kept, depth, &sums, i)
        };
        let means = (0..blocks.len()).into_par_iter().map(mean).collect();
        if let Ok(mut spare) = self.spare.lock() {
            *spare = sums;
        }
        Ok(means)
    }

    /// Light that blocks take, times the volume that each ray stands for: none as yet.
    fn spare_sums(&self) -> Vec<Light> {
        let spare = self.spare.lock().ok().and_then(|mut s| s.pop());
        let mut sums = spare.unwrap_or_default();
        sums.clear();
        sums.resize(self.blocks.len(), Light::ZERO);
        sums
    }

    fn swept(
        &self,
        carried: &impl Carried,
        at: &WallLight,
        outside: &[[Light; 2]; DIRECTIONS],
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        let outside = outside.par_chunks(Self::IN_TURN);
        let in_turn = self.directions.par_chunks(Self::IN_TURN);
        let swept = in_turn.zip(outside).map(|(directions, outside)| {
            let mut sums = self.spare_sums();
            let mut walked = Vec::new();
            for (direction, outside) in directions.iter().zip(outside) {
                let sweep = Sweep {
                    carried,
                    at,
                    outside: *outside,
                    travel: [direction.along, -direction.along],
                    section: direction.section,
                };
                for bundle in &direction.bundles {
                    cancel.check()?;
                    bundle.each(self.blocks, &mut walked, |crossings, walls| {
                        sweep.ray(crossings, walls, &mut sums);
                    });
                }
            }
            Ok(sums)
        });
        let swept = swept.collect::<Result<Vec<_>>>()?;
        let mean = |i: usize| mean_of(carried.kept(i), self.kept[i], self.depths[i], &swept, i);
        let means = (0..self.blocks.len()).into_par_iter().map(mean).collect();
        if let Ok(mut spare) = self.spare.lock() {
            *spare = swept;
        }
        Ok(means)
    }
}

/// What rays are in a block and take of it.
#[derive(Clone, Copy, Debug, Default)]
struct Taken<K> {
    /// Volume that they stand for, times extinction.
    depth: K,
    /// The same of what is taken of light of 1.
    light: K,
}

impl<K: Share> Taken<K> {
    fn add(&mut self, crossing: Crossing<K>, tau: K, section: f32) {
        self.depth += tau * section;
        self.light += crossing.taken * section;
    }

    /// The depth of all, and the share of what the block sends that arrives in itself.
    fn of_all(all: impl Iterator<Item = Self>) -> (K, K) {
        let none = (K::default(), K::default());
        let (depth, light) = all.fold(none, |(d, l), t| (d + t.depth, l + t.light));
        // Of what no ray passes nothing is known.
        let all = depth.each(|d| if d > 0.0 { 1.0 } else { 0.0 });
        let kept = (all - light.over(depth)).each(|k| k.max(0.0));
        (depth, kept)
    }
}

/// The mean light in a block that sends this, keeps this share of it, and took the light in all
/// sums.
fn mean_of<K: Share>(sent: Light, kept: K, depth: K, sums: &[Vec<Light>], block: usize) -> Light {
    if depth.most() > 0.0 {
        let taken: Light = sums.iter().map(|sums| sums[block]).sum();
        let depth = depth.light();
        let arriving = Light::select(depth.cmpgt(Light::ZERO), taken / depth, Light::ZERO);
        sent * kept.light() + arriving
    } else {
        Light::ZERO
    }
}

/// The rays of one direction of a set, in places of their own.
fn rays(blocks: &Blocks, direction: Vec3, set: u32, number: usize) -> (Vec<Ray>, f32) {
    lattice::rays(blocks, direction, u64::from(set) << 32 | number as u64)
}

/// What the rays of one direction pass.
struct Sweep<'a, C> {
    carried: &'a C,
    at: &'a WallLight<'a>,
    /// Along the rays and against them.
    outside: [Light; 2],
    travel: [Vec3; 2],
    section: f32,
}

impl<C: Carried> Sweep<'_, C> {
    /// Adds the light that blocks take from one ray and from the one against it.
    fn ray<K: Share>(&self, crossings: &[Crossing<K>], walls: &[Wall], sums: &mut [Light]) {
        let [ahead, back] =
            [0, 1].map(|way| move |light: Light| self.carried.of_surface(light, self.travel[way]));
        let [outside_ahead, outside_back] = self.outside;
        let at = self.at;
        let count = crossings.len();
        let inner = |w: &Wall| w.before > 0 && (w.before as usize) < count;
        if !walls.iter().any(inner) {
            let ends = [0, count].map(|n| move |w: &&Wall| w.before as usize == n);
            let along = walls.iter().rfind(ends[0]).map(|w| at.sent(&w.ahead));
            let against = walls.iter().find(ends[1]).map(|w| at.sent(&w.back));
            let light = [
                ahead(along.unwrap_or(outside_ahead)),
                back(against.unwrap_or(outside_back)),
            ];
            self.both_ways(crossings, light, sums);
            return;
        }
        let mut light = ahead(outside_ahead);
        let mut from = 0;
        for wall in walls {
            let before = wall.before as usize;
            self.one_way::<K, 0>(crossings[from..before].iter(), light, sums);
            (from, light) = (before, ahead(at.sent(&wall.ahead)));
        }
        self.one_way::<K, 0>(crossings[from..].iter(), light, sums);
        light = back(outside_back);
        let mut to = count;
        for wall in walls.iter().rev() {
            let before = wall.before as usize;
            self.one_way::<K, 1>(crossings[before..to].iter().rev(), light, sums);
            (to, light) = (before, back(at.sent(&wall.back)));
        }
        self.one_way::<K, 1>(crossings[..to].iter().rev(), light, sums);
    }

    /// Takes light from blocks one after the other.
    #[inline]
    fn one_way<'c, K: Share + 'c, const WAY: usize>(
        &self,
        crossings: impl Iterator<Item = &'c Crossing<K>>,
        mut light: Light,
        sums: &mut [Light],
    ) {
        for crossing in crossings {
            self.cross::<K, WAY>(crossing, &mut light, sums);
        }
    }

    /// The same along a ray and against it, in turn: one need not wait for the other.
    #[inline]
    fn both_ways<K: Share>(
        &self,
        crossings: &[Crossing<K>],
        mut light: [Light; 2],
        sums: &mut [Light],
    ) {
        let [along, against] = &mut light;
        for (ahead, back) in crossings.iter().zip(crossings.iter().rev()) {
            self.cross::<K, 0>(ahead, along, sums);
            self.cross::<K, 1>(back, against, sums);
        }
    }

    #[inline]
    fn cross<K: Share, const WAY: usize>(
        &self,
        crossing: &Crossing<K>,
        light: &mut Light,
        sums: &mut [Light],
    ) {
        let &Crossing { block, taken } = crossing;
        let block = block as usize;
        sums[block] += *light * (taken * self.section).light();
        let taken = taken.light();
        *light = *light * (Light::ONE - taken) + self.carried.sent(block, self.travel[WAY]) * taken;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounce::blocks::tests::uneven;
    use crate::bounce::walls::WallSide;
    use crate::math::Rgb;
    use crate::math::exp::exp_neg_and_rest;
    use crate::math::sampling::{hash, unit2};

    fn by_chance(count: usize, key: u64) -> Vec<Light> {
        let light = |i| {
            let [a, b] = unit2(hash(&[key, i as u64]));
            Light::new(a, b, a * b)
        };
        (0..count).map(light).collect()
    }

    /// Surfaces behind a ray, before its end, and in between.
    fn walls(ray: &Ray) -> Vec<Wall> {
        let side = |part: f32| WallSide::of(Rgb([part, 1.0, 2.0 - part]));
        let inner = (ray.origin.x > 4.0).then_some(0.4 * ray.t_max);
        let at = [Some(f32::NEG_INFINITY), inner, Some(f32::INFINITY)];
        let wall = |t| Wall {
            t,
            before: 0,
            ahead: side(0.25),
            back: side(0.75),
        };
        at.into_iter().flatten().map(wall).collect()
    }

    /// The mean along all rays, one block at a time.
    fn plain(blocks: &Blocks, sources: &[Light]) -> Vec<Light> {
        let mut sums = vec![(Light::ZERO, 0.0_f32); blocks.len()];
        for (i, direction) in lattice::directions(0).into_iter().enumerate() {
            let (rays, section) = lattice::rays(blocks, direction, i as u64);
            for ray in rays {
                let mut met = Vec::new();
                blocks.walk(&ray, |block, near, far| met.push((block, near, far)));
                for is_back in [false, true] {
                    let mut walls = walls(&ray);
                    if is_back {
                        met.reverse();
                        walls.reverse();
                    }
                    let mut walls = walls.into_iter().peekable();
                    let mut light = Light::ZERO;
                    for &(block, near, far) in &met {
                        let middle = 0.5 * (near + far);
                        let is_passed =
                            |w: &Wall| if is_back { w.t > middle } else { w.t <= middle };
                        while let Some(wall) = walls.next_if(is_passed) {
                            let side = if is_back { wall.back } else { wall.ahead };
                            light = WallLight::tree().sent(&side);
                        }
                        let tau = blocks.sigma_t[block] * (far - near);
                        let (passed, taken) = exp_neg_and_rest(tau);
                        let share = if tau > 1e-4 {
                            taken / tau
                        } else {
                            1.0 - 0.5 * tau
                        };
                        let mean = sources[block] + (light - sources[block]) * share;
                        sums[block].0 += mean * (tau * section);
                        sums[block].1 += tau * section;
                        light = light * passed + sources[block] * taken;
                    }
                }
            }
        }
        let mean = |(sum, depth)| {
            if depth > 0.0 {
                sum / depth
            } else {
                Light::ZERO
            }
        };
        sums.into_iter().map(mean).collect()
    }

    #[test]
    fn means_are_those_of_plain_walks_whether_laid_down_or_not() {
        let blocks = uneven(0.9);
        let sources = by_chance(blocks.len(), 1);
        let expected = plain(&blocks, &sources);
        let found = [u64::MAX, 20_000, 0].map(|room| {
            let room = Room::new(room);
            let sweeps =
                Sweeps::<f32>::of_walls(&blocks, walls, &room, &Cancel::default()).unwrap();
            let means = |at| sweeps.means(&sources, &at, &Cancel::default()).unwrap();
            let _ = means(WallLight::NONE);
            means(WallLight::tree())
        });
        for (found, expected) in found[0].iter().zip(&expected) {
            let error = (*found - *expected).abs().max_element();
            assert!(
                error < 1e-5 * expected.max_element().max(1.0),
                "{found} {expected}"
            );
        }
        assert_eq!(found[0], found[1]);
        assert_eq!(found[0], found[2]);
    }

    #[test]
    fn as_much_light_goes_one_way_as_the_other() {
        let blocks = uneven(0.9);
        let sweeps = Sweeps::<f32>::alone(&blocks, &Room::new(u64::MAX));
        let [a, b] = [1, 2].map(|key| by_chance(blocks.len(), key));
        let arrives = |from: &[Light], at: &[Light]| {
            let means = sweeps.means(from, &WallLight::NONE, &Cancel::default());
            let of = |((m, a), d): ((&Light, &Light), &f32)| (*m * *a * *d).as_dvec3();
            means
                .unwrap()
                .iter()
                .zip(at)
                .zip(sweeps.depths())
                .map(of)
                .sum::<glam::DVec3>()
        };
        let (there, back) = (arrives(&a, &b), arrives(&b, &a));
        assert!(
            (there / back - 1.0).abs().max_element() < 1e-5,
            "{there} {back}"
        );
    }
}
