//! The hierarchy over the triangles of a mesh, from the top down.

use super::instances::InstanceBvh;
use super::slab_ray::MAX_ENTRIES;
use super::split::{Bounds, Group, Item, Plane};
use super::{Blocks, Child, Node, TriangleBvh, WIDTH};
use crate::Result;
use crate::run::Cancel;
use crate::scene::Mesh;
use crate::trace::watertight::{Block, LANES, VertexBlock};
use arrayvec::ArrayVec;
use rayon::prelude::*;
use std::convert::Infallible;
use std::ops::Range;
use wide::f32x8;

/// Levels of nodes. Each leaves all but one child of a node to be visited later, which is what
/// [`MAX_ENTRIES`] have room for.
const LEVELS: usize = (MAX_ENTRIES - 1) / (WIDTH - 1);
const _: () = assert!(LEVELS == crate::formats::MAX_NODE_LEVELS as usize);
/// Levels that are parted by halves: enough for all the triangles that a mesh can have.
const HALVED_LEVELS: usize = 8;
/// Triangles of a leaf, at most.
const MAX_LEAF: usize = Child::MAX_BLOCKS;
/// What the way through a node costs for each of its children, in tests of a block.
const CHILD_COST: f32 = 0.25;
/// What the way through a node of its own costs.
const NODE_COST: f32 = 1.0;
/// Triangles up to which a part is built by one thread.
const ONE_THREAD: usize = 1 << 14;

impl<'a> TriangleBvh<'a> {
    /// Builds the hierarchy.
    #[must_use]
    pub fn new(mesh: &'a Mesh) -> Self {
        let Ok(bvh) = Self::over_all(mesh, || Ok::<_, Infallible>(()));
        bvh
    }

    /// Builds the hierarchy as [`TriangleBvh::new`] does, but stops on request.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new_until(mesh: &'a Mesh, cancel: &Cancel) -> Result<Self> {
        Self::over_all(mesh, || cancel.check())
    }

    /// The hierarchy over flat triangles, and those over instances if there are any.
    fn over_all<E: Send>(
        mesh: &'a Mesh,
        go_on: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, E> {
        let by_vertex = is_large(mesh);
        let mut all = Self::over(mesh, 0..mesh.flat_count() as u32, by_vertex, &go_on)?;
        let prototypes = mesh.instances.prototypes().par_iter();
        let prototypes =
            prototypes.map(|p| Self::over(mesh, p.triangles.clone(), by_vertex, &go_on));
        let prototypes = prototypes.collect::<Result<_, E>>()?;
        all.instances = InstanceBvh::new(mesh, prototypes).map(Box::new);
        Ok(all)
    }

    /// The hierarchy over triangles that only stand for their boxes.
    pub(super) fn of_boxes(mesh: &Mesh) -> TriangleBvh<'static> {
        let triangles = 0..mesh.triangles.len() as u32;
        let maker = Maker {
            mesh,
            go_on: || Ok::<_, Infallible>(()),
            drops_equals: false,
        };
        let Ok(Tables {
            nodes,
            blocks,
            scale,
        }) = maker.tables(triangles, false);
        TriangleBvh {
            nodes: nodes.into(),
            blocks,
            scale,
            ..TriangleBvh::default()
        }
    }

    /// The hierarchy of triangles, by their places among all that are stored, the same for any
    /// number of threads, with blocks that know their vertices or their corners; `go_on` is asked
    /// at each split, and ends it with its error.
    pub(super) fn over<E: Send>(
        mesh: &'a Mesh,
        triangles: Range<u32>,
        by_vertex: bool,
        go_on: impl Fn() -> Result<(), E> + Sync,
    ) -> Result<Self, E> {
        let maker = Maker {
            mesh,
            go_on,
            drops_equals: true,
        };
        let Tables {
            nodes,
            blocks,
            scale,
        } = maker.tables(triangles, by_vertex)?;
        if nodes.is_empty() {
            return Ok(Self::default());
        }
        Ok(Self {
            blocks,
            nodes: nodes.into(),
            positions: &mesh.positions,
            scale,
            masks: None,
            instances: None,
        })
    }
}

/// Triangles from which on blocks know their vertices: 24 bytes a triangle less count for more,
/// there, than frames that take a seventh longer.
const LARGE: usize = 1 << 22;

