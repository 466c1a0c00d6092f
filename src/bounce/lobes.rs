//! Light that leaves blocks in lobes, in a medium that scatters by a phase function.
//!
//! Light that scatters often spreads as in a thinner medium that scatters alike in all directions
//! (similarity, van de Hulst 1980), which [`Blocks::spreading`] makes of blocks. Of direct light
//! the first flight is along its lobes; what arrives in the end has a mean direction, and what is
//! scattered of it a lobe around that.

use super::blocks::Blocks;
use super::lattice::{self, DIRECTIONS};
use super::light::{Light, Share};
use super::sweeps::{Carried, Sweeps};
use super::walls::WallLight;
use crate::Result;
use crate::run::Cancel;
use crate::tree::media::{TwoLobes, in_lobe};
use glam::Vec3;
use rayon::prelude::*;

/// Lobes of one volume.
#[derive(Debug)]
pub struct Lobes {
    mean_cosine: f32,
    /// By block: of direct light.
    direct: Vec<DirectLobe>,
    /// By block, of all light but that straight from lights: the mean over the sphere and over the
    /// block of the mean channel times the direction of travel.
    flux: Vec<Vec3>,
}

/// A lobe as few directions see it: the weights of all are 1 on average, and have its mean
/// direction.
#[derive(Clone, Copy, Debug)]
struct DirectLobe {
    mean: Vec3,
    scale: f32,
    tilt: Vec3,
}

impl DirectLobe {
    fn new(mean: Vec3, directions: &[Vec3; 2 * DIRECTIONS]) -> Self {
        let (mut all, mut way) = (0.0, Vec3::ZERO);
        for direction in directions {
            let weight = in_lobe(mean, *direction);
            all += weight;
            way += *direction * weight;
        }
        Self {
            mean,
            scale: directions.len() as f32 / all,
            // Directions have the second moment of the sphere.
            tilt: 3.0 * (mean - way / all),
        }
    }

    /// What leaves along one of the directions, over the mean of all.
    #[inline]
    fn weight(&self, travel: Vec3) -> f32 {
        in_lobe(self.mean, travel) * self.scale + self.tilt.dot(travel)
    }
}

impl Lobes {
    /// Bytes a block, with the light that is given and that is sent in the end.
    pub const BYTES_A_BLOCK: u64 =
        (size_of::<DirectLobe>() + 2 * size_of::<Vec3>() + size_of::<Light>() + size_of::<Sent>())
            as u64;
    /// The longest mean direction, as files have it.
    const LONGEST: f32 = 0.98;

    /// Of blocks whose direct light leaves in these mean directions, in a medium of this mean
    /// cosine.
    pub fn new(of_direct: &[Vec3], mean_cosine: f32) -> Self {
        let mut directions = [Vec3::ZERO; 2 * DIRECTIONS];
        for (both, d) in directions.chunks_mut(2).zip(lattice::directions(0)) {
            both.copy_from_slice(&[d, -d]);
        }
        let lobe = |mean: &Vec3| DirectLobe::new(*mean, &directions);
        Self {
            mean_cosine,
            direct: of_direct.par_iter().map(lobe).collect(),
            flux: vec![Vec3::ZERO; of_direct.len()],
        }
    }

    /// What sources are made of: direct light, and how much more or less of it scatters a second
    /// time as it leaves in lobes.
    ///
    /// # Errors
    /// A stop on request.
    pub fn given<K: Share>(
        &self,
        sweeps: &Sweeps<K>,
        blocks: &Blocks,
        direct: &[Light],
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        let more = More {
            direct,
            lobes: &self.direct,
        };
        let mut given = sweeps.means_of(&more, &WallLight::NONE, cancel)?;
        let pairs = given.iter_mut().zip(direct).enumerate();
        pairs.for_each(|(i, (g, d))| *g = *g * blocks.albedo_of(i) + *d);
        Ok(given)
    }

    /// Finds where light goes of blocks with these sources, of which this much is direct, between
    /// surfaces.
    ///
    /// # Errors
    /// A stop on request.
    pub fn find_ways<K: Share>(
        &mut self,
        sweeps: &Sweeps<K>,
        [sources, direct]: [&[Light]; 2],
        walls: &WallLight,
        cancel: &Cancel,
    ) -> Result<()> {
        let ways = Ways {
            sources,
            direct,
            lobes: &self.direct,
        };
        let flux = sweeps.means_of(&ways, walls, cancel)?;
        self.flux = flux.into_iter().map(Vec3::from).collect();
        Ok(())
    }

