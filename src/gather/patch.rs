//! What a tree says that parts of the scene's triangles send.

use super::cone::OVERHANG;
use super::geometry::Geometry;
use super::patch_id::{PatchExtent, PatchId};
use crate::math::{Ray, Rgb};
use crate::tree::node_aggregate::NodeAggregate;
use crate::tree::page::{ChildKind, DiskBlock, PageLeaves, PageNodes, WIDTH, WideNode};
use crate::tree::traversal::{OpenNodes, Query, Visited, traverse};
use crate::tree::{MISLEADING_DIFFERENCE, SurfelStore};
use glam::Vec3;
use std::ops::ControlFlow;
use wide::f32x8;

/// Mean radiance, and the area that sends it.
type Sent = ([f32; 3], f32);

/// One side of a triangle.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleSide<'a> {
    pub corners: [Vec3; 3],
    /// Unit normal on the side.
    pub normal: Vec3,
    pub is_back: bool,
    pub extent: PatchExtent,
    /// Whether surfels of one piece of the scene have one size.
    pub is_even: bool,
    /// The triangles that may stand between surfels.
    pub geometry: &'a dyn Geometry,
}

impl TriangleSide<'_> {
    /// Returns the radiance that a patch of the side sends: a mean over the disks and small nodes
    /// that hold its middle, or, where such a node is lit in a small part only, over those that
    /// hold the middles of its quarters. `None` where the tree knows no surface.
    pub fn radiance(
        &self,
        id: &PatchId,
        pages: &SurfelStore,
        open: &mut OpenNodes<()>,
    ) -> Option<Rgb> {
        let mut mean = |id: &PatchId| Patch::new(id, self).mean(self, pages, open);
        let whole = mean(id)?;
        if !whole.is_uneven {
            return whole
                .radiance()
                .or_else(|| self.radiance_near(id, pages, open));
        }
        let (mut sum, mut known) = (Rgb::BLACK, 0.0);
        for quarter in id.quarters() {
            if let Some(radiance) = mean(&quarter).and_then(|m| m.radiance()) {
                sum += radiance;
                known += 1.0;
            }
        }
        if known > 0.0 {
            Some(sum * (1.0 / known))
        } else {
            whole.radiance()
        }
    }

    /// Returns what the disk nearest to a patch sends, if the triangle has a mask: surfels stand
    /// apart on what is there in small part, and none may hold the middle of a patch.
    fn radiance_near(
        &self,
        id: &PatchId,
        pages: &SurfelStore,
        open: &mut OpenNodes<()>,
    ) -> Option<Rgb> {
        let uv = id.middle([Vec3::ZERO, Vec3::X, Vec3::Y]);
        self.geometry.opacity(id.triangle, [uv.x, uv.y])?;
        Patch::new(id, self)
            .looking_around(self)
            .mean(self, pages, open)?
            .radiance()
    }

    /// Returns what the surfels of a node send that face as the side does.
    #[inline]
    fn sent(&self, nodes: &PageNodes, aggregate: usize) -> Sent {
        nodes.sent(aggregate, self.normal.to_array(), self.is_back)
    }

    /// Whether something stands between a point of it and the middle of a disk, from which that is
    /// so far off: of a floor that goes on under a wall, the disks on the wall's other side reach
    /// through it.
    fn is_hidden(&self, point: Vec3, offset: [f32; 3], radius2: f32) -> bool {
        /// Height above the surface at which hidden disks are looked for, over the radius: curved
        /// surfaces do not hide their own disks.
        const HEIGHT: f32 = 0.25;
        let offset = Vec3::from(offset);
        let distance = offset.length();
        let above = point + self.normal * (HEIGHT * radius2.sqrt());
        let to_disk = offset * (-1.0 / distance);
        distance > 0.0
            && (self.geometry)
                .closest(&Ray::new(above, to_disk, distance))
                .is_some()
    }
}

/// A part of one side of a triangle.
#[derive(Clone, Copy, Debug)]
struct Patch {
    /// The point at which the tree is evaluated.
    middle: Vec3,
    /// Square of its longest edge, and at least that of a disk.
    area: f32,
    /// Square of a radius that the disks of its own surface are below. Larger ones are of something
    /// else near by, which must not drown them.
    own2: f32,
    /// Whether surfels stand close enough to tell its quarters apart.
    has_quarters: bool,
    /// Square of the distance at which boxes beside the middle are looked into.
    around2: f32,
}

