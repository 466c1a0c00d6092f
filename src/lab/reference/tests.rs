//! Against closed forms.

use super::*;
use crate::math::polygon;
use crate::run::{Cancel, OnWarning};
use crate::scene::{
    Camera, EnvironmentImage, EnvironmentInput, Film, Grid, Light, Material, PhaseFunction, Volume,
};
use glam::{Affine3A, DAffine3, DVec3, Vec3};
use std::f32::consts::PI;

mod colored;
mod sky;

fn scene() -> Scene {
    Scene::empty(
        Camera {
            name: "main".into(),
            scene_from_camera: Affine3A::from_translation(Vec3::new(0.0, 0.0, 5.0)),
            fov_x_rad: 1.0,
            keys: Vec::new(),
            lens: None,
            shutter: None,
            path: Vec::new(),
        },
        Film {
            width: 20,
            height: 12,
            exposure: 1.0,
        },
    )
}

fn add_quad(scene: &mut Scene, corners: [Vec3; 4], albedo: f32, emission: f32, both: bool) {
    let mesh = &mut scene.mesh;
    let n = mesh.positions.len() as u32;
    mesh.positions.extend(corners);
    mesh.triangles
        .extend([[n, n + 1, n + 2], [n, n + 2, n + 3]]);
    let material = scene.materials.len() as u32;
    mesh.material.extend([material; 2]);
    scene.materials.push(Material {
        emission: [emission, 0.5 * emission, 2.0 * emission],
        emits_both_sides: both,
        ..Material::diffuse("quad", [albedo; 3])
    });
}

/// A closed box from -1 to 1 whose sides face inwards.
fn add_box(scene: &mut Scene, albedo: f32, emission: f32) {
    for axis in 0..3 {
        for side in [-1.0_f32, 1.0] {
            let at = |u: f32, v: f32| {
                let mut p = [0.0; 3];
                p[axis] = side;
                p[(axis + 1) % 3] = u;
                p[(axis + 2) % 3] = -side * v;
                Vec3::from(p)
            };
            let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
            add_quad(scene, corners, albedo, emission, false);
        }
    }
}

/// A constant medium in a box.
fn add_medium(scene: &mut Scene, min: DVec3, max: DVec3, sigma_t: f32, albedo: f32) {
    let dims = [3, 2, 17];
    let size = max - min;
    let scene_from_index =
        DAffine3::from_translation(min) * DAffine3::from_scale(size / DVec3::new(3.0, 2.0, 17.0));
    let grid = Grid::from_fn(dims, |_| sigma_t);
    let volume = Volume::new("medium".into(), grid, [albedo; 3], scene_from_index);
    scene.volumes.push(volume);
}

/// Mean of many paths, its green channel.
fn radiance(scene: &Scene, max_depth: u32, origin: Vec3, direction: Vec3) -> f64 {
    let paths = PathTracer::new(scene, max_depth, &Cancel::default()).unwrap();
    let n = 1 << 13;
    let sum: f64 = (0..n)
        .map(|i| {
            let mut sampler = Sampler::new(17, i);
            f64::from(
                paths
                    .radiance(origin, direction.normalize(), &mut sampler)
                    .0[1],
            )
        })
        .sum();
    sum / f64::from(n)
}

#[track_caller]
fn near(got: f64, expected: f64, relative: f64) {
    assert!(
        (got - expected).abs() <= relative * expected,
        "{got} against {expected}"
    );
}

#[test]
fn a_closed_glowing_box_is_a_neumann_series() {
    let mut scene = scene();
    add_box(&mut scene, 0.6, 2.0);
    let (origin, direction) = (Vec3::new(0.3, -0.2, 0.1), Vec3::new(0.5, 0.7, -0.3));
    near(radiance(&scene, 1, origin, direction), 1.0, 1e-6);
    near(radiance(&scene, 2, origin, direction), 1.6, 3e-3);
    near(radiance(&scene, 3, origin, direction), 1.96, 3e-3);
    near(radiance(&scene, 0, origin, direction), 2.5, 5e-3);
}

