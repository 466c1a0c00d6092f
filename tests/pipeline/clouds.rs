//! A cloud alone under a sun and a sky: what its frames take follows pixels, and not its voxels.

use crate::{Work, beauty, mean, relative_rms, with_threads};
use glam::{DAffine3, DVec3};
use lvox::formats::Overwrite;
use lvox::image::{Frame, Region};
use lvox::run::Job;
use lvox::scene::{
    CameraInput, Film, Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput,
};
use lvox::shade::{self, Settings};
use lvox::tree::{OpenTree, TreeNeeds};
use lvox::{pack, scatter};
use std::collections::BTreeMap;

/// A cloud of waves in a cube of edge 2 of so many voxels along each axis, and a camera before it.
fn cloud(voxels: usize) -> Scene {
    colored_cloud(voxels, 12.0, [1.0; 3])
}

/// The same with such an extinction where it is densest, and of each channel over that.
fn colored_cloud(voxels: usize, densest: f32, color: [f32; 3]) -> Scene {
    let camera = CameraInput::look_at("front", [0.0, 0.3, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.7);
    cloud_before(camera.unwrap(), voxels, densest, color)
}

/// The same before another camera.
fn cloud_before(camera: CameraInput, voxels: usize, densest: f32, color: [f32; 3]) -> Scene {
    let density = |v: [usize; 3]| {
        let p = v.map(|i| (i as f32 + 0.5) / voxels as f32 * 2.0 - 1.0);
        let [x, y, z] = p.map(|c| (9.0 * c).sin());
        let squares: f32 = p.iter().map(|c| c * c).sum();
        densest * (0.5 + x * y + y * z + z * x).clamp(0.0, 1.0) * (1.0 - squares).max(0.0)
    };
    let place = DAffine3::from_translation(DVec3::splat(-1.0))
        * DAffine3::from_scale(DVec3::splat(2.0 / voxels as f64));
    let volume = VolumeInput::new(
        "cloud",
        Grid::from_fn([voxels; 3], density),
        [0.99; 3],
        place,
    )
    .extinction_color(color);
    let film = Film {
        width: 64,
        height: 48,
        exposure: 1.0,
    };
    SceneBuilder::new("a cloud")
        .camera(camera)
        .film(film)
        .light(LightInput::sun([0.5, -0.7, -0.5], [5.0; 3], 0.0).unwrap())
        .light(LightInput::environment([0.2, 0.3, 0.5]))
        .volume(volume)
        .build()
        .unwrap()
}

fn shaded(scene: &Scene, tree: &OpenTree, region: Region) -> (Frame, BTreeMap<String, f64>) {
    let job = Job::default();
    let frame = shade::run(scene, tree, &Settings::default(), region, &[], &job).unwrap();
    let counts = job.report.stages()[0].counts.clone();
    (frame, counts)
}

/// Where voxels are smaller than pixels, twice as many along each axis take as much work, within a
/// fifth, to the same picture.
#[test]
fn frames_of_twice_as_many_voxels_take_no_more_work() {
    let [(few, few_counts), (many, many_counts)] = [64, 128].map(|voxels| {
        let scene = cloud(voxels);
        let work = Work::new("");
        let tree = OpenTree::open(&work.bake(&scene, 1), None).unwrap();
        let (frame, counts) = shaded(&scene, &tree, Region::full(64, 48));
        (beauty(&frame), counts)
    });
    for name in [
        "media_cells_marched",
        "media_segments",
        "media_points_lit",
        "media_vertices_swept",
        "cells_swept",
    ] {
        let [few, many] = [few_counts[name], many_counts[name]];
        assert!(few > 0.0 && many <= 1.2 * few, "{name}: {few}, {many}");
    }
    let lit = many_counts["media_points_lit"] / f64::from(64 * 48);
    assert!(lit < 12.0, "{lit} points lit a pixel");
    let (brighter, difference) = apart(&many, &few);
    assert!(
        brighter.abs() < 0.01 && difference < 0.03,
        "{brighter} {difference}"
    );
}

/// Where voxels are wider than pixels, a camera amid thin parts of a cloud has many of them before
/// it, and asks for light as often as the vertices ask that light stands at.
#[test]
fn rays_amid_a_cloud_are_lit_as_often_as_light_changes() {
    let amid = CameraInput::look_at("amid", [0.0, 0.1, 0.9], [0.0; 3], [0.0, 1.0, 0.0], 0.3);
    let scene = cloud_before(amid.unwrap(), 128, 3.0, [1.0; 3]);
    let work = Work::new("");
    let tree = OpenTree::open(&work.bake(&scene, 1), None).unwrap();
    let (_, counts) = shaded(&scene, &tree, Region::full(64, 48));
    let [cells, segments] = ["media_cells_marched", "media_segments"].map(|name| counts[name]);
    assert!(
        segments > 0.0 && 3.0 * segments < 2.0 * cells,
        "{segments} of {cells}"
    );
}

/// Where voxels are wider than pixels, but the cloud is smooth, many voxels are fewer cells to pass
/// than fewer, to the same picture; of a packed scene, to the same bits, not all are read.
#[test]
fn frames_amid_smooth_voxels_take_as_much_work_as_the_cloud_is_detailed() {
    let amid = || CameraInput::look_at("amid", [0.0, 0.1, 0.9], [0.0; 3], [0.0, 1.0, 0.0], 0.3);
    // The first is too small to be looked at brick by brick.
    let [few, many] = [160, 168].map(|n| cloud_before(amid().unwrap(), n, 1.0, [1.0; 3]));
    let work = Work::new("");
    let tree = OpenTree::open(&work.bake(&few, 1), None).unwrap();
    let (few, few_counts) = shaded(&few, &tree, Region::full(64, 48));
    let tree = OpenTree::open(&work.bake(&many, 1), None).unwrap();
    let (frame, counts) = shaded(&many, &tree, Region::full(64, 48));
    let cells = [&few_counts, &counts].map(|counts| counts["media_cells_marched"]);
    assert!(cells[1] < 0.75 * cells[0], "{cells:?}");
    let (brighter, difference) = apart(&beauty(&frame), &beauty(&few));
    assert!(
        brighter.abs() < 0.01 && difference < 0.03,
        "{brighter} {difference}"
    );
    let packed = work.path("many.lvp");
    let (files, job) = (pack::Files::default(), Job::default());
    pack::run(&many, files, &packed, Overwrite::Refuse, &job).unwrap();
    let packed = Scene::load(&packed).unwrap();
    let (again, _) = shaded(&packed, &tree, Region::full(64, 48));
    assert!(beauty(&again) == beauty(&frame));
    assert!(!packed.volumes[0].sigma_t.is_read());
    // A limit asks for what a frame reads.
    let held = [&many, &packed].map(|scene| {
        let (settings, whole) = (Settings::default(), Region::full(64, 48));
        let needs = TreeNeeds::default();
        shade::check_memory(scene, &settings, whole, &[], needs, &Job::default()).unwrap()
    });
    let voxels = many.volumes[0].sigma_t.bytes() as u64;
    assert!(held[1] + voxels < held[0], "{held:?}, {voxels}");
    let lit = [(&many, "a.lvs"), (&packed, "b.lvs")].map(|(scene, name)| {
        let (light, settings) = (work.path(name), scatter::Settings::default());
        scatter::run(scene, &tree, &light, &settings, Overwrite::Refuse, &job).unwrap();
        std::fs::read(light).unwrap()
    });
    assert!(lit[0] == lit[1]);
}

/// In fog of so many voxels that its bricks are as coarse as can be, shafts of light are as sharp.
#[test]
fn coarse_bricks_keep_shafts_of_light() {
    let camera = CameraInput::look_at("front", [0.0, 0.0, 4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.6);
    let slat = |i: i32| {
        let (x, y) = (-1.2 + 0.4 * f64::from(i), 1.1);
        let corners = [
            [x, y, -1.2],
            [x + 0.2, y, -1.2],
            [x + 0.2, y, 1.2],
            [x, y, 1.2],
        ];
        MeshInput::new("slat", corners, vec![[0, 1, 2], [0, 2, 3]])
    };
    // Bricks of media whose albedo may vary stay as they are.
    let pictures = [false, true].map(|has_albedos| {
        let n = 168;
        let place = DAffine3::from_translation(DVec3::splat(-1.0))
            * DAffine3::from_scale(DVec3::splat(2.0 / n as f64));
        let grid = |value| Grid::from_fn([n; 3], move |_| value);
        let fog = VolumeInput::new("fog", grid(0.5), [0.9; 3], place);
        let fog = match has_albedos {
            true => fog.albedo_grid([0; 3].map(|_| grid(0.9))),
            false => fog,
        };
        let scene = SceneBuilder::new("fog")
            .camera(camera.clone().unwrap())
            .film(Film {
                width: 64,
                height: 48,
                exposure: 1.0,
            })
            .light(LightInput::sun([0.2, -1.0, -0.1], [5.0; 3], 0.0).unwrap())
            .volume(fog);
        let scene = (0..6).map(slat).fold(scene, SceneBuilder::mesh);
        let scene = scene.build().unwrap();
        let work = Work::new("");
        let tree = OpenTree::open(&work.bake(&scene, 1), None).unwrap();
        beauty(&shaded(&scene, &tree, Region::full(64, 48)).0)
    });
    let (brighter, difference) = apart(&pictures[0], &pictures[1]);
    assert!(
        brighter.abs() < 0.01 && difference < 0.02,
        "{brighter} {difference}"
    );
}

/// The voxels of a frame, its sweep and its rays to the sun are those of the whole frame, whichever
/// part is shaded, on however many threads.
#[test]
fn a_part_of_a_cloud_has_the_bits_of_the_whole() {
    let opaque = colored_cloud(128, OPAQUE, [1.0; 3]);
    for scene in [cloud(128), colored_cloud(128, 12.0, COLOR), opaque] {
        check_part(&scene);
    }
}

fn check_part(scene: &Scene) {
    let work = Work::new("");
    let tree = OpenTree::open(&work.bake(scene, 1), None).unwrap();
    let (whole, _) = with_threads(1, || shaded(scene, &tree, Region::full(64, 48)));
    let whole = beauty(&whole);
    let part = Region {
        x0: 20,
        y0: 11,
        x1: 43,
        y1: 30,
    };
    let (tile, _) = with_threads(4, || shaded(scene, &tree, part));
    for (i, pixel) in beauty(&tile).iter().enumerate() {
        let (x, y) = (20 + i % 23, 11 + i / 23);
        assert_eq!(*pixel, whole[y * 64 + x], "{x} {y}");
    }
}

/// By how much pixels are brighter than others on the mean, and how far they are from them.
fn apart(found: &[[f32; 3]], expected: &[[f32; 3]]) -> (f64, f64) {
    let brighter = mean(found) / mean(expected) - 1.0;
    (brighter, relative_rms(found, expected))
}

/// Extinction of a cloud whose densest voxels of 128 along an edge have a depth of 2.5.
const OPAQUE: f32 = 160.0;

/// Where single voxels are opaque and smaller than pixels, light is found at few points of what the
/// camera sees, and is that of vertices as close as voxels.
#[test]
fn opaque_voxels_smaller_than_pixels_are_lit_at_few_points_as_they_are_at_many() {
    let scene = colored_cloud(128, OPAQUE, [1.0; 3]);
    let work = Work::new("");
    let baked = work.bake(&scene, 1);
    let tree = OpenTree::open(&baked, None).unwrap();
    let (few, counts) = shaded(&scene, &tree, Region::full(64, 48));
    let path = work.path("all.lvs");
    let (settings, job) = (scatter::Settings::default(), Job::default());
    scatter::run(&scene, &tree, &path, &settings, Overwrite::Replace, &job).unwrap();
    let tree = tree.with_scatter(&path).unwrap();
    let (all, _) = shaded(&scene, &tree, Region::full(64, 48));
    let (brighter, difference) = apart(&beauty(&few), &beauty(&all));
    assert!(
        brighter.abs() < 0.01 && difference < 0.04,
        "{brighter} {difference}"
    );
    let of_pixels = |name: &str| counts[name] / f64::from(64 * 48);
    let [lit, gathered, swept] = [
        "media_points_lit",
        "media_points_gathered",
        "media_vertices_swept",
    ]
    .map(of_pixels);
    assert!(
        lit < 12.0 && gathered < 3.0 && swept < 0.5,
        "{lit} {gathered} {swept}"
    );
}

/// Extinction by channel of a cloud that stops red most.
const COLOR: [f32; 3] = [1.0, 0.5, 0.2];

/// A cloud of colour is swept on the vertices and cells of a grey one, and each of its channels is
/// that of a grey cloud of such an extinction.
#[test]
fn a_cloud_of_colour_is_swept_to_the_channels_of_grey_ones() {
    let frame = |scene: Scene| {
        let work = Work::new("");
        let tree = OpenTree::open(&work.bake(&scene, 1), None).unwrap();
        let (frame, counts) = shaded(&scene, &tree, Region::full(64, 48));
        (beauty(&frame), counts)
    };
    let (colored, counts) = frame(colored_cloud(128, 12.0, COLOR));
    for (c, of_channel) in COLOR.into_iter().enumerate() {
        let (grey, grey_counts) = frame(colored_cloud(128, 12.0 * of_channel, [1.0; 3]));
        if c == 0 {
            for name in ["media_vertices_swept", "cells_swept"] {
                let [found, of_grey] = [&counts, &grey_counts].map(|counts| counts[name]);
                assert!(found == of_grey && found > 0.0, "{name}: {found} {of_grey}");
            }
        }
        let channel = |pixels: &[[f32; 3]]| pixels.iter().map(|p| [p[c]; 3]).collect::<Vec<_>>();
        let (found, expected) = (channel(&colored), channel(&grey));
        let (brighter, difference) = apart(&found, &expected);
        assert!(
            brighter.abs() < 0.005 && difference < 0.03,
            "{c}: {brighter} {difference}"
        );
    }
}
