//! Parts of a packed scene that most have not: each has a number and is there only where it says
//! something, behind all else.

use super::instances::PackedInstances;
use super::rules::{check, is_share};
use super::view::PackedCamera;
use super::volume::PackedVolume;
use crate::record::ExtinctionColor;
use crate::{Result as Checked, check as rules, parts};
use bincode::de::Decoder;
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};

/// The parts that a scene has.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PackedParts {
    /// Where surfaces are there.
    pub masks: Option<PackedMasks>,
    /// Textures of the emission of materials, by rising number of these.
    #[serde(default)]
    pub emission_textures: Vec<PackedEmissionTexture>,
    /// Lenses and shutters of cameras, by rising number of these; at least one, if there are any.
    #[serde(default)]
    pub lenses: Vec<PackedLens>,
    /// Extinction by channel of media that are not grey, by rising number of these.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub extinction_colors: Vec<ExtinctionColor>,
    /// Numbers of media whose albedo varies, rising. Of each three volumes come behind all media,
    /// whose samples are its red, green and blue.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub albedo_grids: Vec<u32>,
    /// What is stored once and placed many times.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instances: Option<PackedInstances>,
    /// Numbers of media of which a column has the errors of bricks on coarser levels, rising.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub brick_errors: Vec<u32>,
    /// What clouds that are baked of the scene say of its surfaces, materials and volumes among
    /// their settings: names and digests, by rising name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub digests: Vec<(String, String)>,
}

/// Numbers of parts.
const MASKS: u32 = 1;
const EMISSION_TEXTURES: u32 = 2;
const LENSES: u32 = 3;
const EXTINCTION_COLORS: u32 = 4;
const ALBEDO_GRIDS: u32 = 5;
const INSTANCES: u32 = 6;
const BRICK_ERRORS: u32 = 7;
const DIGESTS: u32 = 8;

/// A texture that is a factor on the emission of a material.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedEmissionTexture {
    /// Number of the material.
    pub material: u32,
    /// Number of the texture.
    pub texture: u32,
}

/// The lens and the shutter of a camera.
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
pub struct PackedLens {
    /// Number of the camera.
    pub camera: u32,
    /// Radius of its opening and focus distance, scene units; `None` for a pinhole.
    pub lens: Option<[f32; 2]>,
    /// The same of each of its keys.
    pub keys: Vec<Option<[f32; 2]>>,
    /// When its shutter opens and closes, in frames from that of the picture.
    pub shutter: Option<[f64; 2]>,
}

/// Where surfaces are there.
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
pub struct PackedMasks {
    /// Those of materials, by rising number of these; at least one.
    pub masks: Vec<PackedMask>,
    /// Whether vertices have factors on the opacity.
    pub has_opacities: bool,
}

/// Where the surfaces of a material are there.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedMask {
    /// Number of the material.
    pub material: u32,
    /// Opacity, 0 to 1.
    pub opacity: f32,
    /// Factor on the opacity, by its luminance: number of a texture.
    pub texture: Option<u32>,
    /// The opacity from which on they are there; `None` for a share.
    pub cutoff: Option<f32>,
}

impl bincode::Encode for PackedParts {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        if let Some(masks) = &self.masks {
            (MASKS, masks).encode(encoder)?;
        }
        parts::encode(EMISSION_TEXTURES, &self.emission_textures, encoder)?;
        parts::encode(LENSES, &self.lenses, encoder)?;
        parts::encode(EXTINCTION_COLORS, &self.extinction_colors, encoder)?;
        parts::encode(ALBEDO_GRIDS, &self.albedo_grids, encoder)?;
        if let Some(instances) = &self.instances {
            (INSTANCES, instances).encode(encoder)?;
        }
        parts::encode(BRICK_ERRORS, &self.brick_errors, encoder)?;
        parts::encode(DIGESTS, &self.digests, encoder)
    }
}

impl<C> bincode::Decode<C> for PackedParts {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let mut found = Self::default();
        let mut last = 0;
        while let Some(number) = parts::next(decoder, &mut last)? {
            match number {
                MASKS => found.masks = Some(PackedMasks::decode(decoder)?),
                EMISSION_TEXTURES => found.emission_textures = parts::some(decoder)?,
                LENSES => found.lenses = parts::some(decoder)?,
                EXTINCTION_COLORS => found.extinction_colors = parts::some(decoder)?,
                ALBEDO_GRIDS => found.albedo_grids = parts::some(decoder)?,
                INSTANCES => found.instances = Some(PackedInstances::decode(decoder)?),
                BRICK_ERRORS => found.brick_errors = parts::some(decoder)?,
                DIGESTS => found.digests = parts::some(decoder)?,
                _ => return Err(parts::UNKNOWN),
            }
        }
        Ok(found)
    }
}

bincode::impl_borrow_decode!(PackedParts);

