//! A room with smoke, moved, scaled, turned, and under other light: the picture stays.

use super::row::Row;
use super::workbench::{Workbench, mean, pixels, relative_rms};
use crate::Result;
use crate::math::unflatten;
use crate::shade::{Kernel, Settings};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write;

/// What is done to the room.
#[derive(Clone, Copy)]
struct Change {
    world_from_room: DAffine3,
    scale: f64,
    light: f64,
    channels: [usize; 3],
    kernel: Kernel,
}

const NONE: Change = Change {
    world_from_room: DAffine3::IDENTITY,
    scale: 1.0,
    light: 1.0,
    channels: [0, 1, 2],
    kernel: Kernel::Traced,
};

const VOXELS: usize = 16;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let base = View::new(bench, &NONE)?;
    let mut compare = |case: &str, parameter: &str, change: Change, limit: f64| -> Result<()> {
        compare(bench, &base, [case, parameter], &change, limit, &mut rows)
    };
    compare("the same again", "", NONE, 0.0)?;
    for by in [DVec3::new(1e6, -2e6, 3e6), DVec3::new(0.0, 0.0, 1e6)] {
        let change = Change {
            world_from_room: DAffine3::from_translation(by),
            ..NONE
        };
        compare(
            "moved",
            &format!("by {} {} {}", by.x, by.y, by.z),
            change,
            0.02,
        )?;
    }
    for scale in [1e-6, 1e-3, 1e3, 1e6] {
        let change = Change {
            world_from_room: DAffine3::from_scale(DVec3::splat(scale)),
            scale,
            ..NONE
        };
        compare("scaled", &format!("by {scale:e}"), change, 0.02)?;
    }
    for (name, axis) in [("x", DVec3::X), ("y", DVec3::Y), ("z", DVec3::Z)] {
        let turn = DQuat::from_axis_angle(axis, FRAC_PI_2);
        let mut matrix = DMat3::from_quat(turn);
        for column in [&mut matrix.x_axis, &mut matrix.y_axis, &mut matrix.z_axis] {
            *column = column.round();
        }
        let change = Change {
            world_from_room: DAffine3::from_mat3(matrix),
            ..NONE
        };
        // Rays of a gather start from other tangents, so noise differs.
        compare(
            "turned by 90 degrees",
            &format!("about {name}"),
            change,
            0.05,
        )?;
    }
    for light in [1e-30, 1e-12, 1e12, 1e30] {
        let change = Change { light, ..NONE };
        compare("light scaled", &format!("by {light:e}"), change, 1e-3)?;
    }
    for channels in [[1, 2, 0], [2, 1, 0]] {
        let change = Change { channels, ..NONE };
        compare("channels permuted", &format!("{channels:?}"), change, 1e-3)?;
    }
    for (name, kernel) in [("traced", Kernel::Traced), ("cone", Kernel::Cone)] {
        let base = View::new(bench, &Change { kernel, ..NONE })?;
        for (scale, light) in [(1e6, 1e30), (1e6, 1e-30), (1e-6, 1e30), (1e-6, 1e-30)] {
            let change = Change {
                world_from_room: DAffine3::from_scale(DVec3::splat(scale)),
                scale,
                light,
                kernel,
                ..NONE
            };
            let case = format!("size and light scaled, kernel {name}");
            let parameter = format!("by {scale:e}, light by {light:e}");
            self::compare(bench, &base, [&case, &parameter], &change, 0.02, &mut rows)?;
        }
    }
    Ok(rows)
}

/// Compares the picture of a changed room with the first, and what their trees hold.
fn compare(
    bench: &Workbench,
    base: &View,
    [case, parameter]: [&str; 2],
    change: &Change,
    limit: f64,
    rows: &mut Vec<Row>,
) -> Result<()> {
    let view = View::new(bench, change)?;
    // Noise that differs hides in a mean to a fifth.
    let mean_limit = if limit > 0.02 {
        0.2 * limit
    } else {
        limit.min(1e-3)
    };
    let back: Vec<[f32; 3]> = (view.pixels.iter())
        .map(|p| {
            let mut out = [0.0; 3];
            for (from, &to) in change.channels.iter().enumerate() {
                out[to] = (f64::from(p[from]) / change.light) as f32;
            }
            out
        })
        .collect();
    rows.push(Row::relative(
        format!("{case}: mean of the picture"),
        parameter,
        mean(&base.pixels),
        mean(&back),
        mean_limit,
    ));
    rows.push(Row::nothing(
        format!("{case}: RMS of pixels over the mean"),
        parameter,
        relative_rms(&back, &base.pixels),
        limit,
    ));
    let flux = |view: &View| view.flux.iter().sum::<f64>();
    let factor = change.light * change.scale * change.scale;
    rows.push(Row::relative(
        format!("{case}: flux in the tree"),
        parameter,
        flux(base) * factor,
        flux(&view),
        mean_limit,
    ));
    rows.push(Row::nothing(
        format!("{case}: lit surfels and lvoxels that went dark, or the other way"),
        parameter,
        base.lit.abs_diff(view.lit) as f64 / base.lit as f64,
        mean_limit,
    ));
    Ok(())
}

/// The picture of a changed room, and what its tree holds.
struct View {
    pixels: Vec<[f32; 3]>,
    flux: [f64; 3],
    /// Surfels and lvoxels that are lit.
    lit: u64,
}

