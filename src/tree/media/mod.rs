//! Lvoxels along a ray: the blocks of each volume on its own index grid, walked front to back.

mod incident;

use crate::math::dda::{Passage, Steps};
use crate::math::segment::{Interval, Segment, flatten_overlaps};
use crate::math::{Aabb, Boxes, Ray, Rgb, unflatten};
use glam::{Affine3A, DAffine3, DMat3, DVec3, Vec3, Vec3A};
pub use incident::IncidentGrid;
use lvox_formats::record::{Lvoxel, MAX_LEVEL, VolumeInfo};

const BRICK: usize = 1 << MAX_LEVEL;
const EMPTY: u32 = u32::MAX;

/// All lvoxels of a tree.
#[derive(Debug, Default)]
pub struct Media {
    volumes: Vec<BlockGrid<Block>>,
    boxes: Boxes,
    /// The same lvoxels, which send nothing; none if they do not tell what arrives of their light.
    dark: Option<Box<Media>>,
}

/// The lvoxels of one volume: a table of bricks, each empty or a cube of blocks of one size.
#[derive(Debug)]
struct BlockGrid<B> {
    index_from_scene: Affine3A,
    index_from_scene_f64: DAffine3,
    dims: [f32; 3],
    table_dims: [usize; 3],
    /// Index in `bricks`, or [`EMPTY`].
    table: Vec<u32>,
    bricks: Vec<Brick>,
    cubes: Vec<Cube>,
    /// Blocks that are not empty, cube by cube: rays wait for memory more than for anything else.
    blocks: Vec<B>,
    /// By block, the lobe in which its light leaves; none if all light leaves in all directions
    /// alike.
    lobes: Vec<[i8; 3]>,
    /// Whether lvoxels with lobes were noted.
    has_lobes: bool,
    /// By block, what arrives there of the light of the others; none if no lvoxel tells.
    incident: Vec<Rgb>,
    /// Whether lvoxels that tell were noted.
    has_incident: bool,
}

/// A brick that is not empty.
#[derive(Clone, Debug)]
struct Brick {
    /// The first of its cubes: one, or eight if its blocks are single voxels.
    first_cube: u32,
    /// Log2 of the voxels along an edge of its blocks.
    level: u8,
    /// Box of the blocks that are not empty, in blocks: first and one past the last.
    filled: [[u8; 3]; 2],
    /// Whether that is all of the brick.
    is_full: bool,
}

/// Four by four by four blocks.
#[derive(Clone, Copy, Debug, Default)]
struct Cube {
    /// A bit for each block that is not empty.
    filled: u64,
    /// Index of the first of those.
    first: u32,
}

/// Extinction per scene unit and source function.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    sigma_t: f32,
    source: Rgb,
}

/// An lvoxel as it lies in its volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LvoxelBlock {
    /// Its first voxel.
    pub first: [usize; 3],
    /// Voxels along its edge.
    pub edge: usize,
    /// Extinction per scene unit.
    pub sigma_t: f32,
    /// Source function: the mean over all directions.
    pub source: Rgb,
    /// Mean direction in which its light leaves, as [`Lvoxel`] has it.
    pub lobe: [i8; 3],
}

impl LvoxelBlock {
    /// The mean direction in which its light leaves, scene space.
    #[must_use]
    pub fn mean_direction(&self) -> Vec3 {
        mean_direction(self.lobe)
    }
}

fn mean_direction(lobe: [i8; 3]) -> Vec3 {
    Vec3::from(lobe.map(f32::from)) * (1.0 / Lvoxel::LOBE_ONE)
}

/// Light that leaves in a unit direction, over the mean of all directions, where this is the mean
/// direction in which it leaves (Henyey & Greenstein 1941).
#[inline]
#[must_use]
pub fn in_lobe(lobe: Vec3, travel: Vec3) -> f32 {
    let squared = (travel - lobe).length_squared();
    (1.0 - lobe.length_squared()) / (squared * squared.sqrt())
}

/// Finds a block in its brick: the index of the cube, and the bit in that.
#[inline]
fn place([x, y, z]: [usize; 3]) -> (usize, usize) {
    let cube = (z >> 2) << 2 | (y >> 2) << 1 | x >> 2;
    (cube, (z & 3) << 4 | (y & 3) << 2 | x & 3)
}

/// The places of a tree's lvoxels. What they hold is read in a second pass over them, so that they
/// are never in memory twice.
#[derive(Debug)]
pub struct MediaLayout {
    volumes: Vec<BlockGrid<()>>,
}

impl MediaLayout {
    /// No lvoxels yet, in these volumes.
    #[must_use]
    pub fn new(volumes: &[VolumeInfo]) -> Self {
        Self {
            volumes: volumes.iter().map(BlockGrid::new).collect(),
        }
    }

