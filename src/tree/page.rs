//! A page of the tree laid out for rays: eight children, eight disks at a time. Nodes and leaves
//! are apart, as rays that end at triangles seldom ask for leaves.

use super::node_aggregate::{Axes, NodeAggregate, per_area};
use crate::math::Aabb;
use glam::Vec3;
use lvox_formats::record::{Below, Node, Surfel, SurfelAggregate, tangent_frame};
use std::f32::consts::PI;
use std::ops::Range;

/// Children a node, and disks a leaf.
pub const WIDTH: usize = 8;
const NO_CLIPS: u32 = u32::MAX;

/// The kind of what a child slot of a [`WideNode`] holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ChildKind {
    /// No child: the slot is not used.
    #[default]
    None,
    /// Another node of the page.
    Inner,
    /// A block of disks.
    Leaf,
    /// The root of another page.
    Page,
    /// The root of another page, whose children send about what it sends.
    EvenPage,
}

/// The up to eight children of a node.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub struct WideNode {
    /// Lower corners of the children's boxes, by axis.
    pub min: [[f32; WIDTH]; 3],
    /// Upper corners of the children's boxes, by axis, scene space.
    pub max: [[f32; WIDTH]; 3],
    /// Cross-section of each child's bounding sphere, four times that if it is not flat: over
    /// distance squared, about its solid angle.
    pub cross_section: [f32; WIDTH],
    /// Index of node, block or page, by kind.
    pub child: [u32; WIDTH],
    /// Kind of what each slot holds.
    pub kind: [ChildKind; WIDTH],
    /// A bit for each slot in use.
    pub used: u32,
    /// Index of the first child's aggregate; the others follow.
    pub first_aggregate: u32,
}

impl Default for WideNode {
    fn default() -> Self {
        Self {
            min: [[f32::INFINITY; WIDTH]; 3],
            max: [[f32::NEG_INFINITY; WIDTH]; 3],
            cross_section: [f32::INFINITY; WIDTH],
            child: [0; WIDTH],
            kind: [ChildKind::None; WIDTH],
            used: 0,
            first_aggregate: 0,
        }
    }
}

impl WideNode {
    /// The box of a child.
    #[inline]
    #[must_use]
    pub fn bounds(&self, child: usize) -> Aabb {
        let corner = |c: &[[f32; WIDTH]; 3]| Vec3::from(c.map(|axis| axis[child]));
        Aabb {
            min: corner(&self.min),
            max: corner(&self.max),
        }
    }
}

/// The disks of a leaf, at most eight; unused lanes have a negative squared radius.
#[derive(Clone, Debug)]
#[repr(C, align(32))]
pub struct DiskBlock {
    /// Centres, by axis, scene space.
    pub centre: [[f32; WIDTH]; 3],
    /// Unit normals, by axis.
    pub normal: [[f32; WIDTH]; 3],
    /// Squares of the radii before clipping; negative in lanes without a disk.
    pub radius2: [f32; WIDTH],
    /// Index of the first disk's [`DiskLight`]; the others follow.
    pub first_light: u32,
    /// Lanes in use, 1 to 8, from the first.
    pub count: u32,
}

/// Radiance that a disk sends to either side.
#[derive(Clone, Copy, Debug)]
pub struct DiskLight {
    /// Radiance from the front.
    pub front: [f32; 3],
    /// Radiance from the back.
    pub back: [f32; 3],
    clips: u32,
}

/// The half-planes that are left of a clipped disk: offsets from the centre with `normal . x <=
/// offset`.
#[derive(Clone, Copy, Debug)]
pub struct ClipPlanes([[f32; 4]; 3]);

/// The surfels of an aggregate that face an axis.
#[derive(Clone, Copy, Debug, Default)]
struct Facing {
    /// Area that the axis sees of them, over that of all surfels: areas times radiance would leave
    /// the range of f32.
    area: f32,
    /// Radiance that their fronts send.
    radiance: [f32; 3],
}

