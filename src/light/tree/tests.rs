//! What a tree over many lights promises.

use super::{LightCut, LightTree};
use crate::light::emitter::Emitter;
use crate::light::emitters::Emitters;
use crate::light::shading_point::{MediumReceiver, PhaseReceiver, Receiver, SurfaceReceiver};
use crate::light::{Lights, SceneMedia, ShadowRays};
use crate::math::{PhaseFunction, Ray, Rgb, SeenPhase, sampling};
use crate::scene::{Light, Material, Scene};
use crate::trace::Tracer;
use glam::Vec3;

/// Numbers in [0,1) that a key tells.
struct Numbers {
    key: u64,
    next: u64,
}

impl Numbers {
    fn new(key: u64) -> Self {
        Self { key, next: 0 }
    }

    fn unit(&mut self) -> f32 {
        self.next += 1;
        sampling::unit(sampling::hash(&[self.key, self.next]))
    }

    fn direction(&mut self) -> Vec3 {
        sampling::sphere([self.unit(), self.unit()])
    }

    /// In a box of 10 x 4 x 6 around the origin.
    fn place(&mut self) -> Vec3 {
        Vec3::new(
            10.0 * self.unit() - 5.0,
            4.0 * self.unit() - 2.0,
            6.0 * self.unit() - 3.0,
        )
    }

    fn receiver(&mut self) -> Either {
        if self.unit() < 0.25 {
            return Either::Medium;
        }
        let normal = self.direction();
        Either::Surface(SurfaceReceiver {
            normal,
            face_normal: normal,
        })
    }
}

/// A receiver of any kind.
#[derive(Clone, Copy)]
enum Either {
    Surface(SurfaceReceiver),
    Medium,
}

impl Receiver for Either {
    fn response(self, d: Vec3) -> f32 {
        match self {
            Self::Surface(s) => s.response(d),
            Self::Medium => MediumReceiver.response(d),
        }
    }

    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32 {
        match self {
            Self::Surface(s) => s.response_to_triangle(corners),
            Self::Medium => MediumReceiver.response_to_triangle(corners),
        }
    }

    fn normals(self) -> Option<[Vec3; 2]> {
        match self {
            Self::Surface(s) => s.normals(),
            Self::Medium => MediumReceiver.normals(),
        }
    }
}

/// Emitters of power over a range of 36 and of different colours: half of them anywhere, half on a
/// ceiling.
fn scene_of_emitters(count: usize, key: u64) -> Scene {
    let mut numbers = Numbers::new(key);
    let mut scene = Scene::without_picture();
    let size = 0.5 / (count as f32).sqrt();
    for i in 0..count {
        let (mut middle, mut normal) = (numbers.place(), numbers.direction());
        if i % 2 == 0 {
            (middle.y, normal) = (2.0, -Vec3::Y);
        }
        let (x, y) = sampling::tangents(normal);
        let first = scene.mesh.positions.len() as u32;
        let side = size * (0.3 + numbers.unit());
        for corner in [x, -0.5 * x + 0.8 * y, -0.5 * x - 0.8 * y] {
            scene.mesh.positions.push(middle + corner * side);
        }
        scene.mesh.triangles.push([first, first + 1, first + 2]);
        scene.mesh.material.push(i as u32);
        let radiance = 30.0 * 6.0_f32.powf(2.0 * numbers.unit() - 1.0);
        scene.materials.push(Material {
            emission: std::array::from_fn(|_| radiance * (0.2 + numbers.unit())),
            emits_both_sides: i % 5 == 0,
            ..Material::diffuse("", [0.0; 3])
        });
    }
    scene
}

fn sends(e: &Emitter, origin: Vec3, receiver: Either) -> Rgb {
    let in_front = (origin - e.corners[0]).dot(e.normal) > 0.0;
    if in_front || e.both_sides {
        e.radiance * receiver.response_to_triangle(e.corners.map(|c| c - origin))
    } else {
        Rgb::BLACK
    }
}

