//! Media whose extinction has a colour, against closed forms and against grey media by channel.

use super::super::flight;
use super::*;
use crate::math::Ray;
use crate::scene::{Emission, EmissiveInput, SceneBuilder};

const COLOR: [f32; 3] = [0.25, 1.0, 0.6];

/// A box of a constant medium of that extinction in its densest channel.
fn medium(sigma_t: f32, albedo: [f32; 3], color: [f32; 3]) -> Volume {
    let mut scene = scene();
    add_medium(&mut scene, -DVec3::ONE, DVec3::ONE, sigma_t, 1.0);
    let mut volume = scene.volumes.remove(0).with_extinction_color(color);
    volume.albedo = albedo;
    volume
}

/// One whose extinction differs from voxel to voxel.
fn uneven(most: f32, color: [f32; 3]) -> Volume {
    let grid = Grid::from_fn([13, 20, 17], |[i, j, k]| {
        let v = sampling::unit(sampling::hash(&[i as u64, j as u64, k as u64]));
        if v < 0.3 { 0.0 } else { most * v }
    });
    let place = DAffine3::from_translation(DVec3::new(-1.0, -0.6, -0.9))
        * DAffine3::from_scale(DVec3::splat(0.1));
    Volume::new("uneven".into(), grid, [0.9; 3], place).with_extinction_color(color)
}

/// Means of many samples, and the standard deviations of these.
fn means(n: u32, mut sample: impl FnMut(&mut Sampler) -> Rgb) -> [[f64; 2]; 3] {
    let mut sums = [[0.0; 2]; 3];
    for i in 0..n {
        let Rgb(light) = sample(&mut Sampler::new(23, i));
        for (sum, v) in sums.iter_mut().zip(light.map(f64::from)) {
            *sum = [sum[0] + v, sum[1] + v * v];
        }
    }
    let n = f64::from(n);
    sums.map(|[sum, squares]| {
        let mean = sum / n;
        [mean, ((squares / n - mean * mean) / n).max(0.0).sqrt()]
    })
}

/// The same of the light along a camera ray.
fn seen(scene: &Scene, max_depth: u32, origin: Vec3, direction: Vec3) -> [[f64; 2]; 3] {
    let paths = PathTracer::new(scene, max_depth, &Cancel::default()).unwrap();
    let direction = direction.normalize();
    means(1 << 20, |sampler| {
        paths.radiance(origin, direction, sampler)
    })
}

#[test]
fn every_channel_gets_through_by_its_own_extinction() {
    let (tau, behind) = (3.0, 0.8);
    let mut colored = vec![medium(0.5 * tau, [0.9; 3], COLOR)];
    // A second one of another colour, and a grey one, in the same place.
    colored.push(medium(0.5 * behind, [0.5; 3], [1.0, 0.0, 0.3]));
    colored.push(medium(0.1, [0.5; 3], [1.0; 3]));
    let depths =
        [0, 1, 2].map(|c| f64::from(tau * COLOR[c] + behind * [1.0, 0.0, 0.3][c] + 2.0 * 0.1));
    let ray = Ray::endless(Vec3::new(0.2, 0.3, 4.0), -Vec3::Z);
    let by_ratio = means(1 << 16, |s| flight::transmittance(&colored, &ray, s));
    let by_flights = means(1 << 16, |s| {
        let mut throughput = Rgb::splat(1.0);
        let first = s.next4()[0];
        match flight::collide(&colored, &ray, first, &mut throughput, s) {
            None => throughput,
            Some(_) => Rgb::BLACK,
        }
    });
    for c in 0..3 {
        let expected = (-depths[c]).exp();
        for [mean, sigma] in [by_ratio[c], by_flights[c]] {
            assert!(
                (mean - expected).abs() < 4.0 * sigma,
                "channel {c}: {mean} against {expected}, sigma {sigma}"
            );
            assert!(sigma < 0.01 * expected.sqrt(), "channel {c}: sigma {sigma}");
        }
    }
}

