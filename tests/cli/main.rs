//! The program from outside: exit codes, what goes to stdout and stderr, what is left on disk.

mod compare;
mod help;
mod plan;
#[path = "../support/mod.rs"]
mod support;

use lvox::image::exr::{self, Precision};
use lvox::image::{Frame, Layer, Region};
use std::fs;
use std::path::{Path, PathBuf};
use support::names;
use support::program::lvox;

const WIDTH: u32 = 40;
const HEIGHT: u32 = 32;

fn shade(region: Region, tree: &str) -> Frame {
    let mut frame = Frame::new(WIDTH, HEIGHT, region);
    let mut pixels = Vec::new();
    for y in region.y0..region.y1 {
        for x in region.x0..region.x1 {
            pixels.push([x as f32 / 64.0, y as f32 / 64.0, 0.25]);
        }
    }
    frame.layers.push(Layer::rgb("", &pixels));
    frame.attributes.insert("lvox/tree".into(), tree.into());
    frame
}

fn write_tiles(dir: &Path, count: u32) -> Vec<String> {
    (0..count)
        .map(|i| {
            let name = format!("tile{i}.exr");
            let region = Region::tile(WIDTH, HEIGHT, i, count).unwrap();
            exr::write(&dir.join(&name), &shade(region, "00ff"), Precision::Half).unwrap();
            name
        })
        .collect()
}

fn write_whole(dir: &Path, name: &str) -> PathBuf {
    let path = dir.join(name);
    let full = Region::full(WIDTH, HEIGHT);
    exr::write(&path, &shade(full, "00ff"), Precision::Half).unwrap();
    path
}

#[test]
fn wrong_usage_is_exit_code_2() {
    let dir = tempfile::tempdir().unwrap();
    for args in [
        &[][..],
        &["no-such-verb"],
        &["merge"],
        &["compare", "a.exr"],
        &["compare", "a.exr", "b.exr", "--threads", "0"],
        &["compare", "a.exr", "b.exr", "--threads", "1025"],
        &["compare", "a.exr", "b.exr", "--memory-limit", "much"],
        &["compare", "a.exr", "b.exr", "--exposure", "-2"],
        &["compare", "a.exr", "b.exr", "--region", "1", "2", "3"],
        &["compare", "a.exr", "b.exr", "--progress", "loud"],
    ] {
        let run = lvox(dir.path(), args);
        assert_eq!((run.code, run.stdout.as_str()), (2, ""), "{args:?}");
        assert!(!run.stderr.is_empty());
    }
}

/// What a terminal would obey, in names of files, in their words and on the command line, is shown.
#[test]
fn names_are_shown_in_one_line() {
    let dir = tempfile::tempdir().unwrap();
    let odd = "a\n\u{1b}[31m\u{202e}b.toml";
    let shown = "a\\n\\u{1b}[31m\\u{202e}b";
    lvox(dir.path(), &["inspect", odd]).refused(2, &[shown, "No such file"]);
    lvox(dir.path(), &["verify", odd]).refused(2, &[shown]);
    let usage = lvox(dir.path(), &["inspect", "x", &format!("--{odd}")]);
    assert_eq!(usage.code, 2);
    assert!(usage.stderr.contains(shown), "{}", usage.stderr);
    assert!(!usage.stderr.contains('\u{1b}'), "{}", usage.stderr);

    fs::write(
        dir.path().join(odd),
        "[[mesh]]\nfile = \"no\\u001b\\nsuch.obj\"\n",
    )
    .unwrap();
    lvox(dir.path(), &["inspect", odd]).refused(2, &[shown, "no\\u{1b}\\nsuch.obj"]);
    let cube = "name = \"x\\ny\"\n[[mesh]]\nfile = \"builtin:cube\"\nname = \"c\\u001b\\nd\"\n";
    fs::write(dir.path().join(odd), cube).unwrap();
    let found = lvox(dir.path(), &["inspect", odd]);
    assert_eq!(found.code, 0, "{}", found.stderr);
    for part in [shown, "'x\\ny'", "'c\\u{1b}\\nd'"] {
        assert!(found.stdout.contains(part), "{part} in {}", found.stdout);
    }
    assert!(!found.stdout.contains('\u{1b}'));

    let long = format!("{}.toml", "x/".repeat(1000));
    let run = lvox(dir.path(), &["inspect", &long]);
    run.refused(2, &["…"]);
    assert!(
        run.stderr.lines().all(|l| l.chars().count() <= 1010),
        "{}",
        run.stderr
    );
}