impl PackedParts {
    pub(super) fn validate(
        &self,
        materials: usize,
        textures: usize,
        cameras: &[PackedCamera],
        (media, albedos): (&[PackedVolume], &[PackedVolume]),
    ) -> Checked<()> {
        if let Some(masks) = &self.masks {
            masks.validate(materials, textures)?;
        }
        let of = &self.emission_textures;
        let is_right = are_in_order(of.iter().map(|of| of.material), materials)
            && of.iter().all(|of| (of.texture as usize) < textures);
        check(
            is_right,
            &|| "textures of emission".to_owned(),
            &format!("some of {materials} materials, in order, and textures below {textures}"),
            of,
        )?;
        let numbers: Vec<u32> = self.lenses.iter().map(|l| l.camera).collect();
        check(
            numbers.is_sorted_by(|a, b| a < b),
            &|| "lenses".to_owned(),
            "cameras in order",
            &numbers,
        )?;
        self.lenses.iter().try_for_each(|l| l.validate(cameras))?;
        self.check_albedo_grids(media, albedos)?;
        let of = &self.brick_errors;
        let has_bricks = |v: &u32| media[*v as usize].bricks_with_errors() > 0;
        check(
            are_in_order(of.iter().copied(), media.len()) && of.iter().all(has_bricks),
            &|| "errors of bricks".to_owned(),
            &format!("some of {} media, in order, of many voxels", media.len()),
            of,
        )?;
        let of = &self.digests;
        let is_digest = |(name, digest): &(String, String)| {
            let is_digit = |c: u8| matches!(c, b'0'..=b'9' | b'a'..=b'f');
            let is_of_assets = name.starts_with("scene/")
                && !["scene/lights", "scene/camera"].contains(&name.as_str());
            is_of_assets && digest.len() == 32 && digest.bytes().all(is_digit)
        };
        check(
            of.is_sorted_by(|(a, _), (b, _)| a < b) && of.iter().all(is_digest),
            &|| "digests".to_owned(),
            "names that begin with scene/, but of no lights or cameras, in order, each with 32 \
             hexadecimal digits",
            of,
        )?;
        let of = &self.extinction_colors;
        check(
            are_in_order(of.iter().map(|of| of.volume), media.len())
                && !of.iter().any(ExtinctionColor::is_grey),
            &|| "extinction colours".to_owned(),
            &format!("some of {} media, in order, that are not grey", media.len()),
            of,
        )?;
        of.iter().try_for_each(|of| {
            let name = &media[of.volume as usize].name;
            rules::extinction_color(of.color, &|| format!("volume {name:?}"))
        })
    }
}

impl PackedParts {
    /// Volumes of a medium whose albedo varies.
    pub(super) const CHANNELS: usize = 3;

    fn check_albedo_grids(&self, media: &[PackedVolume], albedos: &[PackedVolume]) -> Checked<()> {
        let of = &self.albedo_grids;
        let is_right = |(number, channels): (&u32, &[PackedVolume])| {
            let medium = media.get(*number as usize);
            let is_grid_of = |m: &PackedVolume| {
                let mut channels = channels.iter();
                channels.all(|c| c.dims == m.dims && c.levels.len() == 1)
            };
            channels.len() == Self::CHANNELS && medium.is_some_and(is_grid_of)
        };
        let mut grids = of.iter().zip(albedos.chunks(Self::CHANNELS));
        check(
            are_in_order(of.iter().copied(), media.len())
                && albedos.len() == Self::CHANNELS * of.len()
                && grids.all(is_right),
            &|| "albedo grids".to_owned(),
            "three volumes of one level for each, of as many voxels as the medium",
            of,
        )
    }
}

impl PackedLens {
    fn validate(&self, cameras: &[PackedCamera]) -> Checked<()> {
        let camera = cameras.get(self.camera as usize);
        let mut lenses = self.keys.iter().chain([&self.lens]).flatten().flatten();
        let is_open = |[open, close]: [f64; 2]| {
            open < close && open.abs() <= MOST_FRAMES && close.abs() <= MOST_FRAMES
        };
        let is_right = camera.is_some_and(|c| c.keys.len() == self.keys.len())
            && lenses.all(|l| (1e-15..=1e15).contains(l))
            && self.shutter.is_none_or(is_open);
        let expected = "a camera, lengths from 1e-15 to 1e15 of it and each of its keys, and a \
                        shutter that opens before it closes";
        check(is_right, &|| "lenses".to_owned(), expected, self)
    }
}

/// Frames from that of a picture at which a shutter may open and close.
const MOST_FRAMES: f64 = 1000.0;

/// Whether numbers rise, and stay below a count.
fn are_in_order(numbers: impl Iterator<Item = u32> + Clone, count: usize) -> bool {
    numbers.clone().is_sorted_by(|a, b| a < b)
        && numbers.last().is_none_or(|n| (n as usize) < count)
}

impl PackedMasks {
    fn validate(&self, materials: usize, textures: usize) -> Checked<()> {
        let what = || "masks".to_owned();
        let numbers: Vec<u32> = self.masks.iter().map(|m| m.material).collect();
        let is_right = !numbers.is_empty() && are_in_order(numbers.iter().copied(), materials);
        check(
            is_right,
            &what,
            &format!("some of {materials} materials, in order"),
            &numbers,
        )?;
        for mask in &self.masks {
            let is_right = is_share(mask.opacity)
                && mask.cutoff.is_none_or(is_share)
                && mask.texture.is_none_or(|t| (t as usize) < textures);
            check(
                is_right,
                &what,
                &format!("numbers from 0 to 1, and a texture below {textures}"),
                mask,
            )?;
        }
        Ok(())
    }
}
