//! Rays that go much the same way, traced together: they share what they visit (Wald, Slusallek,
//! Benthin & Wagner 2001).

use super::slab_ray::{SlabRay, Stack, push_sorted};
use super::{Blocks, Child, Corners, Nearest, There, TriangleBvh, Whole};
use crate::math::{Hit, Ray};
use crate::scene::Masks;
use crate::trace::watertight::{ShearedRay, VertexBlock};
use arrayvec::ArrayVec;
use std::borrow::Borrow;
use wide::f32x8;

/// Rays of a packet, at most.
pub(super) const PACKET: usize = 64;

/// Number of active rays of a packet at or below which they go on by themselves.
pub(super) const MIN_RAYS_TOGETHER: u32 = 2;

/// The rays of a packet, one bit each.
type Mask = u64;

/// A ray of a packet.
pub(super) struct Member {
    slabs: SlabRay,
    sheared: ShearedRay,
    nearest: Nearest,
}

impl TriangleBvh<'_> {
    /// Finds what [`Self::closest`] does for each ray of a packet, to the bit, without instances,
    /// where triangles are there by these masks.
    pub(super) fn closest_of_own_packet(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>],
        masks: Option<&Masks>,
    ) {
        if self.nodes.is_empty() {
            hits.fill(None);
            return;
        }
        for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
            let mut packet: ArrayVec<Member, PACKET> = ArrayVec::new();
            packet.extend(rays.iter().map(|ray| {
                let ray = self.scaled(ray);
                Member {
                    slabs: SlabRay::new(&ray),
                    sheared: ShearedRay::new(&ray),
                    nearest: Nearest::new(ray.t_max),
                }
            }));
            match (masks, &self.blocks) {
                (Some(masks), _) => self.trace_masked(masks, &mut packet),
                (None, Blocks::Corners(blocks)) => self.trace(&&blocks[..], &mut packet, &Whole),
                (None, Blocks::Vertices(blocks)) => self.trace_by_vertex(blocks, &mut packet),
            }
            for (hit, member) in hits.iter_mut().zip(&packet) {
                *hit = member.nearest.hit(self.scale);
            }
        }
    }

    #[inline(never)]
    fn trace_by_vertex(&self, blocks: &[VertexBlock], packet: &mut [Member]) {
        self.trace(&self.by_vertex(blocks), packet, &Whole);
    }

    /// Finds the nearest hit of each ray of a packet.
    #[inline(always)]
    pub(super) fn trace(&self, blocks: &impl Corners, packet: &mut [Member], there: &impl There) {
        let nodes = &self.nodes[..];
        // With the least distance at which one of the rays enters.
        let mut stack: Stack<(Child, Mask)> = Stack::new();
        stack.push((0.0, (Child::node(0), Mask::MAX >> (PACKET - packet.len()))));
        // Rays that ended before what is visited are not told apart here: boxes and triangles do
        // that for all, and to look costs more than it saves.
        while let Some((_, (child, active))) = stack.pop() {
            if active.count_ones() <= MIN_RAYS_TOGETHER {
                for k in members(active) {
                    let Member {
                        slabs,
                        sheared,
                        nearest,
                    } = &mut packet[k];
                    let t_end = nearest.t_end;
                    self.visit_from(blocks, child, slabs, t_end, |block, t_end| {
                        nearest.meet(block, sheared, there);
                        *t_end = nearest.t_end;
                        true
                    });
                }
            } else if child.is_leaf() {
                for block in blocks.of_leaf(child.blocks()) {
                    for k in members(active) {
                        let Member {
                            sheared, nearest, ..
                        } = &mut packet[k];
                        nearest.meet(block.borrow(), sheared, there);
                    }
                }
            } else {
                let node = &nodes[child.0 as usize];
                let mut nears = f32x8::splat(f32::INFINITY);
                let mut any = f32x8::ZERO;
                let mut masks = [f32x8::ZERO; 2];
                for k in members(active) {
                    let Member { slabs, nearest, .. } = &packet[k];
                    let (near, met) = slabs.meet(node, nearest.t_end);
                    any |= met;
                    nears = nears.fast_min(met.select(near, nears));
                    masks[k / 32] |= met & f32x8::splat(f32::from_bits(1 << (k % 32)));
                }
                let nears = nears.to_array();
                let [low, high] = masks.map(|m| m.to_array().map(f32::to_bits));
                let below = stack.len();
                for k in members(any.to_bitmask().into()) {
                    let mask = Mask::from(low[k]) | Mask::from(high[k]) << 32;
                    push_sorted(&mut stack, below, (nears[k], (node.children[k], mask)));
                }
            }
        }
    }
}

