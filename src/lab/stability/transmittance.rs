//! Transmittance and emission-absorption of homogeneous slabs and spheres.

use super::field::Field;
use super::row::Row;
use super::workbench::{
    Workbench, add_quad, ball, mean, media, media_with_source, pixels, stage, unit_cube, volume,
};
use crate::Result;
use crate::gather::Medium;
use crate::math::exp::{exp_neg, one_minus_exp_neg};
use crate::math::segment::Composite;
use crate::math::{Ray, Rgb};
use crate::scene::{Grid, Scene};
use crate::shade::Settings;
use crate::trace::Tracer;
use glam::Vec3;

/// Optical depths; exp(-69) is 1.1e-30.
const TAUS: [f64; 9] = [1e-8, 1e-6, 1e-4, 1e-2, 1.0, 10.0, 69.0, 1e2, 1e4];
const LIMIT: f64 = 1e-5;
/// Below this transmittance nothing is asked but that next to nothing comes through.
const OPAQUE: f64 = 1e-30;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    kernels(&mut rows);
    slabs(bench, &mut rows)?;
    spheres(bench, &mut rows)?;
    Ok(rows)
}

/// A transmittance at an optical depth: relative where there is any, else its size.
pub fn transmittance(case: &str, parameter: String, tau: f64, got: f64, limit: f64) -> Row {
    let expected = (-tau).exp();
    if expected > OPAQUE {
        Row::relative(case, parameter, expected, got, limit)
    } else {
        Row::nothing(case, parameter, got, OPAQUE)
    }
}

fn kernels(rows: &mut Vec<Row>) {
    for tau in TAUS.map(|t| t as f32) {
        let exact = f64::from(tau);
        let at = format!("tau {tau:e}");
        rows.push(transmittance(
            "exp(-tau), kernel",
            at.clone(),
            exact,
            exp_neg(tau).into(),
            LIMIT,
        ));
        let share = -(-exact).exp_m1() / exact;
        let got = f64::from(one_minus_exp_neg(tau)) / exact;
        rows.push(Row::relative(
            "(1 - exp(-tau)) / tau, kernel",
            at.clone(),
            share,
            got,
            LIMIT,
        ));
        // A slab in a hundred pieces of uneven depth.
        let pieces = 100;
        let mut light = Composite::default();
        let mut total = 0.0;
        for i in 0..pieces {
            let piece = tau * (0.5 + i as f32 / (pieces - 1) as f32) / pieces as f32;
            total += f64::from(piece);
            light.medium(piece, Rgb::splat(2.0));
        }
        rows.push(Row::relative(
            "emission-absorption of a slab in 100 pieces, kernel",
            at.clone(),
            -2.0 * (-total).exp_m1(),
            light.radiance.0[0].into(),
            LIMIT,
        ));
        rows.push(transmittance(
            "transmittance of a slab in 100 pieces, kernel",
            at,
            total,
            light.transmittance.into(),
            LIMIT,
        ));
    }
    for tau in [1e-30_f32, 1e-38] {
        let got = f64::from(one_minus_exp_neg(tau)) / f64::from(tau);
        let at = format!("tau {tau:e}");
        rows.push(Row::relative(
            "(1 - exp(-tau)) / tau, kernel",
            at,
            1.0,
            got,
            LIMIT,
        ));
    }
}

/// An emitter of radiance 4 behind a cube of fog around the origin, looked at along -z by one
/// pixel.
pub fn emitter_behind(grid: Grid, albedo: f32) -> Scene {
    let dims = grid.dims();
    let mut scene = stage(
        1,
        Vec3::new(0.03, 0.02, 2.0),
        Vec3::new(0.03, 0.02, 0.0),
        1e-4,
    );
    let corner = Vec3::new(-2.0, -2.0, -1.0);
    add_quad(&mut scene, [corner, 4.0 * Vec3::X, 4.0 * Vec3::Y], 0.0, 4.0);
    scene.volumes.push(volume(grid, albedo, unit_cube(dims)));
    scene
}

/// Few rays: these pictures have no noise.
pub fn brief() -> Settings {
    Settings {
        samples: 4,
        volume_samples: 4,
        shadow_rays: 1,
        ..Settings::default()
    }
}