/// A few receivers that light can reach, with the sum of what all lights send by their closed
/// forms.
fn receivers(emitters: &Emitters, count: u32, key: u64) -> Vec<(Vec3, Either, Rgb)> {
    let mut numbers = Numbers::new(key);
    let mut found = Vec::new();
    while found.len() < 60 {
        let (origin, receiver) = (numbers.place(), numbers.receiver());
        let sum = (0..count)
            .map(|i| sends(&emitters.all()[i as usize], origin, receiver))
            .fold(Rgb::BLACK, |sum, light| sum + light);
        if sum.mean() > 0.01 {
            found.push((origin, receiver, sum));
        }
    }
    found
}

#[test]
fn many_emitters_of_any_size_and_radiance_send_what_they_do() {
    let scene = scene_of_emitters(100, 4);
    let emitters = Emitters::new(&scene);
    for (length, light) in [(49, 99), (49, -99), (-49, 99), (-49, -99)] {
        let [length, light] = [length, light].map(|exponent| libm::ldexpf(1.0, exponent));
        let mut other = scene_of_emitters(100, 4);
        other.mesh.positions.iter_mut().for_each(|p| *p *= length);
        for material in &mut other.materials {
            material.emission = material.emission.map(|v| v * light);
        }
        let others = Emitters::new(&other);
        for (origin, receiver, _) in receivers(&emitters, 100, 9) {
            let sent = |emitters: &Emitters, origin| {
                let cut = LightCut::new(
                    emitters.tree().unwrap(),
                    emitters.all(),
                    origin,
                    receiver,
                    0.03,
                );
                (cut.light(), cut.choose(0.4).map(|c| (c.emitter, c.chance)))
            };
            let ((a, near), (b, far)) = (sent(&emitters, origin), sent(&others, origin * length));
            for c in 0..3 {
                assert!(
                    (b.0[c] / light - a.0[c]).abs() <= 1e-4 * a.0[c],
                    "{a:?} {b:?}"
                );
            }
            let (Some(near), Some(far)) = (near, far) else {
                panic!("an emitter is chosen: {near:?} {far:?}")
            };
            assert!(near.0 == far.0 && (near.1 / far.1 - 1.0).abs() < 1e-3);
        }
    }
}

#[test]
fn chances_add_up_to_one_and_no_light_that_can_reach_a_point_is_left_out() {
    for (count, tolerance) in [(65, 0.03), (65, 10.0), (400, 0.03), (400, 0.2)] {
        let scene = scene_of_emitters(count, 1);
        let emitters = Emitters::new(&scene);
        let tree = emitters.tree().unwrap();
        for (origin, receiver, sum) in receivers(&emitters, count as u32, 2) {
            let cut = LightCut::new(tree, emitters.all(), origin, receiver, tolerance);
            let (chances, none) = cut.chances(count);
            let total = chances.iter().sum::<f32>() + none;
            assert!((total - 1.0).abs() < 1e-4, "{count}: {total}");
            for (i, chance) in chances.iter().enumerate() {
                let sent = sends(&emitters.all()[i], origin, receiver).mean();
                // Within a thousand of its share, no light is asked less than a hundredth as often
                // as it sends.
                let share = sent / sum.mean();
                assert!(share < 1e-3 || *chance > 0.01 * share, "{share} {chance}");
                assert!(sent == 0.0 || *chance > 0.0, "{i} sends {sent}");
            }
        }
    }
}

