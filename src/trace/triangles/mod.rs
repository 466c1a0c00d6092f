//! Watertight ray casting (Woop, Benthin & Wald 2013): triangles four at a time, in a hierarchy
//! eight wide.
//!
//! `build` makes the nodes from the top down, `split` finds where triangles part; `slab_ray` is the
//! test of a ray against boxes, `packet` the way of rays that go much the same way, `instances`
//! finds meshes that are placed many times, `masked` is what else scenes with masks need, and
//! `packed` is how the hierarchy lies in a packed scene. The crate `obvhs` builds and walks
//! hierarchies, too, but slower (`cargo bench --bench rays`), leaks at edges that triangles share,
//! and takes a time that is quadratic in triangles at one place.

mod build;
mod instances;
mod masked;
mod packed;
mod packet;
mod slab_ray;
mod split;

use super::watertight::{Block, LANES, ShearedRay, VertexBlock};
use crate::column::Column;
use crate::math::{Hit, Ray};
use crate::scene::{Masks, Mesh, Scene};
use glam::Vec3;
use instances::InstanceBvh;
use slab_ray::{SlabRay, Stack};
use std::borrow::Borrow;
use std::ops::Range;
use wide::f32x8;

/// All triangles of a mesh, ready for rays.
#[derive(Debug, Default)]
pub struct TriangleBvh<'a> {
    nodes: Column<Node>,
    blocks: Blocks,
    /// Of the mesh.
    positions: &'a [Vec3],
    /// Boxes and blocks are this many times larger than the mesh: a power of two, so that it
    /// changes no digit, and so large or small that no product of coordinates leaves the range of
    /// f32.
    scale: f32,
    /// Where triangles are there; `None` if all are everywhere.
    masks: Option<Masks<'a>>,
    /// What stands among the triangles, behind all of them in number.
    instances: Option<Box<InstanceBvh<'a>>>,
}

/// The triangles of leaves.
#[derive(Debug)]
enum Blocks {
    Corners(Column<Block>),
    /// Of large meshes: less memory, and more time for each ray.
    Vertices(Column<VertexBlock>),
}

impl Default for Blocks {
    fn default() -> Self {
        Self::Corners(Column::new())
    }
}

impl Blocks {
    fn len(&self) -> usize {
        match self {
            Self::Corners(blocks) => blocks.len(),
            Self::Vertices(blocks) => blocks.len(),
        }
    }
}

/// Gives blocks with their corners.
trait Corners {
    /// The blocks of a leaf.
    fn of_leaf(&self, leaf: Range<usize>) -> impl Iterator<Item = impl Borrow<Block>>;
}

impl Corners for &[Block] {
    #[inline(always)]
    fn of_leaf(&self, leaf: Range<usize>) -> impl Iterator<Item = impl Borrow<Block>> {
        self[leaf].iter()
    }
}

/// Blocks that know their vertices.
struct ByVertex<'a> {
    blocks: &'a [VertexBlock],
    /// Of all vertices.
    coordinates: &'a [f32],
    scale: f32,
}

impl Corners for ByVertex<'_> {
    #[inline(always)]
    fn of_leaf(&self, leaf: Range<usize>) -> impl Iterator<Item = impl Borrow<Block>> {
        let blocks = self.blocks[leaf].iter();
        blocks.map(|block| block.with_corners(self.coordinates, self.scale))
    }
}

/// Children of a node.
const WIDTH: usize = 8;

/// Boxes of up to eight children, by plane: lower x, y, z, upper x, y, z. Those of absent ones end
/// before they begin.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
struct Node {
    planes: [f32x8; 6],
    children: [Child; WIDTH],
}

/// A node, or up to 16 blocks that follow each other.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(transparent)]
struct Child(u32);

impl Child {
    const LEAF: u32 = 1 << 31;
    const COUNT_SHIFT: u32 = 27;
    const MAX_BLOCKS: usize = 16;

    fn node(index: usize) -> Self {
        Self(index as u32)
    }

    /// The same child where so many nodes stand before those that it was counted among, of which
    /// the first is nobody's child.
    fn behind(self, nodes: usize) -> Self {
        if self.is_leaf() || self == Self::default() {
            self
        } else {
            Self(self.0 + nodes as u32)
        }
    }