#[test]
fn a_medium_that_absorbs_nothing_does_not_show_in_a_furnace() {
    for sigma_t in [0.1, 2.0, 12.0] {
        let mut scene = scene();
        scene.lights.push(Light::Environment { radiance: [0.7; 3] });
        add_medium(&mut scene, DVec3::splat(-1.0), DVec3::ONE, sigma_t, 1.0);
        // A second one that overlaps.
        add_medium(
            &mut scene,
            DVec3::ZERO,
            DVec3::splat(2.0),
            0.5 * sigma_t,
            1.0,
        );
        near(
            radiance(&scene, 0, Vec3::new(0.1, 0.2, 4.0), -Vec3::Z),
            0.7,
            0.01,
        );
        let mut scene = self::scene();
        add_box(&mut scene, 0.5, 1.0);
        add_medium(&mut scene, DVec3::splat(-0.9), DVec3::ONE, sigma_t, 1.0);
        near(
            radiance(&scene, 0, Vec3::new(0.1, 0.2, 0.4), Vec3::X),
            1.0,
            0.015,
        );
    }
}

#[test]
fn nor_does_one_whatever_its_phase_function() {
    for phase in [
        PhaseFunction::henyey_greenstein(0.85),
        PhaseFunction::henyey_greenstein(-0.6),
        PhaseFunction::two_lobes([0.9, -0.2], 0.7),
    ] {
        let mut scene = scene();
        scene.lights.push(Light::Environment { radiance: [0.7; 3] });
        add_medium(&mut scene, DVec3::splat(-1.0), DVec3::ONE, 4.0, 1.0);
        scene.volumes[0].phase = phase;
        let from = Vec3::new(0.1, 0.2, 4.0);
        near(radiance(&scene, 0, from, -Vec3::Z), 0.7, 0.01);
        let mut scene = self::scene();
        add_box(&mut scene, 0.5, 1.0);
        add_medium(&mut scene, DVec3::splat(-0.9), DVec3::ONE, 4.0, 1.0);
        scene.volumes[0].phase = phase;
        let from = Vec3::new(0.1, 0.2, 0.4);
        // Three times the noise of so many paths.
        near(radiance(&scene, 0, from, Vec3::X), 1.0, 0.025);
    }
}

#[test]
fn a_slab_in_the_sun_scatters_by_its_phase_function() {
    // The angle between the directions of travel of the sun's light and of what the camera sees.
    let (sun, view) = (Vec3::new(0.6, 0.0, -0.8), Vec3::new(0.0, 0.8, -0.6));
    for (phase, towards) in [
        (PhaseFunction::henyey_greenstein(0.85), -view),
        (PhaseFunction::henyey_greenstein(-0.5), -view),
        (PhaseFunction::two_lobes([0.9, -0.2], 0.7), -view),
    ] {
        let mut scene = scene();
        let wide = DVec3::new(500.0, 500.0, 0.5);
        add_medium(&mut scene, -wide, wide, 1.0, 0.8);
        scene.volumes[0].phase = phase;
        scene.lights.push(Light::Directional {
            direction: sun,
            irradiance: [3.0; 3],
            angular_radius_rad: 0.0,
        });
        let rates = 1.0 / 0.6 + 1.0 / 0.8;
        let scattered = 0.8 * 3.0 * f64::from(phase.value(sun.dot(towards)));
        let expected = scattered / 0.6 / rates * -f64::from(-rates as f32).exp_m1();
        let origin = Vec3::new(0.0, -4.0, 3.0);
        near(radiance(&scene, 2, origin, view), expected, 0.05);
    }
}

#[test]
fn a_conservative_slab_lets_through_what_the_mean_cosine_says() {
    // Isotropic light on one side, T = (4/3) / ((1 - g) tau + 1.4208): within 0.1 % at g = 0 from
    // a depth of 5 on, and some percent for others.
    for (g, tau, limit) in [(0.0, 5.0, 0.01), (0.85, 20.0, 0.03)] {
        let mut scene = scene();
        let at = |x: f32, y: f32| Vec3::new(x, y, -1.0);
        let wide = 400.0;
        let corners = [
            at(-wide, -wide),
            at(wide, -wide),
            at(wide, wide),
            at(-wide, wide),
        ];
        add_quad(&mut scene, corners, 0.0, 2.0, false);
        let wide = DVec3::new(400.0, 400.0, 0.5);
        add_medium(&mut scene, -wide, wide, tau, 1.0);
        scene.volumes[0].phase = PhaseFunction::henyey_greenstein(g);
        let n = 1 << 13;
        let paths = PathTracer::new(&scene, 0, &Cancel::default()).unwrap();
        let sum: f64 = (0..n)
            .map(|i| {
                let mut sampler = Sampler::new(23, i);
                let [u, v, ..] = sampler.next4();
                let d = crate::math::sampling::cosine_hemisphere([u, v]);
                let origin = Vec3::new(0.0, 0.0, 0.6);
                f64::from(paths.radiance(origin, -d, &mut sampler).0[1])
            })
            .sum();
        let expected = (4.0 / 3.0) / f64::from((1.0 - g) * tau + 1.4208);
        near(sum / f64::from(n), expected, limit + 0.02);
    }
}

