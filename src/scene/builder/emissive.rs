//! Emissive volumes as they are handed to a builder.

use super::VolumeInput;
use crate::scene::{Emission, EmissiveVolume, Grid, Volume};
use crate::{Error, Result};
use glam::DAffine3;

/// A grid of values that light comes from, in world space.
#[derive(Debug)]
pub struct EmissiveInput {
    /// Values in the place of extinction.
    pub(in crate::scene) values: VolumeInput,
    pub(in crate::scene) emission: Emission,
}

impl EmissiveInput {
    /// Values that are at least 0, and the light that they stand for, per world unit of length.
    /// `world_from_grid` is as that of [`VolumeInput::new`].
    #[must_use]
    pub fn new(
        name: impl Into<String>,
        values: Grid,
        emission: Emission,
        world_from_grid: DAffine3,
    ) -> Self {
        Self {
            values: VolumeInput::new(name, values, [0.0; 3], world_from_grid),
            emission,
        }
    }

    /// Takes its light, for a scene that is lit by others.
    pub(in crate::scene) fn darken(&mut self) {
        self.emission = Emission::Proportional { radiance: [0.0; 3] };
    }

    /// The volume, in the space of a scene.
    pub(super) fn in_scene(self, scene_from_world: DAffine3) -> EmissiveVolume {
        let v = self.values;
        let scene_from_index = scene_from_world * v.world_from_grid;
        EmissiveVolume {
            values: Volume::new(v.name, v.sigma_t, v.albedo, scene_from_index),
            emission: self.emission,
        }
    }

    /// Refuses what readers of files refuse before they make one.
    pub(super) fn check_values(&self) -> Result<()> {
        let numbers = match self.emission {
            Emission::Proportional { radiance } => radiance,
            Emission::Blackbody { scale } => [scale; 3],
        };
        if !numbers.iter().all(|v| (0.0..=1e30).contains(v)) {
            return Err(Error::input(format!(
                "volume `{}`: an emission of {numbers:?}: expected numbers from 0 to 1e30",
                self.values.name
            )));
        }
        self.values.check_values()
    }
}
