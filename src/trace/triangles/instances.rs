//! Meshes that are kept once and placed many times: a hierarchy over the boxes of their places, and
//! one over the triangles of each, in which rays go on in its own space.

use super::packet::{MIN_RAYS_TOGETHER, PACKET, members};
use super::slab_ray::{SlabRay, Stack, push_sorted};
use super::{Blocks, Child, TriangleBvh};
use crate::math::{Aabb, Hit, Ray};
use crate::scene::{Instance, Instances, Mesh};
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
mod tests {
    use super::super::tests::sphere;
    use super::*;
    use crate::math::sampling::{self, hash, unit};
    use crate::scene::{CameraInput, Mask, Material, MeshInput, Scene, SceneBuilder, Texture};
    use crate::trace::{Surface, Tracer, offset};
    use glam::{DMat3, Vec2};

    fn number(i: u64, k: u64) -> f64 {
        f64::from(unit(hash(&[i, k]))) - 0.5
    }

    /// A bumpy ball with normals and texture coordinates, of two materials, of which one has a mask if
    /// the scene has any.
    fn ball(is_masked: bool) -> MeshInput {
        let mesh = sphere(17, 23);
        let bump = |i: u64| 1.0 + 0.3 * unit(hash(&[i, 5]));
        let positions = (0..).zip(&mesh.positions[..]).map(|(i, p)| *p * bump(i));
        let positions: Vec<DVec3> = positions.map(|p| p.as_dvec3()).collect();
        let mut materials = vec![
            Material::diffuse("a", [0.5; 3]),
            Material::diffuse("b", [0.3, 0.6, 0.2]),
        ];
        let texels = (0..64).map(|i| [unit(hash(&[i])); 3]).collect();
        if is_masked {
            materials[1].mask = Some(Mask {
                opacity: 0.9,
                texture: Some(0),
                cutoff: Some(0.4),
            });
        }
        let uvs = (0..mesh.positions.len() as u64).map(|i| {
            let [u, v] = [11, 12].map(|k| unit(hash(&[i, k])));
            Vec2::new(u, v)
        });
        let triangles = mesh.triangles.to_vec();
        let of = (0..triangles.len() as u32).map(|i| i % 2);
        MeshInput::new("ball", positions, triangles.clone())
            .materials(materials, of.collect(), vec![Texture::new(8, 8, texels)])
            .normals(mesh.positions.to_vec())
            .uvs(uvs.collect())
    }

    /// Places of all kinds: turned, of all sizes, sheared, mirrored, and far away.
    fn places(count: u64, offset: f64) -> Vec<DAffine3> {
        let place = |i: u64| {
            let axes = [0, 1, 2].map(|k| {
                let column = [0, 1, 2].map(|a| number(i, 3 * k + a) * 2.0);
                DVec3::from(column) + DVec3::AXES[k as usize] * 1.5
            });
            let mut turned = DMat3::from_cols(axes[0], axes[1], axes[2]);
            if i % 3 == 0 {
                turned.y_axis = -turned.y_axis;
            }
            let size = libm::exp2(6.0 * number(i, 20) - 1.0);
            let middle = [10, 11, 12].map(|k| number(i, k));
            DAffine3 {
                matrix3: turned * size,
                translation: DVec3::from(middle) * 30.0 + offset,
            }
        };
        (0..count).map(place).collect()
    }