fn is_large(mesh: &Mesh) -> bool {
    mesh.triangles.len() >= LARGE
}

/// What a hierarchy consists of.
#[derive(Default)]
struct Tables {
    nodes: Vec<Node>,
    blocks: Blocks,
    scale: f32,
}

/// What makes the nodes. Their leaves have triangles in the place of blocks.
struct Maker<'a, F> {
    mesh: &'a Mesh,
    go_on: F,
    /// Whether of equal triangles only the first is kept.
    drops_equals: bool,
}

impl<E: Send, F: Fn() -> Result<(), E> + Sync> Maker<'_, F> {
    /// Makes all for some triangles.
    fn tables(&self, triangles: Range<u32>, by_vertex: bool) -> Result<Tables, E> {
        let mesh = self.mesh;
        let scale = scale_of(mesh, &triangles);
        let items = triangles.into_par_iter();
        let mut items: Vec<Item> = items.map(|t| Item::new(mesh, t, scale)).collect();
        // The others are never met, and have no place.
        items.retain(Item::is_finite);
        if items.is_empty() {
            return Ok(Tables::default());
        }
        let mut nodes = Vec::new();
        let all = Group::new(&items, 0);
        self.add(&mut nodes, &mut items, all, 1)?;
        nodes.shrink_to_fit();
        let order: Vec<u32> = items.par_iter().map(Item::triangle).collect();
        drop(items);
        // The triangles of each block, the blocks of a leaf one after the other.
        let mut blocks = Vec::new();
        for child in nodes.iter_mut().flat_map(|node| &mut node.children) {
            if child.is_leaf() {
                // Of triangles until here.
                let leaf = child.blocks();
                let first = blocks.len();
                let starts = leaf.clone().step_by(LANES);
                blocks.extend(starts.map(|start| start..leaf.end.min(start + LANES)));
                *child = Child::leaf(first, blocks.len() - first);
            }
        }
        (self.go_on)()?;
        let blocks = blocks.into_par_iter();
        let blocks = match by_vertex {
            true => {
                let blocks = blocks.map(|range| VertexBlock::new(mesh, &order[range]));
                Blocks::Vertices(blocks.collect::<Vec<_>>().into())
            }
            false => {
                let blocks = blocks.map(|range| Block::new(mesh, &order[range], scale));
                Blocks::Corners(blocks.collect::<Vec<_>>().into())
            }
        };
        Ok(Tables {
            nodes,
            blocks,
            scale,
        })
    }

    /// Adds the node over a group, whose items these are, and all below it.
    fn add(
        &self,
        nodes: &mut Vec<Node>,
        items: &mut [Item],
        group: Group,
        level: usize,
    ) -> Result<(), E> {
        let start = group.first;
        let groups = self.children(items, group, level)?;
        let to = nodes.len();
        nodes.push(Node::around(&groups));
        if items.len() <= ONE_THREAD {
            for (slot, (group, is_leaf)) in groups.into_iter().enumerate() {
                nodes[to].children[slot] = if is_leaf {
                    Child::leaf(group.first, group.len())
                } else {
                    let child = Child::node(nodes.len());
                    let items = &mut items[group.first - start..group.end - start];
                    self.add(nodes, items, group, level + 1)?;
                    child
                };
            }
            return Ok(());
        }
        let parts = parts(items, start, &groups);
        let below = groups
            .par_iter()
            .zip(parts)
            .map(|(&(group, is_leaf), items)| {
                let mut nodes = Vec::new();
                if !is_leaf {
                    self.add(&mut nodes, items, group, level + 1)?;
                }
                Ok(nodes)
            });
        let below: Vec<Vec<Node>> = below.collect::<Result<_, E>>()?;
        for (slot, ((group, is_leaf), below)) in groups.into_iter().zip(below).enumerate() {
            let first = nodes.len();
            nodes[to].children[slot] = if is_leaf {
                Child::leaf(group.first, group.len())
            } else {
                Child::node(first)
            };
            nodes.extend(below.into_iter().map(|mut node| {
                for child in &mut node.children {
                    *child = child.behind(first);
                }
                node
            }));
        }
        Ok(())
    }

    /// Parts a group into the children of its node, and tells which of them are leaves.
    fn children(&self, items: &mut [Item], group: Group, level: usize) -> Result<Children, E> {
        let start = group.first;
        let halved = level > LEVELS - HALVED_LEVELS;
        let is_small = |group: &Group| group.len() <= if halved { MAX_LEAF } else { LANES };
        let mut groups = Children::new();
        groups.push((group, is_small(&group)));
        while !groups.is_full() {
            (self.go_on)()?;
            let size = |(group, _): &(Group, bool)| match halved {
                true => (0.0, group.len()),
                false => (group.half_area(), group.len()),
            };
            let open = (0..groups.len()).filter(|&i| !groups[i].1);
            let largest = open.max_by(|&i, &j| {
                let (a, b) = (size(&groups[i]), size(&groups[j]));
                a.0.total_cmp(&b.0).then(a.1.cmp(&b.1))
            });
            let Some(i) = largest else { break };
            let (mut group, _) = groups[i];
            let items = &mut items[group.first - start..group.end - start];
            let plane = if halved { None } else { group.plane(items) };
            let parts = match plane {
                _ if is_leaf(&group, plane.as_ref(), CHILD_COST) => None,
                Some(plane) => Some(group.part(items, plane)),
                None if group.is_distinct() || !self.drops_equals => Some(group.halve(items)),
                None => {
                    group.drop_equals(self.mesh, items);
                    groups[i] = (group, is_small(&group));
                    continue;
                }
            };
            match parts {
                None => groups[i].1 = true,
                Some(parts) => {
                    let [left, right] = parts.map(|part| (part, is_small(&part)));
                    groups[i] = left;
                    groups.push(right);
                }
            }
        }
        for (group, leaf) in groups
            .iter_mut()
            .filter(|(group, leaf)| !leaf && group.len() <= MAX_LEAF)
        {
            let items = &items[group.first - start..group.end - start];
            *leaf = is_leaf(group, group.plane(items).as_ref(), NODE_COST);
        }
        Ok(groups)
    }
}