impl View {
    fn new(bench: &Workbench, change: &Change) -> Result<Self> {
        let scene = bench.load(&room(change), &[("smoke.raw", &smoke())])?;
        let store = bench.tree(&scene, 5000)?;
        let settings = Settings {
            samples: 16,
            volume_samples: 8,
            kernel: change.kernel,
            ..Settings::default()
        };
        let frame = bench.shade(&scene, &store, &settings)?;
        let tree = store.tree();
        let mut lit = 0;
        for page in 0..tree.surfel_pages() {
            let surfels = tree.surfel_page(page)?.surfels;
            lit += surfels.iter().filter(|s| s.front != [0.0; 3]).count();
        }
        let lvoxels = super::workbench::lvoxels(&store)?;
        lit += lvoxels.iter().filter(|l| l.source != [0.0; 3]).count();
        Ok(Self {
            pixels: pixels(&frame, "")?,
            flux: tree.summary().sums.flux,
            lit: lit as u64,
        })
    }
}

/// A ball, denser in the middle.
fn smoke() -> Vec<u8> {
    (0..VOXELS * VOXELS * VOXELS)
        .map(|i| {
            let at = unflatten(i, [VOXELS; 3]);
            let r2: f32 = at
                .map(|c| (c as f32 - 7.5) / 8.0)
                .iter()
                .map(|c| c * c)
                .sum();
            (255.0 * (1.0 - r2).max(0.0)) as u8
        })
        .collect()
}

/// A room with a red and a green wall, an emitter, a window that the sun shines through, a block,
/// and smoke.
fn room(change: &Change) -> String {
    let map = change.world_from_room;
    let point = |p: [f64; 3]| list(map.transform_point3(DVec3::from(p)).to_array());
    let way = |p: [f64; 3]| list((map.matrix3 * DVec3::from(p)).normalize().to_array());
    let permute = |c: [f64; 3], factor: f64| list(change.channels.map(|k| c[k] * factor));
    let mut text = format!(
        "[film]\nwidth = 48\nheight = 36\n[[camera]]\nposition = {}\ntarget = {}\nup = {}\n\
         fov_x_deg = 40\n",
        point([0.0, 1.0, 3.9]),
        point([0.0, 1.0, 0.0]),
        way([0.0, 1.0, 0.0]),
    );
    // Half circles about x, then z, and the place; a wall's edge is 2.
    let mut mesh = |file: &str, size: [f64; 3], turn: [f64; 2], at: [f64; 3], albedo, emission| {
        let rotation = DQuat::from_rotation_z(turn[1] * FRAC_PI_2)
            * DQuat::from_rotation_x(turn[0] * FRAC_PI_2);
        let local = DAffine3::from_scale_rotation_translation(size.into(), rotation, at.into());
        let _ = writeln!(
            text,
            "[[mesh]]\nfile = \"builtin:{file}\"\ntransform = {}\nalbedo = {}\nemission = {}",
            matrix(&(map * local)),
            permute(albedo, 1.0),
            permute(emission, change.light),
        );
    };
    let (grey, dark) = ([0.7, 0.7, 0.6], [0.0; 3]);
    mesh("quad", [2.0; 3], [0.0, 0.0], [0.0, 0.0, 0.0], grey, dark);
    mesh("quad", [2.0; 3], [2.0, 0.0], [0.0, 2.0, 0.0], grey, dark);
    mesh("quad", [2.0; 3], [1.0, 0.0], [0.0, 1.0, -1.0], grey, dark);
    mesh(
        "quad",
        [2.0; 3],
        [0.0, -1.0],
        [-1.0, 1.0, 0.0],
        [0.6, 0.05, 0.1],
        dark,
    );
    mesh(
        "cube",
        [0.5, 0.8, 0.5],
        [0.0, 0.0],
        [0.4, 0.4, -0.3],
        [0.3, 0.6, 0.5],
        dark,
    );
    mesh(
        "quad",
        [0.5; 3],
        [2.0, 0.0],
        [0.0, 1.98, 0.0],
        dark,
        [1.0, 0.9, 0.7],
    );
    let unit = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.9),
        DQuat::IDENTITY,
        DVec3::new(-0.9, 0.3, -0.2),
    );
    let _ = write!(
        text,
        "[[light]]\ntype = \"directional\"\ndirection = {}\nirradiance = {}\n\
         angular_radius_deg = 2\n\
         [[volume]]\nfile = \"smoke.raw\"\ndims = [{VOXELS}, {VOXELS}, {VOXELS}]\ndtype = \"u8\"\n\
         sigma_t_scale = {:e}\nvalue_scale = 0.00392156862745098\nalbedo = [0.8, 0.8, 0.8]\n\
         unitcube_to_world = {}\n",
        way([-1.0, -0.6, -0.1]),
        permute([0.2, 0.3, 0.4], change.light),
        6.0 / change.scale,
        matrix(&(map * unit)),
    );
    text
}

fn list(v: [f64; 3]) -> String {
    format!("[{:e}, {:e}, {:e}]", v[0], v[1], v[2])
}

fn matrix(m: &DAffine3) -> String {
    let row = |r: usize| {
        let axis = |c: DVec3| c.to_array()[r];
        format!(
            "[{:e}, {:e}, {:e}, {:e}]",
            axis(m.matrix3.x_axis),
            axis(m.matrix3.y_axis),
            axis(m.matrix3.z_axis),
            axis(m.translation)
        )
    };
    format!("[{}, {}, {}, [0, 0, 0, 1]]", row(0), row(1), row(2))
}