#[test]
fn a_slab_lets_through_what_beer_and_lambert_say() {
    for tau in [1e-3_f32, 0.5, 4.0] {
        for max_depth in [1, 2, 0] {
            let mut scene = scene();
            let at = |x: f32, y: f32| Vec3::new(x, y, -1.0);
            let corners = [at(-9.0, -9.0), at(9.0, -9.0), at(9.0, 9.0), at(-9.0, 9.0)];
            add_quad(&mut scene, corners, 0.0, 2.0, false);
            let wide = DVec3::new(50.0, 50.0, 0.5);
            add_medium(&mut scene, -wide, wide, tau, 0.0);
            let got = radiance(&scene, max_depth, Vec3::new(0.0, 0.0, 3.0), -Vec3::Z);
            let expected = f64::from(-tau).exp();
            // Three times the noise of tracking.
            near(
                got,
                expected,
                3.0 * (-f64::from(-tau).exp_m1() / expected / 8192.0).sqrt(),
            );
        }
    }
}

#[test]
fn single_scattering_of_a_slab_in_the_sun() {
    for (tau, split) in [(0.01_f64, false), (1.0, false), (1.0, true), (20.0, false)] {
        let mut scene = scene();
        let wide = DVec3::new(500.0, 500.0, 0.5);
        let (albedo, part) = if split { (0.8, 0.5) } else { (0.8, 1.0) };
        add_medium(&mut scene, -wide, wide, (part * tau) as f32, albedo);
        if split {
            // The other half of the extinction absorbs all.
            add_medium(&mut scene, -wide, wide, (0.5 * tau) as f32, 0.0);
        }
        let (mu0, mu) = (0.8_f64, 0.6_f64);
        scene.lights.push(Light::Directional {
            direction: Vec3::new(0.6, 0.0, -0.8),
            irradiance: [3.0; 3],
            angular_radius_rad: 0.0,
        });
        let rates = 1.0 / mu + 1.0 / mu0;
        let expected =
            0.8 * part * 3.0 / (4.0 * std::f64::consts::PI) / mu / rates * -(-tau * rates).exp_m1();
        let view = Vec3::new(0.0, 0.8, -0.6);
        let origin = Vec3::new(0.0, -4.0, 3.0);
        near(radiance(&scene, 2, origin, view), expected, 0.05);
    }
}

#[test]
fn a_rectangle_lights_a_floor_as_its_form_factor_says() {
    // From far, and so near that most of the light is found by the path itself.
    for (height, both) in [(2.0, false), (0.3, true), (0.02, false)] {
        let mut scene = scene();
        let floor = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let corners = [
            floor(-9.0, 9.0),
            floor(9.0, 9.0),
            floor(9.0, -9.0),
            floor(-9.0, -9.0),
        ];
        add_quad(&mut scene, corners, 0.5, 0.0, false);
        let corner = |x: f32, z: f32| Vec3::new(x, height, z);
        let corners = [
            corner(-0.5, -0.5),
            corner(1.0, -0.5),
            corner(1.0, 0.5),
            corner(-0.5, 0.5),
        ];
        add_quad(&mut scene, corners, 0.0, 4.0, both);
        let point = Vec3::new(0.2, 0.0, 0.1);
        let [a, b, c, d] = corners.map(|p| p - point);
        let irradiance = 2.0
            * (polygon::irradiance([a, b, c], Vec3::Y) + polygon::irradiance([a, c, d], Vec3::Y));
        let expected = f64::from(0.5 * irradiance / PI);
        let origin = Vec3::new(point.x, 0.5 * height, point.z);
        near(radiance(&scene, 2, origin, -Vec3::Y), expected, 6e-3);
        if !both {
            // The emitter's back is dark.
            let above = Vec3::new(0.2, 3.0 * height, 0.1);
            assert_eq!(radiance(&scene, 1, above, -Vec3::Y), 0.0);
        }
    }
}

