//! Lvoxels along a ray: the blocks of each volume on its own index grid, walked front to back.

use super::Crossing;
use super::medium::Source;
use crate::math::Rgb;
use crate::math::dda::{Line, Steps, clip_to_box};
use crate::math::segment::{Composite, Segment, flatten_overlaps};
use glam::{Affine3A, Vec3, Vec3A};
use lvox_formats::record::{Lvoxel, MAX_LEVEL, VolumeInfo};

const BRICK: usize = 1 << MAX_LEVEL;
const EMPTY: u32 = u32::MAX;

/// All lvoxels of a tree, with the source function of each as `S`.
#[derive(Debug, Default)]
pub struct Media<S> {
    volumes: Vec<BlockGrid<S>>,
}

/// The lvoxels of one volume: a table of bricks, each empty or a dense cube of blocks of one size.
#[derive(Debug)]
struct BlockGrid<S> {
    index_from_scene: Affine3A,
    dims: [f32; 3],
    bricks: [usize; 3],
    first: Vec<u32>,
    level: Vec<u8>,
    /// Box of each brick's blocks that are not empty, in blocks: first and one past the last.
    filled: Vec<[[u8; 3]; 2]>,
    blocks: Vec<Block<S>>,
}

/// Extinction per scene unit and source function.
#[derive(Clone, Copy, Debug, Default)]
struct Block<S> {
    sigma_t: f32,
    source: S,
}

impl<S: Source> Media<S> {
    /// Lays out lvoxels, which may come in any order but must lie inside their volumes, as readers promise.
    #[must_use]
    pub fn new(volumes: &[VolumeInfo], lvoxels: impl IntoIterator<Item = Lvoxel>) -> Self {
        let mut grids: Vec<BlockGrid<S>> = volumes.iter().map(BlockGrid::new).collect();
        for l in lvoxels {
            if let Some(grid) = grids.get_mut(usize::from(l.volume)) {
                grid.insert(&l);
            }
        }
        Self { volumes: grids }
    }

    /// Whether there is no medium at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.volumes.iter().all(|v| v.blocks.is_empty())
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.volumes
            .iter()
            .map(|v| {
                size_of_val(&*v.blocks)
                    + size_of_val(&*v.first)
                    + size_of_val(&*v.level)
                    + size_of_val(&*v.filled)
            })
            .sum()
    }

    /// Optical depth of all media from `origin` to `t_max`.
    #[must_use]
    pub fn optical_depth(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        let mut tau = 0.0;
        for walk in self
            .volumes
            .iter()
            .filter_map(|v| v.enter(origin, direction, t_max))
        {
            walk.run(&mut |s| {
                tau += s.tau;
                true
            });
        }
        tau
    }

    /// Passes all media from `origin` to `t_max`, and on the way the surfaces in `crossings`, which are sorted.
    pub fn pass(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        crossings: &[Crossing],
        light: &mut Composite,
    ) {
        let mut crossings = crossings.iter().peekable();
        let mut add = |mut s: Segment| {
            while let Some(c) = crossings.next_if(|c| c.t < s.far) {
                let share = ((c.t - s.near) / (s.far - s.near)).clamp(0.0, 1.0);
                light.medium(s.tau * share, s.source);
                light.surface(c.opacity, c.radiance);
                s.tau *= 1.0 - share;
                s.near = s.near.max(c.t);
            }
            light.medium(s.tau, s.source);
            light.transmittance > Composite::NOTHING
        };
        let mut met = self
            .volumes
            .iter()
            .filter_map(|v| v.enter(origin, direction, t_max));
        let complete = match (met.next(), met.next()) {
            (None, _) => true,
            (Some(walk), None) => walk.run(&mut add),
            (Some(first), Some(second)) => {
                let mut all = Vec::new();
                for walk in [first, second].into_iter().chain(met) {
                    walk.run(&mut |s| {
                        all.push(s);
                        true
                    });
                }
                let mut complete = true;
                flatten_overlaps(&mut all, |s| {
                    complete = add(s);
                    complete
                });
                complete
            }
        };
        if complete {
            crossings.for_each(|c| light.surface(c.opacity, c.radiance));
        }
    }
}

impl<S: Source> BlockGrid<S> {
    fn new(info: &VolumeInfo) -> Self {
        let [x, y, z, t] = info
            .index_from_scene
            .map(|c| Vec3A::from(c.map(|v| v as f32)));
        let bricks = info.dims.map(|n| (n as usize).div_ceil(BRICK));
        let count = bricks[0] * bricks[1] * bricks[2];
        Self {
            index_from_scene: Affine3A {
                matrix3: glam::Mat3A::from_cols(x, y, z),
                translation: t,
            },
            dims: info.dims.map(|n| n as f32),
            bricks,
            first: vec![EMPTY; count],
            level: vec![0; count],
            filled: vec![[[u8::MAX; 3], [0; 3]]; count],
            blocks: Vec::new(),
        }
    }

