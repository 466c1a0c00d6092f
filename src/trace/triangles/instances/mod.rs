//! Meshes that are kept once and placed many times: a hierarchy over the boxes of their places, and
//! one over the triangles of each, in which rays go on in its own space.

use super::packet::{MIN_RAYS_TOGETHER, PACKET, members};
use super::slab_ray::{SlabRay, Stack, push_sorted};
use super::{Blocks, Child, There, TriangleBvh, Whole};
use crate::math::{Aabb, Hit, Ray};
use crate::scene::{Instance, Instances, Masks, Mesh};
use crate::trace::watertight::{Block, LANES};
use arrayvec::ArrayVec;
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;

/// What finds instances along rays.
#[derive(Debug)]
pub(super) struct InstanceBvh<'a> {
    /// Over the triangles of each prototype, by their places among all that are stored.
    prototypes: Vec<TriangleBvh<'a>>,
    /// Over boxes: each is a triangle, of which two corners are its ends.
    places: TriangleBvh<'static>,
    /// By instance.
    inverse: Vec<Inverse>,
}

/// How a ray gets into the space of an instance.
#[derive(Clone, Copy, Debug)]
struct Inverse {
    prototype_from_scene: DAffine3,
    prototype: u32,
    /// What the numbers of its triangles are more than their places, modulo 2^32.
    step: u32,
    is_mirrored: bool,
}

impl Inverse {
    fn new(instance: &Instance, instances: &Instances) -> Self {
        Self {
            prototype_from_scene: instance.scene_from_prototype.inverse(),
            prototype: instance.prototype,
            step: (instance.first).wrapping_sub(instances.stored(instance).start),
            is_mirrored: instance.is_mirrored(),
        }
    }

    /// The ray in the space of the prototype, up to `t_max`: its direction is as much longer or
    /// shorter as all is there, so that distances are those of the scene.
    #[inline]
    fn ray(&self, origin: DVec3, direction: DVec3, t_max: f32) -> Ray {
        let map = &self.prototype_from_scene;
        Ray {
            origin: map.transform_point3(origin).as_vec3(),
            direction: map.transform_vector3(direction).as_vec3(),
            t_max,
        }
    }

    /// A hit as the scene has it.
    #[inline]
    fn hit(&self, hit: Hit) -> Hit {
        let [u, v] = hit.uv;
        Hit {
            triangle: hit.triangle.wrapping_add(self.step),
            uv: if self.is_mirrored { [v, u] } else { [u, v] },
            ..hit
        }
    }
}

/// A ray as it is asked for the boxes of instances, in the scale of the hierarchy over these.
struct Asker {
    slabs: SlabRay,
    origin: DVec3,
    direction: DVec3,
}

/// Whether a hit comes before another: nearer, or as near and of a triangle that comes before.
#[inline]
fn is_before(hit: &Hit, other: Option<&Hit>) -> bool {
    other.is_none_or(|o| hit.t < o.t || (hit.t == o.t && hit.triangle < o.triangle))
}

impl<'a> InstanceBvh<'a> {
    /// Bytes of a place beside its box.
    pub const PLACE_BYTES: usize = size_of::<Inverse>();

    /// What finds the instances of a mesh, by the hierarchies over its prototypes; `None` without
    /// any.
    pub fn new(mesh: &'a Mesh, prototypes: Vec<TriangleBvh<'a>>) -> Option<Self> {
        let instances = &mesh.instances;
        if instances.list().is_empty() {
            return None;
        }
        let list = instances.list().par_iter();
        Some(Self {
            prototypes,
            places: TriangleBvh::over_boxes(instances.list().iter().map(|i| i.bounds)),
            inverse: list.map(|i| Inverse::new(i, instances)).collect(),
        })
    }

    /// The hierarchies over the triangles of prototypes.
    pub fn prototypes(&self) -> &[TriangleBvh<'a>] {
        &self.prototypes
    }

