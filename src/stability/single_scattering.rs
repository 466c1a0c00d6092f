//! Single scattering from a point light in a homogeneous sphere, against quadrature over the same voxels.

use super::field::Field;
use super::row::Row;
use super::workbench::{Workbench, pixels, stage, unit_cube, volume};
use crate::Result;
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
    // Limits at depths of 1e-3, 1 and 10: what comes through is interpolated between vertices 0.7 optical depths apart, and
    // that is seen where it falls steeply: at a rim that is lit from far away, and around a lamp in dense medium.
    for (name, light, limits) in [
        ("outside, at 2 R", at(2.0 * R), [1e-3, 0.03, 0.8]),
        ("outside, at 1.1 R", at(1.1 * R), [1e-3, 0.01, 0.1]),
        ("outside by 1e-6 R", at(R + near), [1e-3, 0.01, 0.1]),
        ("on the border", at(R), [1e-3, 0.01, 0.1]),
        ("inside by 1e-6 R", at(R - near), [1e-3, 0.01, 0.1]),
        ("inside, at R / 2", at(0.5 * R), [1e-3, 0.02, 0.05]),
        (
            "inside, 0.1 R from the ray",
            at(RAY + 0.1 * R),
            [1e-3, 0.03, 0.05],
        ),
        (
            "inside, 0.01 R from the ray",
            at(RAY + 0.01 * R),
            [1e-3, 0.06, 0.4],
        ),
        (
            "inside, 1e-6 R from the ray",
            at(RAY + near),
            [0.02, 0.1, 0.6],
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
    Ok(rows)
}

fn scene(tau: f64, light: Vec3) -> Scene {
    let sigma = (tau / f64::from(2.0 * R)) as f32;
    let grid = Grid::from_fn([N; 3], |v| {
        let r2: f32 = v
            .map(|c| (c as f32 + 0.5) / N as f32 - 0.5)
            .iter()
            .map(|c| c * c)
            .sum();
        if r2 < R * R { sigma } else { 0.0 }
    });
    let mut scene = stage(1, Vec3::new(RAY, 0.0, 1.5), Vec3::new(RAY, 0.0, 0.0), 1e-6);
    scene.volumes.push(volume(grid, 1.0, unit_cube([N; 3])));
    scene.lights.push(Light::Point {
        position: light,
        intensity: [1.0; 3],
    });
    scene
}

/// The pixel without what is scattered more than once: gathers reach nothing.
fn single(bench: &Workbench, scene: &Scene) -> Result<f64> {
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

/// The integral along the pixel's ray of sigma_s / (4 pi) T(camera) T(light) / d^2, over the angle at which the light sees
/// the ray, in which it is smooth however near they are (Kulla & Fajardo 2012).
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
