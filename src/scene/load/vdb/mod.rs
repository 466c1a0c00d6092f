//! OpenVDB fog volumes: float and half grids of the usual tree (5-4-3), floats also stored as half,
//! and grids of colours beside them (vec3s); in file versions 220 to 225; plain, zip or Blosc, with
//! or without the inactive values; placed by any affine map.
//!
//! - `bytes`: numbers off the front of a slice; `blosc`: unpacks compressed values
//! - `tree`: the tree of a grid; `table`: its voxels by boxes; here: the list of grids, and from a
//!   tree to a [`Field`]
//!
//! Inactive voxels and everything outside the active bounding box are empty, whatever the
//! background; those of grids of colours are the background.

mod blosc;
mod bytes;
mod table;
mod tree;

use super::field::Field;
use super::files::{Content, Files};
use super::left_out::LeftOut;
use super::samples::Samples;
use crate::run::Cancel;
use crate::scene::builder::is_singular;
use crate::{Error, Result};
use bytes::Bytes;
use glam::{DAffine3, DMat3, DVec3};
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;
use table::Table;
use tree::{CHANNELS, Encoding, LEAF, Number, Tree};

const MAGIC: i64 = 0x5644_4220;
const OLDEST: u32 = 220;
const NEWEST: u32 = 225;

/// More voxels in the active bounding box are refused.
const MOST_VOXELS: i64 = 1 << 31;
/// More leaves in the active bounding box are refused: a long thin box has more of them for its
/// voxels.
const MOST_LEAVES: i64 = 1 << 24;

/// A grid as listed in the file.
#[derive(Clone)]
struct Entry {
    name: String,
    /// Number that tells it from others of the same name, if the file gives one.
    suffix: Option<String>,
    kind: String,
    /// The grid whose tree it shares, as the file calls it.
    parent: String,
    /// Its own name as the file calls it.
    unique: String,
    /// Offset of its data.
    at: i64,
}

impl Entry {
    /// How the scene file may call it.
    fn label(&self) -> String {
        match &self.suffix {
            Some(suffix) => format!("{}[{suffix}]", self.name),
            None => self.name.clone(),
        }
    }
}

/// What leads the tree of a grid in a file.
struct GridHead<'a> {
    /// The file from the tree on.
    tree_bytes: Bytes<'a>,
    /// Bits that tell how values are compressed.
    compression: u32,
    metadata: HashMap<String, Vec<u8>>,
    world_from_index: DAffine3,
}

/// Everything of one grid.
struct VdbGrid {
    label: String,
    metadata: HashMap<String, Vec<u8>>,
    world_from_index: DAffine3,
    encoding: Encoding,
    tree: Tree,
}

/// The grids of a file that are wanted.
#[derive(Clone, Copy, Debug)]
pub(super) enum Wanted<'a> {
    /// All grids named "density", or else the only one.
    Density,
    /// All grids of a name, or one of them by its label.
    Named(&'a str),
    /// All that can be read.
    All,
}

impl<'a> From<Option<&'a str>> for Wanted<'a> {
    fn from(name: Option<&'a str>) -> Self {
        name.map_or(Self::Density, Self::Named)
    }
}

/// The channels of a grid of colours.
pub(super) struct ColorFields {
    /// Red, green and blue, in one box.
    pub(super) channels: [Field; CHANNELS],
    /// The colour outside of that.
    pub(super) background: [f32; CHANNELS],
}

