//! The way of a ray through the lvoxels of one volume, front to back.

use super::TwoLobes;
use super::grid::{BRICK, Block, BlockGrid, Brick, place};
use crate::math::Ray;
use crate::math::dda::{Passage, Steps};
use crate::math::segment::Segment;
use crate::run::walked::note_lvoxels;
use glam::{Vec3, Vec3A};

/// A ray inside the box of a volume.
pub struct Walk<'a> {
    grid: &'a BlockGrid<Block>,
    passage: Passage,
    /// Unit direction in which light travels that the ray carries.
    travel: Vec3,
}

impl<'a> Walk<'a> {
    /// The way of a ray whose light travels in a unit direction; `None` beside the volume.
    pub fn new(grid: &'a BlockGrid<Block>, ray: &Ray, travel: Vec3) -> Option<Self> {
        let map = (&grid.index_from_scene, &grid.index_from_scene_f64);
        let passage = Passage::new(map, grid.dims, ray)?;
        Some(Self {
            grid,
            passage,
            travel,
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
        let is_through = if self.grid.lobes.is_empty() {
            self.run_plain(&mut counted)
        } else {
            self.run_lobed(&mut counted)
        };
        note_lvoxels(passed);
        is_through
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
