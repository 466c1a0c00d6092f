//! What a file says of its origin.

use crate::record::{MAX_VOLUMES, VolumeInfo};
use crate::{FormatError, Result as Checked, check, parts};
use bincode::de::Decoder;
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};
use bincode::{Decode, Encode};

/// Metadata of a cloud: the scene it comes from, and how its points are to be placed.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
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
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
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

/// Parts that few files have come last, also in a tree, which has the rest of the metadata of its
/// cloud before its own.
impl CloudMeta {
    fn encode_whole<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        let scene = (self.scene_hash, &self.scene_name, self.world_from_scene);
        (scene, &self.volumes, &self.settings, self.disk_overlap).encode(encoder)
    }

    fn decode_whole<C, D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let ((scene_hash, scene_name, world_from_scene), volumes, settings, disk_overlap) =
            Decode::decode(decoder)?;
        Ok(Self {
            scene_hash,
            scene_name,
            world_from_scene,
            volumes,
            settings,
            disk_overlap,
        })
    }
}

impl Encode for CloudMeta {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.encode_whole(encoder)?;
        parts::encode_volumes(&self.volumes, encoder)
    }
}

impl<C> Decode<C> for CloudMeta {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let mut meta = Self::decode_whole(decoder)?;
        parts::decode_volumes(&mut meta.volumes, decoder)?;
        Ok(meta)
    }
}

impl Encode for TreeMeta {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        self.cloud.encode_whole(encoder)?;
        (self.cloud_hash, &self.settings).encode(encoder)?;
        parts::encode_volumes(&self.cloud.volumes, encoder)
    }
}

impl<C> Decode<C> for TreeMeta {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let mut cloud = CloudMeta::decode_whole(decoder)?;
        let (cloud_hash, settings) = Decode::decode(decoder)?;
        parts::decode_volumes(&mut cloud.volumes, decoder)?;
        Ok(Self {
            cloud,
            cloud_hash,
            settings,
        })
    }
}

impl Encode for ScatterMeta {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        let scene = (self.scene_hash, &self.scene_name);
        (scene, &self.volumes, self.tree_hash, &self.settings).encode(encoder)?;
        parts::encode_volumes(&self.volumes, encoder)
    }
}

impl<C> Decode<C> for ScatterMeta {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let ((scene_hash, scene_name), mut volumes, tree_hash, settings): (
            _,
            Vec<VolumeInfo>,
            _,
            _,
        ) = Decode::decode(decoder)?;
        parts::decode_volumes(&mut volumes, decoder)?;
        Ok(Self {
            scene_hash,
            scene_name,
            volumes,
            tree_hash,
            settings,
        })
    }
}

bincode::impl_borrow_decode!(CloudMeta);
bincode::impl_borrow_decode!(TreeMeta);
bincode::impl_borrow_decode!(ScatterMeta);

impl ScatterMeta {
    /// Values that a reader may rely on.
    pub(crate) fn validate(&self) -> Checked<()> {
        check_volumes(&self.volumes)
    }
}

impl CloudMeta {
    /// Values that a reader may rely on.
    pub(crate) fn validate(&self) -> Checked<()> {
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

fn finite(what: &str, values: &[f64]) -> Checked<()> {
    match values.iter().find(|v| !v.is_finite()) {
        Some(v) => Err(FormatError::invalid(what, "a finite number", v)),
        None => Ok(()),
    }
}

fn check_volumes(volumes: &[VolumeInfo]) -> Checked<()> {
    if volumes.len() > MAX_VOLUMES {
        return Err(FormatError::invalid(
            "table of volumes",
            format!("at most {MAX_VOLUMES} volumes"),
            volumes.len(),
        ));
    }
    volumes.iter().try_for_each(check::volume)
}
