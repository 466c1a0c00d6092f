//! Another camera, film and light of a packed scene, without its assets.

use crate::Work;
use crate::packed::{bytes, scene, work};
use crate::support::program::lvox;
use lvox::run::Job;
use lvox::scene::load::Settings;
use lvox::scene::{Light, Scene};
use std::fs;
use std::path::Path;

const CAMERA: &str = r#"
[[camera]]
name = "other"
position = [0.3, 1.2, 3.5]
target = [0, 0.9, 0]
fov_x_deg = 42
"#;
const FILM: &str = "[film]\nwidth = 40\nheight = 30\n";
const LIGHT: &str =
    "[[light]]\ntype = \"point\"\nposition = [0, 1.6, 0.5]\nintensity = [1, 2, 3]\n";

/// A folder with the packed scene alone, its tree in it.
fn packed() -> (Work, tempfile::TempDir) {
    let work = work();
    let here = work.0.path();
    let run = |args: &[&str]| lvox(here, args).done();
    run(&["bake", "scene.toml", "-o", "a.lvc", "--surfels", "20000"]);
    run(&["build", "a.lvc", "-o", "a.lvt"]);
    run(&["scatter", "scene.toml", "-t", "a.lvt", "-o", "a.lvs"]);
    let there = tempfile::tempdir().unwrap();
    let output = there.path().join("scene.lvp");
    let output = output.to_str().unwrap();
    let with = ["-t", "a.lvt", "--scatter", "a.lvs", "-o", output];
    run(&[&["pack", "scene.toml"], &with[..]].concat());
    (work, there)
}

fn write(folder: &Path, name: &str, parts: &[&str]) {
    let text = format!("packed = \"scene.lvp\"\n{}", parts.concat());
    fs::write(folder.join(name), text).unwrap();
}