#[test]
fn lights_are_chosen_by_their_chances() {
    let count = 150;
    let scene = scene_of_emitters(count, 3);
    let emitters = Emitters::new(&scene);
    let tree = emitters.tree().unwrap();
    for (origin, receiver, _) in receivers(&emitters, count as u32, 4).into_iter().take(10) {
        let cut = LightCut::new(tree, emitters.all(), origin, receiver, 0.2);
        let (chances, _) = cut.chances(count);
        let mut found = vec![0.0_f32; count];
        let draws = 20_000;
        for i in 0..draws {
            let Some(choice) = cut.choose((i as f32 + 0.5) / draws as f32) else {
                continue;
            };
            let chance = chances[choice.emitter as usize];
            // A light that emits on both sides is two.
            assert!(choice.chance <= chance * 1.001);
            assert!((0.0..=1.0).contains(&choice.within));
            found[choice.emitter as usize] += 1.0 / draws as f32;
        }
        for (found, chance) in found.iter().zip(&chances) {
            assert!((found - chance).abs() < 3e-4, "{found} {chance}");
        }
    }
}

#[test]
fn a_cut_tells_what_all_lights_send() {
    for (count, limit) in [(100, 0.02), (1000, 0.025), (10_000, 0.04)] {
        let scene = scene_of_emitters(count, 5);
        let emitters = Emitters::new(&scene);
        let tree = emitters.tree().unwrap();
        let mut squares = 0.0;
        let all = receivers(&emitters, count as u32, 6);
        for &(origin, receiver, sum) in &all {
            let cut = LightCut::new(tree, emitters.all(), origin, receiver, 0.03);
            let error = cut.light().mean() / sum.mean() - 1.0;
            squares += error * error;
            // Cuts grow far slower than their number.
            assert!(cut.len() < 400, "{}", cut.len());
        }
        let error = (squares / all.len() as f32).sqrt();
        assert!(error < limit, "{count}: {error}");
    }
}

#[test]
fn a_cut_tells_what_reaches_a_ray_through_a_phase_function() {
    for (g, limit, most) in [(0.3, 0.03, 400), (-0.7, 0.04, 600)] {
        let scene = scene_of_emitters(1000, 5);
        let emitters = Emitters::new(&scene);
        let tree = emitters.tree().unwrap();
        let mut numbers = Numbers::new(11);
        let mut squares = 0.0;
        for _ in 0..60 {
            let (origin, direction) = (numbers.place(), numbers.direction());
            let phase = PhaseFunction::henyey_greenstein(g);
            let receiver = PhaseReceiver(SeenPhase::of(phase, direction).unwrap());
            let send = |e: &Emitter| {
                let in_front = (origin - e.corners[0]).dot(e.normal) > 0.0;
                let response = receiver.response_to_triangle(e.corners.map(|c| c - origin));
                e.radiance.mean()
                    * if in_front || e.both_sides {
                        response
                    } else {
                        0.0
                    }
            };
            let sum: f32 = emitters.all().iter().map(send).sum();
            let cut = LightCut::new(tree, emitters.all(), origin, receiver, 0.03);
            let error = cut.light().mean() / sum - 1.0;
            squares += error * error;
            assert!(cut.len() < most, "{}", cut.len());
        }
        let error = (squares / 60.0).sqrt();
        assert!(error < limit, "{g}: {error}");
    }
}