fn slabs(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    for tau in TAUS {
        let at = format!("tau {tau:e}");
        let scene = emitter_behind(Grid::from_fn([32; 3], |_| tau as f32), 0.0);
        let tau = f64::from(tau as f32);
        let tracer = Tracer::new(&scene);
        let (origin, forward) = (Vec3::new(0.03, 0.02, 2.0), -Vec3::Z);
        let got = exp_neg(tracer.optical_depth(&Ray::new(origin, forward, 2.9)));
        rows.push(transmittance(
            "slab of 32^3 voxels, cells",
            at.clone(),
            tau,
            got.into(),
            LIMIT,
        ));

        let store = bench.tree(&scene, 16)?;
        let mut light = Composite::default();
        (&media(&store)?).pass(&Ray::new(origin, forward, 2.9), 0.0, &[], &mut light);
        let got = light.transmittance.into();
        rows.push(transmittance(
            "slab of 32^3 voxels, lvoxels of a tree",
            at.clone(),
            tau,
            got,
            LIMIT,
        ));

        let picture = pixels(&bench.shade(&scene, &store, &brief())?, "")?;
        rows.push(transmittance(
            "emitter behind a slab, whole pipeline",
            at.clone(),
            tau,
            mean(&picture) / 4.0,
            LIMIT,
        ));
        if tau <= 69.0 {
            let case = "slab of 32^3 voxels, cells, worst of 500 oblique rays";
            rows.push(oblique(case, &at, &scene, |origin, direction| {
                exp_neg(tracer.optical_depth(&Ray::new(origin, direction, 10.0)))
            }));
            let media = media(&store)?;
            let case = "slab of 32^3 voxels, lvoxels of a tree, worst of 500 oblique rays";
            rows.push(oblique(case, &at, &scene, |origin, direction| {
                let mut light = Composite::default();
                (&media).pass(&Ray::new(origin, direction, 10.0), 0.0, &[], &mut light);
                light.transmittance
            }));
        }

        // Light that a medium of source 0.5 sends: albedo 1 in an environment of 0.5, without what
        // is scattered twice.
        let media = &media_with_source(&store, [0.5; 3])?;
        let mut light = Composite::default();
        media.pass(&Ray::new(origin, forward, 2.9), 0.0, &[], &mut light);
        rows.push(Row::relative(
            "emission-absorption of a slab, lvoxels of a tree",
            at,
            -0.5 * (-tau).exp_m1(),
            light.radiance.0[0].into(),
            // What is behind a transmittance of 1e-4 is left out.
            LIMIT.max(if tau > 9.0 { 1e-4 } else { 0.0 }),
        ));
    }
    Ok(())
}

/// The worst of many rays in all directions, of which `transmittance_of` tells how much comes
/// through.
fn oblique(
    case: &str,
    at: &str,
    scene: &Scene,
    transmittance_of: impl Fn(Vec3, Vec3) -> f32,
) -> Row {
    let field = Field::of(&scene.volumes[0]);
    let mut worst = Row::nothing(case, at, 0.0, LIMIT);
    for (origin, direction) in super::rays(500, 2.0, 0.4) {
        let tau = field.optical_depth(origin.as_dvec3(), direction.as_dvec3(), 10.0);
        // Of rays that nothing comes through there is nothing to compare.
        if tau > 69.0 {
            continue;
        }
        let got = transmittance_of(origin, direction);
        let row = transmittance(case, at.into(), tau, got.into(), LIMIT);
        if row.error / row.limit >= worst.error / worst.limit {
            worst = row;
        }
    }
    worst
}

fn spheres(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const N: usize = 48;
    for tau in TAUS {
        let at = format!("tau {tau:e}");
        // A ball of radius 0.45 whose diameter has this depth.
        let sigma = (tau / 0.9) as f32;
        let scene = emitter_behind(ball(N, 0.45, sigma), 0.0);
        let field = Field::of(&scene.volumes[0]);
        let (origin, forward) = (Vec3::new(0.03, 0.02, 2.0), -Vec3::Z);
        let exact = field.optical_depth(origin.as_dvec3(), forward.as_dvec3(), 2.9);
        let store = bench.tree(&scene, 16)?;
        let picture = pixels(&bench.shade(&scene, &store, &brief())?, "")?;
        rows.push(transmittance(
            "emitter behind a sphere of voxels, whole pipeline",
            at.clone(),
            exact,
            mean(&picture) / 4.0,
            LIMIT,
        ));
        let mut light = Composite::default();
        (&media(&store)?).pass(&Ray::new(origin, forward, 2.9), 0.0, &[], &mut light);
        if tau <= 10.0 {
            // The rim of a ball is averaged over blocks.
            rows.push(transmittance(
                "sphere of voxels, lvoxels of a tree",
                at.clone(),
                exact,
                light.transmittance.into(),
                LIMIT.max(0.06 * tau),
            ));
            let chord = 2.0 * (0.45_f64 * 0.45 - 0.03 * 0.03 - 0.02 * 0.02).sqrt();
            rows.push(transmittance(
                "sphere, voxels against the true chord",
                at,
                f64::from(sigma) * chord,
                mean(&picture) / 4.0,
                LIMIT.max(tau / N as f64),
            ));
        }
    }
    Ok(())
}