    /// Notes where an lvoxel is. They may come in any order; the first in a brick decides on the
    /// size of the brick's blocks, and of two in one place. One that does not fit in is left out.
    pub fn note(&mut self, l: &Lvoxel) {
        if let Some(volume) = self.volumes.get_mut(usize::from(l.volume)) {
            volume.note(l);
        }
    }

    /// Bytes that the media will hold.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let blocks: u64 = self.volumes.iter().map(BlockGrid::count).sum();
        let rest: usize = self.volumes.iter().map(BlockGrid::bytes).sum();
        let lobed = (self.volumes.iter()).filter(|v| v.has_lobes);
        let lobes = lobed.map(BlockGrid::count).sum::<u64>() * size_of::<[i8; 3]>() as u64;
        let blocks_and_rest = blocks * size_of::<Block>() as u64 + rest as u64;
        if !self.volumes.iter().any(|v| v.has_incident) {
            return blocks_and_rest + lobes;
        }
        let telling = (self.volumes.iter()).filter(|v| v.has_incident);
        let incident = telling.map(BlockGrid::count).sum::<u64>() * size_of::<Rgb>() as u64;
        2 * blocks_and_rest + lobes + incident
    }

    /// Media whose lvoxels are all empty; [`Media::place`] fills them in.
    #[must_use]
    pub fn allocate(self) -> Media {
        Media {
            boxes: Boxes::new(self.volumes.iter().map(BlockGrid::bounds)),
            volumes: self.volumes.into_iter().map(BlockGrid::allocate).collect(),
            dark: None,
        }
    }
}

impl Media {
    /// Lays out lvoxels, which may come in any order but must lie inside their volumes, as readers
    /// promise.
    #[must_use]
    pub fn new(volumes: &[VolumeInfo], lvoxels: impl IntoIterator<Item = Lvoxel>) -> Self {
        let lvoxels: Vec<Lvoxel> = lvoxels.into_iter().collect();
        let mut layout = MediaLayout::new(volumes);
        lvoxels.iter().for_each(|l| layout.note(l));
        let mut media = layout.allocate();
        lvoxels.iter().for_each(|l| media.place(l));
        media.with_dark()
    }

    /// Fills in an lvoxel that was noted; the first in its place stays.
    pub fn place(&mut self, l: &Lvoxel) {
        if let Some(volume) = self.volumes.get_mut(usize::from(l.volume)) {
            volume.place(l);
        }
    }

    /// All lvoxels are filled in.
    #[must_use]
    pub fn with_dark(mut self) -> Self {
        if self.volumes.iter().any(|v| v.has_incident) {
            self.dark = Some(Box::new(Self {
                volumes: self.volumes.iter().map(BlockGrid::dark).collect(),
                boxes: self.boxes.clone(),
                dark: None,
            }));
        }
        self
    }

    /// Lvoxels that send no light where they tell what arrives of it, as [`Self::incident`] has it;
    /// else these.
    #[must_use]
    pub fn without_incident(&self) -> &Self {
        self.dark.as_deref().unwrap_or(self)
    }

    /// Whether there is no lvoxel at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.volumes.iter().all(|v| v.blocks.is_empty())
    }

    /// Bytes of memory that all lvoxels take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let own: usize = self.volumes.iter().map(BlockGrid::bytes).sum();
        own + self.dark.as_ref().map_or(0, |dark| dark.bytes())
    }

    /// Voxels along each axis of a volume, if there is one of this number.
    #[must_use]
    pub fn dims(&self, volume: usize) -> Option<[usize; 3]> {
        Some(self.volumes.get(volume)?.dims.map(|n| n as usize))
    }

    /// Gives all lvoxels of a volume to `take`.
    pub fn each_block(&self, volume: usize, take: &mut impl FnMut(LvoxelBlock)) {
        if let Some(volume) = self.volumes.get(volume) {
            volume.each_block(take);
        }
    }

    /// The light that the lvoxels of a volume send each other; `None` if they do not tell.
    #[must_use]
    pub fn incident(&self, volume: usize) -> Option<IncidentGrid<'_>> {
        let grid = self.volumes.get(volume)?;
        (!grid.incident.is_empty()).then_some(IncidentGrid(grid))
    }

    /// Gives every segment of a ray in an lvoxel, front to back, to `add` until that says no;
    /// returns whether it never did.
    #[inline]
    pub fn walk(&self, ray: &Ray, add: &mut impl FnMut(Segment) -> bool) -> bool {
        self.walk_lit(ray, -ray.direction, add)
    }

    /// The same for light that travels with the ray, not against it.
    pub fn walk_with(&self, ray: &Ray, add: &mut impl FnMut(Segment) -> bool) -> bool {
        self.walk_lit(ray, ray.direction, add)
    }

    #[inline]
    fn walk_lit(&self, ray: &Ray, travel: Vec3, add: &mut impl FnMut(Segment) -> bool) -> bool {
        let boxes = self.boxes.along(ray);
        let mut met = boxes.filter_map(|v| self.volumes[v].enter(ray, travel));
        match (met.next(), met.next()) {
            (None, _) => true,
            (Some(walk), None) => walk.run(add),
            (Some(first), Some(second)) => {
                // What lvoxels send is known: walking them to their end costs little.
                let walks = [first, second].into_iter().chain(met).map(|walk| {
                    let mut all = Vec::new();
                    walk.run(&mut |s| {
                        all.push(Interval {
                            near: s.near,
                            far: s.far,
                            tau: s.tau,
                            of: s.source,
                        });
                        true
                    });
                    all.into_iter()
                });
                flatten_overlaps(walks, |source| source, add)
            }
        }
    }
}