/// Reads a grid of colours, by name or label.
pub(super) fn read_colors(
    content: impl Into<Content>,
    name: &str,
    files: &Files,
) -> Result<ColorFields> {
    let content = Arc::new(content.into());
    let file = File::open((*content).as_ref(), &mut LeftOut::default())?;
    let chosen = choose(&file.entries, Some(name))?;
    let [number] = chosen[..] else {
        let labels = chosen.iter().map(|i| file.entries[*i].label());
        let labels = labels.collect::<Vec<_>>().join(", ");
        return Err(
            Error::input(format!("the file has several grids `{name}`: {labels}"))
                .hint("choose one by its number, as in \"Cd[0]\""),
        );
    };
    let entry = &file.entries[number];
    let place = format!("grid `{}`", entry.label());
    let channel = |channel: usize| {
        let grid = file.grid(entry, Some(channel), &files.cancel)?;
        let background = grid.tree.background;
        content.release();
        let field = grid.into_field(content.clone(), background)?;
        let field = field.ok_or_else(|| Error::input("no voxel is active"))?;
        Ok::<_, Error>((field, background))
    };
    let read = || {
        let [(red, r), (green, g), (blue, b)] = [channel(0)?, channel(1)?, channel(2)?];
        Ok(ColorFields {
            channels: [red, green, blue],
            background: [r, g, b],
        })
    };
    read().map_err(|e: Error| e.at(&place))
}

/// Reads the grids that are wanted; those that have no active voxel are left out. The user is told
/// what else the file has, but for a grid of colours that is read elsewhere, by
/// [`left_out::tell_left_grids`](super::left_out::tell_left_grids).
pub(super) fn read(
    content: impl Into<Content>,
    path: &Path,
    wanted: Wanted<'_>,
    colors: Option<&str>,
    files: &mut Files,
) -> Result<Vec<Field>> {
    let mut left_out = LeftOut::default();
    let content = Arc::new(content.into());
    let file = File::open((*content).as_ref(), &mut left_out)?;
    let colors = colors.and_then(|name| choose(&file.entries, Some(name)).ok());
    let colors = colors.unwrap_or_default();
    let chosen = match wanted {
        Wanted::Density => choose(&file.entries, None)?,
        Wanted::Named(name) => choose(&file.entries, Some(name))?,
        Wanted::All => file.readable()?,
    };
    let others = file.entries.iter().enumerate();
    let others = others.filter(|(i, _)| !chosen.contains(i) && !colors.contains(i));
    let labels = others.map(|(_, entry)| entry.label()).collect();
    files.leave_grids(path, labels);
    let mut fields = Vec::new();
    for entry in chosen.into_iter().map(|i| &file.entries[i]) {
        let place = format!("grid `{}`", entry.label());
        let grid = file.grid(entry, None, &files.cancel);
        let grid = grid.map_err(|e| e.at(&place))?;
        if grid.tree.background != 0.0 {
            files.warn(format!(
                "{place} has the background {}; it is taken as 0",
                grid.tree.background
            ));
        }
        // All of it was passed over to find leaves.
        content.release();
        match grid
            .into_field(content.clone(), 0.0)
            .map_err(|e| e.at(&place))?
        {
            Some(field) => fields.push(field),
            None => {
                let what = "grids without active voxels are left out";
                left_out.note(what, format_args!("`{}`", entry.label()));
            }
        }
    }
    left_out.tell(path, 0, files);
    Ok(fields)
}

/// A file whose list of grids has been read.
struct File<'a> {
    content: &'a [u8],
    version: u32,
    /// Compression of all grids in old files.
    compression: u32,
    entries: Vec<Entry>,
}

impl<'a> File<'a> {
    fn open(content: &'a [u8], left_out: &mut LeftOut) -> Result<Self> {
        let mut bytes = Bytes::new(content);
        if bytes.i64().ok() != Some(MAGIC) {
            return Err(Error::input(
                "not an OpenVDB file: it does not start with its magic number",
            ));
        }
        let version = bytes.u32()?;
        if version < OLDEST {
            return Err(Error::input(format!(
                "expected an OpenVDB file of version {OLDEST} to {NEWEST}, found {version}"
            ))
            .hint("write it again with a current version of OpenVDB"));
        }
        if version > NEWEST {
            let what = "the file is of a version that may have more than is read";
            left_out.note(what, format_args!("{version}, after {NEWEST}"));
        }
        let _library = bytes.take(8)?;
        let has_offsets = bytes.u8()? != 0;
        let compression = match version < 222 {
            true => u32::from(bytes.u8()? != 0),
            false => 0,
        };
        let _uuid = bytes.take(36)?;
        read_metadata(&mut bytes)?;
        let entries = read_entries(&mut bytes, has_offsets, left_out)?;
        Ok(Self {
            content,
            version,
            compression,
            entries,
        })
    }

