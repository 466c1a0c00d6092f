//! What a file says of its origin.

use crate::record::{MAX_VOLUMES, VolumeInfo};
use crate::{FormatError, Result, check};

/// Metadata of a cloud: the scene it comes from, and how its points are to be placed.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct CloudMeta {
    /// Identity of the scene that was baked.
    pub scene_hash: [u8; 32],
    /// Name of the scene, for people: identity is by hash.
    pub scene_name: String,
    /// Add this to a position in scene space to get world space.
    pub world_from_scene: [f64; 3],
    /// The volumes that lvoxels refer to.
    pub volumes: Vec<VolumeInfo>,
    /// Names and values of the settings that made the cloud.
    pub settings: Vec<(String, String)>,
    /// k in `radius = k sqrt(area / pi)`; 0 if radii are free.
    pub disk_overlap: f32,
}

/// Metadata of a tree: the cloud it comes from.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct TreeMeta {
    /// Metadata of the cloud that the tree was built from.
    pub cloud: CloudMeta,
    /// Identity of the cloud's content, [`crate::Cloud::content_hash`].
    pub cloud_hash: [u8; 16],
    /// Names and values of the settings that made the tree.
    pub settings: Vec<(String, String)>,
}

impl TreeMeta {
    /// Name of the setting that tells how often light bounces.
    pub const BOUNCES: &str = "bounces";

    /// Name of the setting that tells from which tree one of all bounces was made.
    pub const BOUNCED_FROM: &str = "bounced-from";

    /// Names and values of all that the tree was made of and with: parts of the scene, and settings
    /// of each stage. Trees with the same have the same light.
    pub fn made_with(&self) -> impl Iterator<Item = &(String, String)> {
        let all = self.cloud.settings.iter().chain(&self.settings);
        // What it names was made with the settings before it.
        all.filter(|(name, _)| name != Self::BOUNCED_FROM)
    }

    /// How often light bounces, a number or `all`; `None` if the tree sends direct light.
    #[must_use]
    pub fn bounces(&self) -> Option<&str> {
        let mut settings = self.settings.iter();
        let (_, bounces) = settings.find(|(name, _)| name == Self::BOUNCES)?;
        Some(bounces)
    }
}

/// Metadata of scattered light: the scene and the tree it comes from.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct ScatterMeta {
    /// Identity of the scene that was lit.
    pub scene_hash: [u8; 32],
    /// Name of the scene, for people: identity is by hash.
    pub scene_name: String,
    /// The volumes whose vertices are lit.
    pub volumes: Vec<VolumeInfo>,
    /// Identity of the tree that light was gathered from, [`crate::Tree::content_hash`].
    pub tree_hash: [u8; 16],
    /// Names and values of the settings that made it.
    pub settings: Vec<(String, String)>,
}

impl ScatterMeta {
    /// Values that a reader may rely on.
    pub(crate) fn validate(&self) -> Result<()> {
        check_volumes(&self.volumes)
    }
}

impl CloudMeta {
    /// Values that a reader may rely on.
    pub(crate) fn validate(&self) -> Result<()> {
        finite("world_from_scene", &self.world_from_scene)?;
        if !(self.disk_overlap.is_finite() && self.disk_overlap >= 0.0) {
            return Err(FormatError::invalid(
                "disk_overlap",
                "a number of at least 0",
                self.disk_overlap,
            ));
        }
        check_volumes(&self.volumes)
    }
}

fn finite(what: &str, values: &[f64]) -> Result<()> {
    match values.iter().find(|v| !v.is_finite()) {
        Some(v) => Err(FormatError::invalid(what, "a finite number", v)),
        None => Ok(()),
    }
}

fn check_volumes(volumes: &[VolumeInfo]) -> Result<()> {
    if volumes.len() > MAX_VOLUMES {
        return Err(FormatError::invalid(
            "table of volumes",
            format!("at most {MAX_VOLUMES} volumes"),
            volumes.len(),
        ));
    }
    volumes.iter().try_for_each(check::volume)
}