/// Rays of a bake and those of shading, with a wall that hides half of the emitters.
#[test]
fn the_mean_over_rays_is_the_sum_over_all_lights() {
    let mut scene = scene_of_emitters(200, 7);
    let open = scene_of_emitters(200, 7);
    // A wall across the box.
    let first = scene.mesh.positions.len() as u32;
    for (y, z) in [(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)] {
        scene.mesh.positions.push(Vec3::new(0.4, y, z));
    }
    let quad = [[0, 1, 2], [0, 2, 3]].map(|t| t.map(|i| first + i));
    scene.mesh.triangles.extend(quad);
    scene.mesh.material.extend([200; 2]);
    scene.materials.push(Material::diffuse("", [0.5; 3]));
    let emitters = Emitters::new(&open);
    let tracer = Tracer::new(&scene);
    for (baking, tolerance) in [(true, 0.005), (false, 0.04)] {
        let mut lights = Lights::<SceneMedia>::new(&tracer);
        if baking {
            lights = lights.for_baking();
        }
        for (point, receiver, _) in receivers(&emitters, 200, 8).into_iter().take(12) {
            let rays = ShadowRays::Sequence {
                per_light: 16_384,
                first: 0,
                seed: 9,
            };
            let found = match receiver {
                Either::Surface(SurfaceReceiver { normal, .. }) => {
                    lights.irradiance(point, normal, normal, rays)
                }
                Either::Medium => {
                    let mut direct = lights.mean_radiance(point, rays);
                    direct.unshadowed *= 4.0 * std::f32::consts::PI;
                    direct
                }
            };
            let is_seen = |p: Vec3| {
                let way = p - point;
                let end = crate::trace::short_of(p, way.length());
                !tracer.is_occluded(&Ray::new(point, way.normalize(), end))
            };
            let exact = (0..200).fold(Rgb::BLACK, |sum, i| {
                sum + arriving(&emitters.all()[i as usize], point, receiver, is_seen)
            });
            let whole = exact.mean().max(1e-2 * found.unshadowed.mean());
            for c in 0..3 {
                let error = (found.light().0[c] - exact.0[c]) / whole;
                assert!(error.abs() < tolerance, "{baking}: {error}");
            }
        }
    }
}

/// What arrives of an emitter's points that are seen, by 256 parts of it.
fn arriving(e: &Emitter, origin: Vec3, receiver: Either, is_seen: impl Fn(Vec3) -> bool) -> Rgb {
    parts(e.corners, 4)
        .into_iter()
        .filter(|t| is_seen((t[0] + t[1] + t[2]) * (1.0 / 3.0)))
        .map(|corners| sends(&Emitter { corners, ..*e }, origin, receiver))
        .fold(Rgb::BLACK, |sum, light| sum + light)
}

/// A triangle in quarters, and those in quarters, and so on.
fn parts([a, b, c]: [Vec3; 3], times: u32) -> Vec<[Vec3; 3]> {
    if times == 0 {
        return vec![[a, b, c]];
    }
    let [p, q, r] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (a + c)];
    [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
        .into_iter()
        .flat_map(|t| parts(t, times - 1))
        .collect()
}

#[test]
fn one_light_or_none_and_lights_without_area_are_no_trouble() {
    let light = |corners: [Vec3; 3], radiance: f32| Emitter {
        corners,
        normal: Vec3::Z,
        radiance: Rgb::splat(radiance),
        area: 0.5
            * (corners[1] - corners[0])
                .cross(corners[2] - corners[0])
                .length(),
        both_sides: true,
        surface: 0,
    };
    let flat = light([Vec3::ZERO; 3], 1.0);
    assert!(LightTree::new(&[]).is_none());
    assert!(LightTree::new(&[flat, flat]).is_none());
    let one = light([Vec3::ZERO, Vec3::X, Vec3::Y], 2.0);
    // A hundred in one place.
    for all in [vec![flat, one], vec![one; 100]] {
        let tree = LightTree::new(&all).unwrap();
        let emitters = Emitters::of(all);
        for z in [-1.0, 1e-3, 3.0] {
            let at = Vec3::new(0.2, 0.2, z);
            let cut = LightCut::new(&tree, emitters.all(), at, MediumReceiver, 0.0);
            let (chances, none) = cut.chances(emitters.all().len());
            assert!((chances.iter().sum::<f32>() - 1.0).abs() < 1e-4 && none == 0.0);
            assert_eq!(chances[0] > 0.0, emitters.all().len() == 100);
        }
        // In its plane a light sends nothing.
        let beside = Vec3::new(3.0, 0.0, 0.0);
        let cut = LightCut::new(&tree, emitters.all(), beside, MediumReceiver, 0.0);
        assert!(cut.choose(0.5).is_none() && cut.light().is_black());
    }
}