#[test]
fn another_camera_shades_as_with_the_assets() {
    let (work, there) = packed();
    let (here, there) = (work.0.path(), there.path());
    // The same scene with that camera and film in the file of its assets.
    let text = scene();
    let (before, rest) = text.split_once("[film]").unwrap();
    let rest = &rest[rest.find("[[").unwrap()..];
    let assets = format!("{before}{FILM}{CAMERA}{rest}");
    fs::write(here.join("other.toml"), assets).unwrap();
    write(there, "other.toml", &[FILM, CAMERA]);
    let quick = ["--quality", "draft", "-o", "a.npy"];
    let light = ["-t", "a.lvt", "--scatter", "a.lvs"];
    lvox(
        here,
        &[&["shade", "other.toml"], &light[..], &quick].concat(),
    )
    .done();
    let run = lvox(there, &[&["shade", "other.toml"], &quick[..]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    assert!(!run.stderr.contains("baked from"), "{}", run.stderr);
    let pixels = bytes(there, "a.npy");
    assert!(pixels.len() > 40 * 30 * 3 * size_of::<f32>());
    assert!(bytes(here, "a.npy") == pixels);

    // Changes are of the scene file, and a packed scene of it holds what it describes.
    let wide = ["--set", "camera.other.fov_x_deg=60"];
    let run = lvox(
        there,
        &[&["pack", "other.toml", "-o", "wide.lvp"], &wide[..]].concat(),
    );
    assert_eq!(run.code, 0, "{}", run.stderr);
    let wide = Scene::load(&there.join("wide.lvp")).unwrap();
    assert_eq!(wide.cameras.len(), 1);
    assert!((wide.cameras[0].fov_x_rad.to_degrees() - 60.0).abs() < 1e-4);
    assert!(wide.packed_tree().is_some() && wide.packed_light().is_some());
}

#[test]
fn other_lights_are_told_of_a_tree_and_bake() {
    let (_, there) = packed();
    let there = there.path();
    write(there, "lit.toml", &[FILM, LIGHT]);
    let scene = Scene::load(&there.join("lit.toml")).unwrap();
    let packed = Scene::load(&there.join("scene.lvp")).unwrap();
    assert!(matches!(scene.lights[..], [Light::Point { .. }]));
    assert_eq!(scene.cameras.len(), packed.cameras.len());
    assert_eq!(scene.emissive.len(), packed.emissive.len());
    let differ = scene.parts_that_differ(&packed.parts(None)).unwrap();
    assert_eq!(differ, ["lights"]);
    let run = lvox(there, &["shade", "lit.toml", "-o", "a.exr"]);
    assert!(
        run.stderr.contains("a scene of other lights"),
        "{}",
        run.stderr
    );
    for args in [
        &["bake", "lit.toml", "-o", "a.lvc", "--surfels", "5000"][..],
        &["build", "a.lvc", "-o", "a.lvt"],
        &["shade", "lit.toml", "-t", "a.lvt", "-o", "b.exr"],
    ] {
        let run = lvox(there, args);
        assert_eq!(run.code, 0, "{}", run.stderr);
        assert!(!run.stderr.contains("baked from"), "{}", run.stderr);
    }
    assert!(bytes(there, "a.exr") != bytes(there, "b.exr"));
}

#[test]
fn groups_are_of_its_lights_and_of_what_emits() {
    let (_, there) = packed();
    let there = there.path();
    let grouped = format!("{LIGHT}group = \"key\"\n");
    write(there, "lit.toml", &[&grouped]);
    let lit_by = |group: &str| {
        let settings = Settings {
            group: Some(group.into()),
            ..Default::default()
        };
        Scene::load_with(&there.join("lit.toml"), &settings, &Job::default())
    };
    let key = lit_by("key").unwrap();
    assert_eq!((key.lights.len(), key.emissive.len()), (1, 0));
    assert!(key.materials.iter().all(|m| !m.emits()));
    let default = lit_by("default").unwrap();
    assert_eq!((default.lights.len(), default.emissive.len()), (0, 1));
    // What is packed of one group has digests of its own.
    for group in ["key", "default"] {
        let args = [
            "pack", "lit.toml", "-o", "one.lvp", "--force", "--group", group,
        ];
        assert_eq!(lvox(there, &args).code, 0);
        let run = lvox(there, &["verify", "one.lvp"]);
        assert_eq!(run.code, 0, "{group}: {}", run.stderr);
    }
    let error = lit_by("rim").unwrap_err().to_string();
    assert!(error.contains("found key, default"), "{error}");
}

#[test]
fn an_empty_list_of_lights_leaves_none_of_them() {
    let (_, there) = packed();
    let there = there.path();
    write(there, "dark.toml", &["light = []\n"]);
    let dark = Scene::load(&there.join("dark.toml")).unwrap();
    assert!(dark.lights.is_empty() && dark.warnings.is_empty());
    assert_eq!(dark.emissive.len(), 1);
}

/// What was made up for a packed scene is not told of a file that has it.
#[test]
fn lights_and_cameras_that_were_made_up_are_replaced() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let quad = "[[mesh]]\nfile = \"builtin:quad\"\n";
    fs::write(here.join("bare.toml"), quad).unwrap();
    lvox(here, &["pack", "bare.toml", "-o", "scene.lvp"]).done();
    let warnings = |name: &str| Scene::load(&here.join(name)).unwrap().warnings.len();
    assert_eq!(warnings("scene.lvp"), 2);
    for (name, parts, left) in [
        ("lit.toml", &[LIGHT][..], 1),
        ("seen.toml", &[CAMERA], 1),
        ("both.toml", &[LIGHT, CAMERA], 0),
        ("dark.toml", &["light = []\n", CAMERA], 1),
    ] {
        write(here, name, parts);
        assert_eq!(warnings(name), left, "{name}");
    }
}

/// Far from the origin a scene has a space of its own, to which cameras and lights go.
#[test]
fn places_are_in_the_world() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    let text = "[[mesh]]\nfile = \"builtin:quad\"\ntranslate = [5000, 0, 0]\n";
    fs::write(here.join("far.toml"), text).unwrap();
    lvox(here, &["pack", "far.toml", "-o", "scene.lvp"]).done();
    let parts = [
        "[[camera]]\nposition = [5001, 2, 0]\ntarget = [5000, 0, 0]\n",
        "[[light]]\ntype = \"point\"\nposition = [5000, 3, 0]\nintensity = 1\n",
    ];
    fs::create_dir(here.join("shots")).unwrap();
    let described = format!("packed = \"../scene.lvp\"\n{}", parts.concat());
    fs::write(here.join("shots/a.toml"), described).unwrap();
    fs::write(here.join("whole.toml"), format!("{}{text}", parts.concat())).unwrap();
    let [described, whole] =
        ["shots/a.toml", "whole.toml"].map(|name| Scene::load(&here.join(name)).unwrap());
    assert!(described.world_from_scene.x != 0.0);
    assert_eq!(described.world_from_scene, whole.world_from_scene);
    let seen = |s: &Scene| format!("{:?} {:?}", s.cameras, s.lights);
    assert_eq!(seen(&described), seen(&whole));
    assert_eq!(described.files.len(), 2);
}

