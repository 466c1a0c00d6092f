//! The settings that a study varies, one at a time.

use serde::Serialize;
use std::fmt;

/// What a run varies. In files it goes by its name.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, serde::Deserialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Sweep {
    /// Nothing: the base settings.
    #[default]
    Base,
    /// Nothing either: the base settings on a cloud like the paper's.
    Paper,
    /// Optical depth across an lvoxel.
    BlockDepth,
    /// Voxels a side of lvoxels of one size.
    BlockVoxels,
    /// Largest solid angle of a node, steradians.
    MaxSolidAngle,
    /// Rays of a gather on a surface.
    Samples,
    /// Samples per pixel of Monte Carlo.
    Spp,
    /// Surfels of the cloud.
    Surfels,
    /// [`Self::Surfels`] by the mean radius of their disks, scene units; in findings alone.
    SurfelRadius,
}

impl Sweep {
    /// Whether no setting is varied.
    #[must_use]
    pub fn is_alone(self) -> bool {
        matches!(self, Self::Base | Self::Paper)
    }

    /// Whether more of the setting is finer.
    #[must_use]
    pub fn rises(self) -> bool {
        matches!(self, Self::Spp | Self::Samples | Self::Surfels)
    }
}

impl fmt::Display for Sweep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::assert_names;
    use super::*;
    use std::collections::BTreeMap;

    #[test]
    fn files_have_the_names_and_no_others() {
        assert_names([
            (Sweep::Base, "base"),
            (Sweep::Paper, "paper"),
            (Sweep::BlockDepth, "block-depth"),
            (Sweep::BlockVoxels, "block-voxels"),
            (Sweep::MaxSolidAngle, "max-solid-angle"),
            (Sweep::Samples, "samples"),
            (Sweep::Spp, "spp"),
            (Sweep::Surfels, "surfels"),
            (Sweep::SurfelRadius, "surfel-radius"),
        ]);
        serde_json::from_str::<Sweep>("\"threads\"").unwrap_err();
        let values = BTreeMap::from([(Sweep::MaxSolidAngle, 0.5)]);
        let json = serde_json::to_string(&values).unwrap();
        assert_eq!(json, r#"{"max-solid-angle":0.5}"#);
        assert_eq!(
            serde_json::from_str::<BTreeMap<Sweep, f64>>(&json).unwrap(),
            values
        );
    }
}
