//! The lvoxels of one volume on its own index grid.

use super::LvoxelBlock;
use crate::math::{Aabb, Rgb, unflatten};
use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec3};
use lvox_formats::record::{LightPart, Lvoxel, MAX_LEVEL, VolumeInfo};

/// Voxels along an edge of a brick.
pub const BRICK: usize = 1 << MAX_LEVEL;
/// No brick.
pub const EMPTY: u32 = u32::MAX;

/// The lvoxels of one volume: a table of bricks, each empty or a cube of blocks of one size.
#[derive(Debug)]
pub struct BlockGrid<B> {
    pub index_from_scene: Affine3A,
    pub index_from_scene_f64: DAffine3,
    /// Edges of a voxel, scene units.
    pub voxel: Vec3,
    /// Extinction of red, green and blue over that of the lvoxels, one of them 1.
    pub extinction_color: [f32; 3],
    pub dims: [f32; 3],
    pub table_dims: [usize; 3],
    /// Index in `bricks`, or [`EMPTY`].
    pub table: Vec<u32>,
    pub bricks: Vec<Brick>,
    pub cubes: Vec<Cube>,
    /// Blocks that are not empty, cube by cube: rays wait for memory more than for anything else.
    pub blocks: Vec<B>,
    /// By block, the lobe in which its light leaves; none if all light leaves in all directions
    /// alike.
    pub lobes: Vec<[i8; 3]>,
    /// Whether lvoxels with lobes were noted.
    pub has_lobes: bool,
    /// By block, the part of its light that has scattered once; none if that is in the lobe of all.
    pub singles: Vec<LightPart>,
    /// Whether lvoxels with such parts were noted.
    pub has_singles: bool,
    /// By block, what arrives there of the light of the others; none if no lvoxel tells.
    pub incident: Vec<Rgb>,
    /// Whether lvoxels that tell were noted.
    pub has_incident: bool,
}

/// A brick that is not empty.
#[derive(Clone, Debug)]
pub struct Brick {
    /// The first of its cubes: one, or eight if its blocks are single voxels.
    pub first_cube: u32,
    /// Log2 of the voxels along an edge of its blocks.
    pub level: u8,
    /// Box of the blocks that are not empty, in blocks: first and one past the last.
    pub filled: [[u8; 3]; 2],
    /// Whether that is all of the brick.
    pub is_full: bool,
}

/// Four by four by four blocks.
#[derive(Clone, Copy, Debug, Default)]
pub struct Cube {
    /// A bit for each block that is not empty.
    pub filled: u64,
    /// Index of the first of those.
    pub first: u32,
}

/// Extinction per scene unit and source function.
#[derive(Clone, Copy, Debug, Default)]
pub struct Block {
    pub sigma_t: f32,
    pub source: Rgb,
}

/// Finds a block in its brick: the index of the cube, and the bit in that.
#[inline]
pub fn place([x, y, z]: [usize; 3]) -> (usize, usize) {
    let cube = (z >> 2) << 2 | (y >> 2) << 1 | x >> 2;
    (cube, (z & 3) << 4 | (y & 3) << 2 | x & 3)
}

/// Bricks of a volume, by axis.
fn table_dims(info: &VolumeInfo) -> [usize; 3] {
    info.dims.map(|n| (n as usize).div_ceil(BRICK))
}

/// Bytes that finding the lvoxels of a volume takes, whatever its number of lvoxels.
pub fn table_bytes(info: &VolumeInfo) -> u128 {
    let bricks: u128 = table_dims(info).iter().map(|&n| n as u128).product();
    bricks * size_of::<u32>() as u128
}

