//! Files made byte by byte.

use super::*;

/// A grid of one 16^3 node with leaves at the given slots, or tiles.
#[derive(Clone)]
pub struct Spec {
    pub version: u32,
    pub compression: u32,
    pub half: bool,
    pub kind: String,
    pub class: &'static str,
    pub map: Vec<u8>,
    /// Corner of the 4096^3 node of the root.
    pub origin: [i32; 3],
    /// Slots of the 16^3 node that hold leaves; voxels where the hash of their offset is even are
    /// active.
    pub leaves: Vec<usize>,
    /// Slot of an active tile of 8^3 voxels, and of one of 128^3.
    pub tile_8: Option<(usize, f32)>,
    pub tile_128: Option<(usize, f32)>,
    pub root_tile: Option<([i32; 3], f32)>,
    pub count: Option<i64>,
}

impl Default for Spec {
    fn default() -> Self {
        Self {
            version: 224,
            compression: 0,
            half: false,
            kind: "Tree_float_5_4_3".into(),
            class: "fog volume",
            map: uniform_scale(0.5),
            origin: [0, 0, 0],
            leaves: vec![0, 17, 4095],
            tile_8: None,
            tile_128: None,
            root_tile: None,
            count: None,
        }
    }
}

/// Channels of vectors over the value that a single number would have.
pub const VECTOR: [f32; 3] = [1.0, 0.5, 2.0];

pub fn text(s: &str) -> Vec<u8> {
    [&(s.len() as u32).to_le_bytes(), s.as_bytes()].concat()
}

