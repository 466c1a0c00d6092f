//! `lvox reference` from outside: what it writes, and that a stop loses nothing.

mod support;

use lvox::Kind;
use lvox::image::Region;
use lvox::internals::reference::{self, Settings, Start};
use lvox::run::Job;
use lvox::scene::Scene;
use std::path::Path;
use support::program::{self, Run};

const REGION: &[&str] = &["--region", "300", "200", "340", "230"];

fn arguments<'a>(more: &[&'a str]) -> Vec<&'a str> {
    [&["reference", "--demo"], REGION, more].concat()
}

fn lvox(dir: &Path, args: &[&str]) -> Run {
    program::lvox(dir, &arguments(args))
}

#[test]
fn wrong_use_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    for (args, part) in [
        (&["-o", "a.png"][..], ".exr"),
        (&["-o", "a.exr", "--spp", "0"], "0"),
        (&["-o", "a.exr", "--time", "0"], "--time"),
        (&["-o", "a.exr", "--strands", "0"], "--strands"),
        (&["-o", "no/a.exr"], "no"),
        (&["-o", "a.exr", "--camera", "nobody"], "nobody"),
    ] {
        let run = lvox(dir.path(), args);
        assert_eq!(run.code, 2, "{args:?}");
        assert!(run.stderr.contains(part), "{args:?}: {}", run.stderr);
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}

#[test]
fn fewer_samples_than_are_kept_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let run = |spp: &str, more: &[&str]| {
        let args = [&["-o", "a.exr", "--max-depth", "2", "--spp", spp], more].concat();
        let run = lvox(dir.path(), &args);
        run.done();
        run.stderr
    };
    assert!(!run("3", &[]).contains("warning"));
    let stderr = run("2", &[]);
    let told = "warning: a.exr.sums keeps 3 samples per pixel, more than --spp 2";
    assert!(stderr.contains(told), "{stderr}");
    assert!(!run("4", &[]).contains("warning"));
    assert!(!run("2", &["--force"]).contains("warning"));
}

#[test]
fn samples_and_noise_are_told_and_compare_has_the_noise_too() {
    let dir = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let run = lvox(dir.path(), &[&["--max-depth", "2"], args].concat());
        run.done();
        run.stderr.lines().last().unwrap_or_default().to_owned()
    };
    let told = run(&["-o", "a.exr", "--spp", "8"]);
    let (start, noise) = told.rsplit_once(' ').unwrap();
    assert_eq!(start, "8 samples per pixel; its noise is of relMSE");
    let noise: f64 = noise.parse().unwrap();
    let told = run(&["-o", "b.exr", "--spp", "2", "--strands", "1"]);
    assert!(told.starts_with("2 samples") && told.contains("does not tell"));
    assert_eq!(
        run(&["-o", "c.exr", "--spp", "1", "--progress", "none"]),
        ""
    );

    let read = |verb: &str, part: &str| {
        let run = program::lvox(dir.path(), &[verb, "a.exr.sums"]);
        let said = run.stdout + &run.stderr;
        assert!(said.contains(part), "{verb}: {said}");
        run.code
    };
    assert_eq!(read("inspect", "300 200 to 340 230"), 0);
    assert_eq!(read("verify", "samples undamaged"), 0);
    let kept = dir.path().join("a.exr.sums");
    let whole = std::fs::read(&kept).unwrap();
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 1;
    std::fs::write(&kept, damaged).unwrap();
    for verb in ["inspect", "verify"] {
        assert_eq!(read(verb, "its checksum is wrong"), 2);
    }
    std::fs::write(&kept, whole).unwrap();

    let compare = |images: [&str; 2], more: &[&str]| {
        let run = program::lvox(
            dir.path(),
            &[&["compare"], &images[..], REGION, more].concat(),
        );
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.stdout
    };
    let table = compare(["b.exr", "a.exr"], &[]);
    let row = table.lines().find(|l| l.starts_with("reference_noise"));
    let value = row.unwrap().split_whitespace().nth(1).unwrap();
    let value: f64 = value.parse().unwrap();
    assert!((value / noise - 1.0).abs() < 0.01, "{value} and {noise}");
    // A single sequence tells none, and of a layer nobody knows.
    assert!(!table.contains("image_noise"), "{table}");
    let json = compare(["a.exr", "b.exr"], &["--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!((json["image_noise"].as_f64().unwrap() / noise - 1.0).abs() < 0.01);
    assert!(json.get("reference_noise").is_none());
}

#[test]
fn what_differs_is_named_and_a_camera_goes_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let base = ["-o", "a.exr", "--spp", "1"];
    lvox(dir.path(), &base).done();
    lvox(dir.path(), &[&base[..], &["--max-depth", "2"]].concat())
        .refused(2, &["max_depth 0, here 2"]);
    let camera = Scene::demo().unwrap().cameras[0].name.clone();
    lvox(dir.path(), &[&base[..], &["--camera", &camera]].concat()).done();
}

#[cfg(unix)]
#[test]
fn a_signal_keeps_what_is_finished_and_the_same_command_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    // Far more than anyone waits for: it is at work when it is asked to stop.
    let endless = ["-o", "twice.exr", "--spp", "100000000", "--threads", "1"];
    let mut command = program::command(dir.path(), &arguments(&endless));
    let is_at_work = |line: &str| line.starts_with("reference: ") && line.contains(" %)");
    let stopped = program::stopped_at(&mut command, is_at_work);
    assert_eq!(stopped.code, 1, "{}", stopped.stderr);
    assert!(dir.path().join("twice.exr.sums").exists());
    let hint = stopped.stderr.lines().last().unwrap();
    let kept = hint.strip_suffix(" samples per pixel are kept; the same command goes on");
    let (_, most) = kept.unwrap().rsplit_once(' ').unwrap();

    let spp = (most.parse::<u32>().unwrap() + 8).to_string();
    let go_on = lvox(dir.path(), &["-o", "twice.exr", "--spp", &spp]);
    go_on.done();
    assert!(go_on.stderr.starts_with("going on from "));
    lvox(dir.path(), &["-o", "once.exr", "--spp", &spp]).done();
    let image = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    assert!(image("once.exr") == image("twice.exr"));
}

#[test]
fn a_stop_before_the_first_sample_replaces_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let image = dir.path().join("a.exr");
    let kept = reference::sums_path(&image);
    let scene = Scene::demo().unwrap();
    let settings = Settings {
        spp: Some(4),
        ..Settings::default()
    };
    let region = Region {
        x0: 0,
        y0: 0,
        x1: 4,
        y1: 4,
    };
    let job = Job::default();
    job.cancel.request();
    for start in [Start::Resume, Start::Afresh] {
        std::fs::write(&image, "an image").unwrap();
        if start == Start::Afresh {
            std::fs::write(&kept, "samples of hours").unwrap();
        }
        let error = reference::run(&scene, &settings, region, &image, start, &job).unwrap_err();
        assert_eq!(error.kind(), Kind::Cancelled);
        assert_eq!(std::fs::read(&image).unwrap(), b"an image");
    }
    assert_eq!(std::fs::read(&kept).unwrap(), b"samples of hours");
}
