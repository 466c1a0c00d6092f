//! What shadow rays pass: nothing but surfaces in a vacuum, the scene's media, or simpler media
//! that stand in for them before lights whose shadows are soft.

use crate::Result;
use crate::math::exp::exp_neg;
use crate::math::{Boxes, Ray, Spectrum, sampling};
use crate::scene::{Material, Scene, Volume};
use crate::trace::{Cells, SteppedVolume, Tracer};
use glam::{DVec3, Vec3};
use std::marker::PhantomData;

/// Media that shadow rays pass instead of the scene's own.
pub trait ShadowMedia<K>: Sync + std::fmt::Debug {
    /// Optical depth along a ray in a scene.
    fn optical_depth(&self, tracer: &Tracer, ray: &Ray) -> K;

    /// Whether it is known that no light gets to a point, whatever surfaces there are.
    fn is_dark(&self, _point: Vec3) -> bool {
        false
    }
}

/// Media that rays to suns pass instead of the scene's own.
pub trait MediaBeforeSuns<K>: Sync + std::fmt::Debug {
    /// Those before a light, by its number; `None` for the scene's own.
    fn before_sun(&self, light: usize) -> Option<&dyn ShadowMedia<K>>;
}

/// What shadow rays pass beside surfaces, as a type: code for scenes without media does no work for
/// any.
pub trait Shadows: Copy + Sync + std::fmt::Debug {
    /// What tells shares of light: one number, or one for each channel behind media of colour.
    type Share: Spectrum;

    /// Share of light that gets from the end of a ray to its origin, 0 behind a surface. Media on
    /// the way are those of `media`, or the scene's own.
    fn transmittance(
        &self,
        tracer: &Tracer,
        ray: &Ray,
        media: Option<&dyn ShadowMedia<Self::Share>>,
    ) -> Self::Share;

    /// Media before emitters, if not the scene's own.
    fn before_emitters(&self) -> Option<&dyn ShadowMedia<Self::Share>>;

    /// Media before a sun, by the light's number, if not the scene's own.
    fn before_sun(&self, light: usize) -> Option<&dyn ShadowMedia<Self::Share>>;
}

/// A scene without media.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vacuum;

impl Shadows for Vacuum {
    type Share = f32;

    #[inline]
    fn transmittance(&self, tracer: &Tracer, ray: &Ray, _: Option<&dyn ShadowMedia<f32>>) -> f32 {
        tracer.let_through(ray)
    }

    #[inline]
    fn before_emitters(&self) -> Option<&dyn ShadowMedia<f32>> {
        None
    }

    #[inline]
    fn before_sun(&self, _: usize) -> Option<&dyn ShadowMedia<f32>> {
        None
    }
}

/// The media of a scene, grey or of colour, voxel by voxel but where others stand in for them.
#[derive(Clone, Copy, Debug, Default)]
pub struct SceneMedia<'a, K = f32> {
    /// Media that rays to emitters pass instead.
    pub(super) before_emitters: Option<&'a SoftShadowMedia>,
    /// Media that rays to suns pass instead.
    pub(super) before_suns: Option<&'a dyn MediaBeforeSuns<K>>,
    pub(super) share: PhantomData<K>,
}

impl<K: Spectrum> Shadows for SceneMedia<'_, K> {
    type Share = K;

    fn transmittance(&self, tracer: &Tracer, ray: &Ray, media: Option<&dyn ShadowMedia<K>>) -> K {
        match media {
            None => tracer.transmittance(ray),
            Some(media) if media.is_dark(ray.origin) => K::default(),
            Some(media) => match tracer.let_through(ray) {
                0.0 => K::default(),
                through => media.optical_depth(tracer, ray).exp_neg() * through,
            },
        }
    }

    fn before_emitters(&self) -> Option<&dyn ShadowMedia<K>> {
        self.before_emitters
            .map(|media| media as &dyn ShadowMedia<K>)
    }

    fn before_sun(&self, light: usize) -> Option<&dyn ShadowMedia<K>> {
        self.before_suns?.before_sun(light)
    }
}

/// The media of a scene on few voxels, passed in steps as long as leaves rays nearly alike: shadows
/// of emitters are soft, so that rays to them need not pass media voxel by voxel.
#[derive(Debug)]
pub struct SoftShadowMedia {
    all: Vec<SoftMedium>,
    boxes: Boxes,
}

