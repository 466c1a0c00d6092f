//! The hierarchy over the triangles of a mesh, of the one that `obvhs` makes.

use super::slab_ray::MAX_ENTRIES;
use super::{Child, Node, TriangleBvh, WIDTH};
use crate::Result;
use crate::run::Cancel;
use crate::scene::Mesh;
use crate::trace::two_wide::{two_wide, two_wide_until};
use crate::trace::watertight::{Block, LANES};
use glam::Vec3A;
use obvhs::bvh2::Bvh2;
use obvhs::triangle::Triangle;
use smallvec::{SmallVec, smallvec};
use std::convert::Infallible;
use std::ops::Range;
use wide::f32x8;

/// Levels of nodes that follow the hierarchy of two children a node. What is below them, as in a
/// long chain of triangles each of which is half as large as the one before, gets one box.
const LEVELS: usize = (MAX_ENTRIES - 1) / (WIDTH - 1) - LEVELS_IN_ONE_BOX;
/// Levels of nodes over all the blocks that a mesh can have.
const LEVELS_IN_ONE_BOX: usize = 8;

impl TriangleBvh {
    /// Builds the hierarchy.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        let go_on = || Ok::<_, Infallible>(());
        let Ok(bvh) = Self::over(mesh, |triangles| Ok(two_wide(&triangles)), go_on);
        bvh
    }

    /// Builds the hierarchy as [`TriangleBvh::new`] does, but stops on request.
    ///
    /// # Errors
    /// If cancelled; a thread may be busy with what was begun until that is done. If no thread can
    /// be had.
    pub fn new_until(mesh: &Mesh, cancel: &Cancel) -> Result<Self> {
        Self::over(mesh, |t| two_wide_until(t, cancel), || cancel.check())
    }

    /// The hierarchy of what is made of all triangles; `go_on` is asked at each node, and ends it
    /// with its error.
    fn over<E>(
        mesh: &Mesh,
        two_wide: impl FnOnce(Vec<Triangle>) -> Result<Bvh2, E>,
        go_on: impl Fn() -> Result<(), E>,
    ) -> Result<Self, E> {
        let mut bvh = Self::default();
        if mesh.triangles.is_empty() {
            return Ok(bvh);
        }
        bvh.scale = scale_of(mesh);
        let triangles: Vec<Triangle> = (0..mesh.triangles.len())
            .map(|i| {
                let [v0, v1, v2] = mesh.corners(i).map(|p| Vec3A::from(p * bvh.scale));
                Triangle { v0, v1, v2 }
            })
            .collect();
        bvh.add(mesh, &two_wide(triangles)?, go_on)?;
        Ok(bvh)
    }

    /// Takes over a hierarchy that is two wide.
    ///
    /// Each level leaves all but one child of a node to be visited later, which is what
    /// [`MAX_ENTRIES`] have room for.
    fn add<E>(
        &mut self,
        mesh: &Mesh,
        bvh: &Bvh2,
        go_on: impl Fn() -> Result<(), E>,
    ) -> Result<(), E> {
        let mut todo = vec![(0, 0, 1)];
        self.nodes.push(Node::default());
        while let Some((from, to, level)) = todo.pop() {
            go_on()?;
            let mut group: SmallVec<[usize; WIDTH]> = SmallVec::new();
            group.push(from);
            while group.len() < WIDTH {
                let area = |i: usize| bvh.nodes[group[i]].aabb.half_area();
                let largest = (0..group.len())
                    .filter(|&i| !bvh.nodes[group[i]].is_leaf())
                    .max_by(|&i, &j| area(i).total_cmp(&area(j)));
                let Some(i) = largest else { break };
                let first = bvh.nodes[group[i]].first_index as usize;
                group[i] = first;
                group.push(first + 1);
            }
            let mut lower = [[f32::INFINITY; WIDTH]; 3];
            let mut upper = [[f32::NEG_INFINITY; WIDTH]; 3];
            for (slot, &id) in group.iter().enumerate() {
                let child = &bvh.nodes[id];
                let (min, max) = (child.aabb.min, child.aabb.max);
                // As much as rounding can put a hit beside its triangle.
                let margin = 1e-6 * (max - min).max_element()
                    + 2.0 * f32::EPSILON * min.abs().max(max.abs()).max_element();
                for a in 0..3 {
                    lower[a][slot] = min[a] - margin;
                    upper[a][slot] = max[a] + margin;
                }
                self.nodes[to].children[slot] = if child.is_leaf() || level == LEVELS {
                    let first = self.blocks.len();
                    for triangles in leaves(bvh, id) {
                        let blocks = triangles.chunks(LANES);
                        let blocks = blocks.map(|t| Block::new(mesh, t, self.scale));
                        self.blocks.extend(blocks);
                    }
                    self.child_of(first..self.blocks.len(), (min - margin, max + margin))
                } else {
                    let index = self.nodes.len();
                    self.nodes.push(Node::default());
                    todo.push((id, index, level + 1));
                    Child::node(index)
                };
            }
            let [x, y, z] = lower.map(f32x8::new);
            let [u, v, w] = upper.map(f32x8::new);
            self.nodes[to].planes = [x, y, z, u, v, w];
        }
        Ok(())
    }

    /// Blocks that follow each other, in one box: a leaf, or a node over as many of them as it
    /// takes.
    fn child_of(&mut self, blocks: Range<usize>, bounds: (Vec3A, Vec3A)) -> Child {
        if blocks.len() <= Child::MAX_BLOCKS {
            return Child::leaf(blocks.start, blocks.len());
        }
        let (min, max) = bounds;
        let [x, y, z] = min.to_array().map(f32x8::splat);
        let [u, v, w] = max.to_array().map(f32x8::splat);
        let index = self.nodes.len();
        self.nodes.push(Node {
            planes: [x, y, z, u, v, w],
            ..Node::default()
        });
        for slot in 0..WIDTH {
            let at = |slot: usize| blocks.start + blocks.len() * slot / WIDTH;
            let child = self.child_of(at(slot)..at(slot + 1), bounds);
            self.nodes[index].children[slot] = child;
        }
        Child::node(index)
    }
}