/// Groups in the order of a node's children, and which of them are leaves.
type Children = ArrayVec<(Group, bool), WIDTH>;

/// Whether a leaf of a whole group costs a ray no more than the parts on both sides of a plane and
/// what it takes to choose one of them, in tests of a block.
fn is_leaf(group: &Group, plane: Option<&Plane>, choice: f32) -> bool {
    group.len() <= MAX_LEAF
        && plane.is_none_or(|plane| {
            let blocks = group.len().div_ceil(LANES) as f32;
            (blocks - choice) * group.half_area() <= plane.cost
        })
}

/// The items of each group that is below a node, by the order of groups. Nothing of what is left
/// out between them is in any.
fn parts<'a>(
    mut items: &'a mut [Item],
    mut start: usize,
    groups: &Children,
) -> Vec<&'a mut [Item]> {
    let mut order: ArrayVec<usize, WIDTH> = (0..groups.len()).collect();
    order.sort_unstable_by_key(|&i| groups[i].0.first);
    let mut parts: Vec<&mut [Item]> = groups.iter().map(|_| &mut [][..]).collect();
    for i in order {
        let (group, _) = groups[i];
        let (_, rest) = items.split_at_mut(group.first - start);
        let (part, rest) = rest.split_at_mut(group.len());
        parts[i] = part;
        (items, start) = (rest, group.end);
    }
    parts
}

impl Node {
    /// A node over groups, without what they hold.
    fn around(groups: &Children) -> Self {
        let mut lower = [[f32::INFINITY; WIDTH]; 3];
        let mut upper = [[f32::NEG_INFINITY; WIDTH]; 3];
        for (slot, (group, _)) in groups.iter().enumerate() {
            let Bounds { min, max } = group.bounds;
            // As much as rounding can put a hit beside its triangle.
            let margin = 1e-6 * (max - min).max_element()
                + 2.0 * f32::EPSILON * min.abs().max(max.abs()).max_element();
            for a in 0..3 {
                lower[a][slot] = min[a] - margin;
                upper[a][slot] = max[a] + margin;
            }
        }
        let [x, y, z] = lower.map(f32x8::new);
        let [u, v, w] = upper.map(f32x8::new);
        Self {
            planes: [x, y, z, u, v, w],
            ..Self::default()
        }
    }
}

