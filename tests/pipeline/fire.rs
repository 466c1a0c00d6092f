//! Emissive volumes: the same picture in tiles, and the light that closed forms and the path tracer
//! have.

use crate::{Work, beauty, layer, mean, shade, with_threads};
use glam::{DAffine3, DVec3};
use lvox::image::Region;
use lvox::internals::reference;
use lvox::run::Job;
use lvox::scene::{
    CameraInput, Emission, EmissiveInput, Film, Grid, MeshInput, Scene, SceneBuilder, VolumeInput,
};
use lvox::shade::{self as shading, Aov, Settings};
use lvox::tree::OpenTree;

/// A floor below a ball that glows, with smoke in the same place and beside it if that is asked
/// for.
fn scene(emission: Emission, value: f32, smoke: bool) -> Scene {
    let camera = CameraInput::look_at("front", [0.0, 1.5, 4.0], [0.0, 0.5, 0.0], DVec3::Y, 0.7);
    let corners = [
        [-3.0, 0.0, 3.0],
        [3.0, 0.0, 3.0],
        [3.0, 0.0, -3.0],
        [-3.0, 0.0, -3.0],
    ];
    let floor = MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]]);
    let ball = |value: f32| {
        Grid::from_fn([24; 3], move |v| {
            let squares: f32 = v.iter().map(|i| ((*i as f32 - 11.5) / 12.0).powi(2)).sum();
            value * (1.5 - 1.5 * squares).clamp(0.0, 1.0)
        })
    };
    let at = |x: f64| {
        DAffine3::from_translation(DVec3::new(x, 0.4, -0.4))
            * DAffine3::from_scale(DVec3::splat(0.8 / 24.0))
    };
    let film = Film {
        width: 48,
        height: 36,
        exposure: 1.0,
    };
    let builder = SceneBuilder::new("fire")
        .film(film)
        .camera(camera.unwrap())
        .mesh(floor.albedo([0.6, 0.5, 0.4]))
        .emissive(EmissiveInput::new("fire", ball(value), emission, at(-0.4)));
    let builder = match smoke {
        true => builder
            .volume(VolumeInput::new("its smoke", ball(3.0), [0.6; 3], at(-0.4)))
            .volume(VolumeInput::new("smoke", ball(3.0), [0.8; 3], at(0.6))),
        false => builder,
    };
    builder.build().unwrap()
}

const FLAME: Emission = Emission::Proportional {
    radiance: [6.0, 2.5, 0.5],
};

#[test]
fn a_fire_is_no_scene_without_light() {
    let scene = scene(FLAME, 1.0, false);
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert!(scene.volumes.is_empty() && scene.emissive.len() == 1);
}

#[test]
fn light_of_a_fire_agrees_with_the_path_tracer() {
    for (emission, value, smoke) in [
        (FLAME, 1.0, false),
        (FLAME, 1.0, true),
        (Emission::Blackbody { scale: 40.0 }, 2000.0, true),
    ] {
        let scene = scene(emission, value, smoke);
        let work = Work::new("");
        let tree = work.bake(&scene, 20_000);
        let frame = shade(&scene, &tree, &Settings::default());
        let settings = reference::Settings {
            max_depth: 3,
            spp: Some(512),
            ..reference::Settings::default()
        };
        let region = Region::full(scene.film.width, scene.film.height);
        let mut sums = reference::begin(&scene, &settings, region, &Job::default()).unwrap();
        reference::accumulate(&scene, &settings, &mut sums, &Job::default(), &mut |_| {
            Ok(())
        })
        .unwrap();
        let expected = beauty(&reference::frame(&scene, &sums));
        let found = beauty(&frame);
        let bias = mean(&found) / mean(&expected) - 1.0;
        // In smoke of few voxels light changes between vertices: up to five hundredths too dark.
        let bounds = if smoke { [0.05, 0.06] } else { [0.01, 0.03] };
        assert!(bias.abs() < bounds[0], "{emission:?} {smoke}: {bias}");
        let floor = mean(&expected) as f32;
        let squared = |(a, b): (&f32, &f32)| f64::from((a - b) / (b + floor)).powi(2);
        let pairs = found.as_flattened().iter().zip(expected.as_flattened());
        let rms = (pairs.map(squared).sum::<f64>() / (3 * found.len()) as f64).sqrt();
        assert!(rms < bounds[1], "{emission:?} {smoke}: {rms}");
        // What is seen of the fire itself is a layer of media.
        assert!(mean(&layer(&frame, "volume")) > 0.2 * mean(&found));
    }
}

#[test]
fn tiles_and_threads_make_the_same_picture_of_a_fire() {
    let scene = scene(FLAME, 1.0, true);
    let work = Work::new("");
    let tree = work.bake(&scene, 5_000);
    let whole = beauty(&shade(&scene, &tree, &Settings::default()));
    let again = with_threads(1, || beauty(&shade(&scene, &tree, &Settings::default())));
    assert!(whole == again);
    let region = Region {
        x0: 13,
        y0: 7,
        x1: 31,
        y1: 29,
    };
    let store = OpenTree::open(&tree, None).unwrap();
    let aovs = Aov::ALL.map(|(_, aov)| aov);
    let job = Job::default();
    let tile = shading::run(&scene, &store, &Settings::default(), region, &aovs, &job).unwrap();
    let tile = tile.picture("", &region).unwrap().pixels;
    for (pixel, (x, y)) in tile.iter().zip(region.coordinates()) {
        assert!(
            *pixel == whole[(y * scene.film.width + x) as usize],
            "{x} {y}"
        );
    }
}
