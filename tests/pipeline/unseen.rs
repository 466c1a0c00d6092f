//! What cameras do not see: lamps, other surfaces and the background, which light the scene as
//! ever.

use crate::messages::lvox;
use crate::{ROOM, Work, beauty, mean, relative_rms, shade};
use lvox::image::{Frame, Region};
use lvox::internals::reference;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{Quality, Settings};
use std::fs;

/// A lamp that faces the camera from before the smoke and hides a quarter of the picture, a red
/// card that is flush with it, and what is behind the camera.
fn room(visible: bool) -> String {
    format!(
        "{ROOM}
[[mesh]]
file = \"builtin:quad\"
name = \"lamp\"
scale = 0.7
rotate_deg = [90, 0, 0]
translate = [-0.3, 1.0, 0.9]
albedo = [0, 0, 0]
emission = [3, 3, 4]
visible = {visible}

[[mesh]]
file = \"builtin:quad\"
name = \"card\"
scale = 0.5
rotate_deg = [90, 0, 0]
translate = [-0.3, 1.0, 0.9]
albedo = [0.9, 0.1, 0.1]
visible = {visible}
"
    )
}

fn reference(scene: &Scene, spp: u32) -> Vec<[f32; 3]> {
    let settings = reference::Settings {
        spp: Some(spp),
        max_depth: 3,
        ..reference::Settings::default()
    };
    let region = Region::full(scene.film.width, scene.film.height);
    let job = Job::default();
    let mut sums = reference::begin(scene, &settings, region, &job).unwrap();
    reference::accumulate(scene, &settings, &mut sums, &job, &mut |_| Ok(())).unwrap();
    sums.estimates().0
}

#[test]
fn unseen_surfaces_light_and_hide_all_but_what_the_camera_sees() {
    let works = [true, false].map(|visible| Work::new(&room(visible)));
    let scenes = works.each_ref().map(Work::scene);
    assert_eq!(
        scenes[0].parts(None),
        scenes[1].parts(None),
        "bakes are those of either"
    );
    let trees = [0, 1].map(|i| works[i].bake(&scenes[i], 20_000));
    for corners in [true, false] {
        let settings = Settings {
            pixel_samples: if corners { 1 } else { 4 },
            ..Settings::of(Quality::Draft)
        };
        let [seen, unseen] = [0, 1].map(|i| shade(&scenes[i], &trees[i], &settings));
        let depth = |frame: &Frame| {
            let layer = frame.layer("depth").unwrap();
            layer.channel("Z").unwrap().to_vec()
        };
        let (near, far) = (depth(&seen), depth(&unseen));
        // The lamp is 3 before the camera, and so is a line across the floor.
        let is_lamp = |(near, far): (&f32, &f32)| (near - 3.0).abs() < 1e-3 && *far > 3.1;
        let lamp: Vec<bool> = near.iter().zip(&far).map(is_lamp).collect();
        let count = lamp.iter().filter(|is| **is).count();
        assert!(count > 150, "{count}");
        // Beside the lamp and the border that pixels share with it, it makes no difference.
        let same = |(a, b): (&[f32; 3], &[f32; 3])| {
            let off = (0..3).map(|c| (a[c] - b[c]).abs() / (0.02 + b[c]));
            off.fold(0.0, f32::max) < 0.05
        };
        let is_beside = |i: usize| {
            let (x, y) = ((i % 64) as i64, (i / 64) as i64);
            (-2..=2).all(|dy| {
                (-2..=2).all(|dx| {
                    let at = |v: i64, n: i64| v.clamp(0, n - 1) as usize;
                    !lamp[at(y + dy, 48) * 64 + at(x + dx, 64)]
                })
            })
        };
        let (a, b) = (beauty(&seen), beauty(&unseen));
        let beside: Vec<usize> = (0..a.len()).filter(|i| is_beside(*i)).collect();
        let alike = beside.iter().filter(|&&i| same((&a[i], &b[i]))).count();
        assert!(beside.len() > 2000, "{}", beside.len());
        assert!(
            alike * 100 >= beside.len() * 98,
            "{alike} of {}",
            beside.len()
        );
        // The path tracer sees the same.
        let traced = reference(&scenes[1], 256);
        assert!(
            (mean(&b) / mean(&traced) - 1.0).abs() < 0.03,
            "{} {}",
            mean(&b),
            mean(&traced)
        );
        let off = relative_rms(&b, &traced);
        assert!(off < 0.12, "{off}");
    }
}