    /// Reads what leads the tree of a grid: compression, metadata and place.
    fn head(&self, entry: &Entry, channel: Option<usize>) -> Result<GridHead<'a>> {
        let mut bytes = Bytes::new(self.content);
        bytes.seek(entry.at)?;
        let compression = match self.version < 222 {
            true => self.compression,
            false => bytes.u32()?,
        };
        let metadata = read_metadata(&mut bytes)?;
        // The class comes before the type: a vector grid that is a level set exists nowhere.
        if text(&metadata, "class").as_deref() == Some("level set") {
            return Err(Error::input(
                "it is a level set, not a fog volume: its values are distances",
            )
            .hint(
                "convert it, for example with vdb_tool or Houdini's Convert VDB, to a fog volume",
            ));
        }
        number_of(&entry.kind, channel)?;
        let world_from_index = read_map(&mut bytes)?;
        Ok(GridHead {
            tree_bytes: bytes,
            compression,
            metadata,
            world_from_index,
        })
    }

    /// The numbers of all grids that are fog volumes; that of the first if there is none, so that
    /// an error says why.
    fn readable(&self) -> Result<Vec<usize>> {
        let entries = self.entries.iter().enumerate();
        let readable = entries.filter(|(_, entry)| self.head(entry, None).is_ok());
        let readable: Vec<usize> = readable.map(|(i, _)| i).collect();
        match (readable.is_empty(), self.entries.is_empty()) {
            (false, _) => Ok(readable),
            (true, false) => Ok(vec![0]),
            (true, true) => choose(&self.entries, None),
        }
    }

    fn grid(&self, entry: &Entry, channel: Option<usize>, cancel: &Cancel) -> Result<VdbGrid> {
        let own = self.head(entry, channel)?;
        // An instance has a place of its own and the tree of another grid.
        let (mut bytes, compression) = match entry.parent.is_empty() {
            true => (own.tree_bytes, own.compression),
            false => {
                let parent = self.entries.iter().find(|e| e.unique == entry.parent);
                let parent = parent.filter(|p| p.parent.is_empty()).ok_or_else(|| {
                    Error::input("it shares the tree of a grid that is not there")
                })?;
                let head = self.head(parent, channel)?;
                (head.tree_bytes, head.compression)
            }
        };
        let encoding = Encoding {
            version: self.version,
            compression,
            number: number_of(&entry.kind, channel)?,
            channel,
        };
        let tree = Tree::read(&mut bytes, encoding, cancel)?;
        let grid = VdbGrid {
            label: entry.label(),
            metadata: own.metadata,
            world_from_index: own.world_from_index,
            encoding,
            tree,
        };
        grid.check_count()?;
        Ok(grid)
    }
}

/// How a tree of this type has its values, or the channels of these.
fn number_of(kind: &str, channel: Option<usize>) -> Result<Number> {
    if channel.is_some() {
        return match kind {
            "Tree_vec3s_5_4_3" => Ok(Number::Float),
            "Tree_vec3s_5_4_3_HalfFloat" => Ok(Number::FloatAsHalf),
            other => Err(Error::input(format!(
                "it has the type {other}; colours are read of Tree_vec3s_5_4_3 alone, \
                 also stored as half"
            ))
            .hint("convert it to a grid of vectors of three floats")),
        };
    }
    match kind {
        "Tree_float_5_4_3" => Ok(Number::Float),
        "Tree_float_5_4_3_HalfFloat" => Ok(Number::FloatAsHalf),
        "Tree_half_5_4_3" => Ok(Number::Half),
        other => Err(Error::input(format!(
            "it has the type {other}; only Tree_float_5_4_3, also stored as half, and \
             Tree_half_5_4_3 are supported"
        ))
        .hint("convert it to a float grid")),
    }
}

impl VdbGrid {
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