/// The media of all volumes of a scene that stand on one grid.
#[derive(Debug)]
struct SoftMedium {
    sum: SteppedVolume,
    /// Extinction by channel over that of the largest.
    color: [f32; 3],
    /// The least of these.
    clearest: f32,
    /// Up to where some of the media are exact, scene units from the origin of a ray; 0 where few
    /// voxels tell as much of all.
    near: f32,
    /// Which volumes these are, and the others.
    exact: Vec<usize>,
    others: Option<SteppedVolume>,
}

impl SoftShadowMedia {
    /// Voxels along an edge of a volume, at most.
    const MAX_EDGE: usize = 128;
    /// Voxels of all volumes together, at most: 64 MiB.
    const MAX_VOXELS: usize = 1 << 24;
    /// Depth behind which there is no light worth a step: a millionth is left.
    const NO_LIGHT: f32 = 14.0;

    /// Copies a scene's media, or those that stand in for them; `None` if nothing in it emits.
    ///
    /// # Errors
    /// As [`Volume::ready`].
    pub fn new(scene: &Scene, volumes: &[Volume]) -> Result<Option<Self>> {
        let max_edge = Self::max_edge(volumes.len());
        if !scene.materials.iter().any(Material::emits) && scene.emissive.is_empty() {
            return Ok(None);
        }
        volumes.iter().try_for_each(Volume::ready)?;
        let mut together: Vec<Vec<usize>> = Vec::new();
        for (i, volume) in volumes.iter().enumerate() {
            let is_same = |of: &&mut Vec<usize>| volume.adds_to(&volumes[of[0]]);
            match together.iter_mut().find(is_same) {
                Some(of) => of.push(i),
                None => together.push(vec![i]),
            }
        }
        let bounds = together.iter().map(|of| volumes[of[0]].bounds());
        Ok(Some(Self {
            boxes: Boxes::new(bounds),
            all: (together.into_iter())
                .map(|of| SoftMedium::new(volumes, &of, max_edge))
                .collect(),
        }))
    }

    /// Voxels along an edge of each of `volumes` volumes, at most.
    fn max_edge(volumes: usize) -> usize {
        let edge = libm::cbrt(Self::MAX_VOXELS as f64 / volumes as f64);
        (edge as usize).clamp(1, Self::MAX_EDGE)
    }
}

impl SoftMedium {
    /// The media of these volumes.
    fn new(volumes: &[Volume], of: &[usize], max_edge: usize) -> Self {
        let together = |of: &[usize]| {
            let media: Vec<&Volume> = of.iter().map(|&v| &volumes[v]).collect();
            (!of.is_empty()).then(|| stepped(&media, max_edge))
        };
        let first = &volumes[of[0]];
        let (mut near, mut exact, mut others) = (0.0_f32, Vec::new(), Vec::new());
        for &v in of {
            match together(&[v]).map_or(0.0, |alone| exact_up_to(&volumes[v], &alone)) {
                0.0 => others.push(v),
                exact_up_to => {
                    near = near.max(exact_up_to);
                    exact.push(v);
                }
            }
        }
        Self {
            sum: stepped(
                &of.iter().map(|&v| &volumes[v]).collect::<Vec<_>>(),
                max_edge,
            ),
            color: first.extinction_color,
            clearest: first.clearest(),
            others: together(&others).filter(|_| near > 0.0),
            near,
            exact,
        }
    }

    /// Optical depth along a ray, or any from `enough` on where it is more.
    fn optical_depth(&self, tracer: &Tracer, ray: &Ray, enough: f32) -> f32 {
        if self.near == 0.0 {
            return self.sum.optical_depth_up_to(ray, enough);
        }
        let first = ray.up_to(self.near);
        let exact = self.exact.iter();
        let exact: f32 = exact.map(|&v| tracer.optical_depth_in(v, &first)).sum();
        let others = self.others.as_ref();
        let before = exact + others.map_or(0.0, |others| others.optical_depth(&first));
        if ray.t_max <= self.near || before >= enough {
            return before;
        }
        let rest = Ray::new(ray.at(self.near), ray.direction, ray.t_max - self.near);
        before + self.sum.optical_depth_up_to(&rest, enough - before)
    }
}

impl<K: Spectrum> ShadowMedia<K> for SoftShadowMedia {
    fn optical_depth(&self, tracer: &Tracer, ray: &Ray) -> K {
        let mut depth = K::default();
        for medium in self.boxes.along(ray).map(|i| &self.all[i]) {
            let left = Self::NO_LIGHT - depth.least();
            if left <= 0.0 {
                break;
            }
            let tau = medium.optical_depth(tracer, ray, left / medium.clearest);
            depth += K::tinted(tau, &medium.color);
        }
        depth
    }
}

