//! OpenVDB fog volumes: float grids of the usual tree (5-4-3), also stored as half, in file
//! versions 220 to 224; plain, zip or Blosc, with or without the inactive values; placed by any
//! affine map.
//!
//! Inactive voxels and everything outside the active bounding box are empty, whatever the
//! background.

mod blosc;
mod bytes;
mod tree;

use super::field::{Field, Samples};
use super::files::Files;
use crate::run::{Cancel, memory};
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use bytes::Bytes;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use tree::{Encoding, LEAF, Tree, VOLUME};

const MAGIC: i64 = 0x5644_4220;
const OLDEST: u32 = 220;
const NEWEST: u32 = 224;

/// More voxels in the active bounding box are refused.
const MOST_VOXELS: i64 = 1 << 31;
/// More leaves in the active bounding box are refused: a long thin box has more of them for its
/// voxels.
const MOST_LEAVES: i64 = 1 << 24;

/// A grid as listed in the file.
struct Entry {
    name: String,
    kind: String,
    /// Offset of its data.
    at: i64,
}

/// Everything of one grid.
struct VdbGrid {
    entry: Entry,
    metadata: HashMap<String, Vec<u8>>,
    world_from_index: DAffine3,
    tree: Tree,
}

/// Reads the grid named `wanted`, or else "density", or else the only one.
pub(super) fn read(content: &[u8], wanted: Option<&str>, files: &mut Files) -> Result<Field> {
    let grid = VdbGrid::read(content, wanted, &files.cancel)?;
    let name = grid.entry.name.clone();
    if grid.tree.background != 0.0 {
        files.warn(format!(
            "grid `{name}` has the background {}; it is taken as 0",
            grid.tree.background
        ));
    }
    grid.into_field(content.len())
        .map_err(|e| e.at(format!("grid `{name}`")))
}

impl VdbGrid {
    fn read(content: &[u8], wanted: Option<&str>, cancel: &Cancel) -> Result<Self> {
        let mut bytes = Bytes::new(content);
        if bytes.i64().ok() != Some(MAGIC) {
            return Err(Error::input(
                "not an OpenVDB file: it does not start with its magic number",
            ));
        }
        let version = bytes.u32()?;
        if !(OLDEST..=NEWEST).contains(&version) {
            return Err(Error::input(format!(
                "expected an OpenVDB file of version {OLDEST} to {NEWEST}, found {version}"
            ))
            .hint("write it again with a current version of OpenVDB"));
        }
        let _library = bytes.take(8)?;
        let has_offsets = bytes.u8()? != 0;
        let mut compression = match version < 222 {
            true => u32::from(bytes.u8()? != 0),
            false => 0,
        };
        let _uuid = bytes.take(36)?;
        read_metadata(&mut bytes)?;
        let entries = read_entries(&mut bytes, has_offsets)?;
        let entry = choose(entries, wanted)?;

        let place = format!("grid `{}`", entry.name);
        bytes.seek(entry.at)?;
        if version >= 222 {
            compression = bytes.u32()?;
        }
        let metadata = read_metadata(&mut bytes).map_err(|e| e.at(&place))?;
        // The class comes before the type: a vector grid that is a level set exists nowhere.
        if text(&metadata, "class").as_deref() == Some("level set") {
            return Err(Error::input(format!(
                "{place} is a level set, not a fog volume: its values are distances"
            ))
            .hint(
                "convert it, for example with vdb_tool or Houdini's Convert VDB, to a fog volume",
            ));
        }
        let half = match entry.kind.as_str() {
            "Tree_float_5_4_3" => false,
            "Tree_float_5_4_3_HalfFloat" => true,
            other => {
                return Err(Error::input(format!(
                    "{place} has the type {other}; only Tree_float_5_4_3 is supported, also stored as half"
                ))
                .hint("convert it to a float grid"));
            }
        };
        let world_from_index = read_map(&mut bytes).map_err(|e| e.at(&place))?;
        let encoding = Encoding {
            version,
            compression,
            half,
        };
        let tree = Tree::read(&mut bytes, encoding, cancel).map_err(|e| e.at(&place))?;
        let grid = Self {
            entry,
            metadata,
            world_from_index,
            tree,
        };
        grid.check_count().map_err(|e| e.at(&place))?;
        Ok(grid)
    }