    /// The samples in the box of active voxels of the file `content`, in which others are
    /// `inactive`; none if there are no such voxels.
    fn into_field(self, content: Arc<Content>, inactive: f32) -> Result<Option<Field>> {
        let Some((low, high)) = self.tree.extent() else {
            return Ok(None);
        };
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
        let first = low.map(|i| i - 1);
        let name = Some(self.label.clone());
        let place = [first_leaf, leaves];
        let named = (self.label, inactive);
        let table = Table::new(content, self.encoding, named, self.tree, first, place)?;
        Ok(Some(Field {
            name,
            dims: size.map(|n| n as usize + 2),
            first,
            padding: 1,
            world_from_file: Some(self.world_from_index),
            patient: None,
            samples: Samples::Other(Box::new(table)).into(),
            start: [0; 3],
        }))
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

fn read_entries(
    bytes: &mut Bytes<'_>,
    has_offsets: bool,
    left_out: &mut LeftOut,
) -> Result<Vec<Entry>> {
    let count = bytes.i32()?;
    let mut entries = Vec::new();
    for _ in 0..count {
        let unique = bytes.text()?;
        // Grids of the same name are told apart by a number after a separator.
        let mut parts = unique.split('\x1e').map(str::to_string);
        let (name, suffix) = (parts.next().unwrap_or_default(), parts.next());
        let kind = bytes.text()?;
        let parent = bytes.text()?;
        let (grid_at, _blocks_at, end) = (bytes.i64()?, bytes.i64()?, bytes.i64()?);
        let at = if has_offsets {
            grid_at
        } else {
            bytes.at() as i64
        };
        if has_offsets && end <= bytes.at() as i64 {
            return Err(Error::input(format!(
                "the grid `{name}` ends at offset {end}, before it starts; the file is damaged"
            )));
        }
        entries.push(Entry {
            name,
            suffix,
            kind,
            parent,
            unique,
            at,
        });
        if !has_offsets {
            // Written to a pipe: where the next grid starts is only known after reading this one.
            if count > 1 {
                let what = "grids behind the first of a file without offsets are left out";
                left_out.note(what, format_args!("{} of them", count - 1));
            }
            break;
        }
        bytes.seek(end)?;
    }
    Ok(entries)
}

/// The numbers of the grids to read.
fn choose(entries: &[Entry], wanted: Option<&str>) -> Result<Vec<usize>> {
    let labels = |entries: &[Entry]| {
        let labels: Vec<_> = entries.iter().map(|e| format!("`{}`", e.label())).collect();
        labels.join(", ")
    };
    let of_name = |name: &str| -> Vec<usize> {
        let numbers = entries.iter().enumerate();
        let named = numbers.filter(|(_, e)| e.name == name);
        named.map(|(i, _)| i).collect()
    };
    if entries.is_empty() {
        return Err(Error::input("the file has no grids"));
    }
    if let Some(wanted) = wanted {
        if let Some(i) = entries
            .iter()
            .position(|e| e.suffix.is_some() && e.label() == wanted)
        {
            return Ok(vec![i]);
        }
        let all = of_name(wanted);
        if !all.is_empty() {
            return Ok(all);
        }
        // One of a name by its number in the file.
        let numbered = wanted.strip_suffix(']').and_then(|w| w.rsplit_once('['));
        let one =
            numbered.and_then(|(name, n)| of_name(name).get(n.parse::<usize>().ok()?).copied());
        return one.map(|i| vec![i]).ok_or_else(|| {
            Error::input(format!(
                "there is no grid `{wanted}`; the file has {}",
                labels(entries)
            ))
        });
    }
    let density = of_name("density");
    if !density.is_empty() {
        return Ok(density);
    }
    let mut readable: Vec<&str> = entries
        .iter()
        .filter(|e| number_of(&e.kind, None).is_ok() || entries.len() == 1)
        .map(|e| e.name.as_str())
        .collect();
    readable.dedup();
    match readable[..] {
        [name] => Ok(of_name(name)),
        _ => Err(
            Error::input(format!("the file has several grids: {}", labels(entries)))
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
