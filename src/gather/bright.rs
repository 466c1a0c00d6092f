//! Bright patches: the parts of surfaces that send far more than most, as where the sun falls on a
//! small part of a room's floor. Few gather rays meet them, and those that do bring most of the
//! light. Gathers may leave them out of what rays meet, and ask them as they ask lights.

use super::Pages;
use super::patch_id::{PatchExtent, PatchId};
use crate::math::{Aabb, Hit, Rgb};
use crate::tree::page::{ChildKind, WIDTH, WideNode};
use crate::tree::store::Page;
use glam::Vec3;
use smallvec::SmallVec;
use std::collections::HashSet;

/// A part of one side of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct BrightPatch {
    /// Corners, scene space.
    pub corners: [Vec3; 3],
    /// Unit normal of the side that sends.
    pub normal: Vec3,
    /// What it sends.
    pub radiance: Rgb,
}

/// A place that a ray met, and about as far around it as the ray speaks for.
#[derive(Clone, Copy, Debug)]
pub struct BrightHit {
    /// Scene space.
    pub position: Vec3,
    /// Scene units.
    pub radius: f32,
}

/// Where bright patches are. Any set would do, as light of each place is counted by one of two ways
/// and by no other.
#[derive(Debug)]
pub(super) struct BrightPatchIndex {
    keys: HashSet<u64>,
    /// Of each triangle whether it has any.
    has_any: Vec<bool>,
}

impl BrightPatchIndex {
    /// Square of the longest edge of a place, over that below which patches are not divided: up to
    /// eight surfels along an edge. In smaller ones there are some without the middle of a surfel,
    /// and larger ones send the light of their bright part from all of their area.
    const SIZE: f32 = 64.0;

    /// None yet, of so many triangles.
    pub fn new(triangles: usize) -> Self {
        Self {
            keys: HashSet::new(),
            has_any: vec![false; triangles],
        }
    }

    /// Adds the place of a hit: which that is, unless it is there.
    pub fn add(&mut self, hit: &Hit, extent: PatchExtent) -> Option<PatchId> {
        let place = Self::place(hit, extent);
        self.has_any[hit.triangle as usize] = true;
        self.keys.insert(place.key()).then_some(place)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    fn place(hit: &Hit, extent: PatchExtent) -> PatchId {
        PatchId::new(hit, extent.edge2, Self::SIZE * extent.least)
    }

    /// The place that a ray met and whether it is bright; `None` on triangles without any that is.
    #[inline]
    pub fn at(&self, hit: &Hit, extent: PatchExtent) -> Option<(PatchId, bool)> {
        self.has_any[hit.triangle as usize].then(|| {
            let place = Self::place(hit, extent);
            (place, self.keys.contains(&place.key()))
        })
    }
}

/// One side of a disk of the tree.
pub(super) struct DiskSide {
    pub centre: Vec3,
    /// On that side.
    pub normal: Vec3,
    pub radius: f32,
}

/// Looks for disks near seeds.
pub(super) struct BrightDiskSearch<'a, P> {
    pub pages: &'a P,
    pub seeds: &'a [BrightHit],
    /// Seeds that have to reach a disk.
    pub support: usize,
    /// What a disk has to send, by the mean channel.
    pub least: f32,
}

/// Indices of seeds.
type Near = SmallVec<[u32; 32]>;

impl<P: Pages> BrightDiskSearch<'_, P> {
    /// Hands out the sides that send enough near enough seeds, in the order of the tree, until told
    /// to stop: then `false`.
    pub fn for_each(&self, mut found: impl FnMut(&DiskSide) -> bool) -> bool {
        let Some(root) = self.pages.root() else {
            return true;
        };
        let all: Near = (0..self.seeds.len() as u32).collect();
        let mut open = vec![(root, 0, all)];
        while let Some((id, index, of_node)) = open.pop() {
            let page = self.pages.page(id);
            let Some(node) = page.nodes().nodes.get(index as usize) else {
                continue;
            };
            for k in (0..WIDTH).filter(|k| node.used >> k & 1 == 1) {
                let near = self.near(&of_node, node, k);
                if near.len() < self.support {
                    continue;
                }
                match node.kind[k] {
                    ChildKind::Inner => open.push((id, node.child[k], near)),
                    ChildKind::Page => open.push((node.child[k], 0, near)),
                    ChildKind::Leaf => {
                        if !self.in_leaf(&page, node.child[k], &mut found) {
                            return false;
                        }
                    }
                    ChildKind::None => {}
                }
            }
        }
        true
    }

    /// Those of some seeds that reach the box of a node's child.
    fn near(&self, of_node: &Near, node: &WideNode, k: usize) -> Near {
        let Aabb { min, max } = node.bounds(k);
        let reaches = |s: &BrightHit| {
            let to_box = s.position.clamp(min, max) - s.position;
            to_box.length_squared() < s.radius * s.radius
        };
        let seeds = of_node.iter().copied();
        seeds
            .filter(|&s| reaches(&self.seeds[s as usize]))
            .collect()
    }

    fn in_leaf(
        &self,
        page: &impl Page,
        block: u32,
        found: &mut impl FnMut(&DiskSide) -> bool,
    ) -> bool {
        let leaves = page.leaves();
        let Some(block) = leaves.blocks.get(block as usize) else {
            return true;
        };
        for k in 0..block.count as usize {
            let light = &leaves.lights[block.first_light as usize + k];
            let vector = |v: &[[f32; WIDTH]; 3]| Vec3::new(v[0][k], v[1][k], v[2][k]);
            for (sent, side) in [(light.front, 1.0), (light.back, -1.0)] {
                let disk = DiskSide {
                    centre: vector(&block.centre),
                    normal: vector(&block.normal) * side,
                    radius: block.radius2[k].sqrt(),
                };
                if Rgb(sent).mean() > self.least && !found(&disk) {
                    return false;
                }
            }
        }
        true
    }
}
