//! Single scattering from a point light in a homogeneous sphere, against quadrature over the same
//! voxels.

use super::field::Field;
use super::row::Row;
use super::workbench::{
    Workbench, ball, gatherer, irradiance, media, pixels, stage, unit_cube, volume,
};
use crate::Result;
use crate::math::PhaseFunction;
use crate::scene::{Grid, Light, Scene};
use crate::shade::Settings;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;

/// Voxels across the sphere's box of edge 1, and the sphere's radius.
const N: usize = 32;
const R: f32 = 0.45;
/// How far the camera's ray passes from the middle.
const RAY: f32 = 0.1;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let near = 1e-6 * R;
    let at = |x: f32| Vec3::new(x, 0.0, 0.013);
    // Limits at depths of 1e-3, 1 and 10.
    for (name, light, limits) in [
        ("outside, at 2 R", at(2.0 * R), [1e-3, 0.02, 0.15]),
        ("outside, at 1.1 R", at(1.1 * R), [1e-3, 0.01, 0.02]),
        ("outside by 1e-6 R", at(R + near), [1e-3, 0.01, 0.02]),
        ("on the border", at(R), [1e-3, 0.01, 0.02]),
        ("inside by 1e-6 R", at(R - near), [1e-3, 0.01, 0.02]),
        ("inside, at R / 2", at(0.5 * R), [1e-3, 0.01, 0.02]),
        (
            "inside, 0.1 R from the ray",
            at(RAY + 0.1 * R),
            [1e-3, 0.01, 0.02],
        ),
        (
            "inside, 0.01 R from the ray",
            at(RAY + 0.01 * R),
            [1e-3, 0.01, 0.05],
        ),
        (
            "inside, 1e-6 R from the ray",
            at(RAY + near),
            [0.01, 0.01, 0.02],
        ),
    ] {
        for (tau, limit) in [1e-3, 1.0, 10.0].into_iter().zip(limits) {
            let scene = scene(tau, light);
            let got = single(bench, &scene)?;
            rows.push(Row::relative(
                format!("light {name}"),
                format!("depth of the sphere {tau:e}"),
                quadrature(&scene),
                got,
                limit,
            ));
        }
    }
    slabs(bench, &mut rows)?;
    Ok(rows)
}

/// A cube of 16 voxels along an edge, so deep, of albedo 1, under a sun overhead.
pub fn slab_in_the_sun(tau: f64, phase: PhaseFunction) -> Scene {
    let mut scene = stage(1, Vec3::Y, Vec3::ZERO, 1.0);
    let grid = Grid::from_fn([16; 3], |_| tau as f32);
    let medium = volume(grid, 1.0, unit_cube([16; 3]));
    scene.volumes.push(medium.with_phase(phase));
    scene.lights.push(Light::Directional {
        direction: -Vec3::Y,
        irradiance: [1.0; 3],
        angular_radius_rad: 0.0,
    });
    scene
}

/// What surfaces get from a cube of medium under a sun overhead, gathered from lvoxels.
fn slabs(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const HEIGHT: f32 = 0.02;
    for tau in [0.1, 1.0, 10.0, 100.0, 1e3, 1e4] {
        let scene = slab_in_the_sun(tau, PhaseFunction::ISOTROPIC);
        let store = bench.tree(&scene, 16)?;
        let media = media(&store)?;
        let gatherer = gatherer(&store, &media, 4096, 0.0);
        let at_height = |y: f32, normal: Vec3| {
            let point = Vec3::new(0.013, y, 0.021);
            irradiance(&gatherer, point, normal, 1)
        };
        let place = [0.013, HEIGHT, 0.021].map(f64::from);
        let expected = above_slab(tau, place, PhaseFunction::ISOTROPIC);
        let at = format!("depth {tau:e}");
        // Lvoxels below 0.7 hold the light of one point.
        let limit = if tau <= 10.0 { 0.1 } else { 0.02 };
        let above = at_height(0.5 + HEIGHT, -Vec3::Y);
        let case = "a surface above a slab of 16 voxels under a sun";
        rows.push(Row::relative(case, at.clone(), expected, above, limit));
        if tau >= 100.0 {
            let below = at_height(-0.5 - HEIGHT, Vec3::Y);
            let case = "a surface below a slab of 16 voxels under a sun";
            rows.push(Row::nothing(case, at, below, 1e-6));
        }
    }
    Ok(())
}

