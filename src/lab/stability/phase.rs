//! Phase functions: their own closed forms, single scattering by direction, light that surfaces get
//! from media, and white furnaces.

use super::field::Field;
use super::furnace::{self, Transport};
use super::row::Row;
use super::single_scattering::{above_slab, single, slab_in_the_sun};
use super::workbench::{
    Workbench, ball, gatherer, irradiance, mean, media, stage, unit_cube, volume,
};
use crate::Result;
use crate::math::PhaseFunction;
use crate::scene::{Grid, Light, Scene};
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Voxels across the ball's box of edge 1, and its radius.
const N: usize = 32;
const R: f32 = 0.45;
/// How far the camera's ray passes from the middle.
const RAY: f32 = 0.1;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let lobes = PhaseFunction::henyey_greenstein;
    let phases = [
        ("g -0.5", lobes(-0.5)),
        ("g 0.85", lobes(0.85)),
        (
            "g 0.9 and -0.2, mix 0.7",
            PhaseFunction::two_lobes([0.9, -0.2], 0.7),
        ),
    ];
    let mut rows = Vec::new();
    for (name, phase) in phases {
        closed_forms(name, phase, &mut rows);
        for angle_deg in [0.0, 20.0, 70.0, 150.0, 180.0_f32] {
            for (tau, limit) in [(1e-3, 1e-3), (1.0, 0.02)] {
                let scene = in_the_sun(tau, phase, angle_deg.to_radians());
                rows.push(Row::relative(
                    format!("{name}: a ball in the sun, {angle_deg} degrees from straight on"),
                    format!("depth {tau:e}"),
                    quadrature(&scene),
                    single(bench, &scene)?,
                    limit,
                ));
            }
        }
        for (tau, limit) in [(0.1, 0.1), (1.0, 0.1)] {
            above(bench, name, phase, tau, limit, &mut rows)?;
        }
        for (tau, limit, all_limit) in [(0.1, 2e-3, 2e-3), (1.0, 0.04, 0.035), (10.0, 0.02, 0.075)]
        {
            let picture = furnace::white_picture(bench, tau, phase, Transport::Once)?;
            let (expected, got) = (furnace::seen(tau, phase), mean(&picture));
            rows.push(Row::with_error(
                format!(
                    "{name}: white furnace, mean of all pixels, against two scatterings: difference"
                ),
                format!("depth {tau:e}"),
                (expected, got),
                (got - expected).abs(),
                limit,
            ));
            let all = furnace::white_picture(bench, tau, phase, Transport::All)?;
            rows.push(Row::relative(
                format!("{name}: white furnace, all scatterings, mean of all pixels"),
                format!("depth {tau:e}"),
                1.0,
                mean(&all),
                all_limit,
            ));
            let brightest = picture.iter().flatten().fold(0.0_f32, |a, &b| a.max(b));
            rows.push(Row::nothing(
                format!("{name}: white furnace, energy that the brightest pixel gains"),
                format!("depth {tau:e}"),
                (f64::from(brightest) - 1.0).max(0.0),
                1e-3,
            ));
        }
    }
    slabs(bench, lobes(0.85), &mut rows)?;
    let mirrored = |cos: f32| (lobes(0.7).value(cos) / lobes(-0.7).value(-cos) - 1.0).abs();
    let worst = (0..=100).map(|i| mirrored(0.02 * i as f32 - 1.0));
    rows.push(Row::nothing(
        "g turned into -g: the largest relative difference of mirrored values",
        "g 0.7",
        worst.fold(0.0, f32::max).into(),
        1e-5,
    ));
    Ok(rows)
}

/// Slabs of a forward lobe, against discrete ordinates (PythonicDISORT); lvoxels have one lobe for
/// all orders of scattering.
fn slabs(bench: &Workbench, phase: PhaseFunction, rows: &mut Vec<Row>) -> Result<()> {
    for (tau, reflects, lets_through, limits) in [
        (1.0, 0.0534, 0.9453, [0.02, 0.012]),
        (5.0, 0.2718, 0.7191, [0.09, 0.07]),
    ] {
        let found = slab(bench, tau, phase)?;
        for (what, expected, found, limit) in [
            ("reflects", reflects, found[0], limits[0]),
            ("lets through", lets_through, found[1], limits[1]),
        ] {
            rows.push(Row::with_error(
                format!(
                    "g 0.85: share that a slab {what} of a sun at a cosine of 0.9, all \
                     scatterings: difference"
                ),
                format!("depth {tau:e}"),
                (expected, found),
                (found - expected).abs(),
                limit,
            ));
        }
    }
    Ok(())
}

/// What a wide slab of albedo 0.999 reflects and lets through of the light of a sun at a cosine of
/// 0.9, in the light of all scatterings.
fn slab(bench: &Workbench, tau: f64, phase: PhaseFunction) -> Result<[f64; 2]> {
    const WIDE: usize = 64;
    const COS: f64 = 0.9;
    let cells = (tau / 0.7).ceil();
    let dims = [WIDE, cells as usize, WIDE];
    let size = DVec3::from(dims.map(|n| n as f64)) * (tau / cells);
    let in_scene = DAffine3::from_scale(size) * unit_cube(dims);
    let mut scene = stage(1, Vec3::Y, Vec3::ZERO, 1.0);
    let medium = volume(Grid::from_fn(dims, |_| 1.0), 0.999, in_scene);
    scene.volumes.push(medium.with_phase(phase));
    scene.lights.push(Light::Directional {
        direction: DVec3::new((1.0 - COS * COS).sqrt(), -COS, 0.0).as_vec3(),
        irradiance: [1.0 / COS as f32; 3],
        angular_radius_rad: 0.0,
    });
    let store = bench.bounced(&scene, bench.tree(&scene, 16)?)?;
    let media = media(&store)?;
    let gatherer = gatherer(&store, &media, 4096, 0.0);
    let away = 0.5 * size.y as f32 + 0.01;
    let beside = |y: f32| {
        irradiance(
            &gatherer,
            Vec3::new(0.013, y, 0.021),
            -Vec3::Y * y.signum(),
            1,
        )
    };
    Ok([beside(away), beside(-away) + (-tau / COS).exp()])
}