/// Names of packed scenes, too, have the number of the frame, and changes reach them.
#[test]
fn each_frame_may_have_a_packed_scene_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let here = dir.path();
    for (frame, shape) in [(1, "quad"), (2, "cube")] {
        let text = format!("[[mesh]]\nfile = \"builtin:{shape}\"\n");
        fs::write(here.join("shape.toml"), text).unwrap();
        let output = format!("shape.000{frame}.lvp");
        lvox(here, &["pack", "shape.toml", "-o", &output]).done();
    }
    let text = format!("packed = \"shape.####.lvp\"\n{CAMERA}{LIGHT}");
    fs::write(here.join("shot.toml"), text).unwrap();
    let load = |frame: i32| {
        let settings = Settings {
            frame: Some(frame),
            ..Settings::default()
        };
        Scene::load_with(&here.join("shot.toml"), &settings, &Job::default()).unwrap()
    };
    assert_eq!(load(1).mesh.triangle_count(), 2);
    assert_eq!(load(2).mesh.triangle_count(), 12);
    assert_eq!(load(2).files_of_frame, Some(2));
    let settings = Settings {
        changes: vec!["packed=shape.0002.lvp".parse().unwrap()],
        ..Settings::default()
    };
    let changed = Scene::load_with(&here.join("shot.toml"), &settings, &Job::default()).unwrap();
    assert_eq!(changed.mesh.triangle_count(), 12);
}

#[test]
fn what_cannot_be_added_is_told() {
    let (_, there) = packed();
    let there = there.path();
    for (text, says) in [
        ("[[mesh]]\nfile = \"builtin:quad\"\n", "of that file alone"),
        (
            "[[volume]]\nfile = \"builtin:plume\"\n",
            "of that file alone",
        ),
    ] {
        write(there, "a.toml", &[text]);
        let run = lvox(there, &["shade", "a.toml", "-o", "a.exr"]);
        assert_eq!(run.code, 2, "{}", run.stderr);
        assert!(run.stderr.contains(says), "{}", run.stderr);
    }
    for (name, says) in [
        ("other.lvp", "other.lvp"),
        ("scene.toml", "expected a packed scene (.lvp)"),
        ("scene.####.lvp", "stands for the number of a frame"),
    ] {
        fs::write(there.join("a.toml"), format!("packed = \"{name}\"\n")).unwrap();
        let told = |args: &[&str]| {
            let run = lvox(there, args);
            assert_eq!(run.code, 2, "{}", run.stderr);
            assert!(run.stderr.contains(says), "{}", run.stderr);
            run
        };
        told(&["shade", "a.toml", "-o", "a.exr"]);
        let run = told(&["bake", "a.toml", "-o", "a.lvc"]);
        assert_eq!(
            run.stderr
                .lines()
                .filter(|l| l.starts_with("error"))
                .count(),
            1
        );
    }
    let told = lvox(there, &["inspect", "scene.lvp"]);
    assert_eq!(told.code, 0, "{}", told.stderr);
}
