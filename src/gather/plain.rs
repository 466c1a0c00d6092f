//! The paper's kernel: a ray through the octree, front to back, that ends at the first disk. No
//! aggregates, no lanes; kept as the reference that the fast kernel is tested against.

use super::cone::{OVERHANG, Scratch};
use super::crossing::Crossing;
use crate::math::{Ray, Rgb};
use crate::tree::page::{ChildKind, PageLeaves, WIDTH};
use crate::tree::traversal::{OpenNodes, Query, Visited, traverse};
use crate::tree::{Page, SurfelStore};
use glam::Vec3;
use std::ops::ControlFlow;

/// Returns the first disk that a ray meets.
pub fn cast(pages: &SurfelStore, ray: &Ray, scratch: &mut Scratch) -> Option<Crossing> {
    cast_in_order::<true>(pages, ray, scratch)
}

/// Returns what [`cast`] does, with a choice of order: children by the distance at which the ray
/// enters them, or as they are stored, to measure what the former is worth.
pub fn cast_in_order<const NEAR_FIRST: bool>(
    pages: &SurfelStore,
    ray: &Ray,
    scratch: &mut Scratch,
) -> Option<Crossing> {
    scratch.crossings.clear();
    let mut query = PlainQuery::<NEAR_FIRST> {
        ray: *ray,
        nearest: None,
    };
    // It never breaks.
    let _ = traverse(pages, &mut query, 0.0, &mut scratch.open);
    query.nearest
}

/// A ray on its way to the first disk. What it knows of an open node is the distance at which it
/// enters that.
struct PlainQuery<const NEAR_FIRST: bool> {
    ray: Ray,
    nearest: Option<Crossing>,
}

impl<const NEAR_FIRST: bool> PlainQuery<NEAR_FIRST> {
    fn t_end(&self) -> f32 {
        self.nearest.map_or(self.ray.t_max, |c| c.t)
    }
}

impl<const NEAR_FIRST: bool> Query for PlainQuery<NEAR_FIRST> {
    type State = f32;

    const OPENS_LEAVES: bool = true;

    fn skips(&self, entry: &f32) -> bool {
        *entry > self.t_end()
    }

    fn visit(&mut self, node: &Visited<'_>, _: &f32, open: &mut OpenNodes<f32>) -> ControlFlow<()> {
        let mut met = [(0.0, 0); WIDTH];
        let mut count = 0;
        let used = (0..WIDTH).filter(|&k| node.children.kind[k] != ChildKind::None);
        for k in used {
            if let Some(entry) =
                (node.children.bounds(k)).enter(self.ray.origin, self.ray.direction)
            {
                met[count] = (entry, k);
                count += 1;
            }
        }
        let met = &mut met[..count];
        if NEAR_FIRST {
            met.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        }
        for &(entry, k) in met.iter().rev() {
            if node.children.kind[k] == ChildKind::Leaf {
                open.open_leaf(node, k, entry);
            } else {
                open.open(node, k, entry);
            }
        }
        ControlFlow::Continue(())
    }

    fn visit_leaf(&mut self, page: &Page<'_>, block: u32) {
        meet_leaf(page.leaves(), block, &self.ray, &mut self.nearest);
    }
}

fn corner(c: &[[f32; WIDTH]; 3], k: usize) -> Vec3 {
    Vec3::new(c[0][k], c[1][k], c[2][k])
}

/// Takes the disks of a leaf that a ray meets before what it met so far.
fn meet_leaf(leaves: &PageLeaves, block: u32, ray: &Ray, best: &mut Option<Crossing>) {
    let Some(block) = leaves.blocks.get(block as usize) else {
        return;
    };
    for lane in 0..block.count as usize {
        let normal = corner(&block.normal, lane);
        let to_centre = corner(&block.centre, lane) - ray.origin;
        let (height, cos) = (normal.dot(to_centre), normal.dot(ray.direction));
        let t = height / cos;
        let own = cos > 0.0 && height * height < OVERHANG * OVERHANG * block.radius2[lane];
        let offset = ray.direction * t - to_centre;
        let light = &leaves.lights[block.first_light as usize + lane];
        let hit = t > 0.0
            && !own
            && t < best.map_or(ray.t_max, |c| c.t)
            && offset.length_squared() <= block.radius2[lane]
            && !leaves.is_clipped(light, offset.to_array());
        if hit {
            let radiance = if normal.dot(ray.direction) < 0.0 {
                light.front
            } else {
                light.back
            };
            *best = Some(Crossing {
                t,
                opacity: 1.0,
                radiance: Rgb(radiance),
            });
        }
    }
}
