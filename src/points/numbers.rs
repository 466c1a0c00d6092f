//! Numbers as files of points have them.

use crate::scene::load::ply::header::Scalar;

/// How numbers are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Text,
    LittleEndian,
    BigEndian,
}

/// A number of a type.
pub(super) fn value(bytes: &[u8], scalar: Scalar, is_little: bool) -> f64 {
    let mut little = [0; 8];
    let size = bytes.len().min(8);
    little[..size].copy_from_slice(&bytes[..size]);
    if !is_little {
        little[..size].reverse();
    }
    let [a, b, c, d, ..] = little;
    match scalar {
        Scalar::I8 => (a as i8).into(),
        Scalar::U8 => a.into(),
        Scalar::I16 => i16::from_le_bytes([a, b]).into(),
        Scalar::U16 => u16::from_le_bytes([a, b]).into(),
        Scalar::I32 => i32::from_le_bytes([a, b, c, d]).into(),
        Scalar::U32 => u32::from_le_bytes([a, b, c, d]).into(),
        Scalar::F32 => f32::from_le_bytes([a, b, c, d]).into(),
        Scalar::F64 => f64::from_le_bytes(little),
    }
}

/// Adds a number to a row as its type has it, little-endian.
pub(super) fn put(row: &mut Vec<u8>, scalar: Scalar, value: f64) {
    match scalar {
        Scalar::I8 => row.extend((value as i8).to_le_bytes()),
        Scalar::U8 => row.push(value as u8),
        Scalar::I16 => row.extend((value as i16).to_le_bytes()),
        Scalar::U16 => row.extend((value as u16).to_le_bytes()),
        Scalar::I32 => row.extend((value as i32).to_le_bytes()),
        Scalar::U32 => row.extend((value as u32).to_le_bytes()),
        Scalar::F32 => row.extend((value as f32).to_le_bytes()),
        Scalar::F64 => row.extend(value.to_le_bytes()),
    }
}

/// The name of a type in a PLY file.
pub(super) fn name_of(scalar: Scalar) -> &'static str {
    match scalar {
        Scalar::I8 => "char",
        Scalar::U8 => "uchar",
        Scalar::I16 => "short",
        Scalar::U16 => "ushort",
        Scalar::I32 => "int",
        Scalar::U32 => "uint",
        Scalar::F32 => "float",
        Scalar::F64 => "double",
    }
}
