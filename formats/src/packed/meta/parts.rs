//! Parts of a packed scene that most have not: each has a number and is there only where it says
//! something, behind all else.

use super::rules::{check, is_share};
use crate::Result as Checked;
use bincode::de::Decoder;
use bincode::de::read::Reader;
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
}

/// Numbers of parts.
const MASKS: u32 = 1;
const EMISSION_TEXTURES: u32 = 2;

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
        match &self.emission_textures[..] {
            [] => Ok(()),
            _ => (EMISSION_TEXTURES, &self.emission_textures).encode(encoder),
        }
    }
}

impl<C> bincode::Decode<C> for PackedParts {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let mut parts = Self::default();
        let mut last = 0;
        while decoder.reader().peek_read(1).is_some() {
            let number = u32::decode(decoder)?;
            if number <= last {
                return Err(DecodeError::Other("parts out of order"));
            }
            last = number;
            match number {
                MASKS => parts.masks = Some(PackedMasks::decode(decoder)?),
                EMISSION_TEXTURES => {
                    parts.emission_textures = bincode::Decode::decode(decoder)?;
                    if parts.emission_textures.is_empty() {
                        return Err(DecodeError::Other("a part that says nothing"));
                    }
                }
                _ => return Err(DecodeError::Other("a part of an unknown kind")),
            }
        }
        Ok(parts)
    }
}

bincode::impl_borrow_decode!(PackedParts);

impl PackedParts {
    pub(super) fn validate(&self, materials: usize, textures: usize) -> Checked<()> {
        if let Some(masks) = &self.masks {
            masks.validate(materials, textures)?;
        }
        let of = &self.emission_textures;
        let is_right = of.is_sorted_by(|a, b| a.material < b.material)
            && of
                .last()
                .is_none_or(|last| (last.material as usize) < materials)
            && of.iter().all(|of| (of.texture as usize) < textures);
        check(
            is_right,
            &|| "textures of emission".to_owned(),
            &format!("some of {materials} materials, in order, and textures below {textures}"),
            of,
        )
    }
}

impl PackedMasks {
    fn validate(&self, materials: usize, textures: usize) -> Checked<()> {
        let what = || "masks".to_owned();
        let numbers: Vec<u32> = self.masks.iter().map(|m| m.material).collect();
        let is_right = numbers.is_sorted_by(|a, b| a < b)
            && (numbers.last()).is_some_and(|last| (*last as usize) < materials);
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