    fn asker(&self, ray: &Ray) -> Asker {
        Asker {
            slabs: SlabRay::new(&self.places.scaled(ray)),
            origin: ray.origin.as_dvec3(),
            direction: ray.direction.as_dvec3(),
        }
    }

    fn boxes(&self) -> &[Block] {
        match &self.places.blocks {
            Blocks::Corners(blocks) => blocks,
            Blocks::Vertices(_) => &[],
        }
    }

    /// Gives `visit` the instances whose boxes a ray enters, below a child, the nearest first as
    /// boxes go, and how far the ray goes, scene units; it returns how far that is from then on.
    #[inline]
    fn visit_from(
        &self,
        child: Child,
        asker: &Asker,
        t_end: f32,
        mut visit: impl FnMut(u32, f32) -> Option<f32>,
    ) {
        let scale = self.places.scale;
        let t_end = t_end * scale;
        let boxes = &self.boxes();
        (self.places).visit_from(boxes, child, &asker.slabs, t_end, |block, t_end| {
            let (near, mut met) = asker.slabs.meet_boxes(block, *t_end);
            // In the order in which they are entered: what the first hides need not be looked at.
            while met != 0 {
                let mut first = met.trailing_zeros() as usize;
                for k in first + 1..LANES {
                    if met >> k & 1 == 1 && near[k] < near[first] {
                        first = k;
                    }
                }
                met &= !(1 << first);
                if near[first] <= *t_end * SlabRay::ROUNDING {
                    match visit(block.triangles[first], *t_end / scale) {
                        Some(t) => *t_end = t * scale,
                        None => return false,
                    }
                }
            }
            true
        });
    }

    /// The nearest hit of a ray, where `best` is that with what is no instance; `trace` finds that
    /// with a prototype in its space.
    pub fn closest(
        &self,
        ray: &Ray,
        best: Option<Hit>,
        mut trace: impl FnMut(&TriangleBvh, &Ray) -> Option<Hit>,
    ) -> Option<Hit> {
        let mut best = best;
        let t_end = best.map_or(ray.t_max, |hit| hit.t);
        let asker = self.asker(ray);
        self.visit_from(Child::node(0), &asker, t_end, |i, _| {
            self.meet(i, &asker, ray.t_max, &mut best, &mut trace);
            Some(best.map_or(ray.t_max, |hit| hit.t))
        });
        best
    }

    /// Takes the hit with an instance if it comes before the best.
    #[inline]
    fn meet(
        &self,
        instance: u32,
        asker: &Asker,
        t_max: f32,
        best: &mut Option<Hit>,
        trace: &mut impl FnMut(&TriangleBvh, &Ray) -> Option<Hit>,
    ) {
        let inverse = &self.inverse[instance as usize];
        // What is as far as the best counts, too, if its triangle comes before.
        let t_max = best.as_ref().map_or(t_max, |b| b.t.next_up().min(t_max));
        let ray = inverse.ray(asker.origin, asker.direction, t_max);
        let hit = trace(&self.prototypes[inverse.prototype as usize], &ray);
        if let Some(hit) = hit.map(|hit| inverse.hit(hit))
            && is_before(&hit, best.as_ref())
        {
            *best = Some(hit);
        }
    }

    /// Gives `visit` each prototype whose box a ray enters, and the ray in its space, while it says
    /// so.
    pub fn visit(&self, ray: &Ray, mut visit: impl FnMut(&TriangleBvh, &Ray) -> bool) {
        let asker = self.asker(ray);
        self.visit_from(Child::node(0), &asker, ray.t_max, |i, t_end| {
            let inverse = &self.inverse[i as usize];
            let local = inverse.ray(asker.origin, asker.direction, ray.t_max);
            visit(&self.prototypes[inverse.prototype as usize], &local).then_some(t_end)
        });
    }