impl Patch {
    /// Nodes up to this many times the area of a patch are taken whole.
    const MAX_WHOLE_NODE: f32 = 4.0;

    fn new(id: &PatchId, side: &TriangleSide) -> Self {
        let extent = &side.extent;
        // A power of two changes no digit.
        let edge2 = extent.edge2 * (1.0 / (1_u32 << (2 * id.level())) as f32);
        Self {
            middle: id.middle(side.corners),
            area: edge2.max(extent.least),
            own2: if side.is_even && extent.least > 0.0 {
                2.0 * extent.least
            } else {
                f32::INFINITY
            },
            has_quarters: edge2 > extent.least,
            around2: 0.0,
        }
    }

    /// The same patch, for disks up to four surfels away and no node as a whole.
    fn looking_around(self, side: &TriangleSide) -> Self {
        Self {
            area: 0.0,
            around2: 16.0 * side.extent.least,
            ..self
        }
    }

    /// The mean over disks and small nodes that hold its middle; `None` of an empty tree.
    fn mean(
        &self,
        side: &TriangleSide,
        pages: &SurfelStore,
        open: &mut OpenNodes<()>,
    ) -> Option<Mean> {
        pages.root()?;
        let mut query = PatchQuery {
            patch: self,
            side,
            pages,
            mean: Mean::default(),
        };
        // It never breaks.
        let _ = traverse(pages, &mut query, (), open);
        Some(query.mean)
    }

    /// Whether a node that sends this says something else than those right below it that hold the
    /// middle: light of the inside of a shell, that is, which faces as the outside across does.
    fn misleads(
        &self,
        (sent, _): Sent,
        nodes: &PageNodes,
        below: u32,
        side: &TriangleSide,
    ) -> bool {
        let Some(node) = nodes.nodes.get(below as usize) else {
            return false;
        };
        let mut mean = Mean::default();
        let holding = self.within(node);
        for k in (0..WIDTH).filter(|k| holding >> k & 1 == 1) {
            mean.add(side.sent(nodes, node.first_aggregate as usize + k));
        }
        let [of_node, nearer] = [sent, mean.sent].map(|c| Rgb(c).mean());
        holding != 0 && (nearer - of_node).abs() > MISLEADING_DIFFERENCE * of_node
    }

    /// A bit for each child whose box holds the middle.
    #[inline]
    fn within(&self, node: &WideNode) -> u32 {
        /// Distance from a box within which a point is taken to be in it, over the size of the box:
        /// rounding, and surfels that stand a little inside of curved surfaces.
        const MARGIN: f32 = 0.02;
        let mut outside2 = f32x8::ZERO;
        for (a, p) in self.middle.to_array().into_iter().enumerate() {
            let (min, max, p) = (
                f32x8::from(node.min[a]),
                f32x8::from(node.max[a]),
                f32x8::splat(p),
            );
            let outside = (min - p).fast_max(p - max).fast_max(f32x8::ZERO);
            outside2 += outside * outside;
        }
        let margin2 = f32x8::from(node.cross_section) * f32x8::splat(MARGIN * MARGIN)
            + f32x8::splat(self.around2);
        outside2.simd_le(margin2).to_bitmask() & node.used
    }
}

/// A patch that gathers what the nodes and disks say which hold its middle.
struct PatchQuery<'a> {
    patch: &'a Patch,
    side: &'a TriangleSide<'a>,
    pages: &'a SurfelStore,
    mean: Mean,
}

impl PatchQuery<'_> {
    /// Takes a node whole, unless what is below it says something else.
    fn takes_whole(&mut self, nodes: &PageNodes, node: &WideNode, k: usize) -> bool {
        let (patch, side) = (self.patch, self.side);
        let aggregate = node.first_aggregate as usize + k;
        let sent = side.sent(nodes, aggregate);
        let misleads = match node.kind[k] {
            _ if !patch.has_quarters => false,
            ChildKind::Inner => self.looks_below(sent, (nodes, node.child[k])),
            ChildKind::Page => {
                let below = self.pages.page(node.child[k]);
                self.looks_below(sent, (below.nodes(), 0))
            }
            // What is below an even page was looked at when the file was written.
            _ => false,
        };
        if !misleads {
            self.mean.add_node(sent, &nodes.aggregates[aggregate], side);
        }
        !misleads
    }

    /// Whether a node that sends this misleads, by those below it.
    fn looks_below(&mut self, sent: Sent, (nodes, below): (&PageNodes, u32)) -> bool {
        let misleads = self.patch.misleads(sent, nodes, below, self.side);
        self.mean.is_uneven |= misleads || is_uneven(sent, nodes, below, self.side);
        misleads
    }
}

