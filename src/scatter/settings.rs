//! How to light media.

use crate::gather::check_max_solid_angle;
use crate::{Error, Result};

/// How to light media.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Gather rays at each vertex; four directions of sweeps for each.
    pub volume_samples: u32,
    /// A node seen under less than this, steradians, may stand for all below it, four times that
    /// for rays of media.
    pub max_solid_angle: f32,
    /// Shadow rays of each vertex to each light with an extent.
    pub shadow_rays: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        // Rays and nodes as the best frames have them.
        Self {
            volume_samples: 16,
            max_solid_angle: 0.01,
            shadow_rays: 16,
            seed: 0,
        }
    }
}

impl Settings {
    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        for (name, value, most) in [
            ("`volume_samples`", self.volume_samples, 65_536),
            ("`shadow_rays`", self.shadow_rays, 4096),
        ] {
            if !(1..=most).contains(&value) {
                return Err(Error::input(format!(
                    "{name} must be 1 to {most}, found {value}"
                )));
            }
        }
        check_max_solid_angle(self.max_solid_angle)
    }

    /// Names and values, as they are kept in the file.
    pub(super) fn listed(&self) -> Vec<(String, String)> {
        let entry = |name: &str, value: String| (name.to_owned(), value);
        vec![
            entry("volume-samples", self.volume_samples.to_string()),
            entry("max-solid-angle", self.max_solid_angle.to_string()),
            entry("shadow-rays", self.shadow_rays.to_string()),
            entry("seed", self.seed.to_string()),
        ]
    }
}
