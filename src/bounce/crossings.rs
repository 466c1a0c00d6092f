//! Rays of one direction through a volume, and the blocks that they cross: laid down once where
//! memory allows, and walked again where it does not.

use super::blocks::Blocks;
use super::walls::Wall;
use crate::math::Ray;
use crate::math::exp::exp_neg_and_rest;
use std::sync::atomic::{AtomicU64, Ordering};

/// A block on a ray.
#[derive(Clone, Copy, Debug)]
pub struct Crossing {
    /// Its number.
    pub block: u32,
    /// Share of the light on the ray that it takes.
    pub taken: f32,
}

/// Bytes that crossings may still take.
#[derive(Debug)]
pub struct Room(AtomicU64);

impl Room {
    /// So many bytes.
    pub fn new(bytes: u64) -> Self {
        Self(AtomicU64::new(bytes))
    }

    /// Takes so many bytes, if they are there.
    fn take(&self, bytes: u64) -> bool {
        let rest = |left: u64| left.checked_sub(bytes);
        (self.0)
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, rest)
            .is_ok()
    }
}

/// Rays side by side, with the surfaces on them.
#[derive(Debug, Default)]
pub struct Bundle {
    rays: Vec<Ray>,
    /// Of all rays, one after the other.
    walls: Vec<Wall>,
    /// By ray: where its walls end among these.
    wall_ends: Vec<u32>,
    kept: Option<Kept>,
}

/// What the rays of a bundle cross.
#[derive(Debug)]
struct Kept {
    /// Of all rays, one after the other.
    crossings: Box<[Crossing]>,
    /// By ray: where its crossings end among these.
    ends: Box<[u32]>,
}

impl Bundle {
    /// Rays of a bundle: few, so that what they cross stays near the processor.
    pub const RAYS: usize = 64;

    /// Adds a ray, and the surfaces on it by distance.
    pub fn push(&mut self, ray: Ray, walls: Vec<Wall>) {
        self.rays.push(ray);
        self.walls.extend(walls);
        self.wall_ends.push(self.walls.len() as u32);
    }

    /// Whether a surface is on any of its rays.
    pub fn has_walls(&self) -> bool {
        !self.walls.is_empty()
    }

    /// Walks its rays for the first time: places their surfaces among the crossings, gives each
    /// crossing with its optical depth, and keeps them where there is room.
    pub fn lay_down(&mut self, blocks: &Blocks, room: &Room, mut meet: impl FnMut(Crossing, f32)) {
        let mut crossings = Vec::new();
        let mut ends = Vec::with_capacity(self.rays.len());
        let mut walls = self.walls.as_mut_slice();
        let mut first_wall = 0;
        for (ray, &end) in self.rays.iter().zip(&self.wall_ends) {
            let (own, rest) = walls.split_at_mut((end - first_wall) as usize);
            (walls, first_wall) = (rest, end);
            let mut own = own.iter_mut().peekable();
            let start = crossings.len();
            walk(blocks, ray, |crossing, tau, middle| {
                while let Some(wall) = own.next_if(|w| w.t <= middle) {
                    wall.before = (crossings.len() - start) as u32;
                }
                meet(crossing, tau);
                crossings.push(crossing);
            });
            own.for_each(|wall| wall.before = (crossings.len() - start) as u32);
            ends.push(crossings.len() as u32);
        }
        let bytes = size_of_val(&crossings[..]) + size_of_val(&ends[..]);
        if room.take(bytes as u64) {
            self.kept = Some(Kept {
                crossings: crossings.into_boxed_slice(),
                ends: ends.into_boxed_slice(),
            });
        }
    }

    /// Gives what each ray crosses, front to back, and the surfaces on it. `walked` is for rays
    /// that are walked again.
    pub fn each(
        &self,
        blocks: &Blocks,
        walked: &mut Vec<Crossing>,
        mut give: impl FnMut(&[Crossing], &[Wall]),
    ) {
        let (mut first, mut first_wall) = (0, 0);
        for (i, (ray, &wall_end)) in self.rays.iter().zip(&self.wall_ends).enumerate() {
            let walls = &self.walls[first_wall as usize..wall_end as usize];
            first_wall = wall_end;
            match &self.kept {
                Some(kept) => {
                    let end = kept.ends[i];
                    give(&kept.crossings[first as usize..end as usize], walls);
                    first = end;
                }
                None => {
                    walked.clear();
                    walk(blocks, ray, |crossing, _, _| walked.push(crossing));
                    give(walked, walls);
                }
            }
        }
    }
}

/// Gives what a ray crosses, with its optical depth and the distance to its middle.
fn walk(blocks: &Blocks, ray: &Ray, mut meet: impl FnMut(Crossing, f32, f32)) {
    blocks.walk(ray, |block, near, far| {
        let tau = blocks.sigma_t[block] * (far - near);
        let crossing = Crossing {
            block: block as u32,
            taken: exp_neg_and_rest(tau).1,
        };
        meet(crossing, tau, 0.5 * (near + far));
    });
}