/// The triangles of each leaf that is below a node, or is it.
fn leaves(bvh: &Bvh2, node: usize) -> impl Iterator<Item = &[u32]> {
    // Mostly it is one.
    let mut todo: SmallVec<[usize; 16]> = smallvec![node];
    std::iter::from_fn(move || {
        loop {
            let node = &bvh.nodes[todo.pop()?];
            let first = node.first_index as usize;
            if node.is_leaf() {
                return Some(&bvh.primitive_indices[first..first + node.prim_count as usize]);
            }
            todo.extend([first + 1, first]);
        }
    })
}

/// The power of two that makes the largest coordinate of a mesh about 1.
fn scale_of(mesh: &Mesh) -> f32 {
    let corners = (0..mesh.triangles.len()).flat_map(|i| mesh.corners(i));
    let largest = corners.fold(0.0_f32, |m, p| m.max(p.abs().max_element()));
    let (_, exponent) = libm::frexpf(largest);
    libm::ldexpf(1.0, (-exponent).clamp(-120, 120))
}

#[cfg(test)]
mod tests {
    use super::super::tests::{scan, sphere};
    use super::*;
    use crate::math::{Ray, sampling};
    use crate::trace::two_wide::MANY;
    use glam::Vec3;

    #[test]
    fn a_large_mesh_can_be_stopped_and_is_built_the_same() {
        let side = 300_u32;
        let at = |i: u32| Vec3::new((i % side) as f32, (i / side) as f32, (i % 7) as f32 * 0.1);
        let corner = |i: u32| i / (side - 1) * side + i % (side - 1);
        let squares = (0..(side - 1) * (side - 1)).map(corner);
        let mesh = Mesh {
            positions: (0..side * side).map(at).collect(),
            triangles: squares
                .flat_map(|i| [[i, i + 1, i + side], [i + 1, i + side + 1, i + side]])
                .collect(),
            ..Mesh::default()
        };
        assert!(mesh.triangles.len() > MANY);
        let cancel = Cancel::default();
        let built = TriangleBvh::new_until(&mesh, &cancel).unwrap();
        let plain = TriangleBvh::new(&mesh);
        for i in 0..1000 {
            let origin = Vec3::new(0.29 * i as f32, 150.3, 9.0);
            let direction = Vec3::new(0.1, 0.2, -1.0).normalize();
            let hit = built.closest(&Ray::endless(origin, direction));
            assert_eq!(hit, plain.closest(&Ray::endless(origin, direction)));
        }
        cancel.request();
        let error = TriangleBvh::new_until(&mesh, &cancel).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Cancelled);
    }

    #[test]
    fn a_leaf_of_any_number_of_triangles_is_met_in_all() {
        let mesh = sphere(12, 20);
        let count = mesh.triangles.len() as u32;
        for copies in [1, 3] {
            let bounds = obvhs::aabb::Aabb {
                min: Vec3A::NEG_ONE,
                max: Vec3A::ONE,
            };
            let mut mesh = mesh.clone();
            mesh.triangles = mesh.triangles.repeat(copies);
            // One leaf of all.
            let mut two_wide = two_wide(&[Triangle::default()]);
            two_wide.nodes[0].aabb = bounds;
            two_wide.nodes[0].prim_count = count * copies as u32;
            two_wide.primitive_indices = (0..count * copies as u32).collect();
            let mut bvh = TriangleBvh {
                scale: 1.0,
                ..TriangleBvh::default()
            };
            let Ok(()) = bvh.add(&mesh, &two_wide, || Ok::<_, Infallible>(()));
            assert!(bvh.blocks.len() > 4 * Child::MAX_BLOCKS);
            for i in 0..500 {
                let o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let d = sampling::sphere(sampling::r2(i, [0.7; 2]));
                let hit = bvh.closest(&Ray::endless(o, d));
                assert_eq!(hit.map(|h| h.t), scan(&mesh, o, d));
                assert!(
                    hit.is_none_or(|h| h.triangle < count),
                    "the first of equals"
                );
            }
        }
    }

    #[test]
    fn a_chain_of_any_depth_is_met_in_all() {
        let mesh = sphere(12, 20);
        let count = mesh.triangles.len() as u32;
        assert!(count as usize > (WIDTH - 1) * LEVELS + WIDTH * Child::MAX_BLOCKS);
        // A node with a leaf of one triangle and a node with the rest, and so on.
        let node = |prim_count, first_index| {
            let mut node = two_wide(&[Triangle::default()]).nodes[0];
            node.aabb.min = Vec3A::NEG_ONE;
            node.aabb.max = Vec3A::ONE;
            (node.prim_count, node.first_index) = (prim_count, first_index);
            node
        };
        let mut chain = two_wide(&[Triangle::default()]);
        chain.primitive_indices = (0..count).collect();
        chain.nodes = vec![node(0, 1)];
        for triangle in 0..count - 1 {
            chain.nodes.push(node(1, triangle));
            chain.nodes.push(node(0, 2 * triangle + 3));
        }
        let last = chain.nodes.len() - 1;
        chain.nodes[last] = node(1, count - 1);
        let mut bvh = TriangleBvh {
            scale: 1.0,
            ..TriangleBvh::default()
        };
        let Ok(()) = bvh.add(&mesh, &chain, || Ok::<_, Infallible>(()));
        let rays: Vec<_> = (0..500)
            .map(|i| {
                let o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                Ray::endless(o, sampling::sphere(sampling::r2(i, [0.7; 2])))
            })
            .collect();
        let mut hits = vec![None; rays.len()];
        bvh.closest_of_packet(&rays, &mut hits);
        for (ray, hit) in rays.iter().zip(hits) {
            let expected = scan(&mesh, ray.origin, ray.direction);
            assert_eq!(hit.map(|h| h.t), expected);
            assert_eq!(hit, bvh.closest(ray));
        }
    }
}
