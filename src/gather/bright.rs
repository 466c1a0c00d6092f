//! Bright patches: the parts of surfaces that send far more than most, as where the sun falls on a
//! small part of a room's floor. Few gather rays meet them, and those that do bring most of the
//! light. Gathers may leave them out of what rays meet, and ask them as they ask lights.

use super::geometry::Geometry;
use super::patch_id::{PatchExtent, PatchId};
use crate::math::{Aabb, Hit, Rgb, sampling};
use crate::tree::page::{ChildKind, WIDTH, WideNode};
use crate::tree::traversal::{OpenNodes, Query, Visited, traverse};
use crate::tree::{Page, SurfelStore};
use glam::Vec3;
use smallvec::SmallVec;
use std::collections::HashSet;
use std::ops::ControlFlow;

/// A part of one side of a triangle.
#[derive(Clone, Copy, Debug)]
pub struct BrightPatch {
    /// Corners, scene space.
    pub corners: [Vec3; 3],
    /// Unit normal of the side that sends.
    pub normal: Vec3,
    /// Radiance that the side sends, the same in all directions, on average over all of the patch:
    /// nothing comes from where a mask says that nothing is there.
    pub radiance: Rgb,
}

/// A point that a bright ray of a pilot gather met, which speaks for the surface around it.
#[derive(Clone, Copy, Debug)]
pub struct BrightHit {
    /// The point, scene space.
    pub position: Vec3,
    /// The distance up to which it speaks for what is around it, scene units.
    pub radius: f32,
}

/// The set of bright patches of a frame. Any set would do, as light of each patch is counted in one
/// of two ways and in no other.
#[derive(Debug)]
pub(super) struct BrightPatchIndex {
    keys: HashSet<u64>,
    /// Whether a triangle has any bright patch, by triangle; beyond, any may have.
    has_any: Vec<bool>,
}

impl BrightPatchIndex {
    /// Ratio of the square of a bright patch's longest edge to that below which patches are not
    /// divided: up to eight surfels along an edge. Of smaller ones some are without the middle of a
    /// surfel, and larger ones send the light of their bright part from all of their area.
    const MAX_EDGE2_OVER_LEAST: f32 = 64.0;

    /// An empty set, of a scene of so many triangles.
    pub fn new(triangles: usize) -> Self {
        Self {
            keys: HashSet::new(),
            has_any: vec![false; triangles],
        }
    }

    /// Adds the patch of a hit, and returns it unless it was there before.
    pub fn add(&mut self, hit: &Hit, extent: PatchExtent) -> Option<PatchId> {
        let place = Self::place(hit, extent);
        if let Some(has_any) = self.has_any.get_mut(hit.triangle as usize) {
            *has_any = true;
        }
        self.keys.insert(place.key()).then_some(place)
    }

    /// Number of bright patches.
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    fn place(hit: &Hit, extent: PatchExtent) -> PatchId {
        PatchId::new(hit, extent.edge2, Self::MAX_EDGE2_OVER_LEAST * extent.least)
    }

    /// Returns the patch that a ray met, and whether it is bright; `None` on triangles without any
    /// that is.
    #[inline]
    pub fn at(&self, hit: &Hit, extent: PatchExtent) -> Option<(PatchId, bool)> {
        let has_any = self.has_any.get(hit.triangle as usize);
        has_any.copied().unwrap_or(true).then(|| {
            let place = Self::place(hit, extent);
            (place, self.keys.contains(&place.key()))
        })
    }
}

/// Mean share of a patch that is there.
pub(super) fn mean_opacity(geometry: &dyn Geometry, patch: &PatchId) -> f32 {
    const POINTS: u64 = 64;
    let [a, b, c] = patch.corners([Vec3::ZERO, Vec3::X, Vec3::Y]);
    let opacity = |i| {
        let w = sampling::triangle(sampling::r2(i, [0.5; 2]));
        let uv = a * w[0] + b * w[1] + c * w[2];
        geometry.opacity(patch.triangle, [uv.x, uv.y])
    };
    let sum = (0..POINTS).map(opacity).sum::<Option<f32>>();
    sum.map_or(1.0, |sum| sum / POINTS as f32)
}

/// One side of a disk of the tree.
pub(super) struct DiskSide {
    pub centre: Vec3,
    /// On that side.
    pub normal: Vec3,
    pub radius: f32,
}

/// A search for disks near hits.
pub(super) struct BrightDiskSearch<'a> {
    pub pages: &'a SurfelStore,
    pub hits: &'a [BrightHit],
    /// Number of hits that have to reach a disk.
    pub support: usize,
    /// Radiance that a disk has to send more than, by the mean channel.
    pub least: f32,
}

/// Indices of hits.
type Near = SmallVec<[u32; 32]>;

impl BrightDiskSearch<'_> {
    /// Gives every side of a disk that sends enough near enough hits to `found`, in the order of
    /// the tree, until that says no; returns whether it never did.
    pub fn for_each(&self, found: impl FnMut(&DiskSide) -> bool) -> bool {
        let all: Near = (0..self.hits.len() as u32).collect();
        let mut query = BrightQuery {
            search: self,
            found,
        };
        traverse(self.pages, &mut query, all, &mut OpenNodes::default()).is_continue()
    }

    /// Returns those of some hits that reach the box of a node's child.
    fn near(&self, of_node: &Near, node: &WideNode, k: usize) -> Near {
        let Aabb { min, max } = node.bounds(k);
        let reaches = |s: &BrightHit| {
            let to_box = s.position.clamp(min, max) - s.position;
            to_box.length_squared() < s.radius * s.radius
        };
        let hits = of_node.iter().copied();
        hits.filter(|&s| reaches(&self.hits[s as usize])).collect()
    }
}

/// A search on its way through the tree. What it knows of an open node is the hits that reach that.
struct BrightQuery<'a, F> {
    search: &'a BrightDiskSearch<'a>,
    found: F,
}

impl<F: FnMut(&DiskSide) -> bool> BrightQuery<'_, F> {
    /// Gives the sides of a leaf's disks that send enough to `found`.
    fn in_leaf(&mut self, page: &Page<'_>, block: u32) -> ControlFlow<()> {
        let leaves = page.leaves();
        let Some(block) = leaves.blocks.get(block as usize) else {
            return ControlFlow::Continue(());
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
                if Rgb(sent).mean() > self.search.least && !(self.found)(&disk) {
                    return ControlFlow::Break(());
                }
            }
        }
        ControlFlow::Continue(())
    }
}

impl<F: FnMut(&DiskSide) -> bool> Query for BrightQuery<'_, F> {
    type State = Near;

    fn visit(
        &mut self,
        node: &Visited<'_>,
        of_node: &Near,
        open: &mut OpenNodes<Near>,
    ) -> ControlFlow<()> {
        for k in (0..WIDTH).filter(|k| node.children.used >> k & 1 == 1) {
            let near = self.search.near(of_node, node.children, k);
            if near.len() < self.search.support {
                continue;
            }
            if node.children.kind[k] == ChildKind::Leaf {
                self.in_leaf(node.page, node.children.child[k])?;
            } else {
                open.open(node, k, near);
            }
        }
        ControlFlow::Continue(())
    }
}
