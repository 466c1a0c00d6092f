//! Media with steep steps, thin sheets, single voxels and checkerboards, against exact integration.

use super::field::Field;
use super::row::Row;
use super::transmittance::brief;
use super::workbench::{Workbench, media_with_source, pixels, stage, volume};
use crate::Result;
use crate::gather::Medium;
use crate::math::Ray;
use crate::math::exp::exp_neg;
use crate::math::segment::Composite;
use crate::scene::{Grid, Light, Scene};
use crate::trace::Tracer;
use glam::{DAffine3, DVec3, Vec3};

struct Case {
    name: &'static str,
    grid: Grid,
    /// Allowed error of the mean transmittance through lvoxels, absolute: they are constant over
    /// half a voxel where the field falls off.
    lvoxels: f64,
}

fn cases() -> Vec<Case> {
    let case = |name, dims, lvoxels, value: &(dyn Fn([usize; 3]) -> f32 + Sync)| Case {
        name,
        grid: Grid::from_fn(dims, value),
        lvoxels,
    };
    let board = |v: [usize; 3], dense| {
        if (v[0] + v[1] + v[2]).is_multiple_of(2) {
            0.0
        } else {
            dense
        }
    };
    vec![
        case("step from 1e-3 to 1e4", [16; 3], 0.03, &|v| {
            if v[0] < 8 { 1e-3 } else { 1e4 }
        }),
        case("step from 1e4 to 1e-3 across z", [9, 9, 16], 0.03, &|v| {
            if v[2] < 8 { 1e4 } else { 1e-3 }
        }),
        case("sheet of one voxel, depth 625", [17, 16, 16], 0.03, &|v| {
            if v[0] == 8 { 1e4 } else { 0.0 }
        }),
        case("sheet of one voxel, depth 1", [17, 16, 16], 0.03, &|v| {
            if v[0] == 8 { 16.0 } else { 0.0 }
        }),
        case("one voxel", [1; 3], 1e-5, &|_| 5.0),
        case("one voxel, thin", [1; 3], 1e-5, &|_| 0.5),
        case("thinner than an lvoxel", [16, 16, 1], 1e-5, &|_| 1.0),
        case("as thick as an lvoxel and a half", [12; 3], 1e-5, &|_| 1.0),
        case("checkerboard of 0 and 20", [16; 3], 0.03, &|v| {
            board(v, 20.0)
        }),
        case("checkerboard of 0 and 1e4", [16; 3], 0.03, &|v| {
            board(v, 1e4)
        }),
    ]
}

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    for case in cases() {
        rows.extend(check(bench, case)?);
    }
    Ok(rows)
}

/// Voxels of 1/16 around the origin, lit from everywhere and by a near light.
fn scene(grid: Grid) -> Scene {
    let dims = grid.dims();
    let mut scene = stage(12, Vec3::new(0.9, 0.7, 1.5), Vec3::ZERO, 45.0);
    let middle = DVec3::from(dims.map(|n| -0.5 * n as f64));
    let placed =
        DAffine3::from_scale(DVec3::splat(1.0 / 16.0)) * DAffine3::from_translation(middle);
    scene.volumes.push(volume(grid, 1.0, placed));
    scene.lights.push(Light::Environment { radiance: [1.0; 3] });
    scene
}