/// Volumes of one grid on at most `max_edge` voxels along an edge, passed in the longest steps that
/// do.
fn stepped(media: &[&Volume], max_edge: usize) -> SteppedVolume {
    /// Lengths of steps to try, voxels.
    const STEPS: [f32; 2] = [4.0, 2.0];
    /// Root mean square by which transmittances may differ from those in steps of one voxel: where
    /// shadows of dense media are all that a picture shows, twice as much can be seen.
    const MAX_ERROR: f64 = 0.006;
    let mut stepped = SteppedVolume::new(media[0], &media[1..], max_edge);
    let rays = rays_through(media[0], &stepped);
    let error = |stepped: &SteppedVolume| {
        let squared = |(ray, expected): &(Ray, f64)| {
            let depth = stepped.optical_depth(ray);
            (f64::from(exp_neg(depth)) - expected).powi(2)
        };
        let count = rays.len().max(1) as f64;
        (rays.iter().map(squared).sum::<f64>() / count).sqrt()
    };
    let does = |&step: &f32| {
        stepped.step = step;
        error(&stepped) < MAX_ERROR
    };
    stepped.step = STEPS.into_iter().find(does).unwrap_or(1.0);
    stepped
}

/// Far more than rays that are asked for, as most of a volume may be empty.
const TRIES: u64 = 1 << 14;
/// Rays that tell of all.
const RAYS: usize = 256;

/// Rays that start in a volume's box.
fn rays_inside(volume: &Volume) -> impl Iterator<Item = Ray> {
    let dims = DVec3::from_array(volume.sigma_t.dims().map(|n| n as f64));
    (0..TRIES).map(move |i| {
        let along = |axis: u64| f64::from(sampling::unit(sampling::hash(&[i, axis])));
        let in_index = dims * DVec3::new(along(0), along(1), along(2));
        let origin = volume.scene_from_index.transform_point3(in_index).as_vec3();
        Ray::endless(origin, sampling::sphere(sampling::r2(i, [0.5; 2])))
    })
}

/// Rays that start in a volume's box and meet something, and what it lets through of each.
fn rays_through(volume: &Volume, stepped: &SteppedVolume) -> Vec<(Ray, f64)> {
    let through = |ray: Ray| {
        let depth = stepped.optical_depth(&ray);
        (depth > 0.0).then(|| (ray, f64::from(exp_neg(depth))))
    };
    rays_inside(volume).filter_map(through).take(RAYS).collect()
}