/// The nodes of a page laid out for rays.
#[derive(Clone, Debug, Default)]
pub struct PageNodes {
    /// Nodes; 0 is the root.
    pub nodes: Vec<WideNode>,
    /// Aggregates of the children of nodes, from [`WideNode::first_aggregate`] on.
    pub aggregates: Vec<NodeAggregate>,
    /// Radiance that aggregates send to the axes that they face: walls, one of six.
    facing: Vec<Facing>,
    /// Radiance of the backs of each aggregate, as in [`lvox_formats::record::SurfelAggregate`];
    /// empty if no back of the page is lit.
    backs: Vec<[[f32; 3]; 6]>,
}

/// The leaves of a page laid out for rays.
#[derive(Clone, Debug, Default)]
pub struct PageLeaves {
    /// Disks, in the order of the nodes that they are below.
    pub blocks: Vec<DiskBlock>,
    /// Radiance that disks send, from [`DiskBlock::first_light`] on.
    pub lights: Vec<DiskLight>,
    clips: Vec<ClipPlanes>,
}

/// Bytes that the nodes and the leaves of a page take at most, of so many nodes and surfels.
#[must_use]
pub fn most_bytes(nodes: u64, surfels: u64, has_clips: bool, has_backs: bool) -> u64 {
    // What is below each node is either a group of nodes or a block of disks; a root that is a leaf
    // is a group, too.
    let below = size_of::<WideNode>().max(size_of::<DiskBlock>());
    let clips = if has_clips {
        size_of::<ClipPlanes>()
    } else {
        0
    };
    let backs = if has_backs {
        size_of::<[[f32; 3]; 6]>()
    } else {
        0
    };
    let facing = size_of::<[Facing; 6]>();
    let node = (size_of::<NodeAggregate>() + facing + backs + below) as u64;
    let surfel = (size_of::<DiskLight>() + clips) as u64;
    let of_nodes = nodes.saturating_mul(node);
    let of_surfels = surfels.saturating_mul(surfel);
    of_nodes
        .saturating_add(of_surfels)
        .saturating_add(size_of::<WideNode>() as u64)
}

impl PageNodes {
    /// Lays out the nodes of a page, which must be valid as the reader promises.
    #[must_use]
    pub fn new(nodes: &[Node]) -> Self {
        let Some(root) = nodes.first() else {
            return Self::default();
        };
        // Leaves before each node: the block of a leaf.
        let mut leaves = 0;
        let count_leaf = |node: &Node| {
            let before = leaves;
            leaves += u32::from(node.below.surfels().is_some());
            before
        };
        let blocks: Vec<u32> = nodes.iter().map(count_leaf).collect();
        let mut out = Self {
            nodes: Vec::with_capacity((nodes.len() - leaves as usize).max(1)),
            aggregates: Vec::with_capacity(nodes.len()),
            facing: Vec::with_capacity(
                nodes
                    .iter()
                    .map(|n| facing_axes(&n.aggregate).count())
                    .sum(),
            ),
            backs: Vec::new(),
        };
        // The groups to come, with the slot that each is below. Not by recursion: a page may be as
        // deep as it has nodes.
        let mut groups = vec![match root.below {
            Below::Nodes { first, count } => (first, count, None),
            _ => (0, 1, None),
        }];
        while let Some((first, count, above)) = groups.pop() {
            let index = out.nodes.len();
            if let Some((above, slot)) = above {
                let above: &mut WideNode = &mut out.nodes[above];
                above.child[slot] = index as u32;
            }
            let node = out.group(nodes, &blocks, first, count);
            // The last comes off first.
            for slot in (0..usize::from(count)).rev() {
                if let Below::Nodes { first, count } = nodes[first as usize + slot].below {
                    groups.push((first, count, Some((index, slot))));
                }
            }
            out.nodes.push(node);
        }
        out.backs.shrink_to_fit();
        out
    }