    fn insert(&mut self, l: &Lvoxel) {
        let per_axis = BRICK >> l.level;
        let block = l.block.map(usize::from);
        let brick = block.map(|b| b / per_axis);
        if (0..3).any(|a| brick[a] >= self.bricks[a]) {
            return;
        }
        let b = (brick[2] * self.bricks[1] + brick[1]) * self.bricks[0] + brick[0];
        let local = block.map(|v| v % per_axis);
        let block = Block {
            sigma_t: l.sigma_t,
            source: S::of(Rgb(l.source)),
        };
        self.set(b, l.level, local, block);
    }

    /// Sets a block of a brick; the first one decides on the size of the brick's blocks.
    fn set(&mut self, brick: usize, level: u8, local: [usize; 3], block: Block<S>) {
        let per_axis = BRICK >> level;
        if self.first[brick] == EMPTY {
            self.first[brick] = self.blocks.len() as u32;
            self.level[brick] = level;
            self.blocks.resize(
                self.blocks.len() + per_axis * per_axis * per_axis,
                Block::default(),
            );
        }
        if self.level[brick] == level {
            let at = (local[2] * per_axis + local[1]) * per_axis + local[0];
            self.blocks[self.first[brick] as usize + at] = block;
            let [first, end] = &mut self.filled[brick];
            for a in 0..3 {
                first[a] = first[a].min(local[a] as u8);
                end[a] = end[a].max(local[a] as u8 + 1);
            }
        }
    }

    fn enter(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Walk<'_, S>> {
        let o = self.index_from_scene.transform_point3(origin).to_array();
        let d = self
            .index_from_scene
            .transform_vector3(direction)
            .to_array();
        let (start, end) = clip_to_box(o, d, self.dims, t_max)?;
        let entry = self
            .index_from_scene
            .transform_point3(origin + direction * start)
            .to_array();
        let line = Line {
            origin: std::array::from_fn(|a| entry[a].clamp(0.0, self.dims[a])),
            direction: d,
            inverse: d.map(|v| 1.0 / v),
        };
        Some(Walk {
            grid: self,
            line,
            start,
            end: end - start,
        })
    }
}

/// A ray inside the box of a volume.
struct Walk<'a, S> {
    grid: &'a BlockGrid<S>,
    line: Line,
    start: f32,
    end: f32,
}

impl<S: Source> Walk<'_, S> {
    /// Gives every non-empty stretch to `add` until that says no; returns whether it never did.
    fn run(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        let bricks = self.grid.bricks;
        let mut outer = Steps::new(
            &self.line,
            0.0,
            [0; 3],
            BRICK as f32,
            bricks.map(|n| n as i32),
        );
        let mut t = 0.0;
        loop {
            let at = outer.at;
            let leave = outer.leave().min(self.end);
            let b = (at[2] as usize * bricks[1] + at[1] as usize) * bricks[0] + at[0] as usize;
            if self.grid.first[b] != EMPTY && leave > t && !self.brick(b, at, t, leave, add) {
                return false;
            }
            t = leave.max(t);
            let a = outer.advance();
            if leave >= self.end || outer.at[a] < 0 || outer.at[a] >= bricks[a] as i32 {
                return true;
            }
        }
    }

    fn brick(
        &self,
        b: usize,
        at: [i32; 3],
        t: f32,
        leave: f32,
        add: &mut impl FnMut(Segment) -> bool,
    ) -> bool {
        let level = self.grid.level[b];
        let per_axis = BRICK >> level;
        let first = self.grid.first[b] as usize;
        let base = at.map(|v| v * BRICK as i32);
        let edge = (1 << level) as f32;
        let [lower, upper] = self.grid.filled[b]
            .map(|corner| std::array::from_fn(|a| base[a] as f32 + edge * f32::from(corner[a])));
        let Some((t, leave)) = self.line.within(lower, upper, t, leave) else {
            return true;
        };
        let mut inner = Steps::new(&self.line, t, base, edge, [per_axis as i32; 3]);
        let mut near = t;
        loop {
            let local = inner.at.map(|v| v as usize);
            let far = inner.leave().min(leave);
            let a = inner.advance();
            let out = far >= leave || inner.at[a] < 0 || inner.at[a] >= per_axis as i32;
            let far = if out { leave } else { far.max(near) };
            let block =
                &self.grid.blocks[first + (local[2] * per_axis + local[1]) * per_axis + local[0]];
            if block.sigma_t > 0.0 && far > near {
                let s = Segment {
                    near: self.start + near,
                    far: self.start + far,
                    tau: block.sigma_t * (far - near),
                    source: block.source.rgb(),
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
