//! Surfaces that masks cut out, from the scene to the picture.

use crate::support::program::lvox;
use crate::{Work, beauty, layer, mean, shade};
use lvox::formats::Cloud;
use lvox::image::Region;
use lvox::run::Job;
use lvox::shade::{Aov, Settings};
use lvox::tree::OpenTree;
use std::fs;

/// A white card above a floor, the camera between the two, and a sun overhead.
const CARD: &str = r#"
[film]
width = 60
height = 60
[[camera]]
position = [0, 1.5, 0]
target = [0, 0, 0]
up = [0, 0, 1]
fov_x_deg = 43.602818972
[[mesh]]
file = "builtin:quad"
scale = [4, 1, 4]
albedo = [0.5, 0.5, 0.5]
[[mesh]]
file = "card.obj"
scale = 0.97
translate = [0.013, 2, 0.004]
opacity = "checks.png"
opacity_cutoff = 0.5
[[light]]
type = "directional"
direction = [0, -1, 0]
irradiance = [3.14159265, 3.14159265, 3.14159265]
"#;

const SQUARE: &str = "v -0.5 0 -0.5\nv -0.5 0 0.5\nv 0.5 0 0.5\nv 0.5 0 -0.5\nvt 0 0\nvt 0 1\n\
                      vt 1 1\nvt 1 0\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n";

/// Eight by eight checks, every other one clear.
fn checks() -> image::RgbaImage {
    image::RgbaImage::from_fn(64, 64, |x, y| {
        let is_there = (x / 8 + y / 8) % 2 == 0;
        image::Rgba([200, 180, 160, if is_there { 255 } else { 0 }])
    })
}

fn work(text: &str) -> Work {
    let work = Work::new(text);
    fs::write(work.path("card.obj"), SQUARE).unwrap();
    checks().save(work.path("checks.png")).unwrap();
    work
}

fn pictures(text: &str) -> lvox::image::Frame {
    let work = work(text);
    let scene = work.scene();
    let tree = work.bake(&scene, 20_000);
    shade(&scene, &tree, &Settings::default())
}

/// The area of the card over that of the floor that the camera sees.
const WHOLE: f64 = 0.97 * 0.97 / 1.44;

#[test]
fn the_shadow_of_a_checkered_card_has_half_its_area() {
    for (opacity, lit) in [
        (
            "opacity = \"checks.png\"\nopacity_cutoff = 0.5",
            1.0 - 0.5 * WHOLE,
        ),
        ("opacity = \"checks.png\"", 1.0 - 0.5 * WHOLE),
        ("opacity = 0.3", 1.0 - 0.3 * WHOLE),
        ("opacity = 1", 1.0 - WHOLE),
        ("opacity = 0", 1.0),
    ] {
        let keys = "opacity = \"checks.png\"\nopacity_cutoff = 0.5";
        let frame = pictures(&CARD.replace(keys, opacity));
        let direct = mean(&layer(&frame, "direct"));
        assert!((direct / 0.5 - lit).abs() < 0.01, "{opacity}: {direct}");
    }
}

/// From above: the card before the floor, which is black.
#[test]
fn a_picture_has_the_card_and_what_is_behind_by_their_areas() {
    let text = CARD
        .replace("position = [0, 1.5, 0]", "position = [0, 3.5, 0]")
        .replace("target = [0, 0, 0]", "target = [0, 2, 0]")
        .replace("albedo = [0.5, 0.5, 0.5]", "albedo = [0, 0, 0]")
        .replace("scale = 0.97", "scale = 0.97\nalbedo = [0.8, 0.8, 0.8]");
    let keys = "opacity = \"checks.png\"\nopacity_cutoff = 0.5";
    for (opacity, share) in [(keys, 0.5), ("opacity = 0.3", 0.3)] {
        let frame = pictures(&text.replace(keys, opacity));
        let seen = mean(&beauty(&frame)) / 0.8 / WHOLE;
        assert!((seen - share).abs() < 0.01, "{opacity}: {seen}");
    }
    // Without the floor alpha says the same.
    let floor = text.find("[[mesh]]").unwrap();
    let card = text[floor + 1..].find("[[mesh]]").unwrap() + floor + 1;
    let work = work(&[&text[..floor], &text[card..]].concat());
    let scene = work.scene();
    let store = OpenTree::open(&work.bake(&scene, 20_000), None).unwrap();
    let (settings, region) = (Settings::default(), Region::full(60, 60));
    let frame = lvox::shade::run(
        &scene,
        &store,
        &settings,
        region,
        &[Aov::Alpha],
        &Job::default(),
    );
    let frame = frame.unwrap();
    let alphas = frame.layer("").unwrap().channel("A").unwrap();
    let alpha = f64::from(alphas.iter().sum::<f32>()) / 3600.0 / WHOLE;
    assert!((alpha - 0.5).abs() < 0.01, "{alpha}");
}

#[test]
fn surfels_are_where_the_card_is_and_their_area_is_its() {
    let work = work(CARD);
    lvox(
        work.0.path(),
        &["bake", "scene.toml", "-o", "a.lvc", "--surfels", "100000"],
    )
    .done();
    let cloud = Cloud::open_path(&work.path("a.lvc")).unwrap();
    let mut area = 0.0;
    let image = checks();
    for chunk in 0..cloud.surfel_chunks() {
        for s in cloud.surfel_chunk(chunk).unwrap() {
            let [x, y, z] = s.position;
            if y > 1.0 {
                area += f64::from(s.area);
                let at = |c: f32| (((c / 0.97 + 0.5) * 64.0) as u32).min(63);
                // A tenth of a texel around it, for rounding.
                let near = [-1.6e-3, 0.0, 1.6e-3];
                let places = near
                    .iter()
                    .flat_map(|i| near.map(|j| (x - 0.013 + i, 0.004 - z + j)));
                let mut alphas = places.map(|(u, v)| image.get_pixel(at(u), at(v))[3]);
                assert!(alphas.any(|alpha| alpha > 0), "{x} {z}");
            }
        }
    }
    assert!((area - 0.5 * 0.97 * 0.97).abs() < 0.002, "{area}");
}

