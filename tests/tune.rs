//! Settings picked for an error: the error is met, and every tile and process picks the same.

mod support;

use lvox::image::{Picture, Region, metrics};
use lvox::internals::reference::{self, Sums};
use lvox::internals::tune::{self, Choice, Outcome};
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Settings};
use lvox::tree::OpenTree;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;
use support::program::lvox;
use support::trees;

const WIDTH: u32 = 96;
const HEIGHT: u32 = 72;

fn demo() -> Scene {
    let mut scene = Scene::demo().unwrap();
    (scene.film.width, scene.film.height) = (WIDTH, HEIGHT);
    scene
}

/// The tree of the demo scene, as a file in `dir`; it is baked once for all tests.
fn tree(dir: &Path) -> OpenTree {
    static BAKED: OnceLock<Vec<u8>> = OnceLock::new();
    let path = dir.join("demo.lvt");
    fs::write(&path, BAKED.get_or_init(|| baked(&demo()))).unwrap();
    OpenTree::open(&path, None).unwrap()
}

fn baked(scene: &Scene) -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let settings = trees::of_surfels(100_000);
    fs::read(trees::baked(scene, &settings, dir.path(), "demo")).unwrap()
}

fn choose(scene: &Scene, store: &OpenTree, error: f64) -> Choice {
    tune::choose(scene, store, error, |rung| rung, &Job::default()).unwrap()
}

fn truth(scene: &Scene) -> Picture {
    let settings = reference::Settings {
        max_depth: 3,
        spp: Some(320),
        strands: 1,
        seed: 7,
        ..reference::Settings::default()
    };
    let region = Region::full(WIDTH, HEIGHT);
    let mut sums: Sums = reference::begin(scene, &settings, region, &Job::default()).unwrap();
    reference::accumulate(
        scene,
        &settings,
        &mut sums,
        &Job::default(),
        &mut |_| Ok(()),
    )
    .unwrap();
    let frame = reference::frame(scene, &sums);
    frame.picture("", &region).unwrap()
}

#[test]
fn errors_land_where_they_were_asked_for() {
    let dir = tempfile::tempdir().unwrap();
    let scene = demo();
    let store = tree(dir.path());
    let truth = truth(&scene);
    let region = Region::full(WIDTH, HEIGHT);
    let mut last = f64::INFINITY;
    for goal in [9e-3, 2.3e-3] {
        let choice = choose(&scene, &store, goal);
        let frame = shade::run(
            &scene,
            &store,
            &choice.settings,
            region,
            &[],
            &Job::default(),
        );
        let picture = frame.unwrap().picture("", &region).unwrap();
        let error = metrics::compare(&picture, &truth, 1.0)
            .unwrap()
            .scores
            .relmse_trimmed;
        assert_eq!(choice.outcome, Outcome::Met, "{choice:?}");
        assert!(
            (goal / 2.0..goal * 2.0).contains(&error),
            "{error} for {goal}, {choice:?}"
        );
        assert!(error < last);
        last = error;
    }
    // The tree itself is not that exact.
    let beyond = choose(&scene, &store, 1e-7);
    assert_eq!(beyond.outcome, Outcome::OutOfReach);
    assert!(beyond.expected > 1e-6, "{beyond:?}");
    let coarse = choose(&scene, &store, 0.5);
    assert_eq!((coarse.outcome, coarse.rung), (Outcome::Better, 0.0));
}

#[test]
fn the_choice_does_not_depend_on_threads_and_keeps_what_is_fixed() {
    let dir = tempfile::tempdir().unwrap();
    let scene = demo();
    let store = tree(dir.path());
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| choose(&scene, &store, 3e-3))
    });
    assert_eq!(one.settings, two.settings);
    assert_eq!(one.tried, two.tried);
    let fixed = |rung| Settings { samples: 4, ..rung };
    let kept = tune::choose(&scene, &store, 3e-3, fixed, &Job::default()).unwrap();
    assert_eq!(kept.settings.samples, 4);
    assert!(kept.rung >= one.rung, "{kept:?} {one:?}");
}