#[test]
fn rays_of_sixteen_cells_take_every_stratum_of_many_lights_once() {
    for per_ray in [1, 4] {
        let mut found = vec![0; 16 * per_ray as usize];
        for cell in 0..16 {
            let rays = ShadowRays::Cells {
                cell,
                square: 0,
                first: 0,
                count: 1,
                seed: 3 + u64::from(cell),
                shared_seed: 3,
            };
            for i in 0..per_ray {
                let [u, v] = rays.point_of_many(i, per_ray);
                assert!((0.0..1.0).contains(&v));
                found[(u * (16 * per_ray) as f32) as usize] += 1;
            }
        }
        assert!(found.iter().all(|n| *n == 1), "{found:?}");
    }
}

/// A point light on a tilted ceiling, as exactly as can be told: the ceiling hides it from nothing
/// below.
#[test]
fn a_surface_that_holds_a_light_does_not_hide_its_light() {
    let mut scene = Scene::without_picture();
    let corners = [[-9.0, 2.3, -7.7], [8.3, 3.1, -6.1], [0.4, 2.6, 9.3]];
    scene.mesh.positions = corners.map(Vec3::from).to_vec().into();
    scene.mesh.triangles = vec![[0, 1, 2]].into();
    scene.mesh.material = vec![0].into();
    scene.materials = vec![Material::diffuse("ceiling", [0.5; 3])];
    let mut numbers = Numbers::new(5);
    for _ in 0..20 {
        let uv = sampling::triangle([numbers.unit(), numbers.unit()]);
        let position = crate::trace::Surface::new(&scene, 0, [uv[1], uv[2]]).position;
        scene.lights = vec![Light::Point {
            position,
            intensity: [1.0; 3],
        }];
        let tracer = Tracer::new(&scene);
        let lights = Lights::<SceneMedia>::new(&tracer);
        for i in 0..100 {
            let point = Vec3::new(numbers.unit(), -numbers.unit(), numbers.unit()) * 3.0;
            let rays = ShadowRays::Sequence {
                per_light: 1,
                first: 0,
                seed: i,
            };
            let on_floor = lights.irradiance(point, Vec3::Y, Vec3::Y, rays);
            assert!(on_floor.delta.mean() > 0.0, "{point}");
            let in_medium = lights.in_medium(point, rays, None, None);
            assert_eq!(in_medium.share, Rgb::splat(1.0), "{point}");
        }
    }
}

/// A sun that a board hides takes nothing from many emitters and adds nothing to them.
#[test]
fn a_hidden_sun_beside_many_emitters_brings_nothing() {
    let irradiance = |suns: usize| {
        let mut scene = scene_of_emitters(100, 4);
        let first = scene.mesh.positions.len() as u32;
        let board = [[-90.0, 3.0, -60.0], [90.0, 3.0, -60.0], [0.0, 3.0, 90.0]];
        scene.mesh.positions.extend(board.map(Vec3::from));
        scene.mesh.triangles.push([first, first + 1, first + 2]);
        scene.mesh.material.push(scene.materials.len() as u32);
        scene.materials.push(Material::diffuse("board", [0.0; 3]));
        let sun = Light::Directional {
            direction: -Vec3::Y,
            irradiance: [40.0; 3],
            angular_radius_rad: 0.005,
        };
        scene.lights.extend(std::iter::repeat_n(sun, suns));
        let tracer = Tracer::new(&scene);
        let lights = Lights::<SceneMedia>::new(&tracer);
        let mut numbers = Numbers::new(3);
        let mut sum = Rgb::BLACK;
        for i in 0..400 {
            let rays = ShadowRays::Sequence {
                per_light: 4,
                first: 0,
                seed: i,
            };
            let direct = lights.irradiance(numbers.place(), Vec3::Y, Vec3::Y, rays);
            sum += direct.ratio.of(direct.unshadowed);
        }
        sum.mean()
    };
    let (dark, hidden) = (irradiance(0), irradiance(1));
    assert!((hidden / dark - 1.0).abs() < 0.02, "{hidden} {dark}");
}
