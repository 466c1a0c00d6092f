//! The tree of a float grid, or of one channel of a grid of vectors: a root, inner nodes of 32^3
//! and 16^3 children, leaves of 8^3 voxels.
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
use std::ops::Range;

const ZIP: u32 = 1;
const ACTIVE_MASK: u32 = 2;
const BLOSC: u32 = 4;

/// From this version on compression is per grid and inactive values may be left out.
const MASK_COMPRESSION_VERSION: u32 = 222;

/// What needs the memory of its lists, as an error says it.
pub(super) const VOLUME: &str = "a volume";

/// Voxels along an edge of a leaf.
pub(super) const LEAF_EDGE: usize = 8;
/// The same, of indices.
pub(super) const LEAF: i64 = LEAF_EDGE as i64;
pub(super) const LEAF_VOXELS: usize = LEAF_EDGE * LEAF_EDGE * LEAF_EDGE;

/// How the values of a grid are written.
#[derive(Clone, Copy)]
pub(super) struct Encoding {
    pub(super) version: u32,
    pub(super) compression: u32,
    pub(super) number: Number,
    /// The channel that is read of values of [`CHANNELS`]; `None` where they are single numbers.
    pub(super) channel: Option<usize>,
}

/// Numbers of a vector.
pub(super) const CHANNELS: usize = 3;

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
        self.number_size() * self.channel.map_or(1, |_| CHANNELS)
    }

    /// Bytes of a number of a value in a node.
    fn number_size(self) -> usize {
        match self.number {
            Number::Float => 4,
            Number::FloatAsHalf | Number::Half => 2,
        }
    }

    /// A value that stands alone.
    fn value(self, bytes: &mut Bytes<'_>) -> Result<f32> {
        let mut number = || match self.number {
            Number::Float | Number::FloatAsHalf => bytes.f32(),
            Number::Half => bytes.f16(),
        };
        let Some(channel) = self.channel else {
            return number();
        };
        let vector = [number()?, number()?, number()?];
        Ok(vector[channel])
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
    /// Offset in the file of its values.
    at: usize,
}

/// Room for what is unpacked, used for one leaf after another.
#[derive(Default)]
pub(super) struct Buffers {
    bytes: Vec<u8>,
    streams: Vec<u8>,
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
    /// Whether any voxel is active of a box of coordinates below 8.
    pub(super) fn has_active(&self, [x, y, z]: &[Range<usize>; 3]) -> bool {
        let row = z.clone().fold(0_u64, |row, z| row | 1 << z);
        let plane = y.clone().fold(0, |plane, y| plane | row << (LEAF_EDGE * y));
        self.mask[x.clone()].iter().any(|word| word & plane != 0)
    }