    /// The file says how many voxels are active; a reader that loses its way gets another number.
    fn check_count(&self) -> Result<()> {
        let stated = self.metadata.get("file_voxel_count");
        let stated = stated.and_then(|b| Some(i64::from_le_bytes(b.as_slice().try_into().ok()?)));
        let found = self.tree.active();
        match stated {
            Some(n) if u64::try_from(n) != Ok(found) => Err(Error::input(format!(
                "expected {n} active voxels as the file says, found {found}; the file is damaged"
            ))),
            _ => Ok(()),
        }
    }

    fn into_field(self, file_bytes: usize) -> Result<Field> {
        let (low, high) = self
            .tree
            .extent()
            .ok_or_else(|| Error::input("no voxel is active: the volume is empty"))?;
        let size: [i64; 3] = std::array::from_fn(|a| high[a] - low[a] + 1);
        // Leaves under the box and its padding of one voxel.
        let first_leaf = low.map(|i| (i - 1).div_euclid(LEAF));
        let leaves: [i64; 3] =
            std::array::from_fn(|a| (high[a] + 1).div_euclid(LEAF) - first_leaf[a] + 1);
        let product = |n: [i64; 3]| n.iter().try_fold(1_i64, |m, &x| m.checked_mul(x));
        if product(size.map(|n| n + 2)).is_none_or(|n| n > MOST_VOXELS)
            || product(leaves).is_none_or(|n| n > MOST_LEAVES)
        {
            return Err(Error::input(format!(
                "the box of active voxels, {low:?} to {high:?}, is larger than {MOST_VOXELS} voxels"
            ))
            .hint("crop the grid, or prune stray active voxels"));
        }
        let leaves = leaves.map(|n| n as usize);
        let table = Table::new(self.tree, first_leaf, leaves)?;
        let first = low.map(|i| i - 1);
        Ok(Field {
            dims: size.map(|n| n as usize + 2),
            first,
            padding: 1,
            world_from_file: Some(self.world_from_index),
            samples: Samples::Lookup {
                value: Box::new(move |voxel| {
                    table.value(std::array::from_fn(|a| first[a] + voxel[a] as i64))
                }),
                file_bytes,
            },
        })
    }
}

/// Finds the leaf or tile of a voxel.
struct Table {
    tree: Tree,
    first_leaf: [i64; 3],
    dims: [usize; 3],
    /// 0: empty; up to the number of leaves: a leaf, counted from 1; above: a tile.
    slots: Vec<u32>,
}

impl Table {
    /// A table over `dims` leaves from `first_leaf`, in units of leaves.
    fn new(tree: Tree, first_leaf: [i64; 3], dims: [usize; 3]) -> Result<Self> {
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
            tree,
            first_leaf,
            dims,
            slots,
        })
    }

    fn value(&self, index: [i64; 3]) -> f32 {
        let [x, y, z] =
            std::array::from_fn(|a| (index[a].div_euclid(LEAF) - self.first_leaf[a]) as usize);
        let id = self.slots[(z * self.dims[1] + y) * self.dims[0] + x] as usize;
        let leaves = self.tree.leaves.len();
        match id {
            0 => 0.0,
            _ if id <= leaves => {
                self.tree.leaves[id - 1].value(index.map(|i| i.rem_euclid(LEAF) as usize))
            }
            _ => self.tree.tiles[id - leaves - 1].value,
        }
    }
}

/// Name, type and bytes of each entry; only the bytes are kept.
fn read_metadata(bytes: &mut Bytes<'_>) -> Result<HashMap<String, Vec<u8>>> {
    let mut metadata = HashMap::new();
    for _ in 0..bytes.u32()? {
        let name = bytes.text()?;
        let _kind = bytes.text()?;
        let length = bytes.u32()? as usize;
        metadata.insert(name, bytes.take(length)?.to_vec());
    }
    Ok(metadata)
}