    /// Finds what [`Self::closest`] does for each ray of a packet; `trace` does for the rays in the
    /// space of a prototype what that does for one.
    pub fn closest_of_packet(
        &self,
        rays: &[Ray],
        hits: &mut [Option<Hit>],
        mut alone: impl FnMut(&TriangleBvh, &Ray) -> Option<Hit>,
        mut together: impl FnMut(&TriangleBvh, &[Ray], &mut [Option<Hit>]),
    ) {
        if self.places.nodes.is_empty() {
            return;
        }
        let askers: ArrayVec<Asker, PACKET> = rays.iter().map(|ray| self.asker(ray)).collect();
        let t_end = |k: usize, hits: &[Option<Hit>]| hits[k].map_or(rays[k].t_max, |h| h.t);
        let scale = self.places.scale;
        let mut stack: Stack<(Child, u64)> = Stack::new();
        stack.push((0.0, (Child::node(0), u64::MAX >> (PACKET - rays.len()))));
        while let Some((_, (child, active))) = stack.pop() {
            if active.count_ones() <= MIN_RAYS_TOGETHER {
                for k in members(active) {
                    let (asker, t_max) = (&askers[k], rays[k].t_max);
                    let best = &mut hits[k];
                    let t_end = best.map_or(t_max, |hit| hit.t);
                    self.visit_from(child, asker, t_end, |i, _| {
                        self.meet(i, asker, t_max, best, &mut alone);
                        Some(best.map_or(t_max, |hit| hit.t))
                    });
                }
            } else if child.is_leaf() {
                for block in &self.boxes()[child.blocks()] {
                    let mut met = [0_u64; LANES];
                    let mut nears = [f32::INFINITY; LANES];
                    for k in members(active) {
                        let (near, lanes) =
                            askers[k].slabs.meet_boxes(block, t_end(k, hits) * scale);
                        for lane in members(lanes.into()) {
                            met[lane] |= 1 << k;
                            nears[lane] = nears[lane].min(near[lane]);
                        }
                    }
                    let mut lanes = [0, 1, 2, 3];
                    lanes.sort_unstable_by(|&a, &b| nears[a].total_cmp(&nears[b]));
                    for lane in lanes.into_iter().filter(|&lane| met[lane] != 0) {
                        let instance = block.triangles[lane];
                        if met[lane].count_ones() <= MIN_RAYS_TOGETHER {
                            for k in members(met[lane]) {
                                let t_max = rays[k].t_max;
                                self.meet(instance, &askers[k], t_max, &mut hits[k], &mut alone);
                            }
                        } else {
                            let all = (rays, &askers[..]);
                            self.meet_together(instance, met[lane], all, hits, &mut together);
                        }
                    }
                }
            } else {
                let node = &self.places.nodes[child.0 as usize];
                let mut nears = [f32::INFINITY; super::WIDTH];
                let mut masks = [0_u64; super::WIDTH];
                for k in members(active) {
                    let (near, met) = askers[k].slabs.meet(node, t_end(k, hits) * scale);
                    let near = near.to_array();
                    for c in members(met.to_bitmask().into()) {
                        masks[c] |= 1 << k;
                        nears[c] = nears[c].min(near[c]);
                    }
                }
                let below = stack.len();
                for c in (0..super::WIDTH).filter(|&c| masks[c] != 0) {
                    push_sorted(&mut stack, below, (nears[c], (node.children[c], masks[c])));
                }
            }
        }
    }

    /// Takes for each of some rays the hit with an instance if it comes before the best.
    fn meet_together(
        &self,
        instance: u32,
        active: u64,
        (rays, askers): (&[Ray], &[Asker]),
        hits: &mut [Option<Hit>],
        together: &mut impl FnMut(&TriangleBvh, &[Ray], &mut [Option<Hit>]),
    ) {
        let inverse = &self.inverse[instance as usize];
        let local = members(active).map(|k| {
            let t_max = rays[k].t_max;
            let t_max = hits[k].map_or(t_max, |b| b.t.next_up().min(t_max));
            inverse.ray(askers[k].origin, askers[k].direction, t_max)
        });
        let local: ArrayVec<Ray, PACKET> = local.collect();
        let mut found = [None; PACKET];
        let found = &mut found[..local.len()];
        together(&self.prototypes[inverse.prototype as usize], &local, found);
        for (k, hit) in members(active).zip(found) {
            if let Some(hit) = hit.map(|hit| inverse.hit(hit))
                && is_before(&hit, hits[k].as_ref())
            {
                hits[k] = Some(hit);
            }
        }
    }
}

