//! Small scenes beside huge things, and light and size at the ends of their ranges together.

use super::degenerate::{room, settings};
use super::row::Row;
use super::workbench::{Workbench, add_quad, mean, pixels, volume};
use crate::Result;
use crate::scene::{Grid, Scene};
use crate::shade::{self, Kernel};
use glam::{DAffine3, DVec3, Vec3};
use std::fmt::Write;

const SURFELS: u64 = 20_000;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    huge(bench, &mut rows)?;
    starved(bench, &mut rows)?;
    opaque(bench, &mut rows)?;
    Ok(rows)
}

/// Mean of a layer of a scene's picture.
fn layer(bench: &Workbench, scene: &Scene, name: &str) -> Result<f64> {
    let store = bench.tree(scene, SURFELS)?;
    Ok(mean(&pixels(
        &bench.shade(scene, &store, &settings())?,
        name,
    )?))
}

/// The room over a black ground, which is not seen.
fn over_ground(edge: f32) -> Scene {
    let mut scene = room();
    let corner = Vec3::new(-0.5 * edge, -1.1, -0.5 * edge);
    add_quad(
        &mut scene,
        [corner, edge * Vec3::Z, edge * Vec3::X],
        0.0,
        0.0,
    );
    scene
}

/// What is huge and neither seen nor lit leaves the light of a small room as it is.
fn huge(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    let direct = layer(bench, &room(), "direct")?;
    for edge in [1e4, 1e5, 1e6] {
        rows.push(Row::relative(
            "room of edge 2 over a black ground: mean of direct light",
            format!("edge of the ground {edge:e}"),
            direct,
            layer(bench, &over_ground(edge), "direct")?,
            1e-3,
        ));
    }
    let indirect = layer(bench, &room(), "indirect")?;
    let mut scene = room();
    let edge = 1e5;
    let placed = DAffine3::from_translation(DVec3::splat(-0.5 * edge))
        * DAffine3::from_scale(DVec3::splat(edge / 4.0));
    let haze = Grid::from_fn([4; 3], |_| 1e-12);
    scene.volumes.push(volume(haze, 0.5, placed));
    rows.push(Row::relative(
        "room of edge 2 in thin haze: mean of indirect light",
        format!("edge of the haze {edge:e}"),
        indirect,
        layer(bench, &scene, "indirect")?,
        0.01,
    ));
    Ok(())
}

/// A ground takes its share of the surfels, and leaves the room enough.
fn starved(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    let settings = |kernel| shade::Settings {
        kernel,
        ..settings()
    };
    for (name, kernel) in [("traced", Kernel::Traced), ("cone", Kernel::Cone)] {
        let mean_of = |scene: &Scene| -> Result<f64> {
            let store = bench.tree(scene, SURFELS)?;
            let frame = bench.shade(scene, &store, &settings(kernel))?;
            Ok(mean(&pixels(&frame, "indirect")?))
        };
        let alone = mean_of(&room())?;
        for (edge, albedo) in [(1e3, 0.0), (1e5, 0.0), (1e5, 0.5)] {
            let mut scene = over_ground(edge);
            if let Some(ground) = scene.materials.last_mut() {
                ground.albedo = [albedo; 3];
            }
            rows.push(Row::relative(
                format!("room of edge 2 over a ground: mean of indirect light, kernel {name}"),
                format!("edge of the ground {edge:e}, albedo {albedo}"),
                alone,
                mean_of(&scene)?,
                0.02,
            ));
        }
    }
    Ok(())
}

/// A room with a cube of a white medium of this extinction.
fn with_cube(bench: &Workbench, extinction: f64) -> Result<Scene> {
    let mut text = String::from(
        "[film]\nwidth = 32\nheight = 24\n[[camera]]\nposition = [0, 1, 3.9]\ntarget = [0, 1, 0]\n\
         fov_x_deg = 40\n",
    );
    for (turn, at, albedo, size, emission) in [
        ([0, 0, 0], [0.0, 0.0, 0.0], 0.7, 2.0, 0.0),
        ([180, 0, 0], [0.0, 2.0, 0.0], 0.7, 2.0, 0.0),
        ([90, 0, 0], [0.0, 1.0, -1.0], 0.7, 2.0, 0.0),
        ([0, 0, -90], [-1.0, 1.0, 0.0], 0.7, 2.0, 0.0),
        ([180, 0, 0], [0.0, 1.98, 0.0], 0.0, 0.6, 9.0),
    ] {
        let _ = write!(
            text,
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {size}\nrotate_deg = {turn:?}\n\
             translate = {at:?}\nalbedo = [{albedo}, {albedo}, {albedo}]\n\
             emission = [{emission}, {emission}, {emission}]\n"
        );
    }
    let _ = write!(
        text,
        "[[volume]]\nfile = \"white.raw\"\ndims = [8, 8, 8]\ndtype = \"u8\"\n\
         sigma_t_scale = {extinction:e}\nvalue_scale = 0.00392156862745098\nalbedo = [1, 1, 1]\n\
         unitcube_to_world = [[0.7, 0, 0, -0.41], [0, 0.7, 0, 0.3], [0, 0, 0.7, -0.37], \
         [0, 0, 0, 1]]\n"
    );
    bench.load(&text, &[("white.raw", &[255; 512])])
}

/// Where nothing gets through, more of a medium changes nothing.
fn opaque(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    let layers = |extinction: f64| -> Result<[f64; 2]> {
        let scene = with_cube(bench, extinction)?;
        let store = bench.tree(&scene, SURFELS)?;
        let frame = bench.shade(&scene, &store, &settings())?;
        Ok([
            mean(&pixels(&frame, "indirect")?),
            mean(&pixels(&frame, "")?),
        ])
    };
    let expected = layers(1e4)?;
    for extinction in [1e6, 1e8, 1e12, 1e30] {
        let got = layers(extinction)?;
        for (k, name) in ["indirect light of the walls", "the picture"]
            .iter()
            .enumerate()
        {
            rows.push(Row::relative(
                format!("opaque white cube of edge 0.7: mean of {name}"),
                format!("extinction {extinction:e}"),
                expected[k],
                got[k],
                0.01,
            ));
        }
    }
    Ok(())
}