    /// The node of some siblings, but for where the nodes below it are.
    fn group(&mut self, nodes: &[Node], blocks: &[u32], first: u32, count: u8) -> WideNode {
        let first_aggregate = self.aggregates.len() as u32;
        let group = first as usize..first as usize + usize::from(count);
        let children = &nodes[group.clone()];
        for child in children {
            let axes = self.add_facing(&child.aggregate);
            self.add_backs(&child.aggregate.back_radiance);
            self.aggregates.push(NodeAggregate::new(child, axes));
        }
        let mut node = WideNode {
            first_aggregate,
            used: (1 << count) - 1,
            ..WideNode::default()
        };
        for (slot, child) in children.iter().enumerate() {
            let mut diagonal2 = 0.0;
            for a in 0..3 {
                let (min, max) = (child.bounds.min[a], child.bounds.max[a]);
                node.min[a][slot] = min;
                node.max[a][slot] = max;
                diagonal2 += (max - min) * (max - min);
            }
            // A mean normal says little of a node that is not flat: it has to look half as large to
            // be taken whole.
            let flat = self.aggregates[first_aggregate as usize + slot].is_flat();
            let allowance = if flat { 1.0 } else { 4.0 };
            node.cross_section[slot] = 0.25 * PI * diagonal2 * allowance;
            (node.kind[slot], node.child[slot]) = match child.below {
                Below::Nodes { .. } => (ChildKind::Inner, 0),
                Below::Surfels { .. } => (ChildKind::Leaf, blocks[group.start + slot]),
                Below::Page(id) => (ChildKind::Page, id),
                Below::EvenPage(id) => (ChildKind::EvenPage, id),
            };
        }
        node
    }

    /// Adds what the fronts of an aggregate send to each axis that they face.
    fn add_facing(&mut self, of: &SurfelAggregate) -> Axes {
        let first = self.facing.len() as u32;
        let mut mask = 0;
        for (axis, area) in facing_axes(of) {
            let radiance = of.axis_radiance[axis];
            mask |= 1 << axis;
            self.facing.push(Facing { area, radiance });
        }
        Axes { mask, first }
    }

    /// Adds what backs of the aggregate to come send towards each axis, if that of any so far do.
    fn add_backs(&mut self, towards: &[[f32; 3]; 6]) {
        const DARK: [[f32; 3]; 6] = [[0.0; 3]; 6];
        if *towards != DARK {
            self.backs.resize(self.aggregates.len(), DARK);
        }
        if *towards != DARK || !self.backs.is_empty() {
            self.backs.push(*towards);
        }
    }

    /// The surfels of an aggregate that face an axis.
    #[inline]
    fn facing(&self, of: &NodeAggregate, axis: usize) -> Facing {
        let Axes { mask, first } = of.axes;
        if mask >> axis & 1 == 0 {
            return Facing::default();
        }
        let before = (mask & ((1 << axis) - 1)).count_ones();
        self.facing[(first + before) as usize]
    }

    /// Indices of the aggregates of the children of a node; none if there is no such node.
    #[must_use]
    #[inline]
    pub fn below(&self, node: u32) -> Range<usize> {
        self.nodes.get(node as usize).map_or(0..0, |node| {
            let first = node.first_aggregate as usize;
            first..first + node.used.count_ones() as usize
        })
    }

    /// Returns the radiance that one side of an aggregate's surfels sends towards `v`: the mean
    /// over those of that side that face it, weighted by the area that each of the three axes there
    /// sees; and that area.
    #[must_use]
    #[inline]
    pub fn sent(&self, aggregate: usize, v: [f32; 3], is_back: bool) -> ([f32; 3], f32) {
        let of = &self.aggregates[aggregate];
        let mut mean = Weighted::default();
        for (a, &along) in v.iter().enumerate() {
            let side = 2 * a + usize::from(along < 0.0);
            if !is_back {
                let fronts = self.facing(of, side);
                mean.add(along.abs() * fronts.area, fronts.radiance);
            } else {
                let radiance = self.backs.get(aggregate).map_or([0.0; 3], |b| b[side]);
                mean.add(along.abs() * self.facing(of, side ^ 1).area, radiance);
            }
        }
        (mean.get(), mean.weight * of.area)
    }

