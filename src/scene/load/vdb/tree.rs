//! The tree of a float grid: a root, inner nodes of 32^3 and 16^3 children, leaves of 8^3 voxels.
//!
//! First comes the topology (masks, and the values of inner nodes), then in the same order the
//! values of the leaves. In a node x is the slowest axis and z the fastest.

use super::blosc;
use super::bytes::Bytes;
use crate::run::{Cancel, memory};
use crate::{Error, Result};
use flate2::bufread::ZlibDecoder;
use half::f16;
use std::io::Read;

const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;

/// From this version on compression is per grid and inactive values may be left out.
const MASK_COMPRESSION_VERSION: u32 = 222;

/// What needs the memory of its lists, as an error says it.
pub(super) const VOLUME: &str = "a volume";

/// Voxels along an edge of a leaf.
pub(super) const LEAF: i64 = 8;
const LEAF_VOXELS: usize = 512;

/// How the values of a grid are written.
#[derive(Clone, Copy)]
pub(super) struct Encoding {
    pub(super) version: u32,
    pub(super) compression: u32,
    pub(super) number: Number,
}

/// What the values of a grid are, and as what they are stored.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    Float,
    /// Floats, those of nodes stored as half.
    FloatAsHalf,
    Half,
}

impl Encoding {
    /// Bytes of a value in a node.
    fn size(self) -> usize {
        match self.number {
            Number::Float => 4,
            Number::FloatAsHalf | Number::Half => 2,
        }
    }

    /// A value that stands alone.
    fn value(self, bytes: &mut Bytes<'_>) -> Result<f32> {
        match self.number {
            Number::Float | Number::FloatAsHalf => bytes.f32(),
            Number::Half => bytes.f16(),
        }
    }
}

/// The active voxels of a grid.
#[derive(Default)]
pub(super) struct Tree {
    pub(super) background: f32,
    pub(super) leaves: Vec<Leaf>,
    pub(super) tiles: Vec<Tile>,
}

/// 8^3 voxels.
pub(super) struct Leaf {
    /// Index of its first voxel.
    pub(super) origin: [i64; 3],
    /// A word for each x, in it bit 8 y + z.
    mask: [u64; 8],
    values: Vec<f32>,
}

/// A cube of active voxels of one value.
pub(super) struct Tile {
    /// Index of its first voxel.
    pub(super) origin: [i64; 3],
    /// Voxels along an edge.
    pub(super) edge: i64,
    pub(super) value: f32,
}

impl Leaf {
    /// The value of a voxel by coordinates below 8; zero if it is not active.
    pub(super) fn value(&self, [x, y, z]: [usize; 3]) -> f32 {
        let bit = y << 3 | z;
        match self.mask[x] >> bit & 1 {
            0 => 0.0,
            _ => self.values[x << 6 | bit],
        }
    }

    fn active(&self) -> u64 {
        self.mask.iter().map(|w| u64::from(w.count_ones())).sum()
    }

    /// First and last coordinate of active voxels, if there are any.
    fn extent(&self) -> Option<([i64; 3], [i64; 3])> {
        let yz = self.mask.iter().fold(0, |all, w| all | w);
        let bits = |has: &dyn Fn(usize) -> bool| {
            let first = (0..8).find(|&i| has(i))?;
            let last = (0..8).rfind(|&i| has(i))?;
            Some((first as i64, last as i64))
        };
        let x = bits(&|i| self.mask[i] != 0)?;
        let y = bits(&|i| yz >> (8 * i) & 0xff != 0)?;
        let z = bits(&|i| yz & 0x0101_0101_0101_0101 << i != 0)?;
        let o = self.origin;
        Some((
            [o[0] + x.0, o[1] + y.0, o[2] + z.0],
            [o[0] + x.1, o[1] + y.1, o[2] + z.1],
        ))
    }
}