impl BlockGrid<()> {
    pub fn new(info: &VolumeInfo) -> Self {
        let [x, y, z, t] = info.index_from_scene.map(DVec3::from);
        let exact = DAffine3 {
            matrix3: DMat3::from_cols(x, y, z),
            translation: t,
        };
        let table_dims = table_dims(info);
        let scene_from_index = exact.inverse().matrix3;
        let voxel = [0, 1, 2].map(|a| scene_from_index.col(a).length() as f32);
        Self {
            index_from_scene: Affine3A::from_cols_array(&exact.to_cols_array().map(|v| v as f32)),
            index_from_scene_f64: exact,
            voxel: voxel.into(),
            extinction_color: info.extinction_color,
            dims: info.dims.map(|n| n as f32),
            table_dims,
            table: vec![EMPTY; table_dims.iter().product()],
            bricks: Vec::new(),
            cubes: Vec::new(),
            blocks: Vec::new(),
            lobes: Vec::new(),
            has_lobes: false,
            singles: Vec::new(),
            has_singles: false,
            incident: Vec::new(),
            has_incident: false,
        }
    }

    /// Box around the volume in the scene; around all where its map has no inverse.
    pub fn bounds(&self) -> Aabb {
        let scene_from_index = self.index_from_scene_f64.inverse();
        let corners = (0..8).map(|i| {
            let corner = [0, 1, 2].map(|a| f64::from(self.dims[a]) * f64::from(i >> a & 1));
            scene_from_index.transform_point3(corner.into()).as_vec3()
        });
        let corners: Vec<_> = corners.collect();
        if corners.iter().all(|c| c.is_finite()) {
            corners.into_iter().fold(Aabb::EMPTY, Aabb::with)
        } else {
            Aabb {
                min: Vec3::NEG_INFINITY,
                max: Vec3::INFINITY,
            }
        }
    }

    pub fn note(&mut self, l: &Lvoxel) {
        let Some((at, cube, bit)) = self.find(l) else {
            return;
        };
        if self.table[at] == EMPTY {
            self.table[at] = self.bricks.len() as u32;
            self.bricks.push(Brick {
                first_cube: self.cubes.len() as u32,
                level: l.level,
                filled: [[u8::MAX; 3], [0; 3]],
                is_full: false,
            });
            let cubes = if l.level == 0 { 8 } else { 1 };
            self.cubes.resize(self.cubes.len() + cubes, Cube::default());
        }
        let brick = &mut self.bricks[self.table[at] as usize];
        if brick.level != l.level {
            return;
        }
        self.cubes[brick.first_cube as usize + cube].filled |= 1 << bit;
        self.has_lobes |= l.lobe != [0; 3] || l.single.share != 0;
        self.has_singles |= l.single.share != 0;
        self.has_incident |= l.incident != [0.0; 3];
        let per_axis = (BRICK >> l.level) as u16;
        let [first, end] = &mut brick.filled;
        for a in 0..3 {
            let at = (l.block[a] % per_axis) as u8;
            first[a] = first[a].min(at);
            end[a] = end[a].max(at + 1);
        }
        brick.is_full = brick.filled == [[0; 3], [per_axis as u8; 3]];
    }

    /// Blocks that are not empty.
    pub fn count(&self) -> u64 {
        let filled = self.cubes.iter().map(|c| u64::from(c.filled.count_ones()));
        filled.sum()
    }

    /// Gives each block that was noted its place, cube by cube.
    pub fn allocate(mut self) -> BlockGrid<Block> {
        let mut first = 0;
        for cube in &mut self.cubes {
            cube.first = first;
            first += cube.filled.count_ones();
        }
        self.cubes.shrink_to_fit();
        self.bricks.shrink_to_fit();
        BlockGrid {
            index_from_scene: self.index_from_scene,
            index_from_scene_f64: self.index_from_scene_f64,
            voxel: self.voxel,
            extinction_color: self.extinction_color,
            dims: self.dims,
            table_dims: self.table_dims,
            table: self.table,
            bricks: self.bricks,
            cubes: self.cubes,
            blocks: vec![Block::default(); first as usize],
            lobes: vec![[0; 3]; if self.has_lobes { first as usize } else { 0 }],
            has_lobes: self.has_lobes,
            singles: vec![LightPart::default(); if self.has_singles { first as usize } else { 0 }],
            has_singles: self.has_singles,
            incident: vec![Rgb::BLACK; if self.has_incident { first as usize } else { 0 }],
            has_incident: self.has_incident,
        }
    }
}

