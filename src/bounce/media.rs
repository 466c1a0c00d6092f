//! The light that media scatter, every order of it, as sources of their blocks.

use super::blocks::Blocks;
use super::diffusion::Diffusion;
use super::krylov;
use super::lattice::DIRECTIONS;
use super::light::{Light, Share};
use super::lobes::{Lobes, Sent};
use super::receivers::{Met, Receiver};
use super::sweeps::Sweeps;
use super::walls::WallLight;
use crate::Result;
use crate::math::Rgb;
use crate::run::Cancel;
use crate::tree::media::TwoLobes;
use rayon::prelude::*;

/// One medium, and the sources of its blocks.
#[derive(Debug)]
pub struct ScatteringVolume<'a, K> {
    blocks: &'a Blocks,
    sweeps: Sweeps<'a, K>,
    diffusion: Diffusion<K>,
    /// Of light that comes straight from lights.
    direct: &'a [Light],
    /// Where light leaves in lobes: what the sources are made of, if not of direct light as it is.
    lobes: Option<(Lobes, Vec<Light>)>,
    /// Of all light.
    sources: Vec<Light>,
    /// What arrived in blocks when light last scattered, if that is kept.
    arrived: Option<Vec<Light>>,
    /// Length of what they are made of.
    scale: f64,
    /// Sweeps that were made.
    pub swept: u32,
    /// What the sources of the last solution are off by, over what they are made of.
    pub residual: f64,
}

impl<'a, K: Share> ScatteringVolume<'a, K> {
    /// Bytes a block, at most: itself, its light in all sums of a sweep, and the vectors of the
    /// solver.
    pub const BYTES_A_BLOCK: u64 = (Sweeps::<K>::BYTES_A_BLOCK
        + Diffusion::<K>::BYTES_A_BLOCK
        + size_of::<Light>() * (3 + krylov::VECTORS)) as u64;
    /// Bytes a block beside these where volumes share a grid: an albedo each, and what arrives.
    pub const BYTES_KEPT: u64 = Blocks::BYTES_OF_ALBEDO + size_of::<Light>() as u64;
    /// Most sweeps of one solution.
    const MOST_SWEEPS: u32 = 200;

    /// A volume that scatters what comes straight from lights.
    pub fn new(blocks: &'a Blocks, sweeps: Sweeps<'a, K>, direct: &'a [Light]) -> Self {
        Self {
            blocks,
            diffusion: Diffusion::new(blocks),
            sweeps,
            direct,
            lobes: None,
            sources: direct.to_vec(),
            arrived: None,
            scale: 0.0,
            swept: 0,
            residual: 0.0,
        }
    }

    /// The same where direct light leaves blocks in lobes, of a medium that scatters by a phase
    /// function and spreads light as these blocks do ([`Blocks::spreading`]).
    ///
    /// # Errors
    /// A stop on request.
    pub fn in_lobes(self, lobes: Lobes, cancel: &Cancel) -> Result<Self> {
        let given = lobes.given(&self.sweeps, self.blocks, self.direct, cancel)?;
        Ok(Self {
            lobes: Some((lobes, given)),
            swept: self.swept + 1,
            ..self
        })
    }

    /// The same that keeps what arrives in blocks when light scatters.
    pub fn that_keeps_arriving(self) -> Self {
        Self {
            arrived: Some(vec![Light::ZERO; self.blocks.len()]),
            ..self
        }
    }

    /// The mean over the sphere and over each block of the light that arrived there when it last
    /// scattered; nothing if that was not to be kept.
    pub fn arrived(&self) -> &[Light] {
        self.arrived.as_deref().unwrap_or_default()
    }

    fn given(&self) -> &[Light] {
        self.lobes.as_ref().map_or(self.direct, |(_, given)| given)
    }