#[test]
fn tiles_of_a_target_merge_into_the_frame() {
    let dir = tempfile::tempdir().unwrap();
    tree(dir.path());
    let size = format!("{WIDTH}x{HEIGHT}");
    let base = ["shade", "--demo", "-t", "demo.lvt", "--resolution", &size];
    let run = |args: &[&str]| {
        let run = lvox(dir.path(), &[&base, args].concat());
        run.done();
        run.stderr
    };
    let target = ["--target-error", "4e-3"];
    let report = ["--report", "whole.json"];
    let talk = run(&[&["-o", "whole.exr"], &target[..], &report].concat());
    let tiles = ["a.exr", "b.exr", "c.exr"];
    for (tile, part) in tiles.iter().zip(["0/3", "1/3", "2/3"]) {
        run(&[&["-o", tile, "--tile", part], &target[..]].concat());
    }
    let merge = ["merge", "a.exr", "b.exr", "c.exr", "-o", "m.exr"];
    lvox(dir.path(), &merge).done();
    let read = |name: &str| fs::read(dir.path().join(name)).unwrap();
    assert!(read("m.exr") == read("whole.exr"));

    // What was picked is said as options that give the same frame, and stands in the report.
    let line = talk.lines().find(|l| l.contains("shading with")).unwrap();
    let options = line.split("shading with ").nth(1).unwrap();
    let options: Vec<&str> = options.split(',').next().unwrap().split(' ').collect();
    run(&[&["-o", "same.exr"], &options[..]].concat());
    assert!(read("same.exr") == read("whole.exr"));
    let report: serde_json::Value = serde_json::from_slice(&read("whole.json")).unwrap();
    let pilot = &report["stages"]
        .as_array()
        .unwrap()
        .iter()
        .find(|s| s["stage"] == "pilot")
        .unwrap()["counts"];
    assert_eq!(pilot["target_error"], 4e-3);
    assert!(pilot["paths"].as_f64().unwrap() > 0.0);
}

#[test]
fn a_target_out_of_reach_is_warned_of_with_the_error_to_expect() {
    let dir = tempfile::tempdir().unwrap();
    tree(dir.path());
    let size = format!("{WIDTH}x{HEIGHT}");
    let base = ["shade", "--demo", "-t", "demo.lvt", "--resolution", &size];
    // The pilot looks at the whole frame; one pixel of it is enough to shade.
    let options = ["--region", "0", "0", "1", "1", "-o", "x.exr"];
    let warned = |target: &str| {
        let args = [&base[..], &options, &["--target-error", target]].concat();
        let run = lvox(dir.path(), &args);
        run.done();
        let talk = run.stderr;
        let warning = talk.lines().find(|l| l.starts_with("warning: "));
        (warning.map(ToOwned::to_owned), talk)
    };
    let (warning, talk) = warned("1e-7");
    let warning = warning.unwrap_or_else(|| panic!("no warning in {talk}"));
    for part in ["1.0e-7 is out of reach", "--surfels"] {
        assert!(warning.contains(part), "{warning}");
    }
    let expected = warning.split("about ").nth(1).unwrap();
    let expected = expected.split(' ').next().unwrap();
    assert!(expected.parse::<f64>().unwrap() > 1e-6, "{warning}");
    assert!(
        talk.contains(&format!("expected error {expected}")),
        "{talk}"
    );
    assert!(dir.path().join("x.exr").is_file());

    assert_eq!(warned("9e-3").0, None);
}

#[test]
fn targets_that_make_no_sense_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    let shade = ["shade", "--demo", "-t", "no.lvt", "-o", "x.exr"];
    for (args, parts) in [
        (&["--target-error=0"][..], "--target-error"),
        (&["--target-error=-1e-3"], "--target-error"),
        (&["--target-error=nan"], "--target-error"),
        (&["--target-error=1"], "--target-error"),
        (&["--target-error=little"], "--target-error"),
        (&["--target-error=1e-3", "--quality", "good"], "--quality"),
        (&["--resolution=640"], "--resolution"),
        (&["--resolution=0x480"], "--resolution"),
    ] {
        let run = lvox(dir.path(), &[&shade, args].concat());
        assert_eq!(run.code, 2, "{args:?}: {}", run.stderr);
        assert!(run.stderr.contains(parts), "{args:?}: {}", run.stderr);
    }
}
