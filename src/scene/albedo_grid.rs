//! A single-scattering albedo that varies over a medium.

use super::grid::{Grid, Region, VolumeGrid, VoxelBox};
use crate::math::Rgb;
use crate::{Error, Result};
use glam::Vec3;
use std::convert::Infallible;

/// The albedo of each voxel of a medium, in `[0,1]`, on the grid of its extinction: trilinear
/// between the centres of voxels. It is kept where the medium is; elsewhere it is 0, which no one
/// asks for. Clones are the same grid.
#[derive(Clone, Debug)]
pub struct AlbedoGrid {
    channels: [VolumeGrid; 3],
}

impl AlbedoGrid {
    /// Of red, green and blue, on as many voxels.
    #[must_use]
    pub fn new(channels: [VolumeGrid; 3]) -> Self {
        Self { channels }
    }

    /// Red, green and blue.
    #[must_use]
    pub fn channels(&self) -> &[VolumeGrid; 3] {
        &self.channels
    }

    /// The albedo at a point of index space.
    #[must_use]
    pub fn at(&self, point_in_index: Vec3) -> Rgb {
        Rgb(std::array::from_fn(|c| {
            self.channels[c].sample(point_in_index)
        }))
    }

    /// Reads its grids if they are in a file and were not read.
    ///
    /// # Errors
    /// As [`VolumeGrid::ready`].
    pub fn ready(&self) -> Result<()> {
        self.channels.iter().try_for_each(VolumeGrid::ready)
    }

    /// Bytes of memory.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.channels.iter().map(VolumeGrid::bytes).sum()
    }

    /// Refuses grids of other voxels than those of an extinction, and values that are no albedos.
    ///
    /// # Errors
    /// Says which.
    pub(super) fn check(&self, sigma_t: &Grid) -> Result<()> {
        let dims = sigma_t.dims();
        if let Some(other) = self.channels.iter().find(|g| g.dims() != dims) {
            return Err(Error::input(format!(
                "expected an albedo grid of {dims:?} voxels, as the extinction, found {:?}",
                other.dims()
            )));
        }
        let invalid = self.channels.iter().find_map(|g| g.first_invalid());
        let most = self
            .channels
            .iter()
            .map(VolumeGrid::max)
            .fold(0.0, f32::max);
        match invalid.or((most > 1.0).then_some(most)) {
            None => Ok(()),
            Some(value) => Err(Error::input(format!(
                "expected an albedo grid of numbers from 0 to 1, found {value}"
            ))),
        }
    }

    /// The mean over a medium of this extinction, weighted by that.
    #[must_use]
    pub fn mean(&self, sigma_t: &Grid) -> Rgb {
        let sum = |grid: &Grid| {
            let [width, _, _] = grid.dims();
            let rows = grid.means([width, 1, 1]);
            rows.into_iter().map(f64::from).sum::<f64>()
        };
        let all = sum(sigma_t);
        if all <= 0.0 {
            return Rgb::BLACK;
        }
        let mean = |c: usize| sum(&scattering(&self.channels[c], sigma_t)) / all;
        Rgb([0, 1, 2].map(|c| mean(c).min(1.0) as f32))
    }

    /// The same on voxels of twice the edge, each with the mean weighted by the extinction; `finer`
    /// and `coarser` are that before and after.
    pub(super) fn coarser(&self, finer: &Grid, coarser: &Grid) -> Self {
        let channel = |grid: &VolumeGrid| {
            let scattered = scattering(grid, finer).coarser();
            let plain = Grid::coarser(grid);
            let of = |region: &Region, samples: &mut [f32]| {
                let [mut given, mut even] = [(); 2].map(|()| vec![0.0; samples.len()]);
                scattered.read(&region.voxels, &mut given);
                plain.read(&region.voxels, &mut even);
                samples.fill(0.0);
                coarser.read(&region.voxels, samples);
                for (sample, (given, even)) in samples.iter_mut().zip(given.iter().zip(even)) {
                    // A voxel of no extinction is one that others are interpolated to.
                    let mean = if *sample > 0.0 { given / *sample } else { even };
                    *sample = mean.min(1.0);
                }
                Ok::<_, Infallible>(())
            };
            let Ok((grid, _)) = coarser.on_its_bricks(of);
            grid.into()
        };
        Self::new(self.channels.each_ref().map(channel))
    }
}

/// Albedo times extinction.
fn scattering(albedo: &Grid, sigma_t: &Grid) -> Grid {
    let of = |region: &Region, samples: &mut [f32]| {
        let mut albedos = vec![0.0; samples.len()];
        albedo.read(&region.voxels, &mut albedos);
        samples.fill(0.0);
        sigma_t.read(&region.voxels, samples);
        let product = |(s, a): (&mut f32, f32)| *s *= a;
        samples.iter_mut().zip(albedos).for_each(product);
        Ok::<_, Infallible>(())
    };
    let Ok((grid, _)) = sigma_t.on_its_bricks(of);
    grid
}

/// The mean albedo over a box of voxels, weighted by their extinction; `None` if there is none.
pub(super) fn mean_over(albedo: &AlbedoGrid, sigma_t: &Grid, voxels: VoxelBox) -> Option<Rgb> {
    let mut sum = Rgb::BLACK;
    let mut weights = 0.0;
    for voxel in voxels.voxels() {
        let centre = Vec3::from(voxel.map(|i| i as f32)) + 0.5;
        let weight = sigma_t.sample(centre);
        if weight > 0.0 {
            sum += albedo.at(centre) * weight;
            weights += weight;
        }
    }
    (weights > 0.0).then(|| Rgb((sum * (1.0 / weights)).0.map(|a| a.min(1.0))))
}

/// Whether the albedo changes at once between voxels of a box that are neighbours and hold medium.
pub(super) fn has_step(albedo: &AlbedoGrid, sigma_t: &Grid, voxels: VoxelBox) -> bool {
    /// What is less is as good as linear.
    const STEP: f32 = 0.2;
    let albedo_of = |voxel: [usize; 3]| {
        let centre = Vec3::from(voxel.map(|i| i as f32)) + 0.5;
        (sigma_t.sample(centre) > 0.0).then(|| albedo.at(centre))
    };
    let known: Vec<Option<Rgb>> = voxels.voxels().map(albedo_of).collect();
    let [width, height, _] = voxels.dims;
    let strides = [1, width, width * height];
    let differ = |a: Rgb, b: Rgb| (0..3).any(|c| (a.0[c] - b.0[c]).abs() > STEP);
    voxels.voxels().enumerate().any(|(i, voxel)| {
        let Some(own) = known[i] else {
            return false;
        };
        (0..3).any(|a| {
            let is_last = voxel[a] + 1 == voxels.first[a] + voxels.dims[a];
            !is_last && known[i + strides[a]].is_some_and(|next| differ(own, next))
        })
    })
}