impl Tree {
    /// Reads topology and values.
    pub(super) fn read(bytes: &mut Bytes<'_>, encoding: Encoding, cancel: &Cancel) -> Result<Self> {
        let buffers = bytes.u32()?;
        if buffers != 1 {
            return Err(Error::input(format!(
                "expected a tree with 1 buffer, found {buffers}"
            )));
        }
        let mut tree = Tree {
            background: encoding.value(bytes)?,
            ..Tree::default()
        };
        let tiles = bytes.u32()?;
        let children = bytes.u32()?;
        for _ in 0..tiles {
            let origin = origin(bytes)?;
            let value = encoding.value(bytes)?;
            if bytes.u8()? != 0 {
                let edge = 4096;
                tree.add_tile(Tile {
                    origin,
                    edge,
                    value,
                })?;
            }
        }
        for _ in 0..children {
            cancel.check()?;
            let origin = origin(bytes)?;
            tree.inner(bytes, encoding, origin, 5)?;
        }
        for i in 0..tree.leaves.len() {
            cancel.check()?;
            tree.leaf_values(bytes, encoding, i)
                .map_err(|e| e.at(format!("leaf {i} of {}", tree.leaves.len())))?;
        }
        Ok(tree)
    }

    /// The number of active voxels.
    pub(super) fn active(&self) -> u64 {
        let leaves = self.leaves.iter().map(Leaf::active).sum::<u64>();
        // A tile of the root has 2^36 voxels, and a file may have many.
        let tiles = self.tiles.iter().map(|t| (t.edge as u64).pow(3));
        tiles.fold(leaves, u64::saturating_add)
    }

    /// First and last index of active voxels, if there are any.
    pub(super) fn extent(&self) -> Option<([i64; 3], [i64; 3])> {
        let leaves = self.leaves.iter().filter_map(Leaf::extent);
        let tiles = (self.tiles.iter()).map(|t| (t.origin, t.origin.map(|o| o + t.edge - 1)));
        leaves.chain(tiles).reduce(|(a, b), (c, d)| {
            (
                std::array::from_fn(|i| a[i].min(c[i])),
                std::array::from_fn(|i| b[i].max(d[i])),
            )
        })
    }

    fn add_tile(&mut self, tile: Tile) -> Result<()> {
        memory::grow(VOLUME, &mut self.tiles, 1)?;
        self.tiles.push(tile);
        Ok(())
    }

    /// A node of (2^log2)^3 children: 5 above 4 above the leaves.
    fn inner(
        &mut self,
        bytes: &mut Bytes<'_>,
        encoding: Encoding,
        origin: [i64; 3],
        log2: usize,
    ) -> Result<()> {
        let count = 1 << (3 * log2);
        let child_mask = bytes.mask(count / 64)?;
        let value_mask = bytes.mask(count / 64)?;
        // Children of a 32^3 node are 128 voxels wide, those of a 16^3 node 8.
        let edge = if log2 == 5 { 128 } else { LEAF };
        let place = |n: usize| {
            let axis = |shift: usize| (n >> shift & ((1 << log2) - 1)) as i64 * edge;
            [
                origin[0] + axis(2 * log2),
                origin[1] + axis(log2),
                origin[2] + axis(0),
            ]
        };
        let is_on = |mask: &[u64], n: usize| mask[n / 64] >> (n % 64) & 1 == 1;
        // Old files leave out the slots that hold children.
        let dense = encoding.version >= MASK_COMPRESSION_VERSION;
        let stored = match dense {
            true => count,
            false => count - on(&child_mask),
        };
        let values = read_values(bytes, encoding, stored, &value_mask, self.background)?;
        let mut next = 0;
        for n in 0..count {
            let is_child = is_on(&child_mask, n);
            let slot = if dense { n } else { next };
            if !is_child && is_on(&value_mask, n) {
                self.add_tile(Tile {
                    origin: place(n),
                    edge,
                    value: values[slot],
                })?;
            }
            next += usize::from(!is_child);
        }
        for n in 0..count {
            if !is_on(&child_mask, n) {
                continue;
            }
            if log2 == 5 {
                self.inner(bytes, encoding, place(n), 4)?;
            } else {
                let mask = bytes.mask(8)?;
                memory::grow(VOLUME, &mut self.leaves, 1)?;
                self.leaves.push(Leaf {
                    origin: place(n),
                    mask: std::array::from_fn(|i| mask[i]),
                    values: Vec::new(),
                });
            }
        }
        Ok(())
    }

