//! Rays of one direction through a volume, and the blocks that they cross: laid down once where
//! memory allows, and walked again where it does not.

use super::blocks::Blocks;
use super::walls::Wall;
use crate::math::{Ray, Spectrum};
use std::sync::atomic::{AtomicU64, Ordering};

/// A block on a ray.
#[derive(Clone, Copy, Debug)]
pub struct Crossing<K> {
    /// Its number.
    pub block: u32,
    /// Share of the light on the ray that it takes.
    pub taken: K,
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
#[derive(Debug)]
pub struct Bundle<K> {
    rays: Vec<Ray>,
    /// Of all rays, one after the other.
    walls: Vec<Wall>,
    /// By ray: where its walls end among these.
    wall_ends: Vec<u32>,
    kept: Option<Kept<K>>,
}

/// What the rays of a bundle cross.
#[derive(Debug)]
struct Kept<K> {
    /// Of all rays, one after the other.
    crossings: Box<[Crossing<K>]>,
    /// By ray: where its crossings end among these.
    ends: Box<[u32]>,
}

impl<K: Spectrum> Bundle<K> {
    /// Rays of a bundle: few, so that what they cross stays near the processor.
    pub const RAYS: usize = 64;

    /// Whether a surface is on any of its rays.
    pub fn has_walls(&self) -> bool {
        !self.walls.is_empty()
    }

    /// Walks rays for the first time and leaves out those that cross nothing: asks of the others
    /// for the surfaces on them, by distance, gives each crossing with its optical depth, and keeps
    /// crossings where there is room.
    pub fn laid_down(
        blocks: &Blocks,
        rays: &[Ray],
        room: &Room,
        walls: impl Fn(&Ray) -> Vec<Wall>,
        mut meet: impl FnMut(Crossing<K>, K),
    ) -> Self {
        let mut bundle = Self {
            rays: Vec::new(),
            walls: Vec::new(),
            wall_ends: Vec::new(),
            kept: None,
        };
        let mut crossings = Vec::new();
        let mut ends = Vec::with_capacity(rays.len());
        // Distances to the middles of crossings.
        let mut middles = Vec::new();
        for ray in rays {
            middles.clear();
            walk(blocks, ray, |crossing, tau, middle| {
                meet(crossing, tau);
                crossings.push(crossing);
                middles.push(middle);
            });
            if middles.is_empty() {
                continue;
            }
            for mut wall in walls(ray) {
                wall.before = middles.partition_point(|middle| *middle < wall.t) as u32;
                bundle.walls.push(wall);
            }
            bundle.rays.push(*ray);
            bundle.wall_ends.push(bundle.walls.len() as u32);
            ends.push(crossings.len() as u32);
        }
        let bytes = size_of_val(&crossings[..]) + size_of_val(&ends[..]);
        if room.take(bytes as u64) {
            bundle.kept = Some(Kept {
                crossings: crossings.into_boxed_slice(),
                ends: ends.into_boxed_slice(),
            });
        }
        bundle
    }

    /// Gives what each ray crosses, front to back, and the surfaces on it. `walked` is for rays
    /// that are walked again.
    pub fn each(
        &self,
        blocks: &Blocks,
        walked: &mut Vec<Crossing<K>>,
        mut give: impl FnMut(&[Crossing<K>], &[Wall]),
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
fn walk<K: Spectrum>(blocks: &Blocks, ray: &Ray, mut meet: impl FnMut(Crossing<K>, K, f32)) {
    blocks.walk(ray, |block, near, far| {
        let tau: K = blocks.depth(blocks.sigma_t[block] * (far - near));
        let crossing = Crossing {
            block: block as u32,
            taken: tau.exp_neg_and_rest().1,
        };
        meet(crossing, tau, 0.5 * (near + far));
    });
}