impl<B> BlockGrid<B> {
    /// Bytes of memory that all blocks take.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.blocks)
            + size_of_val(&*self.lobes)
            + size_of_val(&*self.singles)
            + size_of_val(&*self.incident)
            + size_of_val(&*self.cubes)
            + size_of_val(&*self.bricks)
            + size_of_val(&*self.table)
    }

    /// Index of a block of a brick, by its place there; `None` if it is empty.
    pub fn index(&self, brick: &Brick, block: [usize; 3]) -> Option<usize> {
        let (cube, bit) = place(block);
        let cube = &self.cubes[brick.first_cube as usize + cube];
        let before = (cube.filled & ((1 << bit) - 1)).count_ones();
        (cube.filled >> bit & 1 == 1).then_some((cube.first + before) as usize)
    }

    /// The brick that an lvoxel is in, its cube there, and its bit in that; `None` outside of the
    /// volume.
    fn find(&self, l: &Lvoxel) -> Option<(usize, usize, usize)> {
        let per_axis = BRICK >> l.level;
        let block = l.block.map(usize::from);
        let brick = block.map(|b| b / per_axis);
        let [x, y, z] = self.table_dims;
        let inside = brick[0] < x && brick[1] < y && brick[2] < z;
        let (cube, bit) = place(block.map(|b| b % per_axis));
        inside.then_some(((brick[2] * y + brick[1]) * x + brick[0], cube, bit))
    }
}

impl BlockGrid<Block> {
    pub fn place(&mut self, l: &Lvoxel) {
        let Some((at, cube, bit)) = self.find(l) else {
            return;
        };
        let Some(brick) = self.bricks.get(self.table[at] as usize) else {
            return;
        };
        let cube = self.cubes[brick.first_cube as usize + cube];
        if brick.level != l.level || cube.filled >> bit & 1 == 0 {
            return;
        }
        let before = (cube.filled & ((1 << bit) - 1)).count_ones();
        let i = (cube.first + before) as usize;
        let block = &mut self.blocks[i];
        if block.sigma_t == 0.0 {
            *block = Block {
                sigma_t: l.sigma_t,
                source: Rgb(l.source),
            };
            if let Some(lobe) = self.lobes.get_mut(i) {
                *lobe = l.lobe;
            }
            if let Some(single) = self.singles.get_mut(i) {
                *single = l.single;
            }
            if let Some(incident) = self.incident.get_mut(i) {
                *incident = Rgb(l.incident);
            }
        }
    }

    /// A block of a brick, by its place there; `None` if it is empty.
    pub fn block(&self, brick: &Brick, block: [usize; 3]) -> Option<&Block> {
        Some(&self.blocks[self.index(brick, block)?])
    }

    /// The same blocks without light.
    pub fn dark(&self) -> Self {
        let blocks = self.blocks.iter().map(|b| Block {
            source: Rgb::BLACK,
            ..*b
        });
        Self {
            blocks: blocks.collect(),
            table: self.table.clone(),
            bricks: self.bricks.clone(),
            cubes: self.cubes.clone(),
            lobes: Vec::new(),
            singles: Vec::new(),
            incident: Vec::new(),
            ..*self
        }
    }

    pub fn each_block(&self, take: &mut impl FnMut(LvoxelBlock)) {
        for (at, &brick) in self.table.iter().enumerate() {
            let Some(brick) = self.bricks.get(brick as usize) else {
                continue;
            };
            let edge = 1 << brick.level;
            let base = unflatten(at, self.table_dims).map(|b| b * BRICK);
            for i in 0..(BRICK >> brick.level).pow(3) {
                let block = unflatten(i, [BRICK >> brick.level; 3]);
                if let Some(i) = self.index(brick, block) {
                    let Block { sigma_t, source } = self.blocks[i];
                    take(LvoxelBlock {
                        first: std::array::from_fn(|a| base[a] + block[a] * edge),
                        edge,
                        sigma_t,
                        source,
                        lobe: self.lobes.get(i).copied().unwrap_or_default(),
                        single: self.singles.get(i).copied().unwrap_or_default(),
                    });
                }
            }
        }
    }
}