/// A lamp in a ball lights a floor through the ball, whose far side sends on, as a ball does, what it
/// has of the lamp: the share that is there times its albedo. Few surfels are on it.
#[test]
fn a_ball_of_small_opacity_sends_the_light_of_the_lamp_in_it() {
    const BALL: &str = r#"
[film]
width = 32
height = 24
[[camera]]
position = [0, 3, 5]
target = [0, 0, 0]
fov_x_deg = 45
[[mesh]]
file = "builtin:quad"
scale = [8, 1, 8]
albedo = [0.6, 0.6, 0.6]
[[light]]
type = "point"
position = [0, 1, 0]
intensity = [3, 3, 3]
[[mesh]]
file = "builtin:sphere"
translate = [0, 1, 0]
scale = 0.8
albedo = [0.8, 0.8, 0.8]
opacity = 0.1
visible = false
"#;
    let work = Work::new(BALL);
    let scene = work.scene();
    let tree = work.bake(&scene, 50_000);
    let settings = Settings {
        samples: 1024,
        lattice: 1,
        ..Settings::default()
    };
    let frame = shade(&scene, &tree, &settings);
    let [indirect, direct] = ["indirect", "direct"].map(|name| mean(&layer(&frame, name)));
    let ratio = indirect / direct / (0.1 * 0.8);
    assert!((ratio - 1.0).abs() < 0.1, "{ratio}");
}

#[test]
fn masked_scenes_are_the_same_packed_in_tiles_and_with_any_threads() {
    let work = work(&CARD.replace("opacity_cutoff = 0.5", ""));
    let here = work.0.path();
    let run = |args: &[&str]| lvox(here, args).done();
    run(&["pack", "scene.toml", "-o", "scene.lvp"]);
    let quick = ["--quality", "draft"];
    for (scene, cloud, threads) in [("scene.toml", "a.lvc", "1"), ("scene.lvp", "b.lvc", "2")] {
        let bake = [
            "bake",
            scene,
            "-o",
            cloud,
            "--surfels",
            "5000",
            "--threads",
            threads,
        ];
        run(&bake);
    }
    run(&["build", "a.lvc", "-o", "a.lvt"]);
    let bytes = |name: &str| fs::read(work.path(name)).unwrap();
    assert!(bytes("a.lvc") == bytes("b.lvc"));
    for (scene, image, threads) in [("scene.toml", "a.exr", "1"), ("scene.lvp", "b.exr", "2")] {
        let shade = [
            "shade",
            scene,
            "-t",
            "a.lvt",
            "-o",
            image,
            "--threads",
            threads,
        ];
        run(&[&shade[..], &quick].concat());
    }
    assert!(bytes("a.exr") == bytes("b.exr"));
    for (region, name) in [("0 0 17 60", "c.exr"), ("17 0 60 60", "d.exr")] {
        let region: Vec<&str> = region.split(' ').collect();
        let shade = ["shade", "scene.lvp", "-t", "a.lvt", "-o", name, "--region"];
        run(&[&shade[..], &region, &quick].concat());
    }
    run(&["merge", "c.exr", "d.exr", "-o", "e.exr"]);
    assert!(bytes("a.exr") == bytes("e.exr"));
    let whole = lvox(here, &["verify", "scene.lvp"]);
    assert_eq!(whole.code, 0, "{}", whole.stderr);
    run(&["pack", "scene.lvp", "-o", "again.lvp"]);
    assert!(bytes("again.lvp") == bytes("scene.lvp"));
    let told = lvox(here, &["inspect", "scene.toml"]).stdout;
    assert!(told.contains("opacity"), "{told}");
}

#[test]
fn wrong_masks_are_refused_in_a_line() {
    let keys = "opacity = \"checks.png\"\nopacity_cutoff = 0.5";
    for (opacity, says) in [
        ("opacity = 1.5", "expected a number from 0 to 1, found 1.5"),
        ("opacity = \"none.png\"", "none.png"),
        ("opacity = \"card.obj\"", "not an image"),
        ("opacity_cutoff = 0.5", "there is no `opacity`"),
        (
            "opacity = 0.5\nopacity_cutoff = -1",
            "expected a number from 0 to 1, found -1",
        ),
    ] {
        let work = work(&CARD.replace(keys, opacity));
        let run = lvox(work.0.path(), &["bake", "scene.toml", "-o", "a.lvc"]);
        run.refused(2, &[says]);
        assert!(!work.path("a.lvc").exists());
    }
    let nothing = CARD.replace(
        "[[mesh]]\nfile = \"builtin:quad\"\nscale = [4, 1, 4]\nalbedo = [0.5, 0.5, 0.5]\n",
        "",
    );
    let work = work(&nothing.replace(keys, "opacity = 0"));
    let run = lvox(work.0.path(), &["bake", "scene.toml", "-o", "a.lvc"]);
    run.refused(2, &["masks leave nothing of all 2 triangles"]);
    // What shines has no mask, and says so.
    let work = Work::new(&CARD.replace(keys, "opacity = 0.5\nemission = [1, 1, 1]"));
    fs::write(work.path("card.obj"), SQUARE).unwrap();
    let warnings = work.scene().warnings;
    assert!(
        warnings[0].contains("surfaces that emit have no mask"),
        "{warnings:?}"
    );
}