    /// Unpacks the values of its voxels, x slowest, from the file that it is in; those of voxels
    /// that are not active are `inactive`.
    pub(super) fn unpack(
        &self,
        content: &[u8],
        encoding: Encoding,
        inactive: f32,
        buffers: &mut Buffers,
        values: &mut [f32; LEAF_VOXELS],
    ) -> Result<()> {
        let mut bytes = Bytes::new(content);
        bytes.seek(self.at as i64)?;
        // What the values are of voxels that are not active does not matter.
        let stored = Stored::read(&mut bytes, encoding, LEAF_VOXELS, &self.mask, 0.0)?;
        Packed::read(&mut bytes, encoding, stored.count)?.unpack(encoding, buffers)?;
        let mut rest = buffers.values.as_slice();
        for (row, &word) in values.chunks_exact_mut(64).zip(&self.mask) {
            let count = if stored.all {
                64
            } else {
                word.count_ones() as usize
            };
            let (of_row, after) = rest.split_at(count);
            rest = after;
            if stored.all || word == u64::MAX {
                row.copy_from_slice(of_row);
                let off = (0..64).filter(|bit| word >> bit & 1 == 0);
                off.for_each(|bit| row[bit] = inactive);
                continue;
            }
            row.fill(inactive);
            let mut left = word;
            for value in of_row {
                row[left.trailing_zeros() as usize] = *value;
                left &= left - 1;
            }
        }
        Ok(())
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
    /// Reads the topology, and finds the values of leaves.
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
            tree.find_values(bytes, encoding, i)
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
                    at: 0,
                });
            }
        }
        Ok(())
    }

    /// Passes over the values of a leaf.
    fn find_values(&mut self, bytes: &mut Bytes<'_>, encoding: Encoding, i: usize) -> Result<()> {
        let mask = bytes.mask(8)?;
        let mut buffers = 1;
        if encoding.version < MASK_COMPRESSION_VERSION {
            let _origin = bytes.take(12)?;
            buffers = bytes.u8()?;
        }
        let leaf = &mut self.leaves[i];
        leaf.mask = std::array::from_fn(|i| mask[i]);
        leaf.at = bytes.at();
        let stored = Stored::read(bytes, encoding, LEAF_VOXELS, &mask, 0.0)?;
        Packed::read(bytes, encoding, stored.count)?;
        for _ in 1..buffers {
            // Scratch buffers of old programs.
            Packed::read(bytes, encoding, LEAF_VOXELS)?;
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
    let stored = Stored::read(bytes, encoding, count, active, background)?;
    let mut buffers = Buffers::default();
    Packed::read(bytes, encoding, stored.count)?.unpack(encoding, &mut buffers)?;
    if stored.all {
        return Ok(buffers.values);
    }
    let mut values = buffers.values.into_iter();
    let is_on = |mask: &[u64], n: usize| mask.get(n / 64).is_some_and(|w| w >> (n % 64) & 1 == 1);
    let values = (0..count).map(|n| match is_on(active, n) {
        true => values.next().unwrap_or(background),
        false => stored.inactive[usize::from(is_on(&stored.selection, n))],
    });
    memory::listed(VOLUME, values)
}

/// Which values of a node are in the file.
struct Stored {
    count: usize,
    /// Whether those that are not active are there, too.
    all: bool,
    /// The values of those if they are not, and which of them have the second.
    inactive: [f32; 2],
    selection: Vec<u64>,
}

impl Stored {
    /// Reads what leads the `count` values of a node.
    fn read(
        bytes: &mut Bytes<'_>,
        encoding: Encoding,
        count: usize,
        active: &[u64],
        background: f32,
    ) -> Result<Self> {
        let mut stored = Self {
            count,
            all: true,
            inactive: [background; 2],
            selection: Vec::new(),
        };
        if encoding.version < MASK_COMPRESSION_VERSION {
            return Ok(stored);
        }
        // 0: inactive values are the background; 1: its negative; 2: one other value; 3 to 5: a
        // mask selects between background and negative, background and one other, two others; 6:
        // all values are stored.
        let kind = bytes.u8()?;
        if kind > 6 {
            return Err(Error::input(format!(
                "expected a kind of node from 0 to 6, found {kind}; the file is damaged"
            )));
        }
        if kind > 0 {
            stored.inactive[0] = -background;
        }
        if matches!(kind, 2 | 4 | 5) {
            stored.inactive[0] = encoding.value(bytes)?;
        }
        if kind == 5 {
            stored.inactive[1] = encoding.value(bytes)?;
        }
        if matches!(kind, 3..=5) {
            stored.selection = bytes.mask(count / 64)?;
        }
        if encoding.compression & ACTIVE_MASK != 0 && kind != 6 {
            stored.all = false;
            stored.count = on(active);
        }
        Ok(stored)
    }
}

/// Values as the file has them.
struct Packed<'a> {
    data: &'a [u8],
    /// Bytes that they are when unpacked.
    size: usize,
    is_packed: bool,
}

impl<'a> Packed<'a> {
    /// Reads so many values, without a look at them.
    fn read(bytes: &mut Bytes<'a>, encoding: Encoding, count: usize) -> Result<Self> {
        let size = count * encoding.size();
        // Where no half is stored not even their length is, unlike floats.
        let is_nothing = encoding.number == Number::FloatAsHalf && count == 0;
        let mut length = None;
        if encoding.compression & (ZIP | BLOSC) != 0 && !is_nothing {
            let found = bytes.i64()?;
            // Data that did not get smaller is stored as it is, its length negative.
            if found > 0 {
                length = Some(usize::try_from(found).map_err(|_| wrong_size(size, found))?);
            } else if found.unsigned_abs() != size as u64 {
                return Err(wrong_size(size, found));
            }
        }
        Ok(Self {
            data: bytes.take(length.unwrap_or(size))?,
            size,
            is_packed: length.is_some(),
        })
    }

    /// Unpacks them to the values of the buffers.
    fn unpack(&self, encoding: Encoding, buffers: &mut Buffers) -> Result<()> {
        let Buffers {
            bytes,
            streams,
            values,
        } = buffers;
        let data = if !self.is_packed {
            self.data
        } else if encoding.compression & BLOSC != 0 {
            blosc::unpack(self.data, self.size, bytes, streams)?;
            bytes
        } else {
            bytes.clear();
            bytes.resize(self.size, 0);
            ZlibDecoder::new(self.data)
                .read_exact(bytes)
                .map_err(|e| Error::input(format!("damaged zlib data: {e}")))?;
            bytes
        };
        values.clear();
        memory::grow(VOLUME, values, self.size / encoding.size())?;
        let channel = encoding.channel.unwrap_or(0);
        let step = encoding.size() / encoding.number_size();
        if encoding.number_size() == 2 {
            let halves = data.as_chunks().0.iter().skip(channel).step_by(step);
            values.extend(halves.map(|c| f16::from_le_bytes(*c).to_f32()));
        } else {
            let floats = data.as_chunks().0.iter().skip(channel).step_by(step);
            values.extend(floats.map(|c| f32::from_le_bytes(*c)));
        }
        Ok(())
    }
}

fn wrong_size(expected: usize, found: i64) -> Error {
    Error::input(format!(
        "expected {expected} bytes of values, found {found}; the file is damaged"
    ))
}