    fn floor(offset: f64) -> MeshInput {
        let corners = [
            [-40.0, -5.0, -40.0],
            [-40.0, -5.0, 40.0],
            [40.0, -5.0, 40.0],
            [40.0, -5.0, -40.0],
        ];
        let corners = corners.map(|c| DVec3::from(c) + offset);
        MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]])
    }

    /// One scene with instances, and the same with each place flat.
    fn scenes(is_masked: bool, offset: f64) -> [Scene; 2] {
        let builder = || {
            let from = [offset, offset, offset + 60.0];
            let camera = CameraInput::look_at("", from, [offset; 3], [0.0, 1.0, 0.0], 1.0);
            let builder = SceneBuilder::new("balls").camera(camera.unwrap());
            builder.mesh(floor(offset))
        };
        let places = places(60, offset);
        let instances = builder().instances(ball(is_masked), places.clone());
        let flat = places.iter().fold(builder(), |builder, place| {
            builder.mesh(ball(is_masked).transform(place))
        });
        [instances, flat].map(|builder| builder.build().unwrap())
    }

    fn rays(count: u64) -> Vec<Ray> {
        let ray = |i| {
            let origin = 25.0 * sampling::sphere(sampling::r2(i / 8, [0.3; 2]));
            let origin = if i / 8 % 4 == 0 { 0.3 * origin } else { origin };
            let to = 12.0 * sampling::sphere(sampling::r2(i, [0.7; 2]));
            let to = if i % 16 < 8 {
                to
            } else {
                to * 0.02 - 0.5 * origin
            };
            let t_max = if i % 5 == 0 { 22.0 } else { f32::INFINITY };
            Ray::new(origin, (to - origin).normalize(), t_max)
        };
        (0..count).map(ray).collect()
    }

    /// Holds rays among instances to those among the same triangles without, and returns how many
    /// met an instance.
    fn met_as_flat([instanced, flat]: &[Scene; 2]) -> usize {
        let meshes = [&instanced.mesh, &flat.mesh];
        assert_eq!(meshes[0].triangle_count(), meshes[1].triangle_count());
        assert!(10 * meshes[0].triangles.len() < meshes[1].triangles.len());
        let tracers = [Tracer::new(instanced), Tracer::new(flat)];
        let rays = rays(40_000);
        let mut hits = vec![None; rays.len()];
        tracers[0].closest_of_packet(&rays, &mut hits);
        let (mut met, mut others) = (0, 0);
        for (ray, &hit) in rays.iter().zip(&hits) {
            assert_eq!(hit, tracers[0].closest(ray));
            assert_eq!(hit.is_some(), tracers[0].is_occluded(ray));
            assert_eq!(hit, tracers[0].closest_seen(ray));
            assert_eq!(hit, tracers[0].closest_seen_and_masked(ray).0);
            let expected = tracers[1].closest(ray);
            let is_same = match (hit, expected) {
                (Some(a), Some(b)) => {
                    let is_near = |x: f32, y: f32| (x - y).abs() < 3e-4;
                    (a.t / b.t - 1.0).abs() < 1e-5
                        && (a.triangle, a.is_back) == (b.triangle, b.is_back)
                        && is_near(a.uv[0], b.uv[0])
                        && is_near(a.uv[1], b.uv[1])
                }
                (a, b) => a == b,
            };
            others += usize::from(!is_same);
            met += usize::from(hit.is_some_and(|h| h.triangle > 1));
            let masked = tracers.each_ref().map(|t| t.closest_seen_and_masked(ray).1);
            assert!(!is_same || masked[0] == masked[1]);
            if is_same && let Some(hit) = hit {
                let [a, b] = [instanced, flat].map(|s| Surface::new(s, hit.triangle, hit.uv));
                assert!(a.position.distance(b.position) < 1e-5 * 40.0);
                assert!(a.face_normal.dot(b.face_normal) > 0.9999);
                assert!(a.normal.dot(b.normal) > 0.999);
                assert_eq!((a.albedo, a.material % 2), (b.albedo, b.material % 2));
                assert!(!tracers[0].is_clear(hit.triangle, hit.uv));
            }
        }
        // Rays along silhouettes and edges pass by rounding.
        assert!(others * 1000 < rays.len(), "{others}");
        met
    }

    #[test]
    fn instances_are_met_as_the_same_triangles_that_lie_flat() {
        assert!(met_as_flat(&scenes(false, 0.0)) > 10_000);
        // So far away that the scene moves to the origin.
        assert!(met_as_flat(&scenes(false, 1e7)) > 10_000);
    }

    #[test]
    fn masks_of_instances_are_those_of_their_mesh() {
        let scenes = scenes(true, 0.0);
        assert!(met_as_flat(&scenes) > 10_000);
        let tracers = scenes.each_ref().map(Tracer::new);
        let through = rays(4000).into_iter().map(|ray| {
            let [a, b] = tracers.each_ref().map(|t| t.let_through(&ray));
            usize::from(a != b)
        });
        assert!(through.sum::<usize>() < 4);
    }

    #[test]
    fn nothing_escapes_from_an_instance_nor_meets_where_it_leaves() {
        let closed = sphere(40, 64);
        let positions = closed.positions.iter().map(|p| p.as_dvec3());
        let mesh = MeshInput::new("ball", positions, closed.triangles.to_vec());
        let places = places(30, 0.0);
        let builder = SceneBuilder::new("balls").instances(mesh, places.clone());
        let scene = builder.build().unwrap();
        let tracer = Tracer::new(&scene);
        let count = closed.triangles.len();
        for (k, place) in places.iter().enumerate() {
            let first = k * count;
            let inside = place
                .transform_point3(DVec3::new(0.1, 0.03, -0.2))
                .as_vec3();
            for t in (0..count).step_by(7) {
                let [a, b, c] = scene.mesh.corners(first + t);
                for to in [
                    a,
                    b,
                    c,
                    0.5 * (a + b),
                    0.5 * (b + c),
                    0.3 * a + 0.4 * b + 0.3 * c,
                ] {
                    let ray = Ray::endless(inside, (to - inside).normalize());
                    assert!(tracer.closest(&ray).is_some(), "instance {k}, triangle {t}");
                    assert!(tracer.is_occluded(&ray));
                }
                let surface = Surface::new(&scene, (first + t) as u32, [0.3, 0.3]);
                let up = offset(surface.position);
                let out = Ray::endless(
                    surface.position + surface.face_normal * up,
                    surface.face_normal,
                );
                let hit = tracer.closest(&out);
                assert!(hit.is_none_or(|h| h.triangle as usize != first + t));
            }
        }
    }

    #[test]
    fn areas_and_materials_are_those_of_all_places() {
        let [instanced, flat] = scenes(false, 0.0);
        let [a, b] = [&instanced, &flat].map(|s| s.mesh.areas(s.materials.len()));
        let sum = |areas: &[f64]| areas.iter().sum::<f64>();
        assert!((sum(&a) / sum(&b) - 1.0).abs() < 1e-6);
        for t in (0..flat.mesh.triangles.len()).step_by(11) {
            let [x, y] = [&instanced, &flat].map(|s| {
                let material = s.mesh.material_of(t) as usize;
                (s.materials[material].name.clone(), s.mesh.area(t))
            });
            assert_eq!(x.0, y.0);
            assert!((x.1 / y.1 - 1.0).abs() < 1e-3, "{x:?} {y:?}");
        }
        let [a, b] = [&instanced, &flat].map(Scene::bounds);
        assert!((a.min - b.min).abs().max_element() < 1e-4);
        assert!((a.max - b.max).abs().max_element() < 1e-4);
    }

    #[test]
    fn instances_at_one_place_are_all_kept() {
        let places = vec![DAffine3::IDENTITY; 100];
        let builder = SceneBuilder::new("balls").instances(ball(false), places);
        let scene = builder.build().unwrap();
        let bvh = TriangleBvh::new(&scene.mesh);
        let ray = Ray::endless(Vec3::new(0.1, 0.2, 5.0), -Vec3::Z);
        let mut met = 0;
        bvh.instances.as_ref().unwrap().visit(&ray, |_, _| {
            met += 1;
            true
        });
        assert_eq!(met, 100);
        // The first of triangles as far away, as ever.
        let first = scene.mesh.triangles.len();
        assert!((bvh.closest(&ray).unwrap().triangle as usize) < first);
    }
}
