//! Scenes under an environment image, beside those under the same light in other forms, and beside
//! the path tracer.

use crate::{Work, beauty, layer, mean, relative_rms, shade};
use glam::{DAffine3, DVec3};
use lvox::image::{Frame, Region};
use lvox::internals::reference;
use lvox::run::Job;
use lvox::scene::{
    CameraInput, EnvironmentImage, EnvironmentInput, Film, Grid, LightInput, MeshInput, Scene,
    SceneBuilder, VolumeInput,
};
use lvox::shade::Settings;

const LAYERS: [&str; 4] = ["direct", "environment", "indirect", "volume"];

/// A white block on a floor, in front of a wall, and a ball of fog if that is asked for.
fn builder(fog: bool) -> SceneBuilder {
    let camera = CameraInput::look_at("front", [0.5, 2.0, 5.0], [0.0, 0.5, 0.0], DVec3::Y, 0.8);
    let film = Film {
        width: 64,
        height: 48,
        exposure: 1.0,
    };
    let quad = |name: &str, corners: [[f64; 3]; 4]| {
        MeshInput::new(name, corners, vec![[0, 1, 2], [0, 2, 3]])
    };
    let floor = [
        [-4.0, 0.0, 4.0],
        [4.0, 0.0, 4.0],
        [4.0, 0.0, -2.0],
        [-4.0, 0.0, -2.0],
    ];
    let wall = [
        [-4.0, 0.0, -1.0],
        [1.5, 0.0, -1.0],
        [1.5, 2.5, -1.0],
        [-4.0, 2.5, -1.0],
    ];
    let side = [
        [-1.0, 0.0, 1.5],
        [-1.0, 0.0, -0.6],
        [-1.0, 1.2, -0.6],
        [-1.0, 1.2, 1.5],
    ];
    let scene = SceneBuilder::new("below a sky")
        .film(film)
        .camera(camera.unwrap())
        .mesh(quad("floor", floor).albedo([0.6, 0.5, 0.4]))
        .mesh(quad("wall", wall).albedo([0.7, 0.2, 0.2]))
        .mesh(quad("side", side).albedo([0.8; 3]));
    if !fog {
        return scene;
    }
    let density = |v: [usize; 3]| {
        let squares: f32 = v.iter().map(|i| ((*i as f32 - 7.5) / 8.0).powi(2)).sum();
        4.0 * (1.0 - squares).max(0.0)
    };
    let place = DAffine3::from_translation(DVec3::new(0.2, 0.1, -0.2))
        * DAffine3::from_scale(DVec3::splat(1.2 / 16.0));
    let grid = Grid::from_fn([16; 3], density);
    scene.volume(VolumeInput::new("fog", grid, [0.9; 3], place))
}

/// A blue sky over a brown ground with a glow and, if that is asked for, a sun inside it.
fn sky(sun: bool) -> EnvironmentImage {
    let (width, height) = (256, 128);
    let blank = EnvironmentImage::new(width, height, vec![[0.0; 3]; 256 * 128]).unwrap();
    let towards = glam::Vec3::new(0.6, 0.7, 0.4).normalize();
    let texel = |i: u32| {
        let place = [i % width, i / width].map(|c| c as f32 + 0.5);
        let d = blank.direction([place[0] / width as f32, place[1] / height as f32]);
        let up = d.y.max(0.0);
        let base = match d.y > 0.0 {
            true => [0.5 + 0.4 * (1.0 - up), 0.7 + 0.2 * (1.0 - up), 1.2],
            false => [0.25, 0.2, 0.15],
        };
        let off = 1.0 - d.dot(towards);
        let glow = 30.0 * (-off * 25.0).exp();
        let disk = if sun && off < 1.5e-4 { 1.5e4 } else { 0.0 };
        base.map(|v| v + glow + disk)
    };
    EnvironmentImage::new(width, height, (0..width * height).map(texel).collect()).unwrap()
}

