//! Rays among triangles that are there in part.

use super::instances::InstanceBvh;
use super::packet::Member;
use super::{Blocks, Corners, LANES, Seen, There, TriangleBvh, Whole};
use crate::math::{Hit, Ray};
use crate::scene::{Masks, Scene};
use std::cell::Cell;

/// Masks, and how far the first is that a ray passed.
struct Watched<'a> {
    masks: &'a Masks<'a>,
    passed: Cell<f32>,
}

impl There for Watched<'_> {
    #[inline]
    fn is_there(&self, triangle: u32, uv: [f32; 2], t: f32) -> bool {
        let is_clear = self.masks.is_clear(triangle, uv);
        if is_clear {
            self.passed.set(self.passed.get().min(t));
        }
        !is_clear
    }
}

// Apart, so that what scenes without masks need is compiled as if there were nothing else.
impl<'a> TriangleBvh<'a> {
    /// The same hierarchy, whose triangles are there where the masks of a scene say.
    #[must_use]
    pub fn with_masks(mut self, scene: &'a Scene) -> Self {
        self.masks = Masks::of(scene);
        self
    }

    /// Where triangles are there; `None` if all are everywhere.
    #[must_use]
    #[inline]
    pub fn masks(&self) -> Option<&Masks<'a>> {
        self.masks.as_ref()
    }

    /// The nearest hit along a ray as if no triangle had a mask.
    #[must_use]
    pub fn closest_unmasked(&self, ray: &Ray) -> Option<Hit> {
        self.closest_there(ray, &Whole)
    }

    /// What [`Self::closest_seen`] finds, and whether masks have a say in that: the ray ends on a
    /// masked triangle, or has passed one.
    #[must_use]
    #[inline]
    pub fn closest_seen_and_masked(&self, ray: &Ray, scene: &Scene) -> (Option<Hit>, bool) {
        let Some(masks) = &self.masks else {
            return (self.closest_seen(ray, scene), false);
        };
        let watched = Watched {
            masks,
            passed: Cell::new(f32::INFINITY),
        };
        let seen = Seen {
            scene,
            there: &watched,
        };
        let nearest = self.closest_where(ray, &seen);
        let hit = nearest.hit(self.scale);
        if let Some(instances) = &self.instances {
            let passed = watched.passed.get() / self.scale;
            return closest_among(instances, ray, hit, (scene, masks), passed);
        }
        let ends_on_mask = hit.is_some_and(|hit| masks.of_triangle(hit.triangle).is_some());
        (hit, ends_on_mask || watched.passed.get() < nearest.t_end)
    }

    /// The share of light that triangles let through along a ray: 0 behind one that is there, and
    /// of a screen what it lets through on average.
    #[must_use]
    #[inline]
    pub fn let_through(&self, ray: &Ray) -> f32 {
        match &self.masks {
            Some(masks) => self.let_through_masked(masks, ray),
            None if self.is_occluded(ray) => 0.0,
            None => 1.0,
        }
    }

    #[inline(never)]
    pub(super) fn is_occluded_masked(&self, masks: &Masks, ray: &Ray) -> bool {
        match &self.blocks {
            Blocks::Corners(blocks) => self.is_occluded_by(&&blocks[..], ray, masks),
            Blocks::Vertices(blocks) => self.is_occluded_by(&self.by_vertex(blocks), ray, masks),
        }
    }

    #[inline(never)]
    pub(super) fn trace_masked(&self, masks: &Masks, packet: &mut [Member]) {
        match &self.blocks {
            Blocks::Corners(blocks) => self.trace(&&blocks[..], packet, masks),
            Blocks::Vertices(blocks) => self.trace(&self.by_vertex(blocks), packet, masks),
        }
    }

    #[inline(never)]
    fn let_through_masked(&self, masks: &Masks, ray: &Ray) -> f32 {
        let mut through = self.let_through_own(masks, ray);
        if let Some(instances) = &self.instances
            && through > 0.0
        {
            instances.visit(ray, |prototype, ray| {
                through *= prototype.let_through_own(masks, ray);
                through > 0.0
            });
        }
        through
    }

    /// The same without instances.
    fn let_through_own(&self, masks: &Masks, ray: &Ray) -> f32 {
        match &self.blocks {
            Blocks::Corners(blocks) => self.let_through_by(&&blocks[..], masks, ray),
            Blocks::Vertices(blocks) => self.let_through_by(&self.by_vertex(blocks), masks, ray),
        }
    }

    /// The product over all triangles along a ray, each of which is in one leaf.
    #[inline(always)]
    fn let_through_by(&self, blocks: &impl Corners, masks: &Masks, ray: &Ray) -> f32 {
        let ray = self.scaled(ray);
        let mut through = 1.0;
        self.visit(blocks, &ray, |block, sheared, _| {
            let met = sheared.meet(block);
            for k in 0..LANES {
                if met.lanes >> k & 1 == 1 && met.t[k] < ray.t_max {
                    through *= masks.let_through(block.triangles[k], met.uv.map(|w| w[k]));
                }
            }
            through > 0.0
        });
        through
    }
}