/// Bricks of a volume, by axis.
fn table_dims(info: &VolumeInfo) -> [usize; 3] {
    info.dims.map(|n| (n as usize).div_ceil(BRICK))
}

/// Bytes that finding the lvoxels of a volume takes, whatever its number of lvoxels.
pub(super) fn table_bytes(info: &VolumeInfo) -> u128 {
    let bricks: u128 = table_dims(info).iter().map(|&n| n as u128).product();
    bricks * size_of::<u32>() as u128
}

impl BlockGrid<()> {
    fn new(info: &VolumeInfo) -> Self {
        let [x, y, z, t] = info.index_from_scene.map(DVec3::from);
        let exact = DAffine3 {
            matrix3: DMat3::from_cols(x, y, z),
            translation: t,
        };
        let table_dims = table_dims(info);
        Self {
            index_from_scene: Affine3A::from_cols_array(&exact.to_cols_array().map(|v| v as f32)),
            index_from_scene_f64: exact,
            dims: info.dims.map(|n| n as f32),
            table_dims,
            table: vec![EMPTY; table_dims.iter().product()],
            bricks: Vec::new(),
            cubes: Vec::new(),
            blocks: Vec::new(),
            lobes: Vec::new(),
            has_lobes: false,
            incident: Vec::new(),
            has_incident: false,
        }
    }

    /// Box around the volume in the scene; around all where its map has no inverse.
    fn bounds(&self) -> Aabb {
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

    fn note(&mut self, l: &Lvoxel) {
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
        self.has_lobes |= l.lobe != [0; 3];
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
    fn count(&self) -> u64 {
        let filled = self.cubes.iter().map(|c| u64::from(c.filled.count_ones()));
        filled.sum()
    }

    /// Gives each block that was noted its place, cube by cube.
    fn allocate(mut self) -> BlockGrid<Block> {
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
            dims: self.dims,
            table_dims: self.table_dims,
            table: self.table,
            bricks: self.bricks,
            cubes: self.cubes,
            blocks: vec![Block::default(); first as usize],
            lobes: vec![[0; 3]; if self.has_lobes { first as usize } else { 0 }],
            has_lobes: self.has_lobes,
            incident: vec![Rgb::BLACK; if self.has_incident { first as usize } else { 0 }],
            has_incident: self.has_incident,
        }
    }
}

impl<B> BlockGrid<B> {
    /// Bytes of memory that all blocks take.
    fn bytes(&self) -> usize {
        size_of_val(&*self.blocks)
            + size_of_val(&*self.lobes)
            + size_of_val(&*self.incident)
            + size_of_val(&*self.cubes)
            + size_of_val(&*self.bricks)
            + size_of_val(&*self.table)
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
    fn place(&mut self, l: &Lvoxel) {
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
            if let Some(incident) = self.incident.get_mut(i) {
                *incident = Rgb(l.incident);
            }
        }
    }

    /// The same blocks without light.
    fn dark(&self) -> Self {
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
            incident: Vec::new(),
            ..*self
        }
    }

    fn each_block(&self, take: &mut impl FnMut(LvoxelBlock)) {
        for (at, &brick) in self.table.iter().enumerate() {
            let Some(brick) = self.bricks.get(brick as usize) else {
                continue;
            };
            let edge = 1 << brick.level;
            let base = unflatten(at, self.table_dims).map(|b| b * BRICK);
            for i in 0..(BRICK >> brick.level).pow(3) {
                let block = unflatten(i, [BRICK >> brick.level; 3]);
                let (cube, bit) = place(block);
                let cube = self.cubes[brick.first_cube as usize + cube];
                if cube.filled >> bit & 1 == 1 {
                    let before = (cube.filled & ((1 << bit) - 1)).count_ones();
                    let i = (cube.first + before) as usize;
                    let Block { sigma_t, source } = self.blocks[i];
                    take(LvoxelBlock {
                        first: std::array::from_fn(|a| base[a] + block[a] * edge),
                        edge,
                        sigma_t,
                        source,
                        lobe: self.lobes.get(i).copied().unwrap_or_default(),
                    });
                }
            }
        }
    }