fn scene(tau: f64, light: Vec3) -> Scene {
    let sigma = (tau / f64::from(2.0 * R)) as f32;
    let mut scene = stage(1, Vec3::new(RAY, 0.0, 1.5), Vec3::new(RAY, 0.0, 0.0), 1e-6);
    scene
        .volumes
        .push(volume(ball(N, R, sigma), 1.0, unit_cube([N; 3])));
    scene.lights.push(Light::Point {
        position: light,
        intensity: [1.0; 3],
    });
    scene
}

/// The pixel without what is scattered more than once: gathers reach nothing.
pub fn single(bench: &Workbench, scene: &Scene) -> Result<f64> {
    let settings = Settings {
        pixel_samples: 1,
        edge_samples: 1,
        volume_samples: 1,
        ..Settings::default()
    };
    let store = bench.tree_of(crate::formats::CloudMeta::default(), [], &[])?;
    let frame = bench.shade(scene, &store, &settings)?;
    Ok(f64::from(pixels(&frame, "volume")?[0][0]))
}

/// The integral along the pixel's ray of sigma_s / (4 pi) T(camera) T(light) / d^2, over the angle
/// at which the light sees the ray, in which it is smooth however near they are (Kulla & Fajardo
/// 2012).
fn quadrature(scene: &Scene) -> f64 {
    const STEPS: usize = 4000;
    let field = Field::of(&scene.volumes[0]);
    let Light::Point { position, .. } = scene.lights[0] else {
        return f64::NAN;
    };
    let light = position.as_dvec3();
    let (origin, forward) = (DVec3::new(f64::from(RAY), 0.0, 1.5), -DVec3::Z);
    let nearest = (light - origin).dot(forward);
    let distance = (origin + forward * nearest - light).length();
    let angle = |t: f64| ((t - nearest) / distance).atan();
    let (from, to) = (angle(1.0), angle(2.0));
    let step = (to - from) / STEPS as f64;
    let parts: Vec<f64> = (0..STEPS)
        .into_par_iter()
        .map(|i| {
            let t = nearest + distance * (from + (i as f64 + 0.5) * step).tan();
            let point = origin + forward * t;
            let sigma = field.at(point);
            if sigma == 0.0 {
                return 0.0;
            }
            let way = light - point;
            let tau = field.optical_depth(origin, forward, t)
                + field.optical_depth(point, way.normalize(), way.length());
            sigma * (-tau).exp()
        })
        .collect();
    parts.iter().sum::<f64>() * step / distance / (4.0 * PI)
}

/// Irradiance of a surface at `height` above the cube, which faces down: light that was scattered
/// once on a chord of length l, at a cosine of mu to the sun's way, is (1 - exp(-sigma l (1 + mu)))
/// / (1 + mu) of its irradiance over 4 pi, as much of it as the phase function scatters back.
pub fn above_slab(sigma_t: f64, [x, height, z]: [f64; 3], phase: PhaseFunction) -> f64 {
    const STEPS: usize = 500;
    let sum: f64 = (0..STEPS * STEPS)
        .map(|i| {
            let mu = (((i % STEPS) as f64 + 0.5) / STEPS as f64).sqrt();
            let angle = 2.0 * PI * ((i / STEPS) as f64 + 0.5) / STEPS as f64;
            let across = (1.0 - mu * mu).sqrt();
            let (dx, dz) = (across * angle.cos(), across * angle.sin());
            let end = |at: f64, d: f64| (0.5_f64.copysign(d) - at) / d;
            let far = end(x, dx).min(end(z, dz)).min((1.0 + height) / mu);
            let chord = (far - height / mu).max(0.0);
            let scattered = f64::from(phase.over_isotropic(-mu as f32));
            scattered * -(-sigma_t * chord * (1.0 + mu)).exp_m1() / (1.0 + mu)
        })
        .sum();
    0.25 * sum / (STEPS * STEPS) as f64
}