/// Integral and moments, over angles that crowd around both peaks.
fn closed_forms(name: &str, phase: PhaseFunction, rows: &mut Vec<Row>) {
    const STEPS: usize = 200_000;
    let mut found = [0.0; 9];
    let crowded = |i: usize| {
        let half = STEPS / 2;
        let t = i as f64 / half as f64;
        if i <= half {
            0.5 * PI * t * t
        } else {
            PI - 0.5 * PI * (2.0 - t) * (2.0 - t)
        }
    };
    for i in 0..STEPS {
        let (from, to) = (crowded(i), crowded(i + 1));
        let x = (0.5 * (from + to)).cos();
        let weight = 2.0 * PI * (from.cos() - to.cos()) * f64::from(phase.value(x as f32));
        let [mut last, mut p] = [1.0, x];
        for (l, sum) in found.iter_mut().enumerate() {
            let value = match l {
                0 => 1.0,
                1 => x,
                _ => {
                    let n = l as f64;
                    let next = ((2.0 * n - 1.0) * x * p - (n - 1.0) * last) / n;
                    (last, p) = (p, next);
                    next
                }
            };
            *sum += weight * value;
        }
    }
    rows.push(Row::relative(
        format!("{name}: integral over the sphere"),
        "all angles",
        1.0,
        found[0],
        1e-4,
    ));
    let worst = (1..9).map(|l| (found[l as usize] - f64::from(phase.moment(l))).abs());
    rows.push(Row::nothing(
        format!("{name}: largest difference of moments 1 to 8 from those of its values"),
        "all angles",
        worst.fold(0.0, f64::max),
        1e-4,
    ));
}

/// A ball in a sun that shines at an angle to the way on which light gets to the camera.
fn in_the_sun(tau: f64, phase: PhaseFunction, angle: f32) -> Scene {
    let sigma = (tau / f64::from(2.0 * R)) as f32;
    let mut scene = stage(1, Vec3::new(RAY, 0.0, 1.5), Vec3::new(RAY, 0.0, 0.0), 1e-6);
    let volume = volume(ball(N, R, sigma), 1.0, unit_cube([N; 3]));
    scene.volumes.push(volume.with_phase(phase));
    let (sin, cos) = (libm::sinf(angle), libm::cosf(angle));
    scene.lights.push(Light::Directional {
        direction: Vec3::new(0.6 * sin, 0.8 * sin, cos).normalize(),
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    });
    scene
}

/// The integral along the pixel's ray of sigma_s p T(camera) T(sun).
fn quadrature(scene: &Scene) -> f64 {
    const STEPS: usize = 4000;
    let volume = &scene.volumes[0];
    let field = Field::of(volume);
    let Light::Directional { direction, .. } = scene.lights[0] else {
        return f64::NAN;
    };
    let (origin, forward) = (DVec3::new(f64::from(RAY), 0.0, 1.5), -DVec3::Z);
    let to_sun = -direction.as_dvec3();
    let step = 1.0 / STEPS as f64;
    let parts: Vec<f64> = (0..STEPS)
        .into_par_iter()
        .map(|i| {
            let t = 1.0 + (i as f64 + 0.5) * step;
            let point = origin + forward * t;
            let sigma = field.at(point);
            if sigma == 0.0 {
                return 0.0;
            }
            let tau =
                field.optical_depth(origin, forward, t) + field.optical_depth(point, to_sun, 2.0);
            sigma * (-tau).exp()
        })
        .collect();
    let cos = direction.dot(Vec3::Z);
    parts.iter().sum::<f64>() * step * f64::from(volume.phase.value(cos))
}

/// What a surface above a cube of medium gets, gathered from lvoxels.
fn above(
    bench: &Workbench,
    name: &str,
    phase: PhaseFunction,
    tau: f64,
    limit: f64,
    rows: &mut Vec<Row>,
) -> Result<()> {
    const HEIGHT: f32 = 0.02;
    let scene = slab_in_the_sun(tau, phase);
    let store = bench.tree(&scene, 16)?;
    let media = media(&store)?;
    let gatherer = gatherer(&store, &media, 4096, 0.0);
    let point = Vec3::new(0.013, 0.5 + HEIGHT, 0.021);
    // Lvoxels know of a lobe by its mean cosine alone.
    let known = PhaseFunction::henyey_greenstein(phase.moment(1));
    rows.push(Row::relative(
        format!("{name}: a surface above a slab of 16 voxels under a sun"),
        format!("depth {tau:e}"),
        above_slab(tau, [0.013, HEIGHT, 0.021].map(f64::from), known),
        irradiance(&gatherer, point, -Vec3::Y, 1),
        limit,
    ));
    Ok(())
}