    /// What the blocks of the medium itself send, and the lobes in which that leaves; none where it
    /// leaves alike in all directions.
    pub fn sent(&self) -> (Vec<Light>, Vec<TwoLobes>) {
        match &self.lobes {
            None => (self.sources.clone(), Vec::new()),
            Some((lobes, _)) => {
                let scattered = lobes.scattered(self.blocks, &self.sources, self.direct);
                let all = lobes.with_direct(self.blocks, scattered, self.direct);
                all.into_iter().map(|s| (s.light, s.lobes)).unzip()
            }
        }
    }

    /// Finds the directions of light that has scattered, if they matter.
    fn find_ways(&mut self, walls: &WallLight, cancel: &Cancel) -> Result<()> {
        if let Some((lobes, _)) = &mut self.lobes {
            lobes.find_ways(&self.sweeps, [&self.sources, self.direct], walls, cancel)?;
            self.swept += 1;
        }
        Ok(())
    }

    /// The rays through it.
    pub fn sweeps(&self) -> &Sweeps<'a, K> {
        &self.sweeps
    }

    /// Sources of its blocks.
    pub fn sources(&self) -> &[Light] {
        &self.sources
    }

    /// What blocks send beyond direct light.
    fn added(&self) -> Vec<Sent> {
        if let Some((lobes, _)) = &self.lobes {
            return lobes.scattered(self.blocks, &self.sources, self.direct);
        }
        let pairs = self.sources.iter().zip(self.direct);
        let even = |(all, direct): (&Light, &Light)| Sent::evenly(*all - *direct);
        pairs.map(even).collect()
    }

    /// What blocks with these sources scatter of each other's light and of that of surfaces.
    fn scattered(
        &self,
        sources: &[Light],
        walls: &WallLight,
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        let light = self.sweeps.means(sources, walls, cancel)?;
        Ok(self.by_albedo(light))
    }

    fn by_albedo(&self, mut light: Vec<Light>) -> Vec<Light> {
        let lit = light.par_iter_mut().enumerate();
        lit.for_each(|(i, l)| *l *= self.blocks.albedo_of(i));
        light
    }

    /// What blocks scatter of light that arrives in them, which is kept if it is to be.
    fn scattered_and_kept(&mut self, walls: &WallLight, cancel: &Cancel) -> Result<Vec<Light>> {
        let light = self.sweeps.means(&self.sources, walls, cancel)?;
        if let Some(arrived) = &mut self.arrived {
            arrived.clone_from(&light);
        }
        self.swept += 1;
        Ok(self.by_albedo(light))
    }

    /// Lets its light scatter once more.
    ///
    /// # Errors
    /// A stop on request.
    pub fn scatter_once(&mut self, walls: &WallLight, cancel: &Cancel) -> Result<()> {
        let mut next = self.scattered_and_kept(walls, cancel)?;
        next.iter_mut()
            .zip(self.given())
            .for_each(|(n, d)| *n += *d);
        // Of what has scattered now, before the next time.
        self.find_ways(walls, cancel)?;
        self.sources = next;
        Ok(())
    }

    /// Finds the sources of all orders of scattering between surfaces that send this light, until
    /// the residual over what they are made of is below `tolerance`.
    ///
    /// # Errors
    /// A stop on request.
    pub fn solve(&mut self, walls: &WallLight, tolerance: f64, cancel: &Cancel) -> Result<()> {
        let mut start = std::mem::take(&mut self.sources);
        // Of nothing, the residual is what sources are made of.
        let is_first = self.scale == 0.0;
        if is_first {
            start.fill(Light::ZERO);
        }
        let mut rest = if is_first && !self.sweeps.meet_surfaces() {
            start.clone()
        } else {
            self.swept += 1;
            self.scattered(&start, walls, cancel)?
        };
        let given = start.par_iter().zip(self.given());
        (rest.par_iter_mut().zip(given)).for_each(|(r, (x, d))| *r += *d - *x);
        let (weights, kept) = (self.sweeps.depths(), self.sweeps.kept());
        let rest_length = krylov::length(weights, &rest);
        if is_first {
            self.scale = rest_length;
        }
        let albedo = Light::from(self.blocks.albedo);
        let diffusion = &self.diffusion;
        let all_directions = 2.0 * DIRECTIONS as f32;
        let system = krylov::System {
            weights,
            product: |x: &[Light]| {
                let mut left = self.scattered(x, &WallLight::NONE, cancel)?;
                left.par_iter_mut().zip(x).for_each(|(l, x)| *l = *x - *l);
                Ok(left)
            },
            // What blocks send to themselves is known, and what scatters often spreads as if it
            // diffused (Alcouffe 1977).
            inverse: |r: &[Light]| {
                let given = r.par_iter().zip(weights);
                let given =
                    given.map(|(r, weight)| *r * weight.each(|w| w / all_directions).light());
                let mut spread = diffusion.spread(&given.collect::<Vec<_>>());
                let pairs = r.par_iter().zip(kept);
                (spread.par_iter_mut().zip(pairs)).for_each(|(s, (r, kept))| {
                    *s = *s * albedo + *r / (Light::ONE - albedo * kept.light());
                });
                spread
            },
        };
        let solved = system.solve(start, rest, tolerance * self.scale, Self::MOST_SWEEPS)?;
        self.swept += solved.products;
        self.residual = match self.scale > 0.0 {
            true => solved.residual / self.scale,
            false => 0.0,
        };
        // The solver is right to its residual, which may be more than all light of a dark place.
        self.sources = solved.x.into_iter().map(|x| x.max(Light::ZERO)).collect();
        // Where no ray passes nothing but direct light is known.
        let all = self.sources.iter_mut().zip(self.direct);
        for ((source, direct), weight) in all.zip(weights) {
            let is_missed = weight.light().cmpeq(Light::ZERO);
            *source = Light::select(is_missed, *direct, *source);
        }
        self.find_ways(walls, cancel)
    }

    /// Finds what arrives in blocks of all that they and surfaces send, if that is kept.
    ///
    /// # Errors
    /// A stop on request.
    pub fn find_arriving(&mut self, walls: &WallLight, cancel: &Cancel) -> Result<()> {
        if self.arrived.is_some() {
            self.scattered_and_kept(walls, cancel)?;
        }
        Ok(())
    }
}