#[test]
fn the_time_of_shading_and_the_whole_are_told_at_the_end() {
    let dir = tempfile::tempdir().unwrap();
    let small = "--demo --resolution 16x12 --quality draft -o a.png";
    let run = |line: String| {
        let run = lvox(dir.path(), &line.split_whitespace().collect::<Vec<_>>());
        assert_eq!(run.code, 0, "{}", run.stderr);
        run.stderr
    };
    let render = format!("render {small} --surfels 500 --keep-tree t.lvt --force");
    let told = run(render.clone());
    let words: Vec<&str> = told.lines().last().unwrap().split(' ').collect();
    let [
        "shade",
        own,
        "CPU",
        "s;",
        "with",
        "bake,",
        "build",
        "and",
        "bounce",
        whole,
    ] = words[..]
    else {
        panic!("{told}");
    };
    let [own, whole] = [own, whole].map(|v| v.parse::<f64>().unwrap());
    assert!(own >= 0.0 && whole >= own);
    assert_eq!(run(format!("{render} --progress none")), "");
    let told = run(format!("shade {small} -t t.lvt"));
    let last = told.lines().last().unwrap();
    assert!(
        last.starts_with("shade ") && last.ends_with(" CPU s"),
        "{told}"
    );
}

#[test]
fn merged_tiles_are_the_whole_frame() {
    let dir = tempfile::tempdir().unwrap();
    let whole = write_whole(dir.path(), "whole.exr");
    let tiles = write_tiles(dir.path(), 5);
    for threads in ["1", "3"] {
        let mut args = vec!["merge", "-o", "merged.exr", "--report", "report.json"];
        args.extend(["--threads", threads]);
        args.extend(tiles.iter().map(String::as_str));
        let run = lvox(dir.path(), &args);
        assert_eq!((run.code, run.stdout.as_str()), (0, ""), "{}", run.stderr);
        let merged = fs::read(dir.path().join("merged.exr")).unwrap();
        assert!(merged == fs::read(&whole).unwrap(), "{threads} threads");
    }
    let report = fs::read(dir.path().join("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_slice(&report).unwrap();
    assert_eq!(
        (&report["verb"], &report["ok"]),
        (&"merge".into(), &true.into())
    );
    assert_eq!(report["stages"][0]["counts"]["tiles"], 5.0);
}

#[test]
fn merge_names_what_is_wrong_and_keeps_the_old_frame() {
    let dir = tempfile::tempdir().unwrap();
    let old = write_whole(dir.path(), "merged.exr");
    let before = fs::read(&old).unwrap();
    write_tiles(dir.path(), 2);
    let gap = Region::tile(WIDTH, HEIGHT, 1, 2).unwrap().to_string();
    let run = lvox(dir.path(), &["merge", "-o", "merged.exr", "tile0.exr"]);
    run.refused(2, &["uncovered", &gap]);
    let run = lvox(
        dir.path(),
        &[
            "merge",
            "-o",
            "merged.exr",
            "tile0.exr",
            "tile1.exr",
            "tile0.exr",
        ],
    );
    run.refused(2, &["overlap", "tile0.exr"]);
    let stranger = shade(Region::tile(WIDTH, HEIGHT, 1, 2).unwrap(), "0bad");
    exr::write(&dir.path().join("tile1.exr"), &stranger, Precision::Half).unwrap();
    let run = lvox(
        dir.path(),
        &["merge", "-o", "merged.exr", "tile0.exr", "tile1.exr"],
    );
    run.refused(2, &["lvox/tree", "0bad", "00ff", "tile0.exr", "tile1.exr"]);
    fs::write(dir.path().join("tile1.exr"), "not an image").unwrap();
    let run = lvox(
        dir.path(),
        &["merge", "-o", "merged.exr", "tile0.exr", "tile1.exr"],
    );
    run.refused(2, &["tile1.exr"]);
    assert_eq!(fs::read(&old).unwrap(), before);
    assert_eq!(names(dir.path()), ["merged.exr", "tile0.exr", "tile1.exr"]);
}

#[test]
fn tiles_that_are_missing_can_be_listed_or_left_black() {
    let dir = tempfile::tempdir().unwrap();
    let whole = exr::read(&write_whole(dir.path(), "whole.exr")).unwrap();
    write_tiles(dir.path(), 5);
    let run = |args: &[&str]| lvox(dir.path(), &[&["merge"], args].concat());
    let all = [
        "tile0.exr",
        "tile1.exr",
        "tile2.exr",
        "tile3.exr",
        "tile4.exr",
    ];
    let complete = run(&[&["--missing"], &all[..]].concat());
    assert_eq!((complete.code, complete.stdout.as_str()), (0, ""));

    let gap = Region::tile(WIDTH, HEIGHT, 3, 5).unwrap();
    let Region { x0, y0, x1, y1 } = gap;
    let some = [&all[..3], &all[4..]].concat();
    let listed = run(&[&["--missing"], &some[..]].concat());
    assert_eq!(listed.code, 0, "{}", listed.stderr);
    assert_eq!(listed.stdout, format!("--region {x0} {y0} {x1} {y1}\n"));
    assert!(!dir.path().join("merged.exr").exists());

    let output = ["-o", "merged.exr", "--allow-missing"];
    let strict = run(&[&some[..], &output, &["--strict"]].concat());
    assert_eq!(strict.code, 2, "{}", strict.stderr);
    assert!(
        strict.stderr.contains("error: a warning"),
        "{}",
        strict.stderr
    );
    assert!(!dir.path().join("merged.exr").exists());
    let merged = run(&[&some[..], &output].concat());
    assert_eq!(merged.code, 0, "{}", merged.stderr);
    assert!(
        merged.stderr.contains(&gap.to_string()),
        "{}",
        merged.stderr
    );
    let merged = exr::read(&dir.path().join("merged.exr")).unwrap();
    for (layer, full) in merged.layers.iter().zip(&whole.layers) {
        for ((name, got), (_, expected)) in layer.channels.iter().zip(&full.channels) {
            for (i, (&got, &expected)) in got.iter().zip(expected).enumerate() {
                let (x, y) = (i as u32 % WIDTH, i as u32 / WIDTH);
                let is_gap = (x0..x1).contains(&x) && (y0..y1).contains(&y);
                let expected = if is_gap { 0.0 } else { expected };
                assert_eq!(got.to_bits(), expected.to_bits(), "{name} at {x}, {y}");
            }
        }
    }
}

#[test]
fn a_code_for_retries_is_none_of_done_and_in_vain() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "whole.exr");
    let absent = ["compare", "whole.exr", "none.exr", "--retry-code", "99"];
    lvox(dir.path(), &absent).refused(2, &["none.exr"]);
    for code in ["0", "2", "256", "again"] {
        let run = lvox(dir.path(), &["compare", "a", "b", "--retry-code", code]);
        assert_eq!(run.code, 2, "{}", run.stderr);
        assert!(run.stderr.contains("--retry-code"), "{}", run.stderr);
    }
}