    /// What the blocks of the medium itself send beyond direct light, by its own phase function:
    /// the mean of all directions, and the mean direction.
    pub fn scattered(&self, blocks: &Blocks, sources: &[Light], direct: &[Light]) -> Vec<Sent> {
        let g = self.mean_cosine;
        let scattered = |(i, ((all, direct), flux)): (usize, ((&Light, &Light), &Vec3))| {
            let given = blocks.albedo_of(i);
            // Of the albedo that spreading made of it.
            let albedo = given / (given * g + (1.0 - g));
            let scattered = (*all - *direct).max(Light::ZERO);
            let arriving = mean(scattered / given.max(Light::splat(f32::MIN_POSITIVE)));
            let way = if arriving > 0.0 {
                (*flux / arriving).clamp_length_max(1.0)
            } else {
                Vec3::ZERO
            };
            Sent {
                light: scattered * (1.0 - albedo * g) / (1.0 - g),
                lobes: TwoLobes::one((way * g).clamp_length_max(Self::LONGEST)),
            }
        };
        let pairs = sources.par_iter().zip(direct).zip(&self.flux);
        pairs.enumerate().map(scattered).collect()
    }

    /// What the blocks of the medium itself send, beyond direct light and with it.
    pub fn with_direct(
        &self,
        blocks: &Blocks,
        scattered: Vec<Sent>,
        direct: &[Light],
    ) -> Vec<Sent> {
        let both = |((scattered, direct), lobe): ((Sent, &Light), &DirectLobe)| {
            let direct = *direct * blocks.scale;
            let light = scattered.light + direct;
            let all = mean(light);
            Sent {
                light,
                lobes: TwoLobes {
                    single_share: if all > 0.0 { mean(direct) / all } else { 0.0 },
                    single: lobe.mean,
                    rest: scattered.lobes.rest,
                },
            }
        };
        let pairs = scattered.into_par_iter().zip(direct).zip(&self.direct);
        pairs.map(both).collect()
    }
}

/// What a block sends.
#[derive(Clone, Copy, Debug)]
pub struct Sent {
    /// The mean of all directions.
    pub light: Light,
    /// How it leaves.
    pub lobes: TwoLobes,
}

impl Sent {
    /// The same in all directions.
    pub fn evenly(light: Light) -> Self {
        Self {
            light,
            lobes: TwoLobes::default(),
        }
    }

    /// What goes along a direction.
    #[inline]
    pub fn along(&self, travel: Vec3) -> Light {
        if self.lobes == TwoLobes::default() {
            return self.light;
        }
        self.light * self.lobes.along(travel)
    }
}

fn mean(light: Light) -> f32 {
    light.element_sum() * (1.0 / 3.0)
}

/// What leaves in lobes beyond what would leave alike in all directions.
struct More<'a> {
    direct: &'a [Light],
    lobes: &'a [DirectLobe],
}

impl Carried for More<'_> {
    #[inline]
    fn sent(&self, block: usize, travel: Vec3) -> Light {
        self.direct[block] * (self.lobes[block].weight(travel) - 1.0)
    }

    /// As much as without lobes.
    fn kept(&self, _block: usize) -> Light {
        Light::ZERO
    }
}

/// The mean channel of light times its direction.
struct Ways<'a> {
    sources: &'a [Light],
    direct: &'a [Light],
    lobes: &'a [DirectLobe],
}

impl Carried for Ways<'_> {
    #[inline]
    fn sent(&self, block: usize, travel: Vec3) -> Light {
        let more = self.direct[block] * (self.lobes[block].weight(travel) - 1.0);
        Light::from(travel) * mean(self.sources[block] + more)
    }

    fn kept(&self, block: usize) -> Light {
        Light::from(self.lobes[block].mean) * mean(self.direct[block])
    }

    #[inline]
    fn of_surface(&self, light: Light, travel: Vec3) -> Light {
        Light::from(travel) * mean(light)
    }
}
