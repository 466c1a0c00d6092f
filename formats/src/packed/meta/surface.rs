//! The surfaces of a packed scene: how many, and what they are like.

use super::rules::{are_shares, check, is_light};
use crate::Result;
use bincode::de::Decoder;
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};

/// Vertices and triangles that indices have room for.
const MAX_VERTICES: u64 = u32::MAX as u64;
const MAX_TRIANGLES: u64 = 1 << 27;

/// How a surface reflects and emits.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct PackedMaterial {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Factor on the albedo: number of a texture.
    pub texture: Option<u32>,
    /// Emitted radiance; 0 for no light.
    pub emission: [f32; 3],
    /// Whether the back emits too.
    pub emits_both_sides: bool,
    /// Whether rays of cameras pass it.
    #[serde(default)]
    pub is_unseen: bool,
}

/// The texels of an image, which textures share.
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
pub struct PackedImage {
    /// Number of its texels.
    pub texels: u64,
    /// Codes of a texel: 1 for grey, or 3.
    pub channels: u8,
    /// Bits of a code, 8 or 16; 32 for texels that are linear RGB as they are.
    pub bits: u8,
}

/// What a texture is beyond its border.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub enum PackedWrap {
    /// The image again.
    #[default]
    Repeat,
    /// The texel at the border.
    Clamp,
    /// The image turned round, and so on.
    Mirror,
}

/// An image, and what its codes stand for.
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
pub struct PackedTexture {
    /// Number of its image.
    pub image: u32,
    /// Texels in a row.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// What is beyond the left and right border, and beyond the upper and lower.
    pub wrap: [PackedWrap; 2],
}

/// Which columns triangles and vertices have, and of how many rows.
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
pub struct PackedMesh {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Triangles of zero area that were dropped when the scene was read.
    pub degenerate: u64,
    /// Whether vertices have normals.
    pub has_normals: bool,
    /// Whether vertices have colours.
    pub has_colors: bool,
    /// Whether vertices have texture coordinates.
    pub has_uvs: bool,
}

/// Size of the hierarchy over triangles.
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
pub struct PackedHierarchy {
    /// Number of nodes, at least 1.
    pub nodes: u64,
    /// Number of blocks of four triangles.
    pub blocks: u64,
    /// Whether blocks have vertices in place of corners.
    pub by_vertex: bool,
    /// Boxes and corners are this many times larger than the mesh: a power of two.
    pub scale: f32,
}

/// Bits of the byte that ends a material.
const BOTH_SIDES: u8 = 1;
const UNSEEN: u8 = 2;

impl bincode::Encode for PackedMaterial {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> std::result::Result<(), EncodeError> {
        let bit = |is_set: bool, bit: u8| if is_set { bit } else { 0 };
        let bits = bit(self.emits_both_sides, BOTH_SIDES) | bit(self.is_unseen, UNSEEN);
        self.name.encode(encoder)?;
        self.albedo.encode(encoder)?;
        self.texture.encode(encoder)?;
        self.emission.encode(encoder)?;
        bits.encode(encoder)
    }
}

impl<C> bincode::Decode<C> for PackedMaterial {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> std::result::Result<Self, DecodeError> {
        let material = Self {
            name: String::decode(decoder)?,
            albedo: bincode::Decode::decode(decoder)?,
            texture: bincode::Decode::decode(decoder)?,
            emission: bincode::Decode::decode(decoder)?,
            ..Self::default()
        };
        let bits = u8::decode(decoder)?;
        if bits > BOTH_SIDES | UNSEEN {
            return Err(DecodeError::Other("a material has bits that are unknown"));
        }
        Ok(Self {
            emits_both_sides: bits & BOTH_SIDES != 0,
            is_unseen: bits & UNSEEN != 0,
            ..material
        })
    }
}

bincode::impl_borrow_decode!(PackedMaterial);

impl PackedMaterial {
    pub(super) fn validate(&self, textures: usize) -> Result<()> {
        let what = || format!("material {:?}", self.name);
        let has_texture = self.texture.is_none_or(|t| (t as usize) < textures);
        check(
            has_texture,
            &what,
            &format!("a texture below {textures}"),
            self.texture,
        )?;
        let is_right = are_shares(self.albedo) && is_light(self.emission);
        check(
            is_right,
            &what,
            "an albedo from 0 to 1, and emission of at least 0",
            self,
        )
    }
}

impl PackedMesh {
    pub(super) fn validate(&self, materials: usize) -> Result<()> {
        let is_right = self.vertices <= MAX_VERTICES
            && self.triangles <= MAX_TRIANGLES
            && (self.triangles == 0 || (self.vertices > 0 && materials > 0));
        let expected = "at most 2^32 - 1 vertices and 2^27 triangles, and materials for these";
        check(is_right, &|| "mesh".into(), expected, self)
    }
}

impl PackedHierarchy {
    pub(super) fn validate(&self, mesh: &PackedMesh) -> Result<()> {
        let is_power = self.scale.is_normal() && self.scale > 0.0 && self.scale.to_bits() << 9 == 0;
        let is_right = (1..=MAX_TRIANGLES).contains(&self.nodes)
            && (1..=mesh.triangles).contains(&self.blocks)
            && is_power;
        let expected = "nodes, blocks of the triangles, and a power of two as scale";
        check(is_right, &|| "hierarchy".into(), expected, self)
    }
}