#[test]
fn outputs_that_cannot_be_written_are_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "whole.exr");
    fs::create_dir(dir.path().join("folder.exr")).unwrap();
    for output in ["no/such/folder/a.exr", "folder.exr"] {
        // The tile is not there either: the output is looked at first.
        let run = lvox(dir.path(), &["merge", "-o", output, "missing.exr"]);
        run.refused(2, &[output, "hint: "]);
        let run = lvox(
            dir.path(),
            &["compare", "whole.exr", "whole.exr", "--heatmap", output],
        );
        run.refused(2, &[output]);
        let run = lvox(
            dir.path(),
            &["compare", "whole.exr", "whole.exr", "--report", output],
        );
        run.refused(2, &[output]);
    }
    assert_eq!(names(dir.path()), ["folder.exr", "whole.exr"]);
}

#[test]
fn what_is_always_replaced_does_not_replace_files_of_other_kinds() {
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "whole.exr");
    let cloud = dir.path().join("a.lvc");
    fs::write(&cloud, "LVOXCLD and hours of work").unwrap();
    let compare = ["compare", "whole.exr", "whole.exr"];
    for (args, part) in [
        (&["merge", "whole.exr", "-o", "a.lvc"][..], "named .exr"),
        (
            &[&compare[..], &["--heatmap", "a.lvc"]].concat(),
            "ends in .png",
        ),
        (
            &[&compare[..], &["--report", "a.lvc"]].concat(),
            "not a report",
        ),
        // Reports of runs that fail are written, too.
        (
            &["build", "none.lvc", "-o", "x.lvt", "--report", "a.lvc"],
            "not a report",
        ),
    ] {
        lvox(dir.path(), args).refused(2, &["a.lvc", part]);
        assert_eq!(fs::read(&cloud).unwrap(), b"LVOXCLD and hours of work");
    }
    // One report takes the place of another.
    for _ in 0..2 {
        let run = lvox(
            dir.path(),
            &[&compare[..], &["--report", "r.json"]].concat(),
        );
        assert_eq!(run.code, 0, "{}", run.stderr);
    }
}