    /// Returns the radiance that an aggregate sends towards `v` from either side. Of sides that
    /// face it, backs count where they are lit only: a dark one would halve the light of the front
    /// that it hides behind.
    #[must_use]
    pub fn radiance(&self, aggregate: usize, v: [f32; 3]) -> [f32; 3] {
        let of = &self.aggregates[aggregate];
        let mut mean = Weighted::default();
        for (a, &along) in v.iter().enumerate() {
            let side = 2 * a + usize::from(along < 0.0);
            let fronts = self.facing(of, side);
            mean.add(along.abs() * fronts.area, fronts.radiance);
            if let Some(back) = self.backs.get(aggregate).map(|b| b[side])
                && back != [0.0; 3]
            {
                mean.add(along.abs() * self.facing(of, side ^ 1).area, back);
            }
        }
        mean.get()
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.nodes)
            + size_of_val(&*self.aggregates)
            + size_of_val(&*self.facing)
            + size_of_val(&*self.backs)
    }
}

/// The axes that surfels of an aggregate face, one for walls, and what each sees of their area,
/// over that of all.
pub(super) fn facing_axes(of: &SurfelAggregate) -> impl Iterator<Item = (usize, f32)> {
    let seen = of.axis_area.map(|area| per_area(area, of.area));
    seen.into_iter().enumerate().filter(|(_, area)| *area > 0.0)
}

impl PageLeaves {
    /// Lays out the surfels of a page, so many in each of its leaves, which must be valid as the
    /// reader promises.
    #[must_use]
    pub fn new(counts: &[u8], surfels: &[Surfel]) -> Self {
        let clipped = surfels.iter().filter(|s| s.clips.count > 0).count();
        let mut out = Self {
            blocks: Vec::with_capacity(counts.len()),
            lights: Vec::with_capacity(surfels.len()),
            clips: Vec::with_capacity(clipped),
        };
        let mut rest = surfels;
        for &count in counts {
            let (leaf, others) = rest.split_at(usize::from(count));
            out.add_block(leaf);
            rest = others;
        }
        out
    }

    fn add_block(&mut self, surfels: &[Surfel]) {
        let mut block = DiskBlock {
            centre: [[0.0; WIDTH]; 3],
            normal: [[0.0; WIDTH]; 3],
            radius2: [-1.0; WIDTH],
            first_light: self.lights.len() as u32,
            count: surfels.len() as u32,
        };
        for (lane, s) in surfels.iter().enumerate() {
            for a in 0..3 {
                block.centre[a][lane] = s.position[a];
                block.normal[a][lane] = s.normal[a];
            }
            block.radius2[lane] = s.radius * s.radius;
            let clips = if s.clips.count == 0 {
                NO_CLIPS
            } else {
                self.clips.push(ClipPlanes::new(s));
                self.clips.len() as u32 - 1
            };
            self.lights.push(DiskLight {
                front: s.front,
                back: s.back,
                clips,
            });
        }
        self.blocks.push(block);
    }

    /// Whether the point of a disk at `offset` from its centre is cut away.
    #[must_use]
    #[inline]
    pub fn is_clipped(&self, light: &DiskLight, offset: [f32; 3]) -> bool {
        light.clips != NO_CLIPS
            && self.clips[light.clips as usize]
                .0
                .iter()
                .any(|p| p[0] * offset[0] + p[1] * offset[1] + p[2] * offset[2] > p[3])
    }

    /// Bytes held.
    #[must_use]
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.blocks) + size_of_val(&*self.lights) + size_of_val(&*self.clips)
    }
}