/// Iterates over the rays that a mask has.
#[inline(always)]
pub(super) fn members(mut mask: Mask) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        (mask != 0).then(|| {
            let k = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            k
        })
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::sphere;
    use super::*;
    use crate::math::sampling;
    use crate::scene::Mesh;
    use glam::Vec3;

    /// A sphere with each of its triangles twice, so that all hits are met by two.
    fn doubled() -> Mesh {
        let mut mesh = sphere(24, 40);
        mesh.triangles = mesh.triangles.repeat(2).into();
        mesh.material = vec![0; mesh.triangles.len()].into();
        mesh
    }

    #[test]
    fn a_packet_meets_what_its_rays_meet_alone() {
        let mesh = doubled();
        let bvh = TriangleBvh::new(&mesh);
        let mut met = [0, 0];
        // From rays side by side to rays of all directions; in packets that are full, and in what
        // is left over.
        for spread in [0.0, 0.01, 0.3, 3.0] {
            for (case, count) in (0..400).zip([1, 2, 3, 16, 63, 64, 65, 200].into_iter().cycle()) {
                let origin = 2.0 * sampling::sphere(sampling::r2(case, [0.3; 2]));
                let toward = 1.3 * sampling::sphere(sampling::r2(case, [0.7; 2])) - origin;
                let rays: Vec<_> = (0..count)
                    .map(|i| {
                        let apart = sampling::sphere(sampling::r2(case * 256 + i, [0.5; 2]));
                        let direction = (toward.normalize() + spread * apart).normalize();
                        Ray::endless(origin + 0.1 * spread * apart, direction)
                    })
                    .collect();
                for t_max in [f32::INFINITY, 1.5] {
                    let rays: Vec<_> = rays.iter().map(|r| r.up_to(t_max)).collect();
                    let mut hits = vec![None; rays.len()];
                    bvh.closest_of_packet(&rays, &mut hits);
                    for (ray, &hit) in rays.iter().zip(&hits) {
                        assert_eq!(hit, bvh.closest(ray));
                        met[usize::from(hit.is_some())] += 1;
                    }
                }
            }
        }
        assert!(met.into_iter().min() > Some(5000), "{met:?}");
    }

    /// To the bit, alone and in packets.
    #[test]
    fn blocks_by_vertex_meet_what_blocks_of_corners_meet() {
        let mut mesh = doubled();
        mesh.positions.iter_mut().for_each(|p| *p *= 3e4);
        let built = |by_vertex| {
            let all = 0..mesh.triangles.len() as u32;
            TriangleBvh::over(&mesh, all, by_vertex, || Ok::<_, ()>(())).unwrap()
        };
        let [corners, vertices] = [false, true].map(built);
        assert!(matches!(vertices.blocks, Blocks::Vertices(_)));
        assert_eq!(corners.blocks.len(), vertices.blocks.len());
        let mut met = 0;
        for case in 0..200 {
            let origin = 6e4 * sampling::sphere(sampling::r2(case, [0.3; 2]));
            let rays: Vec<_> = (0..70)
                .map(|i| {
                    let to = 3e4 * sampling::sphere(sampling::r2(case * 70 + i, [0.7; 2]));
                    let t_max = if i % 3 == 0 { 5e4 } else { f32::INFINITY };
                    Ray::new(origin, (to - origin).normalize(), t_max)
                })
                .collect();
            let mut hits = [vec![None; rays.len()], vec![None; rays.len()]];
            corners.closest_of_packet(&rays, &mut hits[0]);
            vertices.closest_of_packet(&rays, &mut hits[1]);
            for (i, ray) in rays.iter().enumerate() {
                let hit = corners.closest(ray);
                assert_eq!([hit; 3], [vertices.closest(ray), hits[0][i], hits[1][i]]);
                assert_eq!(hit.is_some(), vertices.is_occluded(ray));
                met += usize::from(hit.is_some());
            }
        }
        assert!(met > 5000, "{met}");
    }

    #[test]
    fn a_packet_of_rays_along_axes_and_edges_meets_what_they_meet_alone() {
        let mesh = doubled();
        let bvh = TriangleBvh::new(&mesh);
        let axes = [Vec3::X, Vec3::Y, Vec3::Z];
        let toward = axes.into_iter().flat_map(|a| [a, -a]);
        let corners = mesh.positions.iter().map(|p| p.normalize());
        let rays: Vec<_> = toward
            .chain(corners)
            .map(|d| Ray::endless(Vec3::ZERO, d))
            .collect();
        let mut hits = vec![None; rays.len()];
        bvh.closest_of_packet(&rays, &mut hits);
        for (ray, &hit) in rays.iter().zip(&hits) {
            assert!(hit.is_some(), "{}", ray.direction);
            assert_eq!(hit, bvh.closest(ray));
        }
    }
}
