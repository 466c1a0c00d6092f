//! The way of a ray through the lvoxels of one volume, front to back.

use super::TwoLobes;
use super::grid::{BRICK, Block, BlockGrid, Brick, place};
use super::levels::{Levels, Node, View};
use crate::math::Ray;
use crate::math::dda::{Passage, Steps};
use crate::math::segment::Segment;
use crate::run::walked::note_lvoxels;
use glam::{Vec3, Vec3A};
use std::sync::OnceLock;

/// What a beam meets.
enum Seen<'a> {
    Nothing,
    Whole(&'a Node),
    Blocks(&'a Brick),
}

/// A ray, and what is around it.
pub struct Beam<'a> {
    pub ray: &'a Ray,
    /// Unit direction in which light travels that the ray carries.
    pub travel: Vec3,
    /// Width at a distance of 1; 0 for the ray alone.
    pub width: f32,
}

/// A beam inside the box of a volume.
pub struct Walk<'a> {
    grid: &'a BlockGrid<Block>,
    levels: &'a OnceLock<Levels>,
    passage: Passage,
    /// Unit direction in which light travels that the ray carries.
    travel: Vec3,
    /// Width of the beam at a distance of 1.
    width: f32,
}

impl<'a> Walk<'a> {
    /// The way of a beam; `None` beside the volume.
    pub fn new(
        grid: &'a BlockGrid<Block>,
        levels: &'a OnceLock<Levels>,
        beam: &Beam,
    ) -> Option<Self> {
        let map = (&grid.index_from_scene, &grid.index_from_scene_f64);
        let passage = Passage::new(map, grid.dims, beam.ray)?;
        Some(Self {
            grid,
            levels,
            passage,
            travel: beam.travel,
            width: beam.width,
        })
    }

    /// Gives every segment in a block to `add` until that says no; returns whether it never did.
    #[inline]
    pub fn run(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        let mut passed = 0;
        let mut counted = |s| {
            passed += 1;
            add(s)
        };
        let is_through = if !self.grid.lobes.is_empty() {
            self.run_lobed(&mut counted)
        } else if self.widths_in_bricks(self.passage.end) >= 1.0 {
            self.run_wide(&mut counted)
        } else {
            self.run_plain(&mut counted)
        };
        note_lvoxels(passed);
        is_through
    }

    /// Width of the beam so far along the line, in edges of bricks.
    #[inline]
    fn widths_in_bricks(&self, t: f32) -> f32 {
        let brick = self.grid.voxel.max_element() * BRICK as f32;
        (self.passage.start + t) * (self.width / brick)
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

    // Not inlined: most beams are narrow.
    #[inline(never)]
    fn run_wide(&self, add: &mut impl FnMut(Segment) -> bool) -> bool {
        let Passage { line, start, end } = &self.passage;
        let dims = self.grid.table_dims;
        let levels = self.levels.get_or_init(|| Levels::new(self.grid));
        let view = View::new(line.direction, self.grid.voxel);
        let mut bricks = Steps::new(line, 0.0, [0; 3], BRICK as f32, dims.map(|n| n as i32));
        let mut t = 0.0;
        // The highest level of which a cube begins here: of one that began before, a part has been
        // passed.
        let mut begins = levels.top();
        loop {
            let at = bricks.at();
            let brick = at.map(|v| v as usize);
            let (level, seen) = self.seen_at(levels, brick, t, begins);
            let (leave, differ) = leave(&mut bricks, level, *end);
            if leave > t {
                let is_through = match seen {
                    Seen::Nothing => true,
                    Seen::Whole(node) => {
                        let Block { sigma_t, source } = node.along(&view);
                        add(Segment {
                            near: start + t,
                            far: start + leave,
                            tau: sigma_t * (leave - t),
                            source,
                        })
                    }
                    Seen::Blocks(brick) => self.brick::<false>(brick, at, t, leave, add),
                };
                if !is_through {
                    return false;
                }
                t = leave;
            }
            if differ == 0 {
                return true;
            }
            begins = differ.ilog2().min(levels.top());
        }
    }

    /// What the beam meets in a brick, or in the largest cube around it of those up to a level that
    /// it may take whole, and the level of that.
    #[inline]
    fn seen_at(
        &self,
        levels: &'a Levels,
        brick: [usize; 3],
        t: f32,
        begins: u32,
    ) -> (u32, Seen<'a>) {
        let widths = self.widths_in_bricks(t);
        if widths >= 1.0 {
            let widest = (widths as u32).ilog2().min(begins);
            for level in (0..=widest).rev() {
                match levels.node(self.grid, level, brick) {
                    None => return (level, Seen::Nothing),
                    Some(node) if node.is_even() => return (level, Seen::Whole(node)),
                    Some(_) => {}
                }
            }
        }
        let [x, y, z] = brick;
        let [nx, ny, _] = self.grid.table_dims;
        let place = self.grid.table[(z * ny + y) * nx + x];
        let brick = self.grid.bricks.get(place as usize);
        (0, brick.map_or(Seen::Nothing, Seen::Blocks))
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
                        let single = self.grid.singles.get(i).copied().unwrap_or_default();
                        let lobes = TwoLobes::new(self.grid.lobes[i], single);
                        block.source * lobes.along(self.travel)
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

/// Moves to the brick behind the cube of a level around the present one; returns where that cube is
/// left, or the end that comes before it, and the bits by which the places of the two differ: none
/// if no brick is behind.
#[inline]
fn leave(bricks: &mut Steps, level: u32, end: f32) -> (f32, u32) {
    let [x, y, z] = bricks.at();
    loop {
        let leave = bricks.leave();
        if leave >= end || !bricks.advance() {
            return (leave.min(end), 0);
        }
        let next = bricks.at();
        let differ = ((x ^ next[0]) | (y ^ next[1]) | (z ^ next[2])) as u32;
        if differ >> level != 0 {
            return (leave, differ);
        }
    }
}
