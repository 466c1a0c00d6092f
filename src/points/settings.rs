//! What is gathered at points, and how.

use crate::gather::check_max_solid_angle;
use crate::run::Part;
use crate::{Error, Result};

/// How light is gathered at points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Rays of each point.
    pub samples: u32,
    /// A node seen under less than this, steradians, may stand for all below it.
    pub max_solid_angle: f32,
    /// The directions that are looked along; by whether points have normals if `None`.
    pub over: Option<Over>,
    /// Whether the share of the directions in which there are surfaces is told, too.
    pub occlusion: bool,
    /// Whether the mean free distance is told, too.
    pub distance: bool,
    /// Rays start so far off their point along its normal, scene units, beside what rounding needs.
    pub bias: f32,
    /// Key of all random choices.
    pub seed: u64,
    /// The part of the points that is gathered at.
    pub part: Part,
}

/// The directions that a point looks along.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    /// Those above its normal, by their cosine: irradiance.
    Hemisphere,
    /// All alike: mean radiance.
    Sphere,
}

impl Over {
    /// Both, by name.
    pub const ALL: [(&'static str, Self); 2] =
        [("hemisphere", Self::Hemisphere), ("sphere", Self::Sphere)];

    /// Name of the light that is gathered, without its channel.
    pub(super) fn quantity(self) -> &'static str {
        match self {
            Self::Hemisphere => "irradiance",
            Self::Sphere => "mean_radiance",
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            samples: 256,
            max_solid_angle: 0.02,
            over: None,
            occlusion: false,
            distance: false,
            bias: 0.0,
            seed: 0,
            part: Part::WHOLE,
        }
    }
}

impl Settings {
    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        if !(1..=65_536).contains(&self.samples) {
            return Err(Error::input(format!(
                "`samples` must be 1 to 65536, found {}",
                self.samples
            )));
        }
        if !(0.0..f32::INFINITY).contains(&self.bias) {
            return Err(Error::input(format!(
                "`bias` must be 0 or more, found {}",
                self.bias
            )));
        }
        check_max_solid_angle(self.max_solid_angle)
    }
}
