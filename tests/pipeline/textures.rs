//! Textures whose texels are smaller than pixels.

use crate::{Work, beauty, relative_rms, shade};
use lvox::shade::Settings;
use std::fmt::Write;
use std::fs;

const SCENE: &str = r#"
[film]
width = 96
height = 72
[[camera]]
position = [0, 1, 3]
target = [0, 0, 0]
fov_x_deg = 50
[[mesh]]
file = "floor.obj"
texture = "tiles.png"
[[light]]
type = "directional"
direction = [0.2, -1, 0]
irradiance = [3, 3, 3]
"#;

/// A chequerboard of two colours.
fn tiles(colors: [[u8; 3]; 2]) -> image::RgbImage {
    image::RgbImage::from_fn(64, 64, |x, y| {
        image::Rgb(colors[(x / 2 + y / 2) as usize % 2])
    })
}

/// A floor of edge 6, divided into so many squares along each edge.
fn floor(parts: usize) -> String {
    let mut text = String::new();
    for j in 0..=parts {
        for i in 0..=parts {
            let [u, v] = [i, j].map(|k| k as f32 / parts as f32);
            let (x, z) = (6.0 * u - 3.0, 6.0 * v - 3.0);
            writeln!(text, "v {x} 0 {z}\nvt {u} {v}").unwrap();
        }
    }
    for j in 0..parts {
        for i in 0..parts {
            let a = j * (parts + 1) + i + 1;
            let b = a + parts + 1;
            let (c, d) = (a + 1, b + 1);
            writeln!(text, "f {a}/{a} {b}/{b} {d}/{d}\nf {a}/{a} {d}/{d} {c}/{c}").unwrap();
        }
    }
    text
}

/// Corners of pixels share their light, and it was the mean of their four albedos that was lit:
/// 0.28 of the mean beside 256 samples a pixel, with two triangles or with some that are smaller
/// than pixels. Now it is 0.014.
#[test]
fn textures_are_averaged_over_pixels() {
    for parts in [1, 100] {
        let work = Work::new(SCENE);
        tiles([[240, 60, 40], [30, 60, 220]])
            .save(work.path("tiles.png"))
            .unwrap();
        fs::write(work.path("floor.obj"), floor(parts)).unwrap();
        let scene = work.scene();
        let tree = work.bake(&scene, 5_000);
        let [shared, own] = [1, 256].map(|pixel_samples| {
            let settings = Settings {
                pixel_samples,
                ..Settings::default()
            };
            beauty(&shade(&scene, &tree, &settings))
        });
        let difference = relative_rms(&shared, &own);
        assert!(difference < 0.03, "{parts}: {difference}");
    }
}

/// The frame of a floor with a texture, and that of 256 samples in each pixel.
fn floors(texture: &image::RgbImage) -> [Vec<[f32; 3]>; 2] {
    let work = Work::new(SCENE);
    texture.save(work.path("tiles.png")).unwrap();
    fs::write(work.path("floor.obj"), floor(1)).unwrap();
    let scene = work.scene();
    let tree = work.bake(&scene, 5_000);
    [1, 256].map(|pixel_samples| {
        let settings = Settings {
            pixel_samples,
            ..Settings::default()
        };
        beauty(&shade(&scene, &tree, &settings))
    })
}

/// All light of a frame over that of another.
fn ratio(of: &[[f32; 3]], to: &[[f32; 3]]) -> f32 {
    let sum = |frame: &[[f32; 3]]| frame.iter().flatten().sum::<f32>();
    sum(of) / sum(to)
}

/// Where a corner of a pixel is on a black texel, light still falls on those beside it.
#[test]
fn black_texels_take_no_light_from_others() {
    let [shared, own] = floors(&tiles([[240, 200, 160], [0, 0, 0]]));
    let ratio = ratio(&shared, &own);
    assert!((ratio - 1.0).abs() < 0.01, "{ratio}");
    let difference = relative_rms(&shared, &own);
    assert!(difference < 0.05, "{difference}");
}

/// Lines of one texel in sixteen, which corners of pixels mostly miss.
#[test]
fn lines_finer_than_pixels_are_there() {
    let lines = image::RgbImage::from_fn(512, 512, |x, _| match x % 16 {
        0 => image::Rgb([20, 20, 20]),
        _ => image::Rgb([220, 220, 220]),
    });
    let [shared, own] = floors(&lines);
    let ratio = ratio(&shared, &own);
    assert!((ratio - 1.0).abs() < 0.005, "{ratio}");
    let difference = relative_rms(&shared, &own);
    assert!(difference < 0.04, "{difference}");
}
