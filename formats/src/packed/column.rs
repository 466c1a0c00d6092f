//! The columns of a packed scene, and what their rows must be.

use super::meta::{MAX_EMISSION, PackedMeta, check_instances};
use crate::{FormatError, Result};

/// Columns start at multiples of this, so that they can be used where they are mapped.
pub const COLUMN_ALIGNMENT: u64 = 4096;
/// Bytes of a piece of a column, at most: each has a checksum of its own.
const PIECE_BYTES: usize = 1 << 18;
/// Coordinates of vertices and lights are not beyond this.
pub const MAX_COORDINATE: f32 = 4e15;

/// What a column of a packed scene holds.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub enum PackedColumn {
    /// Positions of vertices, 3 f32.
    Positions,
    /// Shading normals of vertices, 3 f32: of unit length, or 0 for that of the face.
    Normals,
    /// Factors on the albedo at vertices, 3 f32.
    Colors,
    /// Texture coordinates of vertices, 2 f32.
    Uvs,
    /// Vertices of triangles, 3 u32.
    Triangles,
    /// Materials of triangles, u32.
    Materials,
    /// Nodes over triangles: boxes of eight children, and which these are.
    Nodes,
    /// Corners of triangles, four by four, as leaves have them.
    Blocks,
    /// Codes of the texels of an image, u8.
    ByteCodes,
    /// Codes of the texels of an image, u16.
    WordCodes,
    /// Texels of an image as they are, 3 f32.
    Texels,
    /// The value of each code in a texture, f32.
    CodeValues,
    /// A whole tree file.
    Tree,
    /// A whole file of scattered light.
    Light,
    /// Vertices of triangles, four by four, as leaves of large meshes have them.
    VertexBlocks,
    /// Radiance of the environment image, 3 f32, row by row from the top.
    Environment,
    /// Factors on the opacity of masks at vertices, f32.
    Opacities,
    /// Places of meshes that are stored once: a map of 12 f64, a box of 6 f32, 2 u32.
    Instances,
    /// Errors of bricks of a volume on coarser levels, 3 f32.
    BrickErrors,
}

impl PackedColumn {
    /// Its number in the block table.
    pub(super) fn code(self) -> u32 {
        self as u32
    }

    /// Name, as in `SPEC.md`.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Positions => "positions",
            Self::Normals => "normals",
            Self::Colors => "colors",
            Self::Uvs => "uvs",
            Self::Triangles => "triangles",
            Self::Materials => "materials",
            Self::Nodes => "nodes",
            Self::Blocks => "blocks",
            Self::ByteCodes => "byte codes",
            Self::WordCodes => "word codes",
            Self::Texels => "texels",
            Self::CodeValues => "code values",
            Self::Tree => "tree",
            Self::Light => "light",
            Self::VertexBlocks => "vertex blocks",
            Self::Environment => "environment",
            Self::Opacities => "opacities",
            Self::Instances => "instances",
            Self::BrickErrors => "errors of bricks",
        }
    }

    /// Bytes of a row.
    #[must_use]
    pub fn width(self) -> usize {
        match self {
            Self::Positions
            | Self::Normals
            | Self::Colors
            | Self::Triangles
            | Self::Texels
            | Self::Environment
            | Self::BrickErrors => 12,
            Self::Uvs => 8,
            Self::Materials | Self::CodeValues | Self::Opacities => 4,
            Self::Nodes => 224,
            Self::Instances => 128,
            Self::Blocks => 160,
            Self::VertexBlocks => 64,
            Self::WordCodes => 2,
            Self::ByteCodes | Self::Tree | Self::Light => 1,
        }
    }

    /// Rows of each piece but the last, which may have fewer.
    pub(super) fn piece_rows(self) -> usize {
        PIECE_BYTES / self.width()
    }
}

/// A column that a file has.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct ColumnRows {
    /// What it holds.
    pub column: PackedColumn,
    /// Of which image, texture or volume; 0 for those of the whole scene.
    pub item: u32,
    /// Its rows.
    pub rows: u64,
}