    /// The way of a ray whose light travels in a unit direction.
    fn enter(&self, ray: &Ray, travel: Vec3) -> Option<Walk<'_>> {
        let map = (&self.index_from_scene, &self.index_from_scene_f64);
        let passage = Passage::new(map, self.dims, ray)?;
        Some(Walk {
            grid: self,
            passage,
            travel,
        })
    }
}

/// A ray inside the box of a volume.
struct Walk<'a> {
    grid: &'a BlockGrid<Block>,
    passage: Passage,
    /// Unit direction in which light travels that the ray carries.
    travel: Vec3,
}

impl Walk<'_> {
    /// Gives every segment in a block to `add` until that says no; returns whether it never did.
    #[inline]
    fn run(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        if self.grid.lobes.is_empty() {
            self.run_plain(add)
        } else {
            self.run_lobed(add)
        }
    }

    #[inline]
    fn run_plain(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        self.run_as::<false>(add)
    }

    // Not inlined: most scenes have no lobes.
    #[inline(never)]
    fn run_lobed(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        self.run_as::<true>(add)
    }

    #[inline(always)]
    fn run_as<const LOBED: bool>(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        let Passage { line, end, .. } = &self.passage;
        let dims = self.grid.table_dims;
        let mut outer = Steps::new(line, 0.0, [0; 3], BRICK as f32, dims.map(|n| n as i32));
        let mut t = 0.0;
        loop {
            let at = outer.at();
            let leave = outer.leave().min(*end);
            let [x, y, z] = at.map(|v| v as usize);
            let b = self.grid.table[(z * dims[1] + y) * dims[0] + x];
            if let Some(brick) = self.grid.bricks.get(b as usize)
                && leave > t
                && !self.brick::<LOBED>(brick, at, t, leave, add)
            {
                return false;
            }
            t = leave.max(t);
            if leave >= *end || !outer.advance() {
                return true;
            }
        }
    }

    #[inline]
    fn brick<const LOBED: bool>(
        &self,
        brick: &Brick,
        at: [i32; 3],
        t: f32,
        leave: f32,
        add: &mut impl FnMut(Segment) -> bool,
    ) -> bool {
        let Passage { line, start, .. } = &self.passage;
        let base = at.map(|v| v * BRICK as i32);
        let edge = (1 << brick.level) as f32;
        let per_axis = (BRICK >> brick.level) as i32;
        let mut ends = Some((t, leave));
        if !brick.is_full {
            // Where blocks reach the border of the brick its own ends hold: they leave no gap to
            // the next brick.
            let corner = |filled: [u8; 3], border: i32, beyond: f32| {
                Vec3A::from_array(std::array::from_fn(|a| match i32::from(filled[a]) {
                    n if n == border => beyond,
                    n => base[a] as f32 + edge * n as f32,
                }))
            };
            let [first, end] = brick.filled;
            let lower = corner(first, 0, f32::NEG_INFINITY);
            let upper = corner(end, per_axis, f32::INFINITY);
            ends = line.within(lower, upper, t, leave);
        }
        let Some((t, leave)) = ends else {
            return true;
        };
        let mut inner = Steps::new(line, t, base, edge, [per_axis; 3]);
        let mut near = t;
        let cubes = &self.grid.cubes[brick.first_cube as usize..];
        loop {
            let (cube, bit) = place(inner.at().map(|v| v as usize));
            let cube = &cubes[cube];
            let far = inner.leave();
            let out = !inner.advance() | (far >= leave);
            let far = if out {
                leave
            } else if far > near {
                far
            } else {
                near
            };
            if cube.filled >> bit & 1 == 1 && far > near {
                let before = (cube.filled & ((1 << bit) - 1)).count_ones();
                let i = (cube.first + before) as usize;
                let block = &self.grid.blocks[i];
                let source = match LOBED {
                    true => {
                        let lobe = mean_direction(self.grid.lobes[i]);
                        block.source * in_lobe(lobe, self.travel)
                    }
                    false => block.source,
                };
                let s = Segment {
                    near: start + near,
                    far: start + far,
                    tau: block.sigma_t * (far - near),
                    source,
                };
                if !add(s) {
                    return false;
                }
            }
            near = far;
            if out {
                return true;
            }
        }
    }
}
