//! Samples of volumes, brick by brick.

use crate::frame::Block;
use crate::{FormatError, Result, bytes};

/// Samples of a brick: at the corners of its 8^3 cells, x fastest.
pub const BRICK_SAMPLES: usize = 9 * 9 * 9;
/// Bricks of a block, at most.
pub const BRICKS_PER_BLOCK: usize = 64;
const ZSTD_LEVEL: i32 = 3;

/// Bytes of so many bricks before compression.
fn raw_bytes(bricks: usize) -> usize {
    bricks * BRICK_SAMPLES * 4
}

/// The planes of some bricks, and those compressed if that is shorter.
pub fn pack(samples: &[f32]) -> Result<(Vec<u8>, Option<Vec<u8>>)> {
    check(samples)?;
    let rows: Vec<u8> = samples.iter().flat_map(|v| v.to_le_bytes()).collect();
    let mut planes = Vec::new();
    bytes::to_planes(&rows, 4, &mut planes);
    let packed = bytes::compress(&planes, ZSTD_LEVEL)?;
    Ok((planes, packed))
}

/// The samples of a block, from its planes.
pub fn unpack(planes: &[u8]) -> Result<Vec<f32>> {
    let samples: Vec<f32> = bytes::singles(&bytes::from_planes(planes, 4)).collect();
    check(&samples)?;
    Ok(samples)
}

fn check(samples: &[f32]) -> Result<()> {
    match samples.iter().find(|v| !(v.is_finite() && **v >= 0.0)) {
        None => Ok(()),
        Some(v) => Err(FormatError::invalid(
            "extinction of a brick",
            "finite numbers of at least 0",
            v,
        )),
    }
}

/// Checks the entry of block `i` in the table.
pub fn check_block(block: &Block, i: usize) -> Result<()> {
    let bricks = block.records as usize;
    if !(1..=BRICKS_PER_BLOCK).contains(&bricks) || block.columns != 0 {
        return Err(FormatError::invalid(
            format!("bricks of block {i}"),
            format!("1 to {BRICKS_PER_BLOCK}, and no columns"),
            format!("{bricks}, columns {:#x}", block.columns),
        ));
    }
    let raw = raw_bytes(bricks);
    if block.raw_bytes as usize != raw || block.stored_bytes > block.raw_bytes {
        return Err(FormatError::invalid(
            format!("bytes of block {i}"),
            format!("{raw} raw, and no more stored"),
            format!("{} raw, {} stored", block.raw_bytes, block.stored_bytes),
        ));
    }
    Ok(())
}