pub fn doubles(values: &[f64]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

pub fn uniform_scale(scale: f64) -> Vec<u8> {
    [text("UniformScaleMap"), doubles(&[scale; 15])].concat()
}

pub fn is_active(offset: usize) -> bool {
    (offset * 0x9e37) >> 3 & 1 == 0
}

/// Value of a voxel by its offset in the leaf and the leaf's slot; exact as half.
pub fn value(slot: usize, offset: usize) -> f32 {
    (1 + offset % 7 + slot % 5) as f32 * 0.25
}

pub fn mask(words: usize, is_on: impl Fn(usize) -> bool) -> Vec<u8> {
    (0..words * 8)
        .map(|byte| (0..8).fold(0, |b, bit| b | u8::from(is_on(byte * 8 + bit)) << bit))
        .collect()
}

impl Spec {
    /// What stands in the file of a value.
    pub fn numbers(&self, value: f32) -> Vec<f32> {
        match self.kind.starts_with("Tree_vec3s") {
            true => VECTOR.map(|factor| factor * value).to_vec(),
            false => vec![value],
        }
    }

    pub fn array(&self, values: &[f32]) -> Vec<u8> {
        let values = &values
            .iter()
            .flat_map(|v| self.numbers(*v))
            .collect::<Vec<_>>()[..];
        if self.half && !self.is_half_tree() && values.is_empty() {
            return Vec::new();
        }
        let data: Vec<u8> = match self.half {
            true => (values.iter())
                .flat_map(|v| half::f16::from_f32(*v).to_le_bytes())
                .collect(),
            false => values.iter().flat_map(|v| v.to_le_bytes()).collect(),
        };
        if self.compression & 5 == 0 {
            return data;
        }
        let packed = if self.compression & 1 != 0 {
            let mut zip = ZlibEncoder::new(Vec::new(), Compression::default());
            zip.write_all(&data).unwrap();
            zip.finish().unwrap()
        } else if data.len() < 48 {
            data.clone()
        } else {
            pack(&data)
        };
        if packed.len() < data.len() {
            [&(packed.len() as i64).to_le_bytes(), packed.as_slice()].concat()
        } else {
            [&(-(data.len() as i64)).to_le_bytes(), data.as_slice()].concat()
        }
    }

    /// Values of a node, those in slots that are not active left out if the file does that.
    pub fn values(&self, values: &[f32], active: impl Fn(usize) -> bool) -> Vec<u8> {
        let kept: Vec<f32> = (0..values.len())
            .filter(|&i| self.compression & 2 == 0 || active(i))
            .map(|i| values[i])
            .collect();
        let kind = if self.compression & 2 != 0 { 0 } else { 6 };
        let mut out = match self.version < 222 {
            true => vec![],
            false => vec![kind],
        };
        out.extend(self.array(&kept));
        out
    }

    pub fn node(&self, size: usize, children: &[usize], tile: Option<(usize, f32)>) -> Vec<u8> {
        let mut values = vec![0.0; size];
        if let Some((slot, value)) = tile {
            values[slot] = value;
        }
        let is_tile = |i: usize| tile.is_some_and(|(slot, _)| slot == i);
        let mut out = mask(size / 64, |i| children.contains(&i));
        out.extend(mask(size / 64, is_tile));
        if self.version < 222 {
            values = (0..size)
                .filter(|i| !children.contains(i))
                .map(|i| values[i])
                .collect();
        }
        out.extend(self.values(&values, is_tile));
        out
    }

    pub fn active(&self) -> i64 {
        let per_leaf = (0..512).filter(|&i| is_active(i)).count();
        (self.leaves.len() * per_leaf) as i64
            + self.tile_8.map_or(0, |_| 512)
            + self.tile_128.map_or(0, |_| 128 * 128 * 128)
            + self.root_tile.map_or(0, |_| 1 << 36)
    }

    pub fn is_half_tree(&self) -> bool {
        self.kind.starts_with("Tree_half")
    }

    pub fn tree(&self) -> Vec<u8> {
        let mut out = 1_u32.to_le_bytes().to_vec();
        let size = if self.is_half_tree() { 2 } else { 4 };
        let background = self.numbers(0.0).into_iter();
        out.extend(background.flat_map(|v| v.to_le_bytes()[..size].to_vec()));
        out.extend(u32::from(self.root_tile.is_some()).to_le_bytes());
        out.extend(1_u32.to_le_bytes());
        if let Some((origin, value)) = self.root_tile {
            out.extend(origin.iter().flat_map(|x| x.to_le_bytes()));
            let numbers = self.numbers(value).into_iter();
            out.extend(numbers.flat_map(f32::to_le_bytes));
            out.push(1);
        }
        out.extend(self.origin.iter().flat_map(|x| x.to_le_bytes()));
        out.extend(self.node(32768, &[0], self.tile_128));
        out.extend(self.node(4096, &self.leaves, self.tile_8));
        for _ in &self.leaves {
            out.extend(mask(8, is_active));
        }
        for slot in &self.leaves {
            out.extend(mask(8, is_active));
            if self.version < 222 {
                out.extend([0; 12]);
                out.push(1);
            }
            let values: Vec<f32> = (0..512)
                .map(|i| if is_active(i) { value(*slot, i) } else { 0.0 })
                .collect();
            out.extend(self.values(&values, is_active));
        }
        out
    }

    pub fn grid(&self) -> Vec<u8> {
        let mut out = match self.version < 222 {
            true => vec![],
            false => self.compression.to_le_bytes().to_vec(),
        };
        out.extend(2_u32.to_le_bytes());
        out.extend([text("class"), text("string"), text(self.class)].concat());
        out.extend([text("file_voxel_count"), text("int64")].concat());
        out.extend(8_u32.to_le_bytes());
        out.extend(self.count.unwrap_or(self.active()).to_le_bytes());
        out.extend(&self.map);
        out.extend(self.tree());
        out
    }

    pub fn file(&self) -> Vec<u8> {
        file(&[("density", self)])
    }
}

pub fn file(grids: &[(&str, &Spec)]) -> Vec<u8> {
    let grids: Vec<_> = grids.iter().map(|&(name, spec)| (name, "", spec)).collect();
    file_with_instances(&grids)
}

/// A file of grids by name, name of the grid whose tree they share, and content.
pub fn file_with_instances(grids: &[(&str, &str, &Spec)]) -> Vec<u8> {
    let spec = grids[0].2;
    let mut out = MAGIC.to_le_bytes().to_vec();
    out.extend(spec.version.to_le_bytes());
    out.extend([10, 0, 0, 0, 1, 0, 0, 0, 1]);
    if spec.version < 222 {
        out.push((spec.compression & 1) as u8);
    }
    out.extend([b'x'; 36]);
    out.extend(1_u32.to_le_bytes());
    out.extend([text("creator"), text("string"), text("a test")].concat());
    out.extend((grids.len() as i32).to_le_bytes());
    for (name, parent, spec) in grids {
        out.extend(text(name));
        let suffix = if spec.half && !spec.is_half_tree() {
            "_HalfFloat"
        } else {
            ""
        };
        out.extend(text(&format!("{}{suffix}", spec.kind)));
        out.extend(text(parent));
        let at = out.len() + 24;
        let mut grid = spec.grid();
        if !parent.is_empty() {
            grid.truncate(grid.len() - spec.tree().len());
        }
        for offset in [at, at, at + grid.len()] {
            out.extend((offset as i64).to_le_bytes());
        }
        out.extend(grid);
    }
    out
}