    /// A leaf of at least one block and at most [`Self::MAX_BLOCKS`]. There are no more blocks
    /// than triangles, and of those no scene has more than the bits of `first` tell,
    /// [`Mesh::MAX_TRIANGLES`].
    fn leaf(first: usize, count: usize) -> Self {
        const { assert!(Mesh::MAX_TRIANGLES <= 1 << Self::COUNT_SHIFT) };
        Self(Self::LEAF | (count as u32 - 1) << Self::COUNT_SHIFT | first as u32)
    }

    #[inline]
    fn is_leaf(self) -> bool {
        self.0 & Self::LEAF != 0
    }

    /// Blocks of a leaf.
    #[inline]
    fn blocks(self) -> Range<usize> {
        let first = self.0 as usize & ((1 << Self::COUNT_SHIFT) - 1);
        first..first + 1 + (self.0 >> Self::COUNT_SHIFT) as usize % Self::MAX_BLOCKS
    }
}

impl TriangleBvh<'_> {
    /// Bytes that it takes of so many triangles, about, while it is made: blocks are seldom full,
    /// and a node has about as many children as there are triangles in five blocks.
    #[must_use]
    pub fn bytes_for(triangles: usize) -> u64 {
        let block = (size_of::<Block>() / LANES) as u64;
        let node = (size_of::<Node>() / (5 * LANES)) as u64;
        triangles as u64 * (block + block / 8 + node)
    }

    /// Bytes that finding so many instances takes, about: a box as a triangle has one, and a map.
    #[must_use]
    pub fn bytes_for_places(instances: usize) -> u64 {
        Self::bytes_for(instances) + (instances * InstanceBvh::PLACE_BYTES) as u64
    }

    /// The nearest hit along a ray; of triangles at the same distance the first of the mesh.
    #[must_use]
    pub fn closest(&self, ray: &Ray) -> Option<Hit> {
        if let Some(masks) = &self.masks {
            return self.closest_there(ray, masks);
        }
        if self.instances.is_some() {
            return self.closest_there(ray, &Whole);
        }
        match &self.blocks {
            Blocks::Corners(blocks) => self.closest_of(&&blocks[..], ray, &Whole).hit(self.scale),
            Blocks::Vertices(blocks) => self.closest_by_vertex(blocks, ray),
        }
    }

    /// The nearest hit along a ray of a camera: of triangles that cameras see in a scene.
    #[must_use]
    pub fn closest_seen(&self, ray: &Ray, scene: &Scene) -> Option<Hit> {
        let hit = self.closest(ray)?;
        if is_seen(scene, scene.mesh.stored(hit.triangle as usize)) {
            return Some(hit);
        }
        match &self.masks {
            Some(masks) => self.closest_there(
                ray,
                &Seen {
                    scene,
                    there: masks,
                },
            ),
            None => self.closest_there(
                ray,
                &Seen {
                    scene,
                    there: &Whole,
                },
            ),
        }
    }

    /// The nearest hit along a ray, where triangles are there.
    #[inline(never)]
    fn closest_where(&self, ray: &Ray, there: &impl There) -> Nearest {
        match &self.blocks {
            Blocks::Corners(blocks) => self.closest_of(&&blocks[..], ray, there),
            Blocks::Vertices(blocks) => self.closest_of(&self.by_vertex(blocks), ray, there),
        }
    }

    /// Whether a ray meets any triangle.
    #[must_use]
    pub fn is_occluded(&self, ray: &Ray) -> bool {
        if let Some(masks) = &self.masks {
            return self.is_occluded_masked(masks, ray) || self.is_among(ray);
        }
        if self.instances.is_some() {
            return self.is_occluded_whole(ray) || self.is_among(ray);
        }
        match &self.blocks {
            Blocks::Corners(blocks) => self.is_occluded_by(&&blocks[..], ray, &Whole),
            Blocks::Vertices(blocks) => self.is_occluded_by_vertex(blocks, ray),
        }
    }

    // Apart, so that what small meshes need is compiled as if there were nothing else.
    #[inline(never)]
    fn closest_by_vertex(&self, blocks: &[VertexBlock], ray: &Ray) -> Option<Hit> {
        self.closest_of(&self.by_vertex(blocks), ray, &Whole)
            .hit(self.scale)
    }

    #[inline(never)]
    fn is_occluded_by_vertex(&self, blocks: &[VertexBlock], ray: &Ray) -> bool {
        self.is_occluded_by(&self.by_vertex(blocks), ray, &Whole)
    }

    fn by_vertex<'b>(&'b self, blocks: &'b [VertexBlock]) -> ByVertex<'b> {
        ByVertex {
            blocks,
            coordinates: bytemuck::cast_slice(self.positions),
            scale: self.scale,
        }
    }

    #[inline(always)]
    fn closest_of(&self, blocks: &impl Corners, ray: &Ray, there: &impl There) -> Nearest {
        let ray = self.scaled(ray);
        let mut nearest = Nearest::new(ray.t_max);
        self.visit(blocks, &ray, |block, sheared, t_end| {
            nearest.meet(block, sheared, there);
            *t_end = nearest.t_end;
            true
        });
        nearest
    }

    #[inline(always)]
    fn is_occluded_by(&self, blocks: &impl Corners, ray: &Ray, there: &impl There) -> bool {
        let ray = self.scaled(ray);
        let mut hit = false;
        self.visit(blocks, &ray, |block, sheared, _| {
            let met = sheared.meet(block);
            hit = (0..LANES).any(|k| {
                met.lanes >> k & 1 == 1
                    && met.t[k] < ray.t_max
                    && there.is_there(block.triangles[k], met.uv.map(|w| w[k]), met.t[k])
            });
            !hit
        });
        hit
    }

    /// A ray in the scale of the hierarchy.
    #[inline(always)]
    fn scaled(&self, ray: &Ray) -> Ray {
        Ray {
            origin: ray.origin * self.scale,
            direction: ray.direction,
            t_max: ray.t_max * self.scale,
        }
    }

    /// Gives `visit` the blocks along a ray in the scale of the hierarchy, the nearest first, while
    /// it says so. It may shorten the ray.
    #[inline]
    fn visit(
        &self,
        blocks: &impl Corners,
        ray: &Ray,
        mut visit: impl FnMut(&Block, &ShearedRay, &mut f32) -> bool,
    ) {
        if self.nodes.is_empty() {
            return;
        }
        let slabs = SlabRay::new(ray);
        let sheared = ShearedRay::new(ray);
        self.visit_from(blocks, Child::node(0), &slabs, ray.t_max, |block, t_end| {
            visit(block, &sheared, t_end)
        });
    }

    /// Gives `visit` the blocks along a ray that are below a child, as [`Self::visit`] does.
    #[inline(always)]
    fn visit_from(
        &self,
        blocks: &impl Corners,
        mut child: Child,
        ray: &SlabRay,
        mut t_end: f32,
        mut visit: impl FnMut(&Block, &mut f32) -> bool,
    ) {
        let nodes = &self.nodes[..];
        let mut stack = Stack::new();
        loop {
            if child.is_leaf() {
                for block in blocks.of_leaf(child.blocks()) {
                    if !visit(block.borrow(), &mut t_end) {
                        return;
                    }
                }
            } else if let Some(next) = ray.enter(&nodes[child.0 as usize], t_end, &mut stack) {
                child = next;
                continue;
            }
            child = loop {
                match stack.pop() {
                    Some((near, child)) if near <= t_end * SlabRay::ROUNDING => break child,
                    Some(_) => {}
                    None => return,
                }
            };
        }
    }
}

