//! What work costs in counts, which are steadier than seconds: cells and rays of a bake, rays and
//! bytes of a frame.

use crate::{ROOM, Work, with_threads};
use glam::{DAffine3, DVec3};
use lvox::bake::{self, Settings};
use lvox::formats::Overwrite;
use lvox::image::Region;
use lvox::run::Job;
use lvox::scene::{Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput};
use lvox::shade;
use lvox::tree::OpenTree;
use std::collections::BTreeMap;

/// A volume of 64^3 voxels in a cube of edge 2 under a sun, beside a floor or below a sky.
fn outdoor(density: impl Fn([f32; 3]) -> f32 + Sync, has_floor: bool) -> Scene {
    let place = DAffine3::from_translation(DVec3::splat(-1.0))
        * DAffine3::from_scale(DVec3::splat(2.0 / 64.0));
    let at = |v: [usize; 3]| v.map(|i| (i as f32 + 0.5) / 32.0 - 1.0);
    let grid = Grid::from_fn([64; 3], |v| density(at(v)));
    let scene = SceneBuilder::new("outdoor")
        .light(LightInput::sun([0.5, -0.7, -0.5], [5.0; 3], 0.0).unwrap())
        .volume(VolumeInput::new("medium", grid, [0.9; 3], place));
    let corners = [[-9.0, -1.5, -9.0], [0.0, -1.5, 9.0], [9.0, -1.5, -9.0]];
    let scene = match has_floor {
        true => scene.mesh(MeshInput::new("floor", corners, vec![[0, 1, 2]])),
        false => scene.light(LightInput::environment([0.2, 0.3, 0.5])),
    };
    scene.build().unwrap()
}

/// Counts of a bake, on threads of its own.
fn baked(scene: &Scene, surfels: u64) -> BTreeMap<String, f64> {
    let work = Work::new("");
    let settings = Settings {
        surfels: bake::SurfelSampling::Area { count: surfels },
        ..Settings::default()
    };
    let job = Job::default();
    let cloud = work.path("scene.lvc");
    with_threads(2, || {
        bake::run(scene, &settings, &cloud, Overwrite::Refuse, &job).unwrap();
    });
    job.report.stages()[0].counts.clone()
}

/// Cells that rays of a bake pass for each lvoxel, and rays.
fn of_an_lvoxel(scene: &Scene) -> [f64; 2] {
    let counts = baked(scene, 1000);
    assert!(counts["lvoxels"] > 10_000.0, "{counts:?}");
    ["cells_of_lvoxels", "rays_of_lvoxels"].map(|name| counts[name] / counts["lvoxels"])
}

fn length([x, y, z]: [f32; 3]) -> f32 {
    (x * x + y * y + z * z).sqrt()
}

#[test]
fn surfels_are_many_where_neighbours_differ() {
    let floor = || {
        let corners = [
            [-9.0, 0.0, -9.0],
            [-9.0, 0.0, 9.0],
            [9.0, 0.0, 9.0],
            [9.0, 0.0, -9.0],
        ];
        MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]])
    };
    let slats = (0..60).map(|i| {
        let x = 0.3 * f64::from(i) - 9.0;
        let corners = [
            [x, 0.5, -9.0],
            [x, 0.5, 9.0],
            [x + 0.15, 0.5, 9.0],
            [x + 0.15, 0.5, -9.0],
        ];
        MeshInput::new("slat", corners, vec![[0, 1, 2], [0, 2, 3]])
    });
    let sun = || LightInput::sun([0.0, -1.0, 0.2], [3.0; 3], 0.0).unwrap();
    let surfels = |scene: SceneBuilder| {
        let work = Work::new("");
        let (cloud, job) = (work.path("scene.lvc"), Job::default());
        let scene = scene.build().unwrap();
        let settings = Settings::default();
        let summary = bake::run(&scene, &settings, &cloud, Overwrite::Refuse, &job).unwrap();
        summary.sums.surfels
    };
    let bare = SceneBuilder::new("bare").mesh(floor());
    assert_eq!(surfels(bare), 125_000, "without light");
    let even = SceneBuilder::new("even").mesh(floor()).light(sun());
    assert_eq!(surfels(even), 125_000, "in the sun");
    let barred = slats.fold(
        SceneBuilder::new("barred").mesh(floor()),
        SceneBuilder::mesh,
    );
    assert_eq!(surfels(barred.light(sun())), 500_000, "below slats");
}

#[test]
fn clouds_take_few_cells_for_each_lvoxel() {
    let waves = |p: [f32; 3]| {
        let [x, y, z] = p.map(|c| (7.0 * c).sin());
        (0.5 + x * y + y * z + z * x).clamp(0.0, 1.0) * (1.0 - length(p)).max(0.0)
    };
    for (sigma_t, has_floor) in [(45.0, false), (45.0, true), (90.0, false), (90.0, true)] {
        let scene = outdoor(|p| sigma_t * waves(p), has_floor);
        let [cells, rays] = of_an_lvoxel(&scene);
        let told = format!("{sigma_t}, {has_floor}: {cells} cells, {rays} rays");
        assert!(cells > 0.0 && cells <= 20.0 && rays <= 6.0, "{told}");
    }
}

#[test]
fn what_is_deep_is_lit_in_its_skin() {
    // A shell with a seam that is wound around it, so deep that each voxel takes all light.
    let shell = |p: [f32; 3]| {
        let is_shell = (0.55..0.9).contains(&length(p)) && (p[0] * 40.0).sin() < 0.9;
        if is_shell { 160.0 } else { 0.0 }
    };
    let [cells, rays] = of_an_lvoxel(&outdoor(shell, true));
    assert!(cells <= 20.0 && rays <= 1.0, "{cells} cells, {rays} rays");
}

#[test]
fn a_surfel_takes_a_ray_for_each_side_and_light() {
    let counts = baked(&outdoor(|_| 0.0, true), 20_000);
    let rays = counts["rays_of_surfels"] / counts["surfels"];
    assert!(rays > 0.5 && rays <= 2.0, "{rays}");
}

#[test]
fn a_frame_tells_its_rays_and_the_bytes_of_pages() {
    let work = Work::new(ROOM);
    let scene = work.scene();
    let tree = OpenTree::open(&work.bake(&scene, 20_000), None).unwrap();
    let region = Region::full(64, 48);
    let job = Job::default();
    with_threads(2, || {
        shade::run(
            &scene,
            &tree,
            &shade::Settings::default(),
            region,
            &[],
            &job,
        )
        .unwrap();
    });
    let counts = &job.report.stages()[0].counts;
    let pixels = counts["pixels"];
    let [rays, cells] = ["rays", "cells_walked"].map(|name| counts[name] / pixels);
    assert!(rays > 1.0 && rays < 250.0, "{rays} rays a pixel");
    assert!(cells > 1.0 && cells < 250.0, "{cells} cells a pixel");
    let [read, decoded] = ["page_bytes_read", "page_bytes_decoded"].map(|name| counts[name]);
    assert!(read > 0.0 && decoded > read && decoded < 30.0 * read);
    assert!(read <= tree.tree().file_bytes() as f64);
}