#[test]
fn unseen_emitters_have_no_border_and_hide_none_of_those_behind() {
    // A small lamp straight behind an unseen one.
    let text = room(false)
        + "[[mesh]]\nfile = \"builtin:quad\"\nscale = 0.03\nrotate_deg = [90, 0, 0]\n\
           translate = [-0.3, 1.0, 0.85]\nalbedo = [0, 0, 0]\nemission = [900, 900, 900]\n";
    let work = Work::new(&text);
    let scene = work.scene();
    let tree = work.bake(&scene, 5000);
    let frame = shade(&scene, &tree, &Settings::of(Quality::Draft));
    let pixels = beauty(&frame);
    let traced = reference(&scene, 1024);
    let brightest = |p: &[[f32; 3]]| {
        p.iter()
            .map(|p| f64::from(p[1].max(50.0) - 50.0))
            .sum::<f64>()
    };
    let (a, b) = (brightest(&pixels), brightest(&traced));
    assert!(b > 100.0 && (a / b - 1.0).abs() < 0.1, "{a} {b}");
}

#[test]
fn an_unseen_environment_is_black_behind_the_scene_and_packed_scenes_keep_it() {
    let sky = |visible: bool| {
        format!(
            "{}[[light]]\ntype = \"environment\"\nradiance = [0.5, 0.7, 1]\nvisible = {visible}\n",
            room(false)
        )
    };
    let works = [true, false].map(|visible| Work::new(&sky(visible)));
    let shade = |work: &Work, scene: &str, name: &str, more: &[&str]| {
        let words = format!(
            "shade {scene} -t scene.lvt --camera away --quality draft --alpha \
             --progress none -o {name}"
        );
        let words: Vec<&str> = words.split(' ').chain(more.iter().copied()).collect();
        lvox(work, &words).done();
        fs::read(work.path(name)).unwrap()
    };
    let colors =
        |work: &Work, name: &str| beauty(&lvox::image::exr::read(&work.path(name)).unwrap());
    for work in &works {
        work.bake(&work.scene(), 2000);
        lvox(work, &["pack", "scene.toml", "-o", "scene.lvp"]).done();
    }
    let [seen, unseen] = &works;
    shade(seen, "scene.toml", "a.exr", &[]);
    shade(seen, "scene.toml", "hidden.exr", &["--no-background"]);
    let bytes = shade(unseen, "scene.toml", "a.exr", &[]);
    assert!(mean(&colors(seen, "a.exr")) > 0.7, "the sky");
    assert_eq!(mean(&colors(unseen, "a.exr")), 0.0);
    assert_eq!(colors(seen, "hidden.exr"), colors(unseen, "a.exr"));
    assert!(bytes == shade(unseen, "scene.lvp", "packed.exr", &[]));
    // It lights the room as if it were seen.
    assert_eq!(seen.scene().parts(None), unseen.scene().parts(None));
    let packed = Scene::load(&unseen.path("scene.lvp")).unwrap();
    assert!(!packed.is_environment_seen);
    let unseen_ones = packed.materials.iter().filter(|m| !m.is_seen).count();
    assert_eq!(unseen_ones, 2);
    assert!(mean(&reference(&unseen.scene(), 4)) > 0.05);
    let told = lvox(unseen, &["inspect", "scene.toml"]).stdout;
    for said in ["'lamp' (unseen)", "'card' (unseen)", "environment (unseen)"] {
        assert!(told.contains(said), "{told}");
    }
}