fn under(input: EnvironmentInput, fog: bool) -> Scene {
    builder(fog).environment_image(input).build().unwrap()
}

fn frame(scene: &Scene, settings: &Settings) -> Frame {
    let work = Work::new("");
    let tree = work.bake(scene, 60_000);
    shade(scene, &tree, settings)
}

fn adds_up(frame: &Frame) {
    let parts = LAYERS.map(|name| layer(frame, name));
    for (i, whole) in beauty(frame).iter().enumerate() {
        for c in 0..3 {
            let sum: f32 = parts.iter().map(|p| p[i][c]).sum();
            assert!((sum - whole[c]).abs() <= 1e-5 * whole[c], "{sum} {whole:?}");
        }
    }
}

/// An image that differs in one texel, so that it is no environment of one colour.
#[test]
fn an_image_that_is_nearly_even_is_an_even_environment() {
    let even = builder(true).light(LightInput::environment([0.5, 1.0, 2.0]));
    let even = frame(&even.build().unwrap(), &Settings::default());
    let mut texels = vec![[0.5, 1.0, 2.0]; 64 * 32];
    texels[17][1] = 1.000_01;
    let image = EnvironmentImage::new(64, 32, texels).unwrap();
    let image = frame(
        &under(EnvironmentInput::new(image), true),
        &Settings::default(),
    );
    for name in LAYERS.into_iter().chain([""]) {
        let [found, expected] = [&image, &even].map(|frame| layer(frame, name));
        let worst = (found.iter().flatten().zip(expected.iter().flatten()))
            .map(|(a, b)| f64::from((a - b).abs()))
            .fold(0.0, f64::max);
        assert!(worst <= 2e-3, "{name}: {worst}");
        let change = (mean(&found) - mean(&expected)).abs();
        assert!(
            change <= 1e-4 * mean(&expected).max(1e-3),
            "{name}: {change}"
        );
    }
    adds_up(&even);
    adds_up(&image);
    // Nothing bounces of a sky that is seen, and nothing else lights the scene.
    assert_eq!(mean(&layer(&even, "direct")), 0.0);
    assert!(mean(&layer(&even, "environment")) > mean(&layer(&even, "indirect")));
}

/// Mean over blocks of eight pixels.
fn blocks(pixels: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let block = |i: usize| {
        let (x, y) = (i % 8 * 8, i / 8 * 8);
        let mut sum = [0.0; 3];
        for at in (0..64).map(|k| (y + k / 8) * 64 + x + k % 8) {
            (0..3).for_each(|c| sum[c] += pixels[at][c] / 64.0);
        }
        sum
    };
    (0..8 * 6).map(block).collect()
}

#[test]
fn light_of_a_sky_and_its_sun_is_that_of_the_path_tracer() {
    let settings = reference::Settings {
        max_depth: 3,
        spp: Some(192),
        ..reference::Settings::default()
    };
    for (fog, tolerance) in [(false, 0.008), (true, 0.015)] {
        let (truth, taken, kept) = {
            let taken = under(EnvironmentInput::new(sky(true)), fog);
            let kept = under(EnvironmentInput::new(sky(true)).keeping_suns(), fog);
            assert_eq!((taken.lights.len(), kept.lights.len()), (1, 0));
            let job = Job::default();
            let region = Region::full(64, 48);
            let mut sums = reference::begin(&kept, &settings, region, &job).unwrap();
            reference::accumulate(&kept, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
            (sums.estimates().0, taken, kept)
        };
        let truth = blocks(&truth);
        for scene in [&taken, &kept] {
            let found = frame(scene, &Settings::default());
            adds_up(&found);
            let found = blocks(&beauty(&found));
            let bias = mean(&found) / mean(&truth) - 1.0;
            let error = relative_rms(&found, &truth);
            assert!(
                bias.abs() < tolerance && error < 3.0 * tolerance,
                "{bias} {error}"
            );
        }
    }
}
