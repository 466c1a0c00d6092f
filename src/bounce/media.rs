//! The light that media scatter, every order of it, as sources of their blocks.

use super::blocks::Blocks;
use super::diffusion::Diffusion;
use super::krylov;
use super::lattice::DIRECTIONS;
use super::light::Light;
use super::receivers::Receiver;
use super::sweeps::Sweeps;
use super::walls::WallLight;
use crate::Result;
use crate::math::Rgb;
use crate::math::exp::exp_neg_and_rest;
use crate::run::Cancel;
use rayon::prelude::*;

/// One volume, and the sources of its blocks.
#[derive(Debug)]
pub struct ScatteringVolume<'a> {
    blocks: &'a Blocks,
    sweeps: Sweeps<'a>,
    diffusion: Diffusion,
    /// Of light that comes straight from lights.
    direct: &'a [Light],
    /// Of all light.
    sources: Vec<Light>,
    /// Length of what they are made of.
    scale: f64,
    /// Sweeps that were made.
    pub swept: u32,
    /// What the sources of the last solution are off by, over what they are made of.
    pub residual: f64,
}

impl<'a> ScatteringVolume<'a> {
    /// Bytes a block, at most: itself, its light in all sums of a sweep, and the vectors of the
    /// solver.
    pub const BYTES_A_BLOCK: u64 = (Sweeps::BYTES_A_BLOCK
        + Diffusion::BYTES_A_BLOCK
        + size_of::<Light>() * (3 + krylov::VECTORS)) as u64;
    /// Most sweeps of one solution.
    const MOST_SWEEPS: u32 = 200;

    /// A volume that scatters what comes straight from lights.
    pub fn new(blocks: &'a Blocks, sweeps: Sweeps<'a>, direct: &'a [Light]) -> Self {
        Self {
            blocks,
            diffusion: Diffusion::new(blocks),
            sweeps,
            direct,
            sources: direct.to_vec(),
            scale: 0.0,
            swept: 0,
            residual: 0.0,
        }
    }

