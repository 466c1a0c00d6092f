//! The pages of a file in its order, for the map of them.

use super::sample::Sample;
use crate::formats::{Block, BlockKind};
use serde_json::{Value, json};

/// Bars of a map, at most; a bar of a larger file is of several pages.
pub const MAX_BARS: usize = 8192;
/// Level of a page whose nodes were not read.
const UNKNOWN: u8 = 255;

/// Bars in the order of the file: stored bytes, raw bytes, points and nodes as 32 bits each, the
/// level of the first node, and the kind, 0 for surfels, 1 for lvoxels.
pub fn bars(surfels: &[Block], lvoxels: &[Block], sample: &Sample) -> (Value, Vec<u8>) {
    let surfels = surfels.iter().enumerate();
    let lvoxels = lvoxels.iter().enumerate();
    let mut pages: Vec<(usize, &Block)> = surfels.chain(lvoxels).collect();
    pages.sort_by_key(|(_, b)| b.offset);
    let each = pages.len().div_ceil(MAX_BARS).max(1);
    let mut bytes = Vec::new();
    let level_of = |id: usize| {
        let level = sample.page_levels.get(&(id as u32));
        level.map_or(UNKNOWN, |&l| l.min(u32::from(UNKNOWN) - 1) as u8)
    };
    for bar in pages.chunks(each) {
        let sum = |of: fn(&Block) -> u32| {
            let values = bar.iter().map(|(_, b)| of(b));
            values.fold(0, u32::saturating_add)
        };
        for v in [
            sum(|b| b.stored_bytes),
            sum(|b| b.raw_bytes),
            sum(|b| b.records),
            sum(|b| b.nodes),
            bar[0].0 as u32,
        ] {
            bytes.extend(v.to_le_bytes());
        }
        let (id, first) = bar[0];
        let is_lvoxels = first.kind == BlockKind::Lvoxels;
        let level = if is_lvoxels { UNKNOWN } else { level_of(id) };
        bytes.extend([level, u8::from(is_lvoxels)]);
    }
    (json!({"pages": pages.len(), "each": each}), bytes)
}