#[test]
fn lights_without_size_send_their_irradiance() {
    let floor = |lights: Vec<Light>| {
        let mut scene = scene();
        let at = |x: f32, z: f32| Vec3::new(x, 0.0, z);
        let corners = [at(-9.0, 9.0), at(9.0, 9.0), at(9.0, -9.0), at(-9.0, -9.0)];
        add_quad(&mut scene, corners, 0.5, 0.0, false);
        scene.lights = lights;
        radiance(&scene, 2, Vec3::new(0.0, 1.0, 0.0), -Vec3::Y)
    };
    let point = Light::Point {
        position: Vec3::new(3.0, 4.0, 0.0),
        intensity: [2.0; 3],
    };
    let spot = Light::Spot {
        position: Vec3::new(0.0, 2.0, 0.0),
        direction: -Vec3::Y,
        intensity: [1.0; 3],
        cos_inner: 1.0 + 0.2,
        cos_outer: 1.0 - 0.2,
    };
    let sun = |angular_radius_rad| Light::Directional {
        direction: Vec3::new(0.0, -0.6, 0.8),
        irradiance: [5.0; 3],
        angular_radius_rad,
    };
    let half = 0.5 / std::f64::consts::PI;
    let expected = [2.0 * 0.8 / 25.0, 0.5 / 4.0, 5.0 * 0.6, 5.0 * 0.6];
    let lights = [point, spot, sun(0.0), sun(0.2)];
    for (light, e) in lights.iter().zip(expected) {
        near(floor(vec![light.clone()]), half * e, 5e-3);
    }
    let all: f64 = expected.iter().sum();
    near(floor(lights.to_vec()), half * all, 0.01);
    let up = Light::Directional {
        direction: Vec3::new(0.0, 0.6, 0.8),
        irradiance: [5.0; 3],
        angular_radius_rad: 0.0,
    };
    assert_eq!(floor(vec![up]), 0.0);
    let environment = Light::Environment { radiance: [2.0; 3] };
    near(floor(vec![environment]), 1.0, 1e-3);
}

fn demo() -> Scene {
    let mut scene = scene();
    add_box(&mut scene, 0.6, 0.0);
    let at = |x: f32, z: f32| Vec3::new(x, 0.9, z);
    let corners = [at(-0.3, -0.3), at(0.3, -0.3), at(0.3, 0.3), at(-0.3, 0.3)];
    add_quad(&mut scene, corners, 0.0, 9.0, true);
    add_medium(&mut scene, DVec3::splat(-0.8), DVec3::splat(0.2), 4.0, 0.7);
    // Through the open front.
    scene.mesh.triangles.to_mut().drain(10..12);
    scene.mesh.material.to_mut().drain(10..12);
    scene
}

fn settings(spp: u32) -> Settings {
    Settings {
        spp: Some(spp),
        ..Settings::default()
    }
}

