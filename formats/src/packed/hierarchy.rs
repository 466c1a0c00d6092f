//! That nodes over triangles are a tree which any ray gets through: children come behind their
//! parents, each has one, and none is too deep.

use super::column::PackedColumn;
use super::meta::PackedMeta;
use crate::{FormatError, Result};

/// Nodes from the root down to any leaf, at most.
pub const MAX_NODE_LEVELS: u8 = 36;
/// Children of a node.
const WIDTH: usize = 8;
/// Where the children of a node stand, behind the planes of their boxes.
const CHILDREN: usize = 6 * WIDTH * 4;
/// Triangles of a block.
const LANES: usize = 4;
/// Where the triangles of a block stand, behind their corners.
const TRIANGLES: usize = 9 * LANES * 4;
const LEAF: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 27;

fn number(row: &[u8], i: usize) -> u32 {
    let at = 4 * i;
    u32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
}

fn float(row: &[u8], i: usize) -> f32 {
    f32::from_bits(number(row, i))
}

fn wrong(column: PackedColumn, row: u64, expected: String, found: String) -> FormatError {
    FormatError::invalid(
        format!("row {row} of the {}", column.name()),
        expected,
        found,
    )
}

/// Checks boxes and children of nodes.
pub fn check_nodes(item: u32, first: u64, piece: &[u8], meta: &PackedMeta) -> Result<()> {
    let Some(hierarchy) = meta
        .hierarchies()
        .nth(item as usize)
        .and_then(Option::as_ref)
    else {
        return Ok(());
    };
    for (row, at) in piece.chunks_exact(PackedColumn::Nodes.width()).zip(first..) {
        for k in 0..WIDTH {
            let child = number(&row[CHILDREN..], k);
            let ends = |a: usize| (float(row, a * WIDTH + k), float(row, (3 + a) * WIDTH + k));
            let is_absent = child == 0;
            let is_box = (0..3).all(|a| {
                let (lower, upper) = ends(a);
                match is_absent {
                    true => lower == f32::INFINITY && upper == f32::NEG_INFINITY,
                    false => lower.is_finite() && upper.is_finite() && lower <= upper,
                }
            });
            if !is_box {
                let expected = "finite boxes of children, and inverted ones of absent ones";
                return Err(wrong(
                    PackedColumn::Nodes,
                    at,
                    expected.into(),
                    format!("another one of child {k}"),
                ));
            }
            let is_there = if is_absent {
                true
            } else if child & LEAF == 0 {
                (at + 1..hierarchy.nodes).contains(&u64::from(child))
            } else {
                let blocks = u64::from(child & ((1 << COUNT_SHIFT) - 1));
                blocks + 1 + u64::from(child >> COUNT_SHIFT & 15) <= hierarchy.blocks
            };
            if !is_there {
                return Err(wrong(
                    PackedColumn::Nodes,
                    at,
                    format!(
                        "a node behind it of {}, or some of {} blocks",
                        hierarchy.nodes, hierarchy.blocks
                    ),
                    format!("{child:#x} as child {k}"),
                ));
            }
        }
    }
    Ok(())
}

/// Checks triangles and corners of blocks.
pub fn check_blocks(item: u32, first: u64, piece: &[u8], meta: &PackedMeta) -> Result<()> {
    let triangles = meta.triangles_of(item);
    for (row, at) in piece
        .chunks_exact(PackedColumn::Blocks.width())
        .zip(first..)
    {
        for lane in 0..LANES {
            let triangle = number(&row[TRIANGLES..], lane);
            let mut corners = (0..9).map(|i| float(row, i * LANES + lane));
            let is_right = match triangle {
                u32::MAX => corners.all(f32::is_nan),
                t => triangles.contains(&t.into()) && corners.all(f32::is_finite),
            };
            if !is_right {
                return Err(wrong(
                    PackedColumn::Blocks,
                    at,
                    format!("triangles of {triangles:?} with finite corners, or none"),
                    format!("{triangle} in lane {lane}"),
                ));
            }
        }
    }
    Ok(())
}

/// Checks triangles and vertices of blocks.
pub fn check_vertex_blocks(item: u32, first: u64, piece: &[u8], meta: &PackedMeta) -> Result<()> {
    let (vertices, triangles) = (meta.mesh.vertices, meta.triangles_of(item));
    let column = PackedColumn::VertexBlocks;
    for (row, at) in piece.chunks_exact(column.width()).zip(first..) {
        let (corners, lanes) = row.split_at(3 * LANES * 4);
        let most = |bytes: &[u8], n: usize, of: fn(u32) -> u32| {
            (0..n).map(|i| of(number(bytes, i))).fold(0, u32::max)
        };
        let vertex = most(corners, 3 * LANES, |v| v);
        // 0 for none.
        let triangle = most(lanes, LANES, |t| t.wrapping_add(1));
        let least = (0..LANES)
            .map(|i| number(lanes, i))
            .fold(u32::MAX, u32::min);
        if u64::from(vertex) >= vertices
            || u64::from(triangle) > triangles.end
            || u64::from(least) < triangles.start
        {
            return Err(wrong(
                column,
                at,
                format!("vertices below {vertices}, and triangles of {triangles:?} or none"),
                "others".into(),
            ));
        }
    }
    Ok(())
}

/// Checks that nodes whose rows are right are one tree, and how deep it is.
pub fn check_tree(nodes: &[u8]) -> Result<()> {
    let width = PackedColumn::Nodes.width();
    // By node, its level from the root on, which has 1; 0 before a parent is known.
    let mut levels = vec![0_u8; nodes.len() / width];
    if let Some(root) = levels.first_mut() {
        *root = 1;
    }
    for (at, row) in nodes.chunks_exact(width).enumerate() {
        let level = levels[at];
        let children = (0..WIDTH).map(|k| number(&row[CHILDREN..], k));
        let inner = children.filter(|child| child & LEAF == 0 && *child != 0);
        let what = PackedColumn::Nodes;
        if level == 0 {
            let expected = "one parent before it".into();
            return Err(wrong(what, at as u64, expected, "none".into()));
        }
        for child in inner {
            let of_child = &mut levels[child as usize];
            if *of_child != 0 || level == MAX_NODE_LEVELS {
                return Err(wrong(
                    what,
                    child.into(),
                    format!("one parent, and at most {MAX_NODE_LEVELS} levels"),
                    format!("another parent or level, by node {at}"),
                ));
            }
            *of_child = level + 1;
        }
    }
    Ok(())
}