/// What [`TriangleBvh::closest_seen_and_masked`] finds, where a ray among what is no instance ends
/// at a hit, and has `passed` a mask so far from its origin.
#[inline(never)]
fn closest_among(
    instances: &InstanceBvh,
    ray: &Ray,
    hit: Option<Hit>,
    (scene, masks): (&Scene, &Masks),
    mut passed: f32,
) -> (Option<Hit>, bool) {
    let hit = instances.closest(ray, hit, |prototype, ray| {
        let watched = Watched {
            masks,
            passed: Cell::new(f32::INFINITY),
        };
        let seen = Seen {
            scene,
            there: &watched,
        };
        let hit = prototype.closest_where(ray, &seen).hit(prototype.scale);
        passed = passed.min(watched.passed.get() / prototype.scale);
        hit
    });
    let has_mask = |hit: Hit| {
        let stored = scene.mesh.stored(hit.triangle as usize);
        masks.of_triangle(stored as u32).is_some()
    };
    let end = hit.map_or(ray.t_max, |hit| hit.t);
    (hit, hit.is_some_and(has_mask) || passed < end)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::{self, hash, unit};
    use crate::scene::{Mask, Material, Mesh, Texture};
    use glam::{Vec2, Vec3};

    /// Triangles all about the origin, of a material without a mask, one with a cut-off and a
    /// share.
    fn confetti() -> Scene {
        let mut scene = Scene::without_picture();
        let number = |i: u32, k: u64| unit(hash(&[u64::from(i), k]));
        for i in 0..60 {
            let middle = 0.7 * sampling::sphere([number(i, 0), number(i, 1)]);
            for k in 0..3 {
                let off = sampling::sphere([number(i, 2 + k), number(i, 5 + k)]);
                scene.mesh.positions.push(middle + 0.6 * off);
                let uv = Vec2::new(number(i, 8 + k), number(i, 11 + k));
                scene.mesh.uvs.push(2.0 * uv);
            }
            scene.mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
            scene.mesh.material.push(if i < 6 { 0 } else { 1 + i % 2 });
        }
        let texels = (0..64).map(|i| [unit(hash(&[i])); 3]).collect();
        scene.textures = vec![Texture::new(8, 8, texels)];
        scene.materials = vec![Material::diffuse("", [0.5; 3]); 3];
        for (m, cutoff) in [(1, Some(0.5)), (2, None)] {
            scene.materials[m].mask = Some(Mask {
                opacity: 0.9,
                texture: Some(0),
                cutoff,
            });
        }
        scene
    }

    #[test]
    fn rays_meet_what_is_there_of_each_triangle() {
        let mut scene = confetti();
        let bvh = TriangleBvh::new(&scene.mesh).with_masks(&scene);
        let masks = Masks::of(&scene).unwrap();
        let alone: Vec<Mesh> = (scene.mesh.triangles.iter())
            .map(|t| Mesh {
                triangles: vec![*t].into(),
                ..scene.mesh.clone()
            })
            .collect();
        let alone: Vec<TriangleBvh> = alone.iter().map(TriangleBvh::new).collect();
        let rays: Vec<Ray> = (0..4000)
            .map(|i| {
                let origin = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let to = 0.8 * sampling::sphere(sampling::r2(i, [0.7; 2]));
                let t_max = if i % 2 == 0 { f32::INFINITY } else { 2.0 };
                Ray::new(origin, (to - origin).normalize(), t_max)
            })
            .collect();
        let mut hits = vec![None; rays.len()];
        bvh.closest_of_packet(&rays, &mut hits);
        let mut count = [0; 3];
        for (ray, hit) in rays.iter().zip(hits) {
            let all = (0_u32..).zip(&alone).filter_map(|(triangle, bvh)| {
                let hit = bvh.closest(ray)?;
                Some(Hit { triangle, ..hit })
            });
            let all: Vec<Hit> = all.collect();
            let there = all.iter().filter(|h| !masks.is_clear(h.triangle, h.uv));
            let expected = there.min_by(|a, b| a.t.total_cmp(&b.t)).copied();
            let (watched, is_masked) = bvh.closest_seen_and_masked(ray, &scene);
            assert_eq!([bvh.closest(ray), hit, watched], [expected; 3]);
            assert_eq!(bvh.is_occluded(ray), expected.is_some());
            let end = expected.map_or(f32::INFINITY, |h| h.t);
            let before = all.iter().filter(|h| h.t < end).count();
            let ends_on_mask = expected.is_some_and(|h| h.triangle >= 6);
            assert_eq!(is_masked, before > 0 || ends_on_mask);
            let through = all.iter().map(|h| masks.let_through(h.triangle, h.uv));
            assert!((bvh.let_through(ray) - through.product::<f32>()).abs() < 1e-6);
            count[0] += usize::from(expected.is_some());
            count[1] += usize::from(before > 0);
            count[2] += usize::from((0.01..0.99).contains(&bvh.let_through(ray)));
        }
        assert!(count.into_iter().min() > Some(500), "{count:?}");
        scene.materials[1].is_seen = false;
        let bvh = TriangleBvh::new(&scene.mesh).with_masks(&scene);
        for ray in &rays {
            let (hit, _) = bvh.closest_seen_and_masked(ray, &scene);
            assert_eq!(hit, bvh.closest_seen(ray, &scene));
            assert!(hit.is_none_or(|h| scene.mesh.material[h.triangle as usize] != 1));
        }
        let inside = Ray::endless(Vec3::ZERO, Vec3::X);
        let plain = TriangleBvh::new(&scene.mesh);
        assert_eq!(
            plain.closest_seen_and_masked(&inside, &scene),
            (plain.closest_seen(&inside, &scene), false)
        );
        let through = plain.let_through(&inside);
        assert_eq!(through == 0.0, plain.is_occluded(&inside));
    }
}