/// Whether triangles are there where rays meet them, as a type: code for scenes without masks does
/// no work for any.
trait There {
    /// Whether a triangle is there at barycentric weights of its second and third corner, where a
    /// ray meets it that has come so far.
    fn is_there(&self, triangle: u32, uv: [f32; 2], t: f32) -> bool;
}

/// Triangles that are there everywhere.
struct Whole;

impl There for Whole {
    #[inline(always)]
    fn is_there(&self, _: u32, _: [f32; 2], _: f32) -> bool {
        true
    }
}

impl There for Masks<'_> {
    #[inline]
    fn is_there(&self, triangle: u32, uv: [f32; 2], _: f32) -> bool {
        !self.is_clear(triangle, uv)
    }
}

/// Triangles that cameras see.
struct Seen<'a, T> {
    scene: &'a Scene,
    there: &'a T,
}

impl<T: There> There for Seen<'_, T> {
    #[inline]
    fn is_there(&self, triangle: u32, uv: [f32; 2], t: f32) -> bool {
        is_seen(self.scene, triangle as usize) && self.there.is_there(triangle, uv, t)
    }
}

/// Whether cameras see a triangle, by its place among those that are stored.
fn is_seen(scene: &Scene, stored: usize) -> bool {
    let material = scene.mesh.material[stored];
    scene.materials[material as usize].is_seen
}

