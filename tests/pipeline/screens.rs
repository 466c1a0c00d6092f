//! Surfaces of which a texture says where they emit: beside the path tracer, in tiles, packed, and
//! with a texture that is white.

use crate::support::program::lvox;
use crate::{Work, beauty, layer, mean, shade, with_threads};
use lvox::image::Region;
use lvox::internals::reference;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self as shading, Aov, Settings};
use lvox::tree::OpenTree;
use std::fs;

/// A screen that stands on a floor before a wall, its picture towards the wall and the camera.
const SCREEN: &str = r#"
[film]
width = 48
height = 36
[[camera]]
position = [1.2, 1.0, 2.6]
target = [0, 0.4, 0]
fov_x_deg = 45
[[mesh]]
file = "builtin:quad"
scale = [5, 1, 5]
albedo = [0.6, 0.5, 0.4]
[[mesh]]
file = "builtin:quad"
scale = [5, 1, 3]
rotate_deg = [90, 0, 0]
translate = [0, 1.5, -0.9]
albedo = [0.5, 0.5, 0.6]
[[mesh]]
name = "screen"
file = "builtin:quad"
scale = [1.2, 1, 0.8]
rotate_deg = [90, 20, 0]
translate = [-0.1, 0.5, 0]
albedo = [0, 0, 0]
emission = [4, 4, 4]
emission_texture = "screen.png"
emits_both_sides = true
"#;

/// Red to the left, a blue lamp in a corner, black between.
fn picture() -> image::RgbImage {
    image::RgbImage::from_fn(32, 32, |x, y| {
        let is_lamp = (24..28).contains(&x) && (4..9).contains(&y);
        match (x < 8, is_lamp) {
            (true, _) => image::Rgb([230, (6 * y) as u8, 20]),
            (_, true) => image::Rgb([60, 120, 255]),
            _ => image::Rgb([0, 0, 0]),
        }
    })
}

fn work(text: &str, picture: &image::RgbImage) -> Work {
    let work = Work::new(text);
    picture.save(work.path("screen.png")).unwrap();
    work
}

fn reference(scene: &Scene, max_depth: u32, spp: u32) -> Vec<[f32; 3]> {
    let settings = reference::Settings {
        spp: Some(spp),
        max_depth,
        ..reference::Settings::default()
    };
    let region = Region::full(scene.film.width, scene.film.height);
    let job = Job::default();
    let mut sums = reference::begin(scene, &settings, region, &job).unwrap();
    reference::accumulate(scene, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    sums.estimates().0
}

#[test]
fn light_of_a_screen_agrees_with_the_path_tracer() {
    let work = work(SCREEN, &picture());
    let scene = work.scene();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    let tree = work.bake(&scene, 20_000);
    let frame = shade(&scene, &tree, &Settings::default());
    for (found, max_depth) in [(layer(&frame, "direct"), 2), (beauty(&frame), 3)] {
        let expected = reference(&scene, max_depth, 1024);
        let bias = mean(&found) / mean(&expected) - 1.0;
        assert!(bias.abs() < 0.01, "{max_depth}: {bias}");
        let floor = 0.5 * mean(&expected) as f32;
        let squared = |(a, b): (&f32, &f32)| f64::from((a - b) / (b + floor)).powi(2);
        let pairs = found.as_flattened().iter().zip(expected.as_flattened());
        let rms = (pairs.map(squared).sum::<f64>() / (3 * found.len()) as f64).sqrt();
        assert!(rms < 0.04, "{max_depth}: {rms}");
    }
}

/// Paths that run into a screen and rays that ask for it tell the same: what is sampled by the
/// cells of a texture has no bias.
#[test]
fn the_path_tracer_finds_the_light_of_the_same_picture_in_triangles() {
    // Two even halves of a texture are two quads of these colours.
    let texture = image::RgbImage::from_fn(2, 2, |x, _| match x {
        0 => image::Rgb([255, 255, 255]),
        _ => image::Rgb([0, 0, 255]),
    });
    // Enlarged, so that little lies between the two.
    let texture = image::imageops::resize(&texture, 256, 256, image::imageops::FilterType::Nearest);
    let textured = work(SCREEN, &texture);
    let half = |x: f64, emission: &str| {
        let screen = &SCREEN[SCREEN.find("[[mesh]]\nname = \"screen\"").unwrap()..];
        let screen = screen.replace("emission = [4, 4, 4]\n", emission);
        let screen = screen.replace("emission_texture = \"screen.png\"\n", "");
        let screen = screen.replace("[1.2, 1, 0.8]", "[0.6, 1, 0.8]");
        let (sin, cos) = 20.0_f64.to_radians().sin_cos();
        let place = format!("[{}, 0.5, {}]", -0.1 + x * cos, -x * sin);
        screen.replace("[-0.1, 0.5, 0]", &place)
    };
    let rest = &SCREEN[..SCREEN.find("[[mesh]]\nname = \"screen\"").unwrap()];
    let halves = half(-0.3, "emission = [4, 4, 4]\n") + &half(0.3, "emission = [0, 0, 4]\n");
    let plain = Work::new(&format!("{rest}{halves}"));
    for max_depth in [2, 3] {
        let [a, b] = [&textured, &plain].map(|w| reference(&w.scene(), max_depth, 256));
        for c in 0..3 {
            let sum = |p: &[[f32; 3]]| p.iter().map(|p| f64::from(p[c])).sum::<f64>();
            let ratio = sum(&a) / sum(&b);
            assert!((ratio - 1.0).abs() < 0.01, "{max_depth} {c}: {ratio}");
        }
    }
}

#[test]
fn a_white_texture_changes_no_pixel() {
    let white = image::RgbImage::from_pixel(5, 3, image::Rgb([255; 3]));
    let textured = work(SCREEN, &white);
    let plain = Work::new(&SCREEN.replace("emission_texture = \"screen.png\"\n", ""));
    let frames = [&textured, &plain].map(|work| {
        let scene = work.scene();
        let tree = work.bake(&scene, 5_000);
        beauty(&shade(&scene, &tree, &Settings::default()))
    });
    assert!(frames[0] == frames[1]);
}

#[test]
fn tiles_threads_and_packed_scenes_make_the_same_picture_of_a_screen() {
    let work = work(SCREEN, &picture());
    let scene = work.scene();
    let tree = work.bake(&scene, 5_000);
    let whole = beauty(&shade(&scene, &tree, &Settings::default()));
    let again = with_threads(1, || beauty(&shade(&scene, &tree, &Settings::default())));
    assert!(whole == again);
    let region = Region {
        x0: 11,
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
    let here = work.0.path();
    lvox(here, &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    lvox(here, &["pack", "scene.lvp", "-o", "again.lvp"]).done();
    let bytes = |name: &str| fs::read(work.path(name)).unwrap();
    assert!(bytes("again.lvp") == bytes("scene.lvp"));
    let told = lvox(here, &["inspect", "scene.toml"]).stdout;
    assert!(told.contains("x texture 0"), "{told}");
    for name in ["screen.png", "scene.toml"] {
        fs::remove_file(work.path(name)).unwrap();
    }
    let packed = Scene::load(&work.path("scene.lvp")).unwrap();
    assert_eq!(packed.parts(None), scene.parts(None));
    assert!(whole == beauty(&shade(&packed, &tree, &Settings::default())));
}

#[test]
fn another_picture_is_another_light() {
    let [a, b] = [picture(), image::imageops::flip_vertical(&picture())]
        .map(|picture| work(SCREEN, &picture).scene());
    let differ = a.parts_that_differ(&b.parts(None)).unwrap();
    assert!(!differ.is_empty());
}