fn text(metadata: &HashMap<String, Vec<u8>>, name: &str) -> Option<String> {
    let value = metadata.get(name)?;
    Some(String::from_utf8_lossy(value).into_owned())
}

fn read_entries(bytes: &mut Bytes<'_>, has_offsets: bool) -> Result<Vec<Entry>> {
    let count = bytes.i32()?;
    let mut entries = Vec::new();
    for _ in 0..count {
        let unique = bytes.text()?;
        // Grids of the same name are told apart by a number after a separator.
        let name = unique.split('\x1e').next().unwrap_or_default().to_string();
        let kind = bytes.text()?;
        let parent = bytes.text()?;
        let (grid_at, _blocks_at, end) = (bytes.i64()?, bytes.i64()?, bytes.i64()?);
        let at = if has_offsets {
            grid_at
        } else {
            bytes.at() as i64
        };
        if parent.is_empty() {
            entries.push(Entry { name, kind, at });
        }
        if !has_offsets {
            // Written to a pipe: where the next grid starts is only known after reading this one.
            break;
        }
        if end <= bytes.at() as i64 {
            return Err(Error::input(format!(
                "the grid `{unique}` ends at offset {end}, before it starts; the file is damaged"
            )));
        }
        bytes.seek(end)?;
    }
    Ok(entries)
}

fn choose(mut entries: Vec<Entry>, wanted: Option<&str>) -> Result<Entry> {
    let names = |entries: &[Entry]| {
        let names: Vec<_> = entries.iter().map(|e| format!("`{}`", e.name)).collect();
        names.join(", ")
    };
    let of_float = |e: &Entry| e.kind.starts_with("Tree_float_");
    if let Some(wanted) = wanted {
        let found = entries.iter().position(|e| e.name == wanted);
        return found.map(|i| entries.swap_remove(i)).ok_or_else(|| {
            Error::input(format!(
                "there is no grid `{wanted}`; the file has {}",
                names(&entries)
            ))
        });
    }
    if let Some(i) = entries.iter().position(|e| e.name == "density") {
        return Ok(entries.swap_remove(i));
    }
    if entries.iter().filter(|e| of_float(e)).count() == 1 {
        entries.retain(of_float);
    }
    match entries.len() {
        0 => Err(Error::input("the file has no grids")),
        1 => Ok(entries.swap_remove(0)),
        _ => Err(
            Error::input(format!("the file has several grids: {}", names(&entries)))
                .hint("choose one with `grid = \"name\"`"),
        ),
    }
}

fn read_map(bytes: &mut Bytes<'_>) -> Result<DAffine3> {
    let kind = bytes.text()?;
    let scale_only = |bytes: &mut Bytes<'_>| -> Result<DVec3> {
        let scale = bytes.vector()?;
        // Voxel size and three things that follow from the scale.
        bytes.take(4 * 24)?;
        Ok(scale)
    };
    let map = match kind.as_str() {
        "UniformScaleMap" | "ScaleMap" => DAffine3::from_scale(scale_only(bytes)?),
        "TranslationMap" => DAffine3::from_translation(bytes.vector()?),
        "UniformScaleTranslateMap" | "ScaleTranslateMap" => {
            let translation = bytes.vector()?;
            DAffine3 {
                matrix3: DMat3::from_diagonal(scale_only(bytes)?),
                translation,
            }
        }
        "AffineMap" | "UnitaryMap" => {
            // Rows for row vectors are columns for column vectors.
            let mut columns = [DVec3::ZERO; 4];
            for column in &mut columns {
                *column = bytes.vector()?;
                bytes.f64()?;
            }
            DAffine3 {
                matrix3: DMat3::from_cols(columns[0], columns[1], columns[2]),
                translation: columns[3],
            }
        }
        other => {
            return Err(Error::input(format!(
                "the transform {other} is not supported; only affine ones are"
            )));
        }
    };
    if is_singular(&map) {
        return Err(Error::input("the transform is singular: it flattens space"));
    }
    Ok(map)
}

#[cfg(test)]
mod tests;
