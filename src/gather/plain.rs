//! The paper's kernel: a ray through the octree, front to back, that ends at the first disk. No
//! aggregates, no lanes; kept as the reference that the fast kernel is tested against.

use super::cone::{OVERHANG, Scratch};
use super::{Crossing, Pages};
use crate::math::{Ray, Rgb};
use crate::tree::page::{ChildKind, PageLeaves, WIDTH};
use crate::tree::store::Page;
use glam::Vec3;

/// Returns the first disk that a ray meets.
pub fn cast<P: Pages>(pages: &P, ray: &Ray, scratch: &mut Scratch) -> Option<Crossing> {
    cast_in_order::<P, true>(pages, ray, scratch)
}

/// The same with a choice of order: children by the distance at which the ray enters them, or as
/// they are stored, to measure what the first is worth.
pub fn cast_in_order<P: Pages, const NEAR_FIRST: bool>(
    pages: &P,
    ray: &Ray,
    scratch: &mut Scratch,
) -> Option<Crossing> {
    scratch.crossings.clear();
    let mut best = None;
    let t_end = |best: &Option<Crossing>| best.map_or(ray.t_max, |c| c.t);
    // What is still to be seen, the next last. Not by recursion: a tree may be as deep as its file
    // is long.
    let mut ahead: Vec<(f32, u32, ChildKind, u32)> = Vec::new();
    if let Some(root) = pages.root() {
        ahead.push((0.0, root, ChildKind::Page, root));
    }
    while let Some((entry, page_id, kind, child)) = ahead.pop() {
        if entry > t_end(&best) {
            continue;
        }
        let (page_id, node) = match kind {
            ChildKind::Inner => (page_id, child),
            ChildKind::Page => (child, 0),
            ChildKind::Leaf => {
                let page = pages.page(page_id);
                meet_leaf(page.leaves(), child, ray, &mut best);
                continue;
            }
            ChildKind::None => continue,
        };
        let page = pages.page(page_id);
        let Some(node) = page.nodes().nodes.get(node as usize) else {
            continue;
        };
        let mut children = [(0.0, 0); WIDTH];
        let mut met = 0;
        for k in (0..WIDTH).filter(|&k| node.kind[k] != ChildKind::None) {
            if let Some(entry) = node.bounds(k).enter(ray.origin, ray.direction) {
                children[met] = (entry, k);
                met += 1;
            }
        }
        let children = &mut children[..met];
        if NEAR_FIRST {
            children.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        }
        let below = |&(entry, k): &(f32, usize)| (entry, page_id, node.kind[k], node.child[k]);
        ahead.extend(children.iter().rev().map(below));
    }
    best
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