    /// The rays through it.
    pub fn sweeps(&self) -> &Sweeps<'a> {
        &self.sweeps
    }

    /// Sources of its blocks.
    pub fn sources(&self) -> &[Light] {
        &self.sources
    }

    /// What the sources are beyond direct light.
    fn added(&self) -> Vec<Light> {
        let pairs = self.sources.iter().zip(self.direct);
        pairs.map(|(all, direct)| *all - *direct).collect()
    }

    /// What blocks with these sources scatter of each other's light and of that of surfaces.
    fn scattered(
        &self,
        sources: &[Light],
        walls: &WallLight,
        cancel: &Cancel,
    ) -> Result<Vec<Light>> {
        let albedo = Light::from(self.blocks.albedo);
        let mut light = self.sweeps.means(sources, walls, cancel)?;
        light.par_iter_mut().for_each(|l| *l *= albedo);
        Ok(light)
    }

    /// Lets its light scatter once more.
    ///
    /// # Errors
    /// A stop on request.
    pub fn scatter_once(&mut self, walls: &WallLight, cancel: &Cancel) -> Result<()> {
        let mut next = self.scattered(&self.sources, walls, cancel)?;
        next.iter_mut().zip(self.direct).for_each(|(n, d)| *n += *d);
        self.sources = next;
        self.swept += 1;
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
        let given = start.par_iter().zip(self.direct);
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
                let given = given.map(|(r, weight)| *r * (*weight / all_directions));
                let mut spread = diffusion.spread(&given.collect::<Vec<_>>());
                let pairs = r.par_iter().zip(kept);
                (spread.par_iter_mut().zip(pairs)).for_each(|(s, (r, kept))| {
                    *s = *s * albedo + *r / (1.0 - albedo * *kept);
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
        let missed = all.zip(weights).filter(|(_, weight)| **weight == 0.0);
        missed.for_each(|((source, direct), _)| *source = *direct);
        Ok(())
    }
}

/// By receiver: what volumes send to it beyond the direct light that they scatter.
pub fn at_receivers(receivers: &[Receiver], volumes: &[ScatteringVolume]) -> Vec<Rgb> {
    let added: Vec<Vec<Light>> = volumes.iter().map(ScatteringVolume::added).collect();
    let at = |receiver: &Receiver| {
        let mut met = receiver.met.iter().peekable();
        let mut sum = Light::ZERO;
        for (i, ray) in (0..).zip(receiver.rays()) {
            let end = met
                .next_if(|m| m.ray == i)
                .map_or(f32::INFINITY, |m| m.hit.t);
            let ray = ray.up_to(end);
            for (volume, added) in volumes.iter().zip(&added) {
                let mut passing = 1.0;
                volume.blocks.walk(&ray, |block, near, far| {
                    let tau = volume.blocks.sigma_t[block] * (far - near);
                    let (passed, taken) = exp_neg_and_rest(tau);
                    sum += added[block] * (passing * taken);
                    passing *= passed;
                });
            }
        }
        Rgb((sum / receiver.count as f32).to_array())
    };
    receivers.par_iter().map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bounce::crossings::Room;
    use glam::{DAffine3, DVec3};
    use lvox_formats::record::{Lvoxel, VolumeInfo};

    /// What a wide slab of so many cells of depth `cell` reflects and lets through of a parallel
    /// beam that falls straight onto it.
    fn slab(cells: u32, cell: f64, albedo: f64) -> (f64, f64, u32) {
        const WIDE: u32 = 64;
        let info = VolumeInfo {
            name: String::new(),
            dims: [WIDE, WIDE, cells],
            index_from_scene: DAffine3::from_scale(DVec3::splat(1.0 / cell)).to_cols_array_2d(),
            albedo: [albedo as f32; 3],
        };
        let mut blocks = Blocks::new(&info);
        let mut direct = Vec::new();
        let passed = |depth: f64| (-depth).exp();
        for z in 0..cells {
            let (top, bottom) = (f64::from(z) * cell, f64::from(z + 1) * cell);
            let mean = (passed(top) - passed(bottom)) / cell;
            let source = albedo * mean / (4.0 * std::f64::consts::PI);
            for i in 0..WIDE * WIDE {
                blocks.push(&Lvoxel {
                    block: [i % WIDE, i / WIDE, z].map(|v| v as u16),
                    sigma_t: 1.0,
                    ..Lvoxel::default()
                });
                direct.push(Light::splat(source as f32));
            }
        }
        let mut volume = ScatteringVolume::new(
            &blocks,
            Sweeps::alone(&blocks, &Room::new(u64::MAX)),
            &direct,
        );
        volume
            .solve(&WallLight::NONE, 1e-3, &Cancel::default())
            .unwrap();
        assert!(volume.residual <= 1e-3);
        // Means over the middle, where the borders are far: rays meet each block in few places.
        let middle = WIDE / 2 - 8..WIDE / 2 + 8;
        let source = |z: u32| {
            let rows = middle.clone().map(|y| (z * WIDE + y) * WIDE);
            let blocks = rows.flat_map(|row| middle.clone().map(move |x| (row + x) as usize));
            blocks.map(|b| f64::from(volume.sources[b].x)).sum::<f64>() / 256.0
        };
        let leaving = |depth_before: &dyn Fn(u32) -> f64| {
            let steps = 200;
            let flux = (0..steps).map(|i| {
                let mu = (f64::from(i) + 0.5) / f64::from(steps);
                let seen = (0..cells)
                    .map(|z| source(z) * passed(depth_before(z) / mu) * (1.0 - passed(cell / mu)));
                2.0 * std::f64::consts::PI * mu * seen.sum::<f64>() / f64::from(steps)
            });
            flux.sum::<f64>()
        };
        let reflected = leaving(&|z| f64::from(z) * cell);
        let depth = f64::from(cells) * cell;
        let through = leaving(&|z| f64::from(cells - 1 - z) * cell) + passed(depth);
        (reflected, through, volume.swept)
    }

    /// Discrete ordinates to convergence (PythonicDISORT): isotropic scattering of albedo 0.999 in
    /// a slab of depth 10 reflects 0.8389 and lets through 0.1382. Means over cells move light a
    /// little too far, by the more the deeper the cells are, and lose none.
    #[test]
    fn slabs_reflect_and_let_through_what_discrete_ordinates_say() {
        let (reflected, through, swept) = slab(14, 10.0 / 14.0, 0.999);
        assert!((reflected - 0.8389).abs() < 0.018, "{reflected}");
        assert!((through - 0.1382).abs() < 0.018, "{through}");
        assert!(swept <= 12, "{swept}");
        let (reflected, through, _) = slab(14, 10.0 / 14.0, 1.0);
        // The borders let some of it out.
        let all = reflected + through;
        assert!((0.96..1.005).contains(&all), "{reflected} {through}");
    }
}