/// How far from their origins rays must pass voxels one by one, scene units: light in what is dense
/// comes from its border, which few voxels blur. 0 where they do not.
fn exact_up_to(volume: &Volume, stepped: &SteppedVolume) -> f32 {
    const VOXELS: f32 = 8.0;
    /// Root mean square by which transmittances from within a medium may be off, over that of
    /// themselves.
    const MAX_ERROR: f64 = 0.05;
    let near = VOXELS * volume.longest_voxel_edge();
    let exact = |ray: &Ray| Cells::new(volume, ray).map_or(0.0, Cells::optical_depth) as f32;
    let starts_inside = |ray: &Ray| exact(&ray.up_to(near / VOXELS)) > 0.0;
    let (mut off, mut all) = (0.0, 0.0);
    for ray in rays_inside(volume).filter(starts_inside).take(RAYS) {
        let rest = Ray::endless(ray.at(near), ray.direction);
        let right = exact(&ray.up_to(near)) + stepped.optical_depth(&rest);
        let [right, found] = [right, stepped.optical_depth(&ray)].map(|t| f64::from(exp_neg(t)));
        off += (right - found).powi(2);
        all += right.max(found).powi(2);
    }
    if off > MAX_ERROR * MAX_ERROR * all {
        near
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;

    fn volume(dims: [usize; 3], sigma_t: impl Fn([usize; 3]) -> f32 + Sync) -> Volume {
        let grid = Grid::from_fn(dims, sigma_t);
        Volume::new("fog".into(), grid, [0.5; 3], DAffine3::IDENTITY)
    }

    #[test]
    fn smooth_media_are_passed_in_long_steps_and_rough_ones_are_not() {
        let cloud = |period: f32| {
            move |[i, j, k]: [usize; 3]| {
                let wave = |i: usize| (std::f32::consts::TAU * i as f32 / period).sin();
                0.03 * (1.0 + wave(i) * wave(j) * wave(k))
            }
        };
        let speckled = |v: [usize; 3]| {
            let bits = sampling::hash(&v.map(|i| i as u64));
            if bits.is_multiple_of(16) { 5.0 } else { 0.0 }
        };
        // A small ball tells of itself, however large the box is that it is in.
        let ball = |v: [usize; 3]| {
            let off = Vec3::from_array(v.map(|i| i as f32 - 40.0)).length();
            if off < 5.0 { 2.0 } else { 0.0 }
        };
        let step = |v: &Volume| stepped(&[v], SoftShadowMedia::MAX_EDGE).step;
        assert_eq!(step(&volume([64, 48, 40], cloud(60.0))), 4.0);
        assert!((2.0..4.0).contains(&step(&volume([64, 48, 40], cloud(6.0)))));
        assert_eq!(step(&volume([64; 3], speckled)), 1.0);
        assert_eq!(step(&volume([80; 3], ball)), 1.0);
    }

    #[test]
    fn borders_of_dense_media_on_few_voxels_are_passed_voxel_by_voxel() {
        let sheets = volume([256, 16, 16], |[x, ..]| if x % 16 < 5 { 0.6 } else { 0.0 });
        let waves = volume([256, 16, 16], |[x, ..]| {
            0.05 * (1.0 + (std::f32::consts::TAU * x as f32 / 64.0).sin())
        });
        let exact_of = |v: &Volume| exact_up_to(v, &stepped(&[v], SoftShadowMedia::MAX_EDGE));
        assert_eq!([exact_of(&sheets), exact_of(&waves)], [8.0, 0.0]);
        let mut scene = Scene::demo().expect("the demo can be read");
        scene.volumes = vec![sheets];
        let media = SoftShadowMedia::new(&scene, &scene.volumes)
            .unwrap()
            .expect("a lamp");
        let tracer = Tracer::new(&scene);
        // From within a sheet to its border, a little oblique, and to the next one.
        let direction = Vec3::new(1.0, 0.1, 0.0).normalize();
        for (x, t_max) in [(2.5, f32::INFINITY), (2.5, 6.0), (4.0, f32::INFINITY)] {
            let ray = Ray::new(Vec3::new(x, 3.0, 8.0), direction, t_max);
            let exact: f32 = tracer.optical_depth(&ray);
            let found: f32 = media.optical_depth(&tracer, &ray);
            // Rays that no light gets along end where that is known.
            let [found, exact] = [found, exact].map(|t| t.min(SoftShadowMedia::NO_LIGHT));
            assert!((found / exact - 1.0).abs() < 0.02, "{found} {exact}");
        }
    }

    #[test]
    fn media_of_one_grid_are_as_deep_together_as_apart() {
        let sheets = volume([256, 16, 16], |[x, ..]| if x % 16 < 5 { 0.6 } else { 0.0 });
        let waves = volume([256, 16, 16], |[x, ..]| {
            0.05 * (1.0 + (std::f32::consts::TAU * x as f32 / 64.0).sin())
        });
        let mut scene = Scene::demo().expect("the demo can be read");
        scene.volumes = vec![waves, sheets];
        let media = SoftShadowMedia::new(&scene, &scene.volumes)
            .unwrap()
            .expect("a lamp");
        assert_eq!((media.all.len(), &media.all[0].exact), (1, &vec![1]));
        let tracer = Tracer::new(&scene);
        let direction = Vec3::new(1.0, 0.02, 0.03).normalize();
        for x in 0..40 {
            let ray = Ray::endless(Vec3::new(6.1 * x as f32 + 0.5, 3.0, 8.0), direction);
            let exact: f32 = tracer.optical_depth(&ray);
            let found: f32 = media.optical_depth(&tracer, &ray);
            let [exact, found] = [exact, found].map(exp_neg);
            assert!((found - exact).abs() < 0.006, "{found} {exact}");
        }
    }

    #[test]
    fn many_volumes_share_the_memory_of_a_few() {
        assert_eq!(SoftShadowMedia::max_edge(1), SoftShadowMedia::MAX_EDGE);
        assert_eq!(SoftShadowMedia::max_edge(8), SoftShadowMedia::MAX_EDGE);
        assert!(SoftShadowMedia::max_edge(1000).pow(3) * 1000 <= SoftShadowMedia::MAX_VOXELS);
        assert_eq!(SoftShadowMedia::max_edge(usize::MAX), 1);
    }

    #[test]
    fn a_scene_without_emitters_has_no_soft_shadows() {
        let mut scene = Scene::demo().expect("the demo can be read");
        assert!(
            SoftShadowMedia::new(&scene, &scene.volumes)
                .unwrap()
                .is_some()
        );
        for material in &mut scene.materials {
            material.emission = [0.0; 3];
        }
        assert!(
            SoftShadowMedia::new(&scene, &scene.volumes)
                .unwrap()
                .is_none()
        );
    }
}