    fn leaf_values(&mut self, bytes: &mut Bytes<'_>, encoding: Encoding, i: usize) -> Result<()> {
        let mask = bytes.mask(8)?;
        let mut buffers = 1;
        if encoding.version < MASK_COMPRESSION_VERSION {
            let _origin = bytes.take(12)?;
            buffers = bytes.u8()?;
        }
        let leaf = &mut self.leaves[i];
        leaf.mask = std::array::from_fn(|i| mask[i]);
        leaf.values = read_values(bytes, encoding, LEAF_VOXELS, &mask, self.background)?;
        for _ in 1..buffers {
            // Scratch buffers of old programs.
            read_array(bytes, encoding, LEAF_VOXELS)?;
        }
        Ok(())
    }
}

fn origin(bytes: &mut Bytes<'_>) -> Result<[i64; 3]> {
    Ok([
        bytes.i32()?.into(),
        bytes.i32()?.into(),
        bytes.i32()?.into(),
    ])
}

fn on(mask: &[u64]) -> usize {
    mask.iter().map(|w| w.count_ones() as usize).sum()
}

/// The `count` values of a node. Inactive ones may have been left out; they are made up from at
/// most two values.
fn read_values(
    bytes: &mut Bytes<'_>,
    encoding: Encoding,
    count: usize,
    active: &[u64],
    background: f32,
) -> Result<Vec<f32>> {
    if encoding.version < MASK_COMPRESSION_VERSION {
        return read_array(bytes, encoding, count);
    }
    // 0: inactive values are the background; 1: its negative; 2: one other value; 3 to 5: a mask
    // selects between background and negative, background and one other, two others; 6: all values
    // are stored.
    let kind = bytes.u8()?;
    if kind > 6 {
        return Err(Error::input(format!(
            "expected a kind of node from 0 to 6, found {kind}; the file is damaged"
        )));
    }
    let mut inactive = match kind {
        0 => [background, background],
        _ => [-background, background],
    };
    if matches!(kind, 2 | 4 | 5) {
        inactive[0] = encoding.value(bytes)?;
    }
    if kind == 5 {
        inactive[1] = encoding.value(bytes)?;
    }
    let selection = match kind {
        3..=5 => bytes.mask(count / 64)?,
        _ => Vec::new(),
    };
    if encoding.compression & ACTIVE_MASK == 0 || kind == 6 {
        return read_array(bytes, encoding, count);
    }
    let mut stored = read_array(bytes, encoding, on(active))?.into_iter();
    let is_on = |mask: &[u64], n: usize| mask.get(n / 64).is_some_and(|w| w >> (n % 64) & 1 == 1);
    let values = (0..count).map(|n| match is_on(active, n) {
        true => stored.next().unwrap_or(background),
        false => inactive[usize::from(is_on(&selection, n))],
    });
    memory::listed(VOLUME, values)
}

fn read_array(bytes: &mut Bytes<'_>, encoding: Encoding, count: usize) -> Result<Vec<f32>> {
    // Where no half is stored not even their length is, unlike floats.
    if encoding.number == Number::FloatAsHalf && count == 0 {
        return Ok(Vec::new());
    }
    let size = count * encoding.size();
    let unpacked;
    let data = if encoding.compression & (ZIP | BLOSC) == 0 {
        bytes.take(size)?
    } else {
        let length = bytes.i64()?;
        if length <= 0 {
            // Data that did not get smaller is stored as it is, its length negative.
            if length.unsigned_abs() != size as u64 {
                return Err(wrong_size(size, length));
            }
            bytes.take(size)?
        } else {
            let length = usize::try_from(length).map_err(|_| wrong_size(size, length))?;
            let packed = bytes.take(length)?;
            unpacked = if encoding.compression & BLOSC != 0 {
                blosc::unpack(packed, size)?
            } else {
                let mut out = vec![0; size];
                ZlibDecoder::new(packed)
                    .read_exact(&mut out)
                    .map_err(|e| Error::input(format!("damaged zlib data: {e}")))?;
                out
            };
            &unpacked
        }
    };
    if encoding.size() == 2 {
        let halves = data.chunks_exact(2);
        return memory::listed(
            VOLUME,
            halves.map(|c| f16::from_le_bytes([c[0], c[1]]).to_f32()),
        );
    }
    let floats = data.chunks_exact(4);
    memory::listed(
        VOLUME,
        floats.map(|c| f32::from_le_bytes([c[0], c[1], c[2], c[3]])),
    )
}

fn wrong_size(expected: usize, found: i64) -> Error {
    Error::input(format!(
        "expected {expected} bytes of values, found {found}; the file is damaged"
    ))
}
