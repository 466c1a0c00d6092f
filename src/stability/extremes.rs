//! Small scenes beside huge things, and light and size at the ends of their ranges together.

use super::degenerate::{room, settings};
use super::row::Row;
use super::workbench::{Workbench, add_quad, mean, pixels, volume};
use crate::Result;
use crate::scene::{Grid, Scene};
use crate::shade::{self, Kernel};
use glam::{DAffine3, DVec3, Vec3};

const SURFELS: u64 = 20_000;

pub fn rows(bench: &Workbench) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    huge(bench, &mut rows)?;
    starved(bench, &mut rows)?;
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
    let corner = Vec3::new(-0.5 * edge, -1.01, -0.5 * edge);
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