impl Query for PatchQuery<'_> {
    type State = ();

    #[inline(always)]
    fn visit(&mut self, node: &Visited<'_>, (): &(), open: &mut OpenNodes<()>) -> ControlFlow<()> {
        let (page, children) = (node.page, node.children);
        let mut holding = self.patch.within(children);
        while holding != 0 {
            let k = holding.trailing_zeros() as usize;
            holding &= holding - 1;
            let is_small = children.cross_section[k] < Patch::MAX_WHOLE_NODE * self.patch.area;
            if is_small && self.takes_whole(page.nodes(), children, k) {
                continue;
            }
            if children.kind[k] == ChildKind::Leaf {
                let leaves = page.leaves();
                if let Some(block) = leaves.blocks.get(children.child[k] as usize) {
                    self.mean.add_disks(leaves, block, self.patch, self.side);
                }
            } else {
                open.open(node, k, ());
            }
        }
        ControlFlow::Continue(())
    }
}

/// A mean of what surfaces send, weighted by area: a running one, since areas times radiance leave
/// the range of f32.
#[derive(Debug)]
struct Mean {
    sent: [f32; 3],
    area: f32,
    /// The disk that comes nearest to holding the point: how far it is from that, and what it
    /// sends.
    nearest: (f32, [f32; 3]),
    /// Whether a node had surfels that lie as the patch does: what of them nothing leaves is dark,
    /// and not unknown.
    is_known: bool,
    /// Whether a node's surfels differ so much that a smaller one would say something else.
    is_uneven: bool,
}

impl Default for Mean {
    fn default() -> Self {
        Self {
            sent: [0.0; 3],
            area: 0.0,
            nearest: (Self::MAX_REACH, [0.0; 3]),
            is_known: false,
            is_uneven: false,
        }
    }
}

impl Mean {
    /// Cosine between the normals of a disk and of a patch from which on both are one surface.
    const MIN_COS_OF_ONE_SURFACE: f32 = 0.7;
    /// A disk further away than this says nothing: five radii along its plane, half a radius off
    /// it.
    const MAX_REACH: f32 = 25.0;

    #[inline]
    fn add(&mut self, (sent, area): Sent) {
        if area > 0.0 {
            self.area += area;
            let share = area / self.area;
            for (s, v) in self.sent.iter_mut().zip(sent) {
                *s += (v - *s) * share;
            }
        }
    }

    /// A node that holds the middle of a patch.
    #[inline]
    fn add_node(&mut self, sent: Sent, node: &NodeAggregate, side: &TriangleSide) {
        /// Most of what stands across, and of rounding in files.
        const ACROSS: f32 = 0.1;
        self.add(sent);
        self.is_known |= node.squared_cosine(side.normal.to_array()) > ACROSS;
    }

