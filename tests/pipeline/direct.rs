//! Direct light by the samples of pixels, beside paths.

use crate::{layer, render};
use lvox::image::Region;
use lvox::reference;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::Settings;
use std::fs;

/// A block over a floor under twelve lamps of different sizes and colours: penumbrae nearly everywhere.
fn lamps() -> String {
    let mut text = String::from(
        "[film]\nwidth = 48\nheight = 36\n[[camera]]\nposition = [0, 2, 4]\ntarget = [0, 0.3, 0]\nfov_x_deg = 50\n\
         [[mesh]]\nfile = \"builtin:quad\"\nscale = 8\nalbedo = [0.8, 0.8, 0.8]\n\
         [[mesh]]\nfile = \"builtin:cube\"\nscale = 0.6\nrotate_deg = [0, 30, 0]\ntranslate = [-0.4, 0.9, 0.2]\n\
         albedo = [0.7, 0.5, 0.3]\n",
    );
    for i in 0..12 {
        let (column, row, third) = ((i % 4) as f32, (i / 4) as f32, (i % 3) as f32);
        text += &format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {}\nrotate_deg = [180, 0, 0]\ntranslate = [{}, {}, {}]\n\
             albedo = [0, 0, 0]\nemission = [{}, {}, {}]\n",
            0.3 + 0.05 * third,
            1.1 * column - 1.6,
            2.2 + 0.2 * third,
            0.9 * row - 1.2,
            2 + 3 * (i % 2),
            3 + 2 * (i % 3),
            6 - i % 4,
        );
    }
    text
}

/// What directly lit and emissive surfaces send to each pixel.
fn truth(text: &str) -> Vec<[f32; 3]> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.toml");
    fs::write(&path, text).unwrap();
    let scene = Scene::load(&path).unwrap();
    let settings = reference::Settings {
        max_depth: 2,
        spp: Some(2048),
        strands: 1,
        seed: 3,
        ..reference::Settings::default()
    };
    let (region, job) = (
        Region::full(scene.film.width, scene.film.height),
        Job::default(),
    );
    let mut sums = reference::begin(&scene, &settings, region, &job).unwrap();
    reference::accumulate(&scene, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    let frame = reference::frame(&scene, &settings, &sums);
    layer(&frame, "")
}

#[test]
fn more_samples_of_pixels_never_add_error() {
    let text = lamps();
    let truth = truth(&text);
    let mut last = f64::INFINITY;
    for pixel_samples in [1, 2, 4, 16, 64] {
        let settings = Settings {
            samples: 1,
            pixel_samples,
            ..Settings::default()
        };
        let direct = layer(&render(&text, 2000, &settings), "direct");
        let square = |(found, truth): (&f32, &f32)| {
            let (found, truth) = (f64::from(*found), f64::from(*truth));
            (found - truth).powi(2) / (truth * truth + 0.01)
        };
        let sum: f64 = direct
            .iter()
            .flatten()
            .zip(truth.iter().flatten())
            .map(square)
            .sum();
        let error = sum / (3 * truth.len()) as f64;
        eprintln!("{pixel_samples} samples of each pixel: relMSE {error:.2e}");
        assert!(
            error <= last,
            "{error} for {pixel_samples}, {last} for fewer"
        );
        last = error;
    }
}
