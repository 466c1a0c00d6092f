//! Makes a scene in memory, bakes it, builds its tree, shades a picture, and writes that beside the
//! tree: `cargo run --release --example bake_and_shade [FOLDER]`.

#![allow(clippy::print_stdout)] // What it prints is the point.

use glam::{DAffine3, DVec3};
use lvox::formats::Overwrite;
use lvox::image::exr::{self, Precision};
use lvox::image::{Region, png, tone};
use lvox::run::Job;
use lvox::scene::{CameraInput, Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput};
use lvox::tree::OpenTree;
use lvox::{bake, build, shade};
use std::path::PathBuf;

/// A white floor, a red wall that colours it, a light, and a ball of fog.
fn scene() -> lvox::Result<Scene> {
    let quad = |name: &str, corner: DVec3, u: DVec3, v: DVec3| {
        let corners = [corner, corner + u, corner + u + v, corner + v];
        MeshInput::new(name, corners, vec![[0, 1, 2], [0, 2, 3]])
    };
    let corner = DVec3::new(-2.0, 0.0, -2.0);
    let (x, y, z) = (4.0 * DVec3::X, 3.0 * DVec3::Y, 4.0 * DVec3::Z);
    let fog = Grid::from_fn([16; 3], |voxel| {
        let from_centre = voxel.map(|i| (i as f32 - 7.5) / 8.0);
        let squares: f32 = from_centre.iter().map(|x| x * x).sum();
        8.0 * (1.0 - squares).max(0.0)
    });
    let scale = DVec3::splat(1.0 / 16.0);
    let world_from_fog =
        DAffine3::from_translation(DVec3::new(-0.5, 0.1, -0.5)) * DAffine3::from_scale(scale);
    let (eye, target, up) = ([1.5, 1.5, 4.5], [-0.3, 0.7, 0.0], [0.0, 1.0, 0.0]);
    SceneBuilder::new("a red wall and fog")
        .camera(CameraInput::look_at("front", eye, target, up, 0.8)?)
        .mesh(quad("floor", corner, z, x).albedo([0.8, 0.8, 0.8]))
        .mesh(quad("wall", corner, y, z).albedo([0.8, 0.1, 0.1]))
        .light(LightInput::point([1.0, 2.5, 1.0], [12.0; 3]))
        .volume(VolumeInput::new("fog", fog, [0.9; 3], world_from_fog))
        .build()
}

fn main() -> lvox::Result<()> {
    let folder = std::env::args()
        .nth(1)
        .map_or_else(std::env::temp_dir, PathBuf::from);
    let (cloud, tree) = (folder.join("example.lvc"), folder.join("example.lvt"));
    let job = Job::default();
    let scene = scene()?;
    let settings = bake::Settings {
        surfels: bake::SurfelSampling::Area { count: 20_000 },
        ..bake::Settings::default()
    };
    bake::run(&scene, &settings, &cloud, Overwrite::Replace, &job)?;
    build::run(
        &cloud,
        &tree,
        &build::Settings::default(),
        Overwrite::Replace,
        &job,
    )?;
    let tree = OpenTree::open(&tree, job.memory_limit)?;
    let whole = Region::full(scene.film.width, scene.film.height);
    let frame = shade::run(&scene, &tree, &shade::Settings::default(), whole, &[], &job)?;
    exr::write(&folder.join("example.exr"), &frame, Precision::Half)?;
    let display = tone::map(&frame.picture("", &whole)?, scene.film.exposure);
    png::write(&folder.join("example.png"), &display)?;
    for warning in job.progress.warnings() {
        eprintln!("warning: {warning}");
    }
    println!("wrote {}", folder.join("example.png").display());
    Ok(())
}
