//! Media whose albedo varies: as those of one albedo where it does not, as the path tracer has them
//! where it does, and the same in a packed scene.

use crate::support::trees;
use crate::{Work, beauty, mean, relative_rms, shade, traced};
use glam::{DAffine3, DVec3};
use lvox::formats::Overwrite;
use lvox::run::Job;
use lvox::scene::{
    CameraInput, Film, Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput,
};
use lvox::shade::Settings;
use lvox::tree::OpenTree;
use lvox::{bounce, pack};
use std::path::Path;

const DIMS: [usize; 3] = [24; 3];

/// By channel, the albedo of a voxel.
type ByVoxel = [fn([usize; 3]) -> f32; 3];

/// A ball of smoke over a floor under a lamp, with an albedo that varies, or of one.
fn scene(albedo: Result<ByVoxel, [f32; 3]>) -> Scene {
    let camera = CameraInput::look_at("front", [0.0, 0.9, 3.0], [0.0, 0.6, 0.0], DVec3::Y, 0.6);
    let corners = [
        [-2.0, 0.0, 2.0],
        [2.0, 0.0, 2.0],
        [2.0, 0.0, -2.0],
        [-2.0, 0.0, -2.0],
    ];
    let floor = MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]]);
    let ball = Grid::from_fn(DIMS, |v| {
        let squares: f32 = v.iter().map(|i| ((*i as f32 - 11.5) / 12.0).powi(2)).sum();
        8.0 * (1.5 - 1.5 * squares).clamp(0.0, 1.0)
    });
    let place = DAffine3::from_translation(DVec3::new(-0.5, 0.2, -0.5))
        * DAffine3::from_scale(DVec3::splat(1.0 / 24.0));
    let smoke = VolumeInput::new("smoke", ball, albedo.err().unwrap_or([0.5; 3]), place);
    let smoke = match albedo {
        Ok(channels) => smoke.albedo_grid(channels.map(|of| Grid::from_fn(DIMS, of))),
        Err(_) => smoke,
    };
    let film = Film {
        width: 48,
        height: 36,
        exposure: 1.0,
    };
    SceneBuilder::new("halves")
        .film(film)
        .camera(camera.unwrap())
        .mesh(floor.albedo([0.6; 3]))
        .light(LightInput::point([0.6, 2.5, 1.5], [10.0; 3]))
        .volume(smoke)
        .build()
        .unwrap()
}

fn right_half([x, ..]: [usize; 3]) -> f32 {
    if x < 12 { 0.1 } else { 0.95 }
}

fn left_half([x, ..]: [usize; 3]) -> f32 {
    if x < 12 { 0.9 } else { 0.2 }
}

/// Blue on the right, red on the left.
fn halves() -> Scene {
    scene(Ok([left_half, |_| 0.3, right_half]))
}

/// The picture of all bounces, from the tree of one.
fn bounced(scene: &Scene, work: &Work, tree: &Path) -> Vec<[f32; 3]> {
    let all = work.path("all.lvt");
    let store = OpenTree::open(tree, None).unwrap();
    let (settings, job) = (bounce::Settings::default(), Job::default());
    bounce::run(scene, &store, &all, &settings, Overwrite::Refuse, &job).unwrap();
    beauty(&shade(scene, &all, &Settings::default()))
}

/// The mean of a channel over the left or the right of the smoke.
fn half(pixels: &[[f32; 3]], channel: usize, is_right: bool) -> f64 {
    let columns = if is_right { 24..36 } else { 12..24 };
    let mut sum = 0.0;
    for y in 6..30 {
        for x in columns.clone() {
            sum += f64::from(pixels[y * 48 + x][channel]);
        }
    }
    sum / (24 * 12) as f64
}

/// Blue on the right, red on the left of a step between voxels 12 and 13, within blocks of two.
fn uneven_halves() -> Scene {
    scene(Ok([
        |[x, ..]| if x < 13 { 0.9 } else { 0.2 },
        |_| 0.3,
        |[x, ..]| if x < 13 { 0.1 } else { 0.95 },
    ]))
}