/// By receiver: what volumes send to it beyond the direct light that they scatter, where these are
/// the surfaces that rays met.
pub fn at_receivers<K: Share>(
    receivers: &[Receiver],
    met: &[Vec<Met<K>>],
    volumes: &[ScatteringVolume<K>],
) -> Vec<Rgb> {
    let added: Vec<Vec<Sent>> = volumes.iter().map(ScatteringVolume::added).collect();
    let at = |(receiver, met): (&Receiver, &Vec<Met<K>>)| {
        let mut met = met.iter().peekable();
        let mut sum = Light::ZERO;
        let mut on_ray: Vec<(f32, f32, usize, usize)> = Vec::new();
        for (i, ray) in (0..).zip(receiver.rays()) {
            let end = met
                .next_if(|m| m.ray == i)
                .map_or(f32::INFINITY, |m| m.hit.t);
            let ray = ray.up_to(end);
            let mut passing = Light::ONE;
            let mut pass = |volume: usize, block: usize, near: f32, far: f32| {
                let blocks = volumes[volume].blocks;
                let tau = blocks.sigma_t[block] / blocks.scale * (far - near);
                let (passed, taken) = blocks.depth::<K>(tau).exp_neg_and_rest();
                sum += added[volume][block].along(-ray.direction) * (passing * taken.light());
                passing *= passed.light();
            };
            if let [volume] = volumes {
                (volume.blocks).walk(&ray, |block, near, far| pass(0, block, near, far));
                continue;
            }
            // Blocks of all media by where the ray enters them: media may be in each other.
            on_ray.clear();
            for (i, volume) in volumes.iter().enumerate() {
                let note = |block, near, far| on_ray.push((near, far, i, block));
                volume.blocks.walk(&ray, note);
            }
            on_ray.sort_by(|a, b| a.0.total_cmp(&b.0));
            for &(near, far, volume, block) in &on_ray {
                pass(volume, block, near, far);
            }
        }
        Rgb((sum / receiver.count as f32).to_array())
    };
    receivers.par_iter().zip(met).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounce::blocks::tests::{tinted, uneven};
    use crate::bounce::crossings::Room;
    use crate::math::sampling::{hash, unit2};
    use glam::{DAffine3, DVec3, Vec3};
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    /// A wide slab of so many cells of depth `cell` in a parallel beam.
    struct Slab {
        cells: u32,
        cell: f64,
        albedo: f64,
        mean_cosine: f32,
        /// Of the beam to the normal.
        cos: f64,
    }

    /// What of the light of a beam that falls onto a slab this reflects and lets through, and how
    /// many sweeps that took.
    fn leaving(slab: &Slab) -> (f64, f64, u32) {
        const WIDE: u32 = 64;
        let &Slab { cells, cell, .. } = slab;
        let info = VolumeInfo {
            name: String::new(),
            dims: [WIDE, WIDE, cells],
            index_from_scene: DAffine3::from_scale(DVec3::splat(1.0 / cell)).to_cols_array_2d(),
            albedo: [slab.albedo as f32; 3],
            extinction_color: [1.0; 3],
        };
        let g = slab.mean_cosine;
        let mut blocks = match g {
            0.0 => Blocks::new(&info),
            g => Blocks::new(&info).spreading(g),
        };
        let mut direct = Vec::new();
        let passed = |depth: f64| (-depth).exp();
        for z in 0..cells {
            let [top, bottom] = [z, z + 1].map(|z| f64::from(z) * cell / slab.cos);
            let mean = (passed(top) - passed(bottom)) / cell;
            let source = slab.albedo * mean / (4.0 * std::f64::consts::PI);
            for i in 0..WIDE * WIDE {
                blocks.push(&Lvoxel {
                    block: [i % WIDE, i / WIDE, z].map(|v| v as u16),
                    sigma_t: 1.0,
                    ..Lvoxel::default()
                });
                direct.push(Light::splat(source as f32 / blocks.scale));
            }
        }
        let sweeps = Sweeps::<f32>::alone(&blocks, &Room::new(u64::MAX));
        let mut volume = ScatteringVolume::new(&blocks, sweeps, &direct);
        let cancel = Cancel::default();
        if g != 0.0 {
            let beam = DVec3::new((1.0 - slab.cos * slab.cos).sqrt(), 0.0, slab.cos);
            let lobes = vec![beam.as_vec3() * g; direct.len()];
            volume = volume.in_lobes(Lobes::new(&lobes, g), &cancel).unwrap();
        }
        volume.solve(&WallLight::NONE, 1e-3, &cancel).unwrap();
        assert!(volume.residual <= 1e-3);
        let (light, ways) = volume.sent();
        let sent = |block: usize, travel: Vec3| match ways.get(block) {
            Some(&lobes) => Sent {
                light: light[block],
                lobes,
            }
            .along(travel),
            None => light[block],
        };
        // Means over the middle, where the borders are far: rays meet each block in few places.
        let middle = WIDE / 2 - 8..WIDE / 2 + 8;
        let source = |z: u32, travel: Vec3| {
            let rows = middle.clone().map(|y| (z * WIDE + y) * WIDE);
            let blocks = rows.flat_map(|row| middle.clone().map(move |x| (row + x) as usize));
            blocks.map(|b| f64::from(sent(b, travel).x)).sum::<f64>() / 256.0
        };
        let around = if g == 0.0 { 1 } else { 16 };
        let leaving = |to_front: bool| {
            let steps = if g == 0.0 { 200 } else { 40 };
            let mut flux = 0.0;
            for i in 0..steps * around {
                let mu = (f64::from(i / around) + 0.5) / f64::from(steps);
                let (sin, cos) =
                    (f64::from(i % around) / f64::from(around) * std::f64::consts::TAU).sin_cos();
                let across = (1.0 - mu * mu).sqrt();
                let along = if to_front { -mu } else { mu };
                let travel = DVec3::new(across * cos, across * sin, along).as_vec3();
                let seen = (0..cells).map(|z| {
                    let before = if to_front { z } else { cells - 1 - z };
                    let before = f64::from(before) * cell / mu;
                    source(z, travel) * passed(before) * (1.0 - passed(cell / mu))
                });
                flux += 2.0 * std::f64::consts::PI * mu * seen.sum::<f64>();
            }
            flux / f64::from(steps * around)
        };
        let through = leaving(false) + passed(f64::from(cells) * cell / slab.cos);
        (leaving(true), through, volume.swept)
    }

    /// Discrete ordinates to convergence (PythonicDISORT): isotropic scattering of albedo 0.999 in
    /// a slab of depth 10 reflects 0.8389 and lets through 0.1382. Means over cells move light a
    /// little too far, by the more the deeper the cells are, and lose none.
    #[test]
    fn slabs_reflect_and_let_through_what_discrete_ordinates_say() {
        let slab = |albedo| Slab {
            cells: 14,
            cell: 10.0 / 14.0,
            albedo,
            mean_cosine: 0.0,
            cos: 1.0,
        };
        let (reflected, through, swept) = leaving(&slab(0.999));
        assert!((reflected - 0.8389).abs() < 0.018, "{reflected}");
        assert!((through - 0.1382).abs() < 0.018, "{through}");
        assert!(swept <= 12, "{swept}");
        let (reflected, through, _) = leaving(&slab(1.0));
        // The borders let some of it out.
        let all = reflected + through;
        assert!((0.96..1.005).contains(&all), "{reflected} {through}");
    }

    /// The same for a mean cosine of 0.85 and a beam at a cosine of 0.9, by depth.
    #[test]
    fn slabs_that_scatter_forward_do_so_too() {
        for (depth, reflects, lets_through) in [(1.0, 0.0534, 0.9453), (5.0, 0.2718, 0.7191)] {
            let cells = f64::ceil(depth / 0.71);
            let (reflected, through, _) = leaving(&Slab {
                cells: cells as u32,
                cell: depth / cells,
                albedo: 0.999,
                mean_cosine: 0.85,
                cos: 0.9,
            });
            let off = [reflected - reflects, through - lets_through];
            assert!(off[0].abs() < 0.012, "{depth}: {reflected}");
            assert!(off[1].abs() < 0.01, "{depth}: {through}");
        }
    }

    /// The sources of a volume with uneven direct light.
    fn solved<K: Share>(blocks: &Blocks) -> Vec<Light> {
        let light = |i| Light::splat(unit2(hash(&[3, i as u64]))[0]);
        let direct: Vec<Light> = (0..blocks.len()).map(light).collect();
        let sweeps = Sweeps::<K>::alone(blocks, &Room::new(u64::MAX));
        let mut volume = ScatteringVolume::new(blocks, sweeps, &direct);
        let cancel = Cancel::default();
        volume.solve(&WallLight::NONE, 1e-5, &cancel).unwrap();
        volume.sources
    }

    #[test]
    fn each_channel_is_that_of_a_grey_medium() {
        const COLOR: [f32; 3] = [1.0, 0.25, 0.0];
        let evenly: Vec<Light> = solved::<f32>(&uneven(0.95));
        assert_eq!(solved::<Rgb>(&uneven(0.95)), evenly);
        let colored = solved::<Rgb>(&tinted(uneven(0.95), COLOR));
        for (c, share) in COLOR.into_iter().enumerate() {
            let mut grey = uneven(0.95);
            grey.sigma_t.iter_mut().for_each(|s| *s *= share);
            for (colored, grey) in colored.iter().zip(solved::<f32>(&grey)) {
                assert!(
                    (colored[c] / grey[c] - 1.0).abs() < 1e-3,
                    "{colored} {grey}"
                );
            }
        }
    }
}