    /// Disks that hold the middle of the patch, the more the nearer theirs is, but for those that
    /// something stands before.
    fn add_disks(
        &mut self,
        leaves: &PageLeaves,
        block: &DiskBlock,
        patch: &Patch,
        side: &TriangleSide,
    ) {
        let (p, n) = (patch.middle.to_array(), side.normal.to_array());
        let mut reach = [0.0_f32; WIDTH];
        let mut cos = [0.0_f32; WIDTH];
        for k in 0..WIDTH {
            let [x, y, z] = [0, 1, 2].map(|a| p[a] - block.centre[a][k]);
            let normal = [0, 1, 2].map(|a| block.normal[a][k]);
            let height = x * normal[0] + y * normal[1] + z * normal[2];
            // What is off the plane by more than disks of one surface stand out over each other is
            // of another one.
            let off = height * height / (OVERHANG * OVERHANG);
            let larger = (block.radius2[k] / patch.own2).max(1.0);
            reach[k] = (x * x + y * y + z * z + off * larger) / block.radius2[k];
            cos[k] = n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2];
        }
        for k in 0..block.count as usize {
            if cos[k].abs() < Self::MIN_COS_OF_ONE_SURFACE || reach[k] >= self.nearest.0.max(1.0) {
                continue;
            }
            let light = &leaves.lights[block.first_light as usize + k];
            let sent = if cos[k] > 0.0 {
                light.front
            } else {
                light.back
            };
            if reach[k] < self.nearest.0 {
                self.nearest = (reach[k], sent);
            }
            let offset = std::array::from_fn(|a| p[a] - block.centre[a][k]);
            if reach[k] < 1.0
                && !leaves.is_clipped(light, offset)
                && !side.is_hidden(patch.middle, offset, block.radius2[k])
            {
                self.add((sent, block.radius2[k].min(patch.own2) * (1.0 - reach[k])));
            }
        }
    }

    /// `None` where there was no surface.
    fn radiance(&self) -> Option<Rgb> {
        if self.area > 0.0 {
            Some(Rgb(self.sent))
        } else {
            // Without a near disk this is black.
            let is_known = self.is_known || self.nearest.0 < Self::MAX_REACH;
            is_known.then_some(Rgb(self.nearest.1))
        }
    }
}