/// Numbers of 32 bits, the largest of them: in the order of numbers that are not negative, where
/// those that are no numbers come last.
fn most(numbers: &[u8], of: impl Fn(u32) -> u32) -> u32 {
    indices(numbers).map(of).fold(0, u32::max)
}

/// The numbers of a row.
fn floats(row: &[u8]) -> impl Iterator<Item = f32> + '_ {
    crate::bytes::singles(row)
}

fn indices(row: &[u8]) -> impl Iterator<Item = u32> + '_ {
    row.chunks_exact(4)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
}

/// Checks every row of a piece of a column for an item; `first` is the number of the first.
pub fn check_rows(
    (column, item): (PackedColumn, u32),
    first: u64,
    piece: &[u8],
    meta: &PackedMeta,
) -> Result<()> {
    // A scene has many rows, and hardly ever a wrong one: all at once, before one by one.
    let are_shares = || most(piece, |bits| bits) <= 1_f32.to_bits();
    let all = |is_right: &dyn Fn(&[u8]) -> bool, expected: &str| match piece
        .chunks(column.width())
        .position(|row| !is_right(row))
    {
        None => Ok(()),
        Some(at) => Err(FormatError::invalid(
            format!("row {} of the {}", first + at as u64, column.name()),
            expected,
            "others",
        )),
    };
    let shares = |row: &[u8]| floats(row).all(|v| (0.0..=1.0).contains(&v));
    let below = |most: u64| move |row: &[u8]| indices(row).all(|i| u64::from(i) < most);
    let mesh = &meta.mesh;
    match column {
        PackedColumn::Positions if most(piece, |v| v << 1 >> 1) <= MAX_COORDINATE.to_bits() => {
            Ok(())
        }
        PackedColumn::Colors
        | PackedColumn::Texels
        | PackedColumn::CodeValues
        | PackedColumn::Opacities
            if are_shares() =>
        {
            Ok(())
        }
        PackedColumn::Triangles if u64::from(most(piece, |i| i)) < mesh.vertices => Ok(()),
        PackedColumn::Materials if (most(piece, |i| i) as usize) < meta.materials.len() => Ok(()),
        PackedColumn::Positions => all(
            &|row| floats(row).all(|v| v.abs() <= MAX_COORDINATE),
            "finite coordinates, at most 1e15",
        ),
        PackedColumn::Normals => all(&is_normal, "a vector of length 1, or 0"),
        PackedColumn::Uvs => all(&|row| floats(row).all(f32::is_finite), "finite numbers"),
        PackedColumn::Colors
        | PackedColumn::Texels
        | PackedColumn::CodeValues
        | PackedColumn::Opacities => all(&shares, "numbers from 0 to 1"),
        PackedColumn::Triangles => all(
            &below(mesh.vertices),
            &format!("vertices below {}", mesh.vertices),
        ),
        PackedColumn::Materials => {
            let count = meta.materials.len() as u64;
            all(&below(count), &format!("a material below {count}"))
        }
        PackedColumn::Nodes => super::hierarchy::check_nodes(item, first, piece, meta),
        PackedColumn::Blocks => super::hierarchy::check_blocks(item, first, piece, meta),
        PackedColumn::VertexBlocks => {
            super::hierarchy::check_vertex_blocks(item, first, piece, meta)
        }
        PackedColumn::Environment => all(&is_light, "numbers from 0 to 1e30"),
        PackedColumn::Instances => match &meta.parts.instances {
            Some(instances) => check_instances(first, piece, instances),
            None => Ok(()),
        },
        PackedColumn::BrickErrors => all(
            &|row| floats(row).all(|v| (0.0..=f32::MAX).contains(&v)),
            "finite numbers of at least 0",
        ),
        PackedColumn::ByteCodes
        | PackedColumn::WordCodes
        | PackedColumn::Tree
        | PackedColumn::Light => Ok(()),
    }
}

fn is_light(row: &[u8]) -> bool {
    floats(row).all(|v| (0.0..=MAX_EMISSION).contains(&v))
}

fn is_normal(row: &[u8]) -> bool {
    let length2: f32 = floats(row).map(|v| v * v).sum();
    length2 == 0.0 || (0.99..=1.01).contains(&length2)
}