fn check(bench: &Workbench, case: Case) -> Result<Vec<Row>> {
    let scene = scene(case.grid);
    let medium = &scene.volumes[0];
    let sigma = f64::from(medium.sigma_t.max());
    let field = Field::of(medium);
    let tracer = Tracer::new(&scene);
    let store = bench.tree(&scene, 16)?;
    let media = &media_with_source(&store, [1.0; 3])?;
    let dims = medium.sigma_t.dims();
    let extent = dims.map(|n| n as f32 / 16.0);
    let reach = 0.45 * extent.iter().copied().fold(f32::INFINITY, f32::min);

    // The place of a step is known to the rounding of coordinates.
    let limit = 1e-5 + 1e-6 * sigma;
    let mut cells = Row::nothing(
        format!("{}: cells, worst of 400 rays", case.name),
        "transmittance",
        0.0,
        limit,
    );
    let (mut leaks, mut rises, mut ringing) = (0, 0, 0.0_f64);
    let (mut exact_sum, mut lvoxel_sum) = (0.0, 0.0);
    for (i, (origin, mut direction)) in super::rays(400, 1.8, reach).enumerate() {
        if i % 8 == 0 {
            direction = (direction * Vec3::from(extent).map(|e| e * e)).normalize();
        }
        let exact = field.optical_depth(origin.as_dvec3(), direction.as_dvec3(), 4.0);
        let got = exp_neg(tracer.optical_depth(&Ray::new(origin, direction, 4.0)));
        let row = super::transmittance::transmittance(
            &cells.case,
            cells.parameter.clone(),
            exact,
            got.into(),
            limit,
        );
        if row.error / row.limit >= cells.error / cells.limit {
            cells = row;
        }
        let mut light = Composite::default();
        media.pass(&Ray::new(origin, direction, 4.0), 0.0, &[], &mut light);
        exact_sum += (-exact).exp();
        lvoxel_sum += f64::from(light.transmittance);
        // Twice the depth that hides a light altogether.
        leaks += usize::from(exact > 140.0 && (got > 1e-30 || light.transmittance > 1e-30));
        ringing = ringing.max((f64::from(light.radiance.0[0] + light.transmittance) - 1.0).abs());
        rises += usize::from(rises_along(&tracer, media, origin, direction));
    }
    let name = |what: &str| format!("{}: {what}", case.name);
    let mut rows = vec![
        cells,
        Row::with_error(
            name("lvoxels of a tree, mean of 400 rays"),
            "transmittance",
            (exact_sum / 400.0, lvoxel_sum / 400.0),
            (lvoxel_sum - exact_sum).abs() / 400.0,
            case.lvoxels,
        ),
        Row::count(name("light through a depth of 140"), "rays", leaks),
        Row::count(name("transmittance rises"), "rays", rises),
        Row::nothing(
            name("ringing: emitted + transmitted - 1"),
            "worst ray",
            ringing,
            1e-5,
        ),
    ];
    let picture = pixels(&bench.shade(&scene, &store, &brief())?, "")?;
    rows.extend(of_picture(case.name, &picture));
    Ok(rows)
}

/// Rows about a picture of a medium before an environment of radiance 1.
fn of_picture(case: &str, picture: &[[f32; 3]]) -> [Row; 2] {
    let name = |what: &str| format!("{case}: {what}");
    let wrong = |v: &&f32| !(v.is_finite() && **v >= 0.0);
    let brightest = picture.iter().flatten().fold(0.0_f32, |a, &b| a.max(b));
    [
        Row::count(
            name("not finite, or negative"),
            "values of a picture",
            picture.iter().flatten().filter(wrong).count(),
        ),
        Row::nothing(
            name("brighter than the environment"),
            "brightest pixel",
            (f64::from(brightest) - 1.0).max(0.0),
            0.02,
        ),
    ]
}

/// Whether a ray's transmittance rises anywhere by more than rounding.
fn rises_along(tracer: &Tracer, media: &crate::tree::Media, origin: Vec3, direction: Vec3) -> bool {
    const STEPS: u32 = 64;
    let mut last = [1.0_f32; 2];
    (0..=STEPS).any(|k| {
        let t = 1.2 + 1.2 * k as f32 / STEPS as f32;
        let mut light = Composite::default();
        media.pass(&Ray::new(origin, direction, t), 0.0, &[], &mut light);
        let now = [
            exp_neg(tracer.optical_depth(&Ray::new(origin, direction, t))),
            light.transmittance,
        ];
        let rises =
            (0..2).any(|i| now[i] > last[i] * (1.0 + 1e-5) || !(0.0..=1.0).contains(&now[i]));
        last = now;
        rises
    })
}
