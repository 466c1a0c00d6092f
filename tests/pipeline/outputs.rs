//! Outputs that name an input or another output are refused, and a run that fails leaves everything
//! as it was.

use crate::messages::lvox;
use crate::{ROOM, Work};
use lvox::image::{Frame, Layer, Region, exr};
use std::fs;

/// Every file of the folder with its content.
fn contents(work: &Work) -> Vec<(String, Vec<u8>)> {
    let read = |name: String| {
        let bytes = fs::read(work.path(&name)).unwrap();
        (name, bytes)
    };
    work.names().into_iter().map(read).collect()
}

#[test]
fn no_output_takes_the_place_of_an_input_or_another_output() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 500);
    let small = ["--resolution", "4x4", "--progress", "none"];
    let shade = ["shade", "scene.toml", "-t", "scene.lvt"];
    let run = lvox(&work, &[&shade[..], &small, &["-o", "p.exr"]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    fs::copy(work.path("p.exr"), work.path("q.exr")).unwrap();
    let before = contents(&work);
    let inputs: [(&str, &str); 21] = [
        ("bake scene.toml -o scene.toml --force", "scene"),
        (
            "bake scene.toml -o ./smoke.raw --force",
            "file of the scene",
        ),
        (
            "bake scene.toml -o new.lvc --report smoke.raw",
            "not a report",
        ),
        ("build scene.lvc -o scene.lvc --force", "cloud"),
        (
            "render scene.toml -o a.exr --keep-tree scene.toml --force",
            "scene",
        ),
        ("render scene.toml -o a.exr --keep-tree a.exr", "--output"),
        ("render scene.toml -o a.exr --report a.exr", "--output"),
        (
            "shade scene.toml -t scene.lvt -o a.exr --report scene.lvt",
            "tree",
        ),
        ("shade scene.toml -t p.exr -o p.exr", "tree"),
        (
            "shade scene.toml -t scene.lvt -o a.exr --radiance-cache a.exr",
            "--output",
        ),
        (
            "shade scene.toml -t scene.lvt -o a.exr --gather-cache ./a.exr",
            "--output",
        ),
        (
            "shade scene.toml -t scene.lvt -o a.exr --radiance-cache a --gather-cache a",
            "--radiance-cache",
        ),
        (
            "shade scene.toml -t scene.lvt -o a.exr --radiance-cache scene.lvt",
            "tree",
        ),
        (
            "tiles scene.toml -t scene.lvt -n 2 -o a --radiance-cache a",
            "--output",
        ),
        ("compare p.exr q.exr --heatmap p.exr", "image"),
        ("compare p.exr q.exr --report q.exr", "reference"),
        ("merge p.exr -o p.exr", "tile"),
        ("inspect scene.lvc --export scene.lvc --force", "file"),
        ("verify scene.lvc --report scene.lvc", "file"),
        ("reference scene.toml -o r.exr --report r.exr.sums", "sums"),
        (
            "study scene.toml -o out --report out/study.json",
            "--output",
        ),
    ];
    for (line, part) in inputs {
        fs::create_dir(work.path("out")).unwrap();
        let args: Vec<&str> = line.split(' ').collect();
        lvox(&work, &args).refused(2, &["would replace", part, "hint: "]);
        fs::remove_dir(work.path("out")).unwrap();
        assert!(contents(&work) == before, "{line} has changed a file");
    }
}

#[cfg(unix)]
#[test]
fn outputs_of_every_kind_follow_links_and_survive_a_failing_run() {
    use std::os::unix::fs::symlink;
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 500);
    fs::create_dir(work.path("store")).unwrap();
    for (line, output) in [
        ("bake scene.toml --surfels 500 -o", "a.lvc"),
        ("build scene.lvc -o", "a.lvt"),
        (
            "shade scene.toml -t scene.lvt --resolution 16x16 -o",
            "a.exr",
        ),
        ("inspect scene.lvc --export", "a.ply"),
    ] {
        let stored = work.path("store").join(output);
        fs::write(&stored, b"old").unwrap();
        symlink(&stored, work.path(output)).unwrap();
        let line = format!("{line} {output} --force --progress none");
        let before = work.names();

        // Of a larger file the system refuses the rest, as on a full disk.
        let limited = format!("ulimit -f 1; exec \"$0\" {line}");
        let run = std::process::Command::new("sh")
            .args(["-c", &limited, env!("CARGO_BIN_EXE_lvox")])
            .current_dir(work.0.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{line}: {said}");
        assert!(said.contains(output) && !said.contains(".part"), "{said}");
        assert_eq!(fs::read(&stored).unwrap(), b"old", "{line}");

        let args: Vec<&str> = line.split(' ').collect();
        let run = lvox(&work, &args);
        assert_eq!(run.code, 0, "{line}: {}", run.stderr);
        assert!(fs::metadata(&stored).unwrap().len() > 1000, "{line}");
        let link = fs::symlink_metadata(work.path(output)).unwrap();
        assert!(link.is_symlink(), "{line}");
        assert_eq!(work.names(), before, "{line}");
    }
    assert_eq!(fs::read_dir(work.path("store")).unwrap().count(), 4);
}

#[test]
fn pipes_are_no_inputs_and_nobody_waits_for_them() {
    let work = Work::new(ROOM);
    let made = std::process::Command::new("mkfifo")
        .arg(work.path("a.pipe"))
        .status();
    assert!(made.unwrap().success());
    for args in [
        &["build", "a.pipe", "-o", "a.lvt"][..],
        &["merge", "a.pipe", "-o", "a.exr"],
        &["inspect", "a.pipe"],
        &["verify", "a.pipe"],
        &["shade", "scene.toml", "-t", "a.pipe", "-o", "a.exr"],
    ] {
        lvox(&work, args).refused(2, &["a.pipe", "expected a file, found a pipe"]);
    }
}

/// Tiles of other programs may hold anything.
#[test]
fn tiles_with_pixels_that_are_not_finite_are_told_and_end_strict_merges() {
    let work = Work::new(ROOM);
    let mut tile = Frame::new(4, 3, Region::full(4, 3));
    let mut pixels = [[1.0; 3]; 12];
    pixels[9][1] = f32::NAN;
    tile.layers.push(Layer::rgb("", &pixels));
    exr::write(&work.path("tile.exr"), &tile, exr::Precision::Half).unwrap();
    let merge = ["merge", "tile.exr", "-o", "out.exr", "--progress", "none"];
    let strict = lvox(&work, &[&merge[..], &["--strict"]].concat());
    let said = "1 pixel is infinite or not a number, the first at (1, 2), in the channels G";
    strict.refused(2, &["out.exr", said]);
    assert!(!work.path("out.exr").exists());
    let run = lvox(&work, &merge);
    run.done();
    assert!(run.stderr.contains(said), "{}", run.stderr);
    assert_eq!(run.stderr.lines().count(), 1, "{}", run.stderr);
}