/// The nearest hit of a ray so far, in the scale of the hierarchy.
struct Nearest {
    t_max: f32,
    /// Distance at which the ray ends: at the hit, or at `t_max`.
    t_end: f32,
    best: Option<Hit>,
}

impl Nearest {
    fn new(t_max: f32) -> Self {
        Self {
            t_max,
            t_end: t_max,
            best: None,
        }
    }

    /// Takes the nearest of a block's hits if it is nearer, or as near and of a triangle that comes
    /// before.
    #[inline(always)]
    fn meet(&mut self, block: &Block, sheared: &ShearedRay, there: &impl There) {
        let met = sheared.meet(block);
        let mut lanes = met.lanes;
        while lanes != 0 {
            let k = lanes.trailing_zeros() as usize;
            lanes &= lanes - 1;
            let (t, triangle) = (met.t[k], block.triangles[k]);
            let first = self
                .best
                .is_none_or(|b| t < b.t || (t == b.t && triangle < b.triangle));
            if t < self.t_max && first {
                let uv = met.uv.map(|w| w[k]);
                if !there.is_there(triangle, uv, t) {
                    continue;
                }
                self.t_end = t;
                self.best = Some(Hit {
                    t,
                    triangle,
                    uv,
                    is_back: met.backs >> k & 1 == 1,
                });
            }
        }
    }