/// By channel, the means of four columns of pixels on the left and on the right of that step.
fn beside_the_step(pixels: &[[f32; 3]]) -> Vec<f64> {
    let mean_of = |first: usize, channel: usize| {
        let rows = (10..26).flat_map(|y| (first..first + 4).map(move |x| y * 48 + x));
        rows.map(|i| f64::from(pixels[i][channel])).sum::<f64>() / 64.0
    };
    let of_side = |first| [0, 1, 2].map(|channel| mean_of(first, channel));
    [of_side(21), of_side(25)].as_flattened().to_vec()
}

/// Each half in each channel is as bright to a twentieth, and a hundredth of the brightest: of one
/// albedo they are to three hundredths, and a step of it is spread over a voxel.
fn assert_close(found: &[[f32; 3]], expected: &[[f32; 3]]) {
    let of = |pixels| {
        let halves = [false, true].map(|is_right| [0, 1, 2].map(|c| half(pixels, c, is_right)));
        halves.as_flattened().to_vec()
    };
    let (found, expected) = (of(found), of(expected));
    let brightest = expected.iter().copied().fold(0.0, f64::max);
    for (f, e) in found.iter().zip(&expected) {
        let most = 0.05 * e + 0.01 * brightest;
        assert!((f - e).abs() < most, "{found:?} {expected:?}");
    }
}

#[test]
fn smoke_of_two_colors_agrees_with_the_path_tracer() {
    let scene = halves();
    let work = Work::new("");
    let tree = work.bake(&scene, 20_000);
    let once = beauty(&shade(&scene, &tree, &Settings::default()));
    let expected = traced(&scene, 3, 512);
    assert!(half(&expected, 0, false) > 1.5 * half(&expected, 0, true));
    assert_close(&once, &expected);
    let expected = traced(&scene, 0, 1024);
    assert_close(&bounced(&scene, &work, &tree), &expected);
}

#[test]
fn a_step_of_albedo_is_not_blurred() {
    let scene = uneven_halves();
    let work = Work::new("");
    let tree = work.bake(&scene, 20_000);
    let found = beside_the_step(&bounced(&scene, &work, &tree));
    let expected = beside_the_step(&traced(&scene, 0, 2048));
    // Of the brighter side: pixels at the step are spread over both.
    for c in 0..3 {
        let most = 0.025 * expected[c].max(expected[c + 3]);
        for side in [c, c + 3] {
            let off = (found[side] - expected[side]).abs();
            assert!(off < most, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn a_grid_of_one_albedo_is_that_albedo() {
    let plain = scene(Err([0.75, 0.5, 0.25]));
    let grid = scene(Ok([|_| 0.75, |_| 0.5, |_| 0.25]));
    assert_eq!(plain.volumes[0].albedo, grid.volumes[0].albedo);
    let picture = |scene: &Scene| {
        let work = Work::new("");
        let tree = work.bake(scene, 5_000);
        bounced(scene, &work, &tree)
    };
    let difference = relative_rms(&picture(&grid), &picture(&plain));
    assert!(difference < 1e-3, "{difference}");
    assert!(mean(&traced(&grid, 3, 4)) == mean(&traced(&plain, 3, 4)));
}

#[test]
fn a_packed_scene_keeps_its_albedos() {
    let scene = halves();
    let work = Work::new("");
    let path = work.path("scene.lvp");
    let job = Job::default();
    pack::run(
        &scene,
        pack::Files::default(),
        &path,
        Overwrite::Refuse,
        &job,
    )
    .unwrap();
    let packed = Scene::load(&path).unwrap();
    assert_eq!(scene.parts(None), packed.parts(None));
    assert_eq!(scene.volumes[0].albedo, packed.volumes[0].albedo);
    assert!(traced(&scene, 3, 2) == traced(&packed, 3, 2));
    let again = work.path("again.lvp");
    pack::run(
        &packed,
        pack::Files::default(),
        &again,
        Overwrite::Refuse,
        &job,
    )
    .unwrap();
    assert!(std::fs::read(&path).unwrap() == std::fs::read(&again).unwrap());
    let tree = trees::baked(&packed, &trees::of_surfels(2000), work.0.path(), "packed");
    let other = trees::baked(&scene, &trees::of_surfels(2000), work.0.path(), "own");
    assert!(std::fs::read(tree).unwrap() == std::fs::read(other).unwrap());
}