#[test]
fn progress_is_talk() {
    let dir = tempfile::tempdir().unwrap();
    write_tiles(dir.path(), 2);
    let args = [
        "merge",
        "-o",
        "m.exr",
        "tile0.exr",
        "tile1.exr",
        "--progress",
    ];
    let run = lvox(dir.path(), &[&args[..], &["json"]].concat());
    assert_eq!(run.stdout, "");
    for line in run.stderr.lines() {
        let json: serde_json::Value = serde_json::from_str(line).unwrap();
        assert_eq!(json["task"], "merge");
    }
    assert!(run.stderr.lines().count() >= 2);
    let run = lvox(dir.path(), &[&args[..], &["none"]].concat());
    assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    let run = lvox(dir.path(), &[&args[..], &["auto"]].concat());
    assert!(run.stderr.starts_with("merge: 2 tiles\n"), "{}", run.stderr);
}

#[cfg(target_os = "linux")]
#[test]
fn a_closed_pipe_is_success_and_a_full_disk_is_not() {
    use std::process::Stdio;
    let dir = tempfile::tempdir().unwrap();
    write_whole(dir.path(), "a.exr");
    let compare = |stdout: Stdio| {
        std::process::Command::new(env!("CARGO_BIN_EXE_lvox"))
            .current_dir(dir.path())
            .args(["compare", "a.exr", "a.exr"])
            .stdout(stdout)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap()
    };
    let mut child = compare(Stdio::piped());
    drop(child.stdout.take());
    assert_eq!(child.wait().unwrap().code(), Some(0));
    let full = fs::File::options().write(true).open("/dev/full").unwrap();
    let output = compare(full.into()).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        String::from_utf8(output.stderr)
            .unwrap()
            .starts_with("error: ")
    );
}

#[test]
fn stability_loads_its_scene_first_and_leaves_nothing_behind() {
    let dir = tempfile::tempdir().unwrap();
    lvox(dir.path(), &["stability", "no such scene.toml"]).refused(2, &["no such scene.toml"]);
    assert!(names(dir.path()).is_empty());
}