    /// The hit in units of the mesh.
    fn hit(&self, scale: f32) -> Option<Hit> {
        self.best.map(|hit| Hit {
            t: hit.t / scale,
            ..hit
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::run::Cancel;
    use glam::Vec3;

    /// A closed sphere of shared vertices.
    pub fn sphere(rings: u32, segments: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for r in 0..=rings {
            let (sin, cos) = sampling::sin_cos_turns(0.5 * r as f32 / rings as f32);
            for s in 0..segments {
                let (y, x) = sampling::sin_cos_turns(s as f32 / segments as f32);
                mesh.positions.push(Vec3::new(sin * x, sin * y, cos));
            }
        }
        for r in 0..rings {
            for s in 0..segments {
                let at = |r: u32, s: u32| {
                    // The poles are one vertex each.
                    if r == 0 {
                        0
                    } else if r == rings {
                        rings * segments
                    } else {
                        r * segments + s % segments
                    }
                };
                let (a, b, c, d) = (at(r, s), at(r, s + 1), at(r + 1, s), at(r + 1, s + 1));
                mesh.triangles.extend(
                    [[a, c, d], [a, d, b]]
                        .iter()
                        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[0] != t[2]),
                );
            }
        }
        mesh.material = vec![0; mesh.triangles.len()].into();
        mesh
    }

    /// Distance to the nearest of all triangles, each on its own.
    pub fn scan(mesh: &Mesh, origin: Vec3, direction: Vec3) -> Option<f32> {
        let ray = ShearedRay::new(&Ray::endless(origin, direction));
        (0..mesh.triangles.len() as u32)
            .map(|t| ray.meet(&Block::new(mesh, &[t], 1.0)))
            .filter(|met| met.lanes == 1)
            .map(|met| met.t[0])
            .min_by(f32::total_cmp)
    }

    #[test]
    fn nothing_escapes_from_a_closed_mesh_not_even_through_its_edges() {
        let mesh = sphere(40, 64);
        let bvh = TriangleBvh::new(&mesh);
        let origin = Vec3::new(0.1, 0.03, -0.2);
        for i in 0..100_000 {
            let d = sampling::sphere(sampling::r2(i, [0.0; 2]));
            assert!(bvh.closest(&Ray::endless(origin, d)).is_some());
            assert!(bvh.is_occluded(&Ray::new(origin, d, 10.0)));
        }
        for (i, t) in mesh.triangles.iter().enumerate() {
            for e in 0..3 {
                let (a, b) = (
                    mesh.positions[t[e] as usize],
                    mesh.positions[t[(e + 1) % 3] as usize],
                );
                for k in 0..8 {
                    let u = sampling::unit(sampling::hash(&[i as u64, e as u64, k]));
                    let d = (a + (b - a) * u - origin).normalize();
                    assert!(
                        bvh.closest(&Ray::endless(origin, d)).is_some(),
                        "edge of triangle {i}"
                    );
                }
            }
        }
    }

    #[test]
    fn hits_agree_with_a_linear_scan_and_axis_directions_hit() {
        let mesh = sphere(12, 20);
        let bvh = TriangleBvh::new(&mesh);
        for i in 0..2000 {
            let o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
            let d = sampling::sphere(sampling::r2(i, [0.7; 2]));
            let scan = scan(&mesh, o, d);
            assert_eq!(bvh.closest(&Ray::endless(o, d)).map(|h| h.t), scan);
        }
        for d in [
            Vec3::new(-0.0, -1.0, -0.0),
            Vec3::new(0.0, 1.0, -0.0),
            Vec3::new(-1.0, -0.0, 0.0),
        ] {
            assert!(
                bvh.closest(&Ray::endless(Vec3::new(0.01, 0.02, 0.03), d))
                    .is_some(),
                "{d}"
            );
        }
    }

    #[test]
    fn hits_scale_with_the_mesh_and_near_ones_are_not_missed() {
        let mesh = sphere(12, 20);
        let bvh = TriangleBvh::new(&mesh);
        for exponent in [-40, -20, 20, 40] {
            let scale = libm::ldexpf(1.0, exponent);
            let mut scaled = mesh.clone();
            scaled.positions.iter_mut().for_each(|p| *p *= scale);
            let scaled = TriangleBvh::new(&scaled);
            for i in 0..2000 {
                // Half of the origins are within 1e-5 of the surface, outside or inside.
                let mut o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let d = sampling::sphere(sampling::r2(i, [0.7; 2]));
                if i % 2 == 0 {
                    let Some(hit) = bvh.closest(&Ray::endless(o, -o.normalize())) else {
                        panic!("the middle is inside")
                    };
                    o -= o.normalize() * (hit.t - 1e-5 * (i % 5) as f32 + 2e-5);
                }
                let hit = bvh.closest(&Ray::endless(o, d));
                let scan = scan(&mesh, o, d);
                assert_eq!(hit.map(|h| h.t), scan);
                let far = scaled.closest(&Ray::endless(o * scale, d));
                assert_eq!(far.map(|h| h.t), hit.map(|h| h.t * scale));
                assert_eq!(
                    scaled.is_occluded(&Ray::endless(o * scale, d)),
                    hit.is_some()
                );
            }
        }
    }

    #[test]
    fn an_empty_mesh_is_never_hit() {
        let mesh = Mesh::default();
        let bvh = TriangleBvh::new_until(&mesh, &Cancel::default()).unwrap();
        assert!(bvh.closest(&Ray::endless(Vec3::ZERO, Vec3::Z)).is_none());
        assert!(!bvh.is_occluded(&Ray::endless(Vec3::ZERO, Vec3::Z)));
        let stale = Hit {
            t: 1.0,
            triangle: 0,
            uv: [0.0; 2],
            is_back: false,
        };
        let mut hits = [Some(stale)];
        bvh.closest_of_packet(&[Ray::endless(Vec3::ZERO, Vec3::Z)], &mut hits);
        assert_eq!(hits, [None]);
    }
}