/// The power of two that makes the largest coordinate of triangles about 1.
fn scale_of(mesh: &Mesh, triangles: &Range<u32>) -> f32 {
    let triangles = &mesh.triangles[triangles.start as usize..triangles.end as usize];
    let corners = triangles.par_iter().map(|t| {
        let corners = t.map(|i| mesh.positions[i as usize].abs().max_element());
        let finite = corners.into_iter().filter(|v| v.is_finite());
        finite.fold(0.0, f32::max)
    });
    let largest = corners.reduce(|| 0.0, f32::max);
    let (_, exponent) = libm::frexpf(largest);
    libm::ldexpf(1.0, (-exponent).clamp(-120, 120))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{scan, sphere};
    use super::*;
    use crate::math::{Ray, sampling};
    use glam::Vec3;

    fn number(i: u64, of: u64) -> f32 {
        sampling::unit(sampling::hash(&[i, of])) - 0.5
    }

    fn point(i: u64, of: u64) -> Vec3 {
        Vec3::from([0, 1, 2].map(|a| number(i, 3 * of + a)))
    }

    fn mesh_of(triangles: impl IntoIterator<Item = [Vec3; 3]>) -> Mesh {
        let positions: Vec<Vec3> = triangles.into_iter().flatten().collect();
        let triangles = (0..positions.len() as u32 / 3).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]);
        Mesh {
            triangles: triangles.collect(),
            positions: positions.into(),
            ..Mesh::default()
        }
    }

    /// Levels of the hierarchy.
    fn levels(bvh: &TriangleBvh) -> usize {
        fn below(bvh: &TriangleBvh, child: Child) -> usize {
            if child.is_leaf() {
                return 0;
            }
            let children = bvh.nodes[child.0 as usize].children;
            let there = children.into_iter().filter(|c| c.0 != 0);
            1 + there.map(|c| below(bvh, c)).max().unwrap_or(0)
        }
        below(bvh, Child::node(0))
    }

    /// Holds rays, alone and in packets, to a scan of all triangles, and returns how many met one.
    fn met_as_by_a_scan(mesh: &Mesh, rays: u64) -> usize {
        let bvh = TriangleBvh::new(mesh);
        assert!(levels(&bvh) <= LEVELS);
        let rays: Vec<_> = (0..rays)
            .map(|i| {
                let origin = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let toward = mesh.positions[sampling::hash(&[i]) as usize % mesh.positions.len()];
                let toward = if toward.is_finite() {
                    toward
                } else {
                    Vec3::ZERO
                };
                let direction = toward + 0.01 * point(i, 3) - origin;
                Ray::endless(origin, direction.normalize())
            })
            .collect();
        let mut hits = vec![None; rays.len()];
        bvh.closest_of_packet(&rays, &mut hits);
        for (ray, &hit) in rays.iter().zip(&hits) {
            assert_eq!(hit.map(|h| h.t), scan(mesh, ray.origin, ray.direction));
            assert_eq!(hit, bvh.closest(ray));
            assert_eq!(hit.is_some(), bvh.is_occluded(ray));
        }
        hits.iter().flatten().count()
    }

    #[test]
    fn any_triangles_are_met_as_by_a_scan() {
        for count in [1, 3, 5, 17, 100, 3000] {
            for size in [1e-3, 0.1, 1.0] {
                let mesh = mesh_of((0..count).map(|i| {
                    let corner = |k| point(i, 0) + size * point(i, k);
                    [corner(1), corner(2), corner(3)]
                }));
                let met = met_as_by_a_scan(&mesh, 300);
                assert!(met > 0 || size * (count as f32) < 10.0);
            }
        }
    }

    #[test]
    fn slivers_rows_and_chains_are_met_as_by_a_scan() {
        let slivers = mesh_of((0..2000).map(|i| {
            let (a, b) = (point(i, 0), point(i, 1));
            [a, b, b + 1e-5 * point(i, 2)]
        }));
        met_as_by_a_scan(&slivers, 300);
        // All middles on a line, along an axis and not.
        for way in [Vec3::X, Vec3::new(0.3, 0.5, -0.4)] {
            let row = mesh_of((0..2000).map(|i| {
                let [a, b] = [0, 1].map(|k| 0.02 * point(i, k));
                let at = way * number(i, 9);
                [at + a, at + b, at - a - b]
            }));
            assert!(met_as_by_a_scan(&row, 300) > 10);
        }
        // Each half as large as the one before, to the end of what numbers can tell.
        let chain = mesh_of((0..140).flat_map(|i| {
            let size = libm::ldexpf(1.0, -i);
            let corner = |k| size * (Vec3::ONE + point(i as u64, k));
            [
                [corner(1), corner(2), corner(3)],
                [corner(4), corner(5), corner(6)],
            ]
        }));
        assert!(met_as_by_a_scan(&chain, 300) > 10);
        // All around one point.
        let nested = mesh_of((0..2000).map(|i| {
            let [a, b] = [0, 1].map(|k| number(i, 7) * point(0, k));
            [a, b, -a - b]
        }));
        assert!(met_as_by_a_scan(&nested, 300) > 10);
    }

    #[test]
    fn equal_triangles_take_one_place_and_the_first_is_met() {
        let mut mesh = sphere(12, 20);
        let count = mesh.triangles.len();
        // In two orders of corners, of which each is kept once.
        let [a, b, c] = mesh.triangles[7];
        for _ in 0..50_000 {
            mesh.triangles.extend([[a, b, c], [b, c, a]]);
        }
        let bvh = TriangleBvh::new(&mesh);
        assert!(bvh.blocks.len() <= count, "{} blocks", bvh.blocks.len());
        let middle = mesh.corners(7).iter().sum::<Vec3>() / 3.0;
        let hit = bvh.closest(&Ray::endless(2.0 * middle, -middle.normalize()));
        assert_eq!(hit.map(|h| h.triangle), Some(7));
        met_as_by_a_scan(&mesh, 20);
    }

    #[test]
    fn triangles_that_are_not_finite_are_never_met_and_harm_no_others() {
        let mut mesh = sphere(12, 20);
        let count = mesh.triangles.len() as u32;
        let first = mesh.positions.len() as u32;
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -f32::NAN];
        for (i, bad) in (0..).zip(bad) {
            mesh.positions.push(Vec3::new(0.0, bad, 0.0));
            mesh.triangles
                .to_mut()
                .insert(40 * i, [first + i as u32, 0, 5]);
        }
        let bvh = TriangleBvh::new(&mesh);
        assert_eq!(bvh.scale, TriangleBvh::new(&sphere(12, 20)).scale);
        let planes = bvh.nodes.iter().flat_map(|node| node.planes);
        assert!(!planes.flat_map(f32x8::to_array).any(f32::is_nan));
        let Blocks::Corners(blocks) = &bvh.blocks else {
            panic!("a small mesh")
        };
        let lanes = blocks.iter().flat_map(|block| block.triangles);
        assert_eq!(lanes.filter(|&t| t != u32::MAX).count() as u32, count);
        for i in 0..500 {
            let direction = sampling::sphere(sampling::r2(i, [0.3; 2]));
            let ray = Ray::endless(Vec3::new(0.1, 0.03, -0.2), direction);
            assert!(bvh.closest(&ray).is_some());
        }
        let nothing = Mesh {
            triangles: vec![[first, 0, 5]].into(),
            ..mesh
        };
        let bvh = TriangleBvh::new(&nothing);
        assert!(bvh.closest(&Ray::endless(Vec3::ZERO, Vec3::Z)).is_none());
    }

    /// A height field of 2 x 299 x 299 triangles.
    fn field() -> Mesh {
        let side = 300_u32;
        let at = |i: u32| Vec3::new((i % side) as f32, (i / side) as f32, (i % 7) as f32 * 0.1);
        let corner = |i: u32| i / (side - 1) * side + i % (side - 1);
        let squares = (0..(side - 1) * (side - 1)).map(corner);
        Mesh {
            positions: (0..side * side).map(at).collect(),
            triangles: squares
                .flat_map(|i| [[i, i + 1, i + side], [i + 1, i + side + 1, i + side]])
                .collect(),
            ..Mesh::default()
        }
    }

    #[test]
    fn any_number_of_threads_builds_the_same() {
        let mesh = field();
        assert!(mesh.triangles.len() > 2 * ONE_THREAD);
        let built = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
            let bvh = pool.build().unwrap().install(|| TriangleBvh::new(&mesh));
            format!("{bvh:?}")
        };
        assert!(built(1) == built(5));
    }

    #[test]
    fn a_build_stops_on_request() {
        let cancel = Cancel::default();
        TriangleBvh::new_until(&field(), &cancel).unwrap();
        cancel.request();
        let error = TriangleBvh::new_until(&field(), &cancel).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Cancelled);
    }
}