// Apart, so that what scenes without instances need is compiled as if there were nothing else.
impl TriangleBvh<'_> {
    /// Finds what [`Self::closest`] does for each ray of a packet, to the bit; `hits` has as many.
    /// Faster where rays that follow each other are near each other and go much the same way.
    pub fn closest_of_packet(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        if let Some(instances) = &self.instances {
            return self.closest_among_of_packet(instances, rays, hits);
        }
        self.closest_of_own_packet(rays, hits, self.masks.as_ref());
    }

    #[inline(never)]
    fn closest_among_of_packet(
        &self,
        instances: &InstanceBvh,
        rays: &[Ray],
        hits: &mut [Option<Hit>],
    ) {
        let masks = self.masks.as_ref();
        for (rays, hits) in rays.chunks(PACKET).zip(hits.chunks_mut(PACKET)) {
            self.closest_of_own_packet(rays, hits, masks);
            instances.closest_of_packet(
                rays,
                hits,
                |prototype, ray| prototype.closest_own(ray, masks),
                |prototype, rays, hits| prototype.closest_of_own_packet(rays, hits, masks),
            );
        }
    }

    /// The nearest hit along a ray, of instances, too, where triangles are there.
    #[inline(never)]
    pub(super) fn closest_there(&self, ray: &Ray, there: &impl There) -> Option<Hit> {
        let hit = self.closest_where(ray, there).hit(self.scale);
        match &self.instances {
            None => hit,
            Some(instances) => instances.closest(ray, hit, |prototype, ray| {
                prototype.closest_where(ray, there).hit(prototype.scale)
            }),
        }
    }

    /// The nearest hit along a ray, without instances, where triangles are there by these masks.
    pub(super) fn closest_own(&self, ray: &Ray, masks: Option<&Masks>) -> Option<Hit> {
        let nearest = match masks {
            Some(masks) => self.closest_where(ray, masks),
            None => self.closest_where(ray, &Whole),
        };
        nearest.hit(self.scale)
    }

    /// Whether a ray meets any instance.
    #[inline(never)]
    pub(super) fn is_among(&self, ray: &Ray) -> bool {
        let Some(instances) = &self.instances else {
            return false;
        };
        let mut is_met = false;
        instances.visit(ray, |prototype, ray| {
            is_met = match &self.masks {
                Some(masks) => prototype.is_occluded_masked(masks, ray),
                None => prototype.is_occluded_whole(ray),
            };
            !is_met
        });
        is_met
    }

    #[inline(never)]
    pub(super) fn is_occluded_whole(&self, ray: &Ray) -> bool {
        match &self.blocks {
            Blocks::Corners(blocks) => self.is_occluded_by(&&blocks[..], ray, &Whole),
            Blocks::Vertices(blocks) => self.is_occluded_by(&self.by_vertex(blocks), ray, &Whole),
        }
    }
}

impl TriangleBvh<'static> {
    /// The hierarchy over boxes: each is a triangle of which two corners are its ends, so that its
    /// box is the same.
    fn over_boxes(boxes: impl Iterator<Item = Aabb>) -> Self {
        let mut mesh = Mesh::default();
        for Aabb { min, max } in boxes {
            // As much as rounding on the way into the space of an instance can put beside its box.
            let margin = 4e-6 * (max - min).max_element()
                + 8.0 * f32::EPSILON * min.abs().max(max.abs()).max_element();
            let ends = [min - Vec3::splat(margin), max + Vec3::splat(margin)];
            let first = mesh.positions.len() as u32;
            mesh.positions.extend(ends);
            mesh.triangles.push([first, first + 1, first]);
        }
        Self::of_boxes(&mesh)
    }
}

#[cfg(test)]
mod tests;