impl ClipPlanes {
    fn new(s: &Surfel) -> Self {
        let (t, b) = tangent_frame(s.normal);
        let mut planes = [[0.0, 0.0, 0.0, f32::INFINITY]; 3];
        for (plane, e) in planes
            .iter_mut()
            .zip(&s.clips.edges[..usize::from(s.clips.count)])
        {
            let (sin, cos) = (libm::sinf(e.angle), libm::cosf(e.angle));
            // A little beyond the crease, so that two facets leave no gap between them.
            let offset = (e.offset + 0.005) * s.radius;
            *plane = [
                t[0] * cos + b[0] * sin,
                t[1] * cos + b[1] * sin,
                t[2] * cos + b[2] * sin,
                offset,
            ];
        }
        Self(planes)
    }
}

/// A mean of radiance.
#[derive(Default)]
struct Weighted {
    sum: [f32; 3],
    weight: f32,
}

impl Weighted {
    #[inline]
    fn add(&mut self, weight: f32, radiance: [f32; 3]) {
        self.weight += weight;
        for (sum, radiance) in self.sum.iter_mut().zip(radiance) {
            *sum += weight * radiance;
        }
    }

    #[inline]
    fn get(&self) -> [f32; 3] {
        if self.weight > 0.0 {
            self.sum.map(|s| s / self.weight)
        } else {
            [0.0; 3]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lvox_formats::record::Bounds;

    #[test]
    fn a_page_may_be_as_deep_as_it_has_nodes() {
        const DEPTH: u32 = 32_767;
        let bounds = Bounds {
            min: [0.0; 3],
            max: [1.0; 3],
        };
        let node = |below| Node {
            bounds,
            below,
            aggregate: SurfelAggregate::default(),
        };
        let chain = |first| Below::Nodes { first, count: 1 };
        let mut nodes: Vec<Node> = (1..=DEPTH).map(|first| node(chain(first))).collect();
        nodes.push(node(Below::Surfels { first: 0, count: 1 }));
        let page = PageNodes::new(&nodes);
        assert_eq!(page.nodes.len(), DEPTH as usize);
        for (i, node) in page.nodes.iter().enumerate().take(DEPTH as usize - 1) {
            let below = (node.kind[0], node.child[0]);
            assert_eq!(below, (ChildKind::Inner, i as u32 + 1));
        }
    }

    #[test]
    fn nodes_are_laid_out_each_before_those_below_it_and_the_first_child_first() {
        let node = |below| Node {
            bounds: Bounds {
                min: [0.0; 3],
                max: [1.0; 3],
            },
            below,
            aggregate: SurfelAggregate::default(),
        };
        let nodes = [
            node(Below::Nodes { first: 1, count: 3 }),
            node(Below::Nodes { first: 4, count: 2 }),
            node(Below::Page(7)),
            node(Below::Nodes { first: 6, count: 1 }),
            node(Below::Surfels { first: 0, count: 1 }),
            node(Below::Nodes { first: 7, count: 1 }),
            node(Below::Surfels { first: 1, count: 1 }),
            node(Below::Surfels { first: 2, count: 1 }),
        ];
        let page = PageNodes::new(&nodes);
        use ChildKind::{Inner, Leaf, None, Page};
        let found: Vec<_> = (page.nodes.iter())
            .map(|n| {
                (
                    n.first_aggregate,
                    [0, 1, 2].map(|k| (n.kind[k], n.child[k])),
                )
            })
            .collect();
        let nothing = (None, 0);
        assert_eq!(
            found,
            [
                (0, [(Inner, 1), (Page, 7), (Inner, 3)]),
                (3, [(Leaf, 0), (Inner, 2), nothing]),
                (5, [(Leaf, 2), nothing, nothing]),
                (6, [(Leaf, 1), nothing, nothing]),
            ]
        );
    }
}