/// Whether what the nodes below one that sends this send differs from it by more than that, on
/// average over their area, as where less than half of it is lit.
fn is_uneven((radiance, area): Sent, nodes: &PageNodes, below: u32, side: &TriangleSide) -> bool {
    let mean = Rgb(radiance).mean();
    let off = |aggregate| {
        let (radiance, part) = side.sent(nodes, aggregate);
        part / area * (Rgb(radiance).mean() - mean).abs()
    };
    area > 0.0 && nodes.below(below).map(off).sum::<f32>() > mean
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::math::Hit;
    use lvox_formats::record::{Below, Bounds, Node, SurfelAggregate};

    /// A wall at x = 0, up to a height.
    #[derive(Debug)]
    pub struct Wall(pub f32);

    impl Geometry for Wall {
        fn closest(&self, ray: &Ray) -> Option<Hit> {
            let &Ray {
                origin,
                direction,
                t_max,
            } = ray;
            let t = -origin.x / direction.x;
            let is_met = t > 0.0 && t < t_max && (origin + direction * t).z < self.0;
            is_met.then_some(Hit {
                t,
                triangle: 0,
                uv: [0.0; 2],
                is_back: false,
            })
        }

        fn triangles(&self) -> u32 {
            1
        }

        fn corners(&self, _: u32) -> [Vec3; 3] {
            [Vec3::ZERO, Vec3::Y, Vec3::Z]
        }

        fn normal(&self, _: u32) -> Vec3 {
            Vec3::X
        }

        fn surfel_area_over_mean(&self, _: u32) -> Option<f32> {
            Some(1.0)
        }
    }

    /// The upper side of a triangle on the floor.
    fn floor(wall: &Wall) -> TriangleSide<'_> {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        TriangleSide {
            corners,
            normal: Vec3::Z,
            is_back: false,
            extent: PatchExtent::new(corners, Some(0.0)),
            is_even: true,
            geometry: wall,
        }
    }

    #[test]
    fn walls_hide_disks_that_reach_under_them_and_bumps_do_not() {
        let point = Vec3::new(0.1, 0.0, 0.0);
        // From the middle of a disk of radius 1 to the point.
        let [across, beside] = [[0.5, 0.0, 0.0], [-0.3, 0.2, 0.0]];
        for (height, is_hidden) in [(1.0, true), (0.3, true), (0.2, false)] {
            let wall = Wall(height);
            let floor = floor(&wall);
            assert_eq!(floor.is_hidden(point, across, 1.0), is_hidden, "{height}");
            assert!(!floor.is_hidden(point, beside, 1.0));
            assert!(!floor.is_hidden(point, [0.0; 3], 1.0));
        }
    }

    #[test]
    fn patches_hold_their_hits_and_are_as_small_as_asked() {
        const SIZE: f32 = 0.13;
        let side = floor(&Wall(0.0));
        let TriangleSide {
            corners, extent, ..
        } = side;
        assert_eq!(extent.edge2, 2.0);
        let mut middles = std::collections::BTreeMap::new();
        for i in 0..2000 {
            let [a, b] = crate::math::sampling::r2(i, [0.5; 2]);
            // Some on the edges, some on corners of patches.
            let uv = match i % 4 {
                0 => [0.25 * (4.0 * a).floor(), 0.25 * (4.0 * b).floor()],
                1 => [a, 1.0 - a],
                _ => [a, b],
            };
            if uv[0] + uv[1] > 1.0 + 1e-6 {
                continue;
            }
            let hit = |is_back| Hit {
                t: 1.0,
                triangle: 0,
                uv,
                is_back,
            };
            let id = PatchId::new(&hit(false), extent.edge2, SIZE);
            let patch = Patch::new(&id, &side);
            assert!(patch.area <= SIZE && patch.area > SIZE / 4.0);
            assert!(patch.has_quarters);
            let quarters = id.quarters().map(|q| q.middle(corners));
            let mean = quarters.into_iter().sum::<Vec3>() * 0.25;
            assert!((mean - patch.middle).length() < 1e-6, "{quarters:?}");
            assert!((quarters[3] - patch.middle).length() < 1e-6, "{quarters:?}");
            for q in &quarters[..3] {
                assert!(q.x > 0.0 && q.y > 0.0 && q.x + q.y < 1.0, "{uv:?}: {q}");
                let off = (*q - patch.middle).length();
                assert!(off > 0.1 * SIZE.sqrt() && off < 0.4 * SIZE.sqrt(), "{off}");
            }
            let own = id.corners(corners);
            let middle = own.into_iter().sum::<Vec3>() * (1.0 / 3.0);
            assert!((middle - patch.middle).length() < 1e-6, "{own:?}");
            assert_eq!(PatchExtent::new(own, None).edge2, extent.edge2 / 16.0);
            let finer = PatchId::new(&hit(false), extent.edge2, SIZE / 4.0);
            assert_eq!(id.smaller(finer), finer);
            assert_eq!(finer.smaller(id), finer);
            assert!(id.quarters().contains(&finer), "{uv:?}: {finer:?}");
            let m = patch.middle;
            assert!(m.x > 0.0 && m.y > 0.0 && m.x + m.y < 1.0, "{uv:?}: {m}");
            let off = Vec3::new(uv[0], uv[1], 0.0) - m;
            assert!(off.length() < SIZE.sqrt(), "{uv:?}: {m}");
            assert_eq!(*middles.entry(id.key()).or_insert(m), m);
            let behind = PatchId::new(&hit(true), extent.edge2, SIZE);
            assert_eq!(behind.key(), id.key() | 1 << 31);
        }
        // Three halvings of the longest edge, the root of two.
        assert_eq!(middles.len(), 16);
    }

    #[test]
    fn nodes_are_uneven_where_less_than_half_is_lit() {
        let node = |below, area: f32, light: f32| {
            let mut aggregate = SurfelAggregate {
                area,
                ..SurfelAggregate::default()
            };
            aggregate.axis_area[4] = area;
            aggregate.axis_radiance[4] = [light; 3];
            Node {
                bounds: Bounds {
                    min: [0.0; 3],
                    max: [1.0; 3],
                },
                below,
                aggregate,
            }
        };
        for (lit, expected) in [(0, false), (1, true), (3, true), (4, false), (8, false)] {
            let mean = lit as f32 / 8.0;
            let mut nodes = vec![
                node(Below::Nodes { first: 1, count: 1 }, 8.0, mean),
                node(Below::Nodes { first: 2, count: 8 }, 8.0, mean),
            ];
            nodes.extend((0..8).map(|k| {
                let light = f32::from(u8::from(k < lit));
                node(Below::Surfels { first: k, count: 1 }, 1.0, light)
            }));
            let page = PageNodes::new(&nodes);
            let below = page.nodes[0].child[0];
            assert_eq!(page.below(below).len(), 8);
            let wall = Wall(0.0);
            let side = floor(&wall);
            let found = is_uneven(side.sent(&page, 0), &page, below, &side);
            assert_eq!(found, expected, "{lit} of 8");
        }
        assert!(PageNodes::default().below(0).is_empty());
    }
}