fn render(scene: &Scene, settings: &Settings, region: Region) -> Sums {
    let job = Job::default();
    let mut sums = begin(scene, settings, region, &job).unwrap();
    accumulate(scene, settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    sums
}

#[test]
fn tiles_and_threads_do_not_matter() {
    let scene = demo();
    let full = Region::full(20, 12);
    let whole = render(&scene, &settings(6), full);
    assert!(relmse(&whole) > 0.0);
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .unwrap();
    assert_eq!(
        pool.install(|| render(&scene, &settings(6), full)).rows,
        whole.rows
    );
    let tile = Region {
        x0: 7,
        y0: 4,
        x1: 13,
        y1: 9,
    };
    let part = render(&scene, &settings(6), tile);
    let cut = |region: &Region| {
        let frame = frame(&scene, &whole);
        let mut pictures = Vec::new();
        for layer in ["", "variance"] {
            pictures.push(frame.picture(layer, region).unwrap());
        }
        pictures
    };
    let own = frame(&scene, &part);
    assert_eq!(own.picture("", &tile).unwrap(), cut(&tile)[0]);
    assert_eq!(own.picture("variance", &tile).unwrap(), cut(&tile)[1]);
}

#[test]
fn a_later_run_goes_on_with_the_same_bits() {
    let scene = demo();
    let full = Region::full(20, 12);
    let dir = tempfile::tempdir().unwrap();
    let (once, twice) = (dir.path().join("once.exr"), dir.path().join("twice.exr"));
    let job = Job::default();
    run(&scene, &settings(9), full, &once, Start::Resume, &job).unwrap();
    run(&scene, &settings(2), full, &twice, Start::Resume, &job).unwrap();
    run(&scene, &settings(9), full, &twice, Start::Resume, &job).unwrap();
    let bytes = |path: &Path| std::fs::read(path).unwrap();
    assert!(bytes(&once) == bytes(&twice));
    assert!(bytes(&sums_path(&once)) == bytes(&sums_path(&twice)));
    let other = Settings {
        max_depth: 2,
        ..settings(9)
    };
    let error = run(&scene, &other, full, &twice, Start::Resume, &job).unwrap_err();
    assert_eq!(error.kind(), crate::Kind::Input);
    run(&scene, &other, full, &twice, Start::Afresh, &job).unwrap();
}

#[test]
fn a_stop_keeps_what_is_there() {
    let scene = demo();
    let full = Region::full(20, 12);
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.exr");
    let job = Job::default();
    run(&scene, &settings(3), full, &path, Start::Resume, &job).unwrap();
    let before = std::fs::read(&path).unwrap();
    job.cancel.request();
    let error = run(&scene, &settings(30), full, &path, Start::Resume, &job).unwrap_err();
    assert_eq!(error.kind(), crate::Kind::Cancelled);
    assert!(error.hint_text().unwrap().contains("3 to 3 samples"));
    assert!(std::fs::read(&path).unwrap() == before);
}

#[test]
fn time_ends_a_run_too() {
    let scene = demo();
    let timed = Settings {
        spp: None,
        secs: Some(0.05),
        ..Settings::default()
    };
    let sums = render(&scene, &timed, Region::full(20, 12));
    assert!(sums.counts().0 >= 1);
}

#[test]
fn the_first_camera_goes_on_by_its_name() {
    let (scene, job) = (scene(), Job::default());
    let by = |camera: Option<&str>| {
        let settings = Settings {
            camera: camera.map(Into::into),
            ..Settings::default()
        };
        begin(&scene, &settings, Region::full(20, 12), &job)
    };
    let sums = by(None).unwrap();
    assert_eq!(sums, by(Some("main")).unwrap());
    assert_eq!(sums.origin.code, CODE);
    assert_eq!(CODE.len(), 32);
    let image = frame(&scene, &sums);
    assert!(image.attributes["lvox/settings"].contains(r#""camera":"main""#));
    assert!(by(Some("other")).is_err());
}

#[test]
fn samples_that_are_not_finite_are_told_by_every_run_that_has_them() {
    let dir = tempfile::tempdir().unwrap();
    let image = dir.path().join("a.exr");
    let mut scene = scene();
    scene.lights.push(Light::Environment {
        radiance: [f32::INFINITY; 3],
    });
    let region = Region::full(scene.film.width, scene.film.height);
    let warned = |spp: u32, on_warning: OnWarning| {
        let settings = Settings {
            spp: Some(spp),
            ..Settings::default()
        };
        let job = Job {
            on_warning,
            ..Job::default()
        };
        let done = run(&scene, &settings, region, &image, Start::Resume, &job);
        (job.progress.warnings(), done.map_err(|e| e.to_string()))
    };
    let told = |n: u32| format!("{n} samples were infinite or not a number and count as black");
    // Warned of as they come and, with nothing left to do, once more.
    for _ in 0..2 {
        assert_eq!(warned(2, OnWarning::GoOn), (vec![told(480)], Ok(())));
    }
    let (_, refused) = warned(2, OnWarning::Fail);
    let message = refused.unwrap_err();
    assert!(message.ends_with(&told(480)), "{message}");
    assert_eq!(warned(3, OnWarning::GoOn).0, [told(480), told(720)]);
}
