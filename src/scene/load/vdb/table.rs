//! The voxels of a tree by boxes: leaves are unpacked when a box asks for them.

use super::super::files::Content;
use super::super::samples::Source;
use super::tree::{Buffers, Encoding, LEAF, LEAF_EDGE, LEAF_VOXELS, Tree, VOLUME};
use crate::Result;
use crate::run::memory;
use crate::scene::grid::VoxelBox;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Leaves that are unpacked before memory of the file is given back: up to 64 MiB of it.
const KEPT_LEAVES: usize = 1 << 15;

/// Finds the leaf or tile of a voxel.
pub(super) struct Table {
    /// The whole file, which leaves point into.
    content: Arc<Content>,
    /// Leaves that were unpacked since memory of the file was given back.
    unpacked: AtomicUsize,
    encoding: Encoding,
    /// What the grid is called, for messages.
    label: String,
    /// The value of voxels that are not active.
    inactive: f32,
    /// Index of the voxel that boxes count from.
    first: [i64; 3],
    tree: Tree,
    first_leaf: [i64; 3],
    /// Leaves along each axis.
    dims: [usize; 3],
    /// 0: empty; up to the number of leaves: a leaf, counted from 1; above: a tile.
    slots: Vec<u32>,
}

/// The part of a box that is in one leaf or tile.
struct Part {
    /// First voxel of the leaf, from that of the box; may be before it.
    base: [i64; 3],
    /// Its voxels in the box, counted from the first of the box.
    voxels: [Range<usize>; 3],
}

impl Part {
    /// Coordinates in the leaf of its first voxels along each axis, and of those behind its last.
    fn in_leaf(&self) -> [Range<usize>; 3] {
        std::array::from_fn(|a| {
            let local = |i: usize| (i as i64 - self.base[a]) as usize;
            local(self.voxels[a].start)..local(self.voxels[a].end)
        })
    }
}

impl Table {
    /// A table over `dims` leaves from `first_leaf`, in units of leaves.
    pub(super) fn new(
        content: Arc<Content>,
        encoding: Encoding,
        (label, inactive): (String, f32),
        tree: Tree,
        first: [i64; 3],
        [first_leaf, dims]: [[i64; 3]; 2],
    ) -> Result<Self> {
        let dims = dims.map(|n| n as usize);
        let mut slots = memory::filled(VOLUME, 0, dims[0] * dims[1] * dims[2])?;
        let clip = |origin: i64, edge: i64, a: usize| {
            let start = origin.div_euclid(LEAF) - first_leaf[a];
            let end = start + edge / LEAF;
            start.clamp(0, dims[a] as i64) as usize..end.clamp(0, dims[a] as i64) as usize
        };
        let mut fill = |origin: [i64; 3], edge: i64, id: usize| {
            for z in clip(origin[2], edge, 2) {
                for y in clip(origin[1], edge, 1) {
                    for x in clip(origin[0], edge, 0) {
                        slots[(z * dims[1] + y) * dims[0] + x] = id as u32;
                    }
                }
            }
        };
        for (i, tile) in tree.tiles.iter().enumerate() {
            fill(tile.origin, tile.edge, tree.leaves.len() + i + 1);
        }
        for (i, leaf) in tree.leaves.iter().enumerate() {
            fill(leaf.origin, LEAF, i + 1);
        }
        Ok(Self {
            content,
            unpacked: AtomicUsize::new(0),
            encoding,
            label,
            inactive,
            first,
            tree,
            first_leaf,
            dims,
            slots,
        })
    }

    /// The leaves and tiles in a box, by their numbers, with what the box has of each leaf's cube.
    fn parts(&self, voxels: &VoxelBox) -> impl Iterator<Item = (usize, Part)> {
        let first: [i64; 3] = std::array::from_fn(|a| self.first[a] + voxels.first[a] as i64);
        let dims = voxels.dims;
        let along = |a: usize| {
            let leaf = |i: i64| i.div_euclid(LEAF) - self.first_leaf[a];
            leaf(first[a]) as usize..leaf(first[a] + dims[a] as i64 - 1) as usize + 1
        };
        let (x, y, z) = (along(0), along(1), along(2));
        let leaves = z.flat_map(move |z| {
            let x = x.clone();
            y.clone()
                .flat_map(move |y| x.clone().map(move |x| [x, y, z]))
        });
        leaves.filter_map(move |leaf| {
            let [x, y, z] = leaf;
            let id = self.slots[(z * self.dims[1] + y) * self.dims[0] + x] as usize;
            let id = id.checked_sub(1)?;
            let base: [i64; 3] =
                std::array::from_fn(|a| (leaf[a] as i64 + self.first_leaf[a]) * LEAF - first[a]);
            let voxels = std::array::from_fn(|a| {
                base[a].max(0) as usize..((base[a] + LEAF) as usize).min(dims[a])
            });
            Some((id, Part { base, voxels }))
        })
    }
}

impl Source for Table {
    fn may_hold(&self, voxels: &VoxelBox, counts: &dyn Fn(f32, f32) -> bool) -> bool {
        if counts(0.0, 0.0) {
            return true;
        }
        let leaves = &self.tree.leaves;
        self.parts(voxels).any(|(id, part)| match leaves.get(id) {
            Some(leaf) => leaf.has_active(&part.in_leaf()),
            None => {
                let value = self.tree.tiles[id - leaves.len()].value;
                counts(value, value)
            }
        })
    }

    fn read(&self, voxels: &VoxelBox, out: &mut [f32]) -> Result<()> {
        out.fill(self.inactive);
        let mut buffers = Buffers::default();
        let mut values = [0.0; LEAF_VOXELS];
        let leaves = &self.tree.leaves;
        let mut unpacked = 0;
        for (id, part) in self.parts(voxels) {
            unpacked += 1;
            match leaves.get(id) {
                Some(leaf) => leaf
                    .unpack(
                        (*self.content).as_ref(),
                        self.encoding,
                        self.inactive,
                        &mut buffers,
                        &mut values,
                    )
                    .map_err(|e| e.at(format!("leaf {id} of {}", leaves.len())))
                    .map_err(|e| e.at(format!("grid `{}`", self.label)))?,
                None => values.fill(self.tree.tiles[id - leaves.len()].value),
            }
            let [x, y, z] = part.in_leaf();
            let [nx, ny, _] = voxels.dims;
            for (z, k) in z.zip(part.voxels[2].clone()) {
                for (y, j) in y.clone().zip(part.voxels[1].clone()) {
                    let row = (k * ny + j) * nx;
                    let row = &mut out[row + part.voxels[0].start..row + part.voxels[0].end];
                    for (out, x) in row.iter_mut().zip(x.clone()) {
                        *out = values[(x * LEAF_EDGE + y) * LEAF_EDGE + z];
                    }
                }
            }
        }
        self.content.check()?;
        if self.unpacked.fetch_add(unpacked, Ordering::Relaxed) >= KEPT_LEAVES {
            self.unpacked.store(0, Ordering::Relaxed);
            self.content.release();
        }
        Ok(())
    }

    fn file_bytes(&self) -> usize {
        (*self.content).as_ref().len()
    }
}