#[test]
fn a_colored_medium_is_three_grey_ones() {
    let (origin, direction) = (Vec3::new(0.1, 0.2, 0.95), Vec3::new(0.1, -0.2, -1.0));
    let albedo = [0.95, 0.8, 0.4];
    let lit = |volumes: Vec<Volume>| {
        let mut scene = scene();
        add_box(&mut scene, 0.5, 0.0);
        let at = |x: f32, z: f32| Vec3::new(x, 0.9, z);
        let corners = [at(-0.5, -0.5), at(0.5, -0.5), at(0.5, 0.5), at(-0.5, 0.5)];
        add_quad(&mut scene, corners, 0.0, 4.0, true);
        scene.lights.push(Light::Point {
            position: Vec3::new(-0.5, -0.6, 0.4),
            intensity: [0.8; 3],
        });
        scene.volumes = volumes;
        scene
    };
    let phase = PhaseFunction::henyey_greenstein(0.4);
    let media = |color: [f32; 3], first: f32, second: f32| {
        let ball = uneven(second, color).with_phase(phase);
        vec![medium(first, albedo, color), ball]
    };
    for (first, second) in [(0.4, 1.0), (1.0, 5.0)] {
        let colored = seen(&lit(media(COLOR, first, second)), 0, origin, direction);
        for c in 0..3 {
            let share = COLOR[c];
            let grey = media([1.0; 3], first * share, second * share);
            let grey = seen(&lit(grey), 0, origin, direction)[c];
            let sigma = colored[c][1].hypot(grey[1]);
            let difference = (colored[c][0] - grey[0]).abs();
            assert!(
                difference < 4.0 * sigma && sigma < 0.03 * grey[0],
                "channel {c}: {:?} against {grey:?}",
                colored[c]
            );
            // No weight of a path for three channels is above 3.
            assert!(colored[c][1] < 3.0 * grey[1], "{:?} {grey:?}", colored[c]);
        }
    }
}

#[test]
fn emissive_volumes_are_seen_through_it_by_channel() {
    let cube = |value: f32| Grid::from_fn([16; 3], |_| value);
    let place = DAffine3::from_scale(DVec3::splat(1.0 / 16.0));
    let even = Emission::Proportional { radiance: [1.0; 3] };
    let fire = EmissiveInput::new("fire", cube(1.0), even, place);
    let builder = SceneBuilder::new("fire").emissive(fire);
    let mut scene = builder.build().expect("the scene is right");
    // Smoke of a depth of 2 where the fire is.
    let place = scene.emissive[0].values.scene_from_index;
    let smoke = Volume::new("smoke".into(), cube(2.0), [0.0; 3], place);
    scene.volumes.push(smoke.with_extinction_color(COLOR));
    let bounds = scene.volumes[0].bounds();
    let center = (bounds.min + bounds.max) * 0.5;
    // Paths that end on their first segment, and those that could go on.
    for max_depth in [1, 0] {
        let found = seen(&scene, max_depth, center + Vec3::Z * 3.0, -Vec3::Z);
        for (c, [mean, sigma]) in found.into_iter().enumerate() {
            let tau = f64::from(2.0 * COLOR[c]);
            let expected = -(-tau).exp_m1() / tau;
            assert!(
                (mean - expected).abs() < 4.0 * sigma + 1e-3 && sigma < 0.01,
                "channel {c}: {mean} against {expected}, sigma {sigma}"
            );
        }
    }
}

#[test]
fn flights_keep_the_sum_of_what_paths_carry() {
    let ray = Ray::endless(Vec3::new(0.1, 0.2, 4.0), Vec3::new(-0.02, -0.05, -1.0));
    for (most, color) in [
        (2.0, COLOR),
        (60.0, COLOR),
        (60.0, [1.0, 0.0, 0.01]),
        (60.0, [0.999, 0.998, 1.0]),
    ] {
        let volumes = [uneven(most, color), medium(0.2 * most, [1.0; 3], COLOR)];
        let mut ends = [0; 2];
        for i in 0..20_000 {
            let mut sampler = Sampler::new(5, i);
            let [first, r, g, b] = sampler.next4();
            let mut throughput = Rgb([r, g, if i % 2 == 0 { b } else { 0.0 }]);
            let sum = |Rgb([r, g, b]): Rgb| r + g + b;
            let before = sum(throughput);
            let found = flight::collide(&volumes, &ray, first, &mut throughput, &mut sampler);
            ends[usize::from(found.is_some())] += 1;
            let after = sum(throughput);
            assert!(
                (after / before - 1.0).abs() < 1e-3 && throughput.0.iter().all(|v| *v >= 0.0),
                "{throughput:?}: {after} after {before}"
            );
        }
        assert!(most > 10.0 || ends.iter().all(|n| *n > 100), "{ends:?}");
    }
}

#[test]
fn grey_media_beside_it_leave_colors_alone() {
    let ray = Ray::endless(Vec3::new(0.1, 0.2, 4.0), -Vec3::Z);
    let grey = || medium(1.0, [1.0; 3], [1.0; 3]);
    // One so thin that nothing collides with it.
    let colored = medium(1e-30, [1.0; 3], COLOR);
    let (alone, beside) = ([grey()], [grey(), colored]);
    for i in 0..2_000 {
        let collide = |volumes: &[Volume]| {
            let mut sampler = Sampler::new(3, i);
            let [first, r, g, b] = sampler.next4();
            let mut throughput = Rgb([r, g, b]);
            let found = flight::collide(volumes, &ray, first, &mut throughput, &mut sampler);
            assert_eq!(throughput, Rgb([r, g, b]));
            let through = flight::transmittance(volumes, &ray, &mut Sampler::new(3, i));
            (found, through)
        };
        assert_eq!(collide(&alone), collide(&beside));
    }
}
