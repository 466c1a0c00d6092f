//! Frames cut into tiles of equal cost.

use crate::support::program::lvox;
use crate::{ROOM, Work};
use std::fs;

/// The room on an odd film, with a tree of few surfels.
fn work() -> Work {
    let work = Work::new(&ROOM.replace("width = 64\nheight = 48", "width = 101\nheight = 75"));
    work.bake(&work.scene(), 5000);
    work
}

const SHADE: [&str; 5] = ["scene.toml", "-t", "scene.lvt", "--quality", "draft"];

fn run(work: &Work, args: &[&[&str]]) -> crate::support::program::Run {
    lvox(work.0.path(), &args.concat())
}

#[test]
fn a_cut_does_not_depend_on_threads_and_memory_and_its_tiles_are_the_frame() {
    let work = work();
    let cut = |count: &str, more: &[&str], name: &str| {
        let base = ["--count", count, "-o", name];
        run(&work, &[&["tiles"], &SHADE, &base, more]).done();
        fs::read_to_string(work.path(name)).unwrap()
    };
    for count in ["1", "7", "64"] {
        let list = cut(count, &["--threads", "1"], "one.txt");
        assert_eq!(list.lines().count().to_string(), count);
        assert_eq!(list, cut(count, &["--threads", "3"], "three.txt"));
        let few = ["--memory-limit", "64M", "--camera", "front"];
        assert_eq!(list, cut(count, &few, "few.txt"));
        let printed = run(&work, &[&["tiles"], &SHADE, &["-n", count]]);
        assert_eq!((printed.code, printed.stdout), (0, list));
    }
    let corner = cut("7", &["--camera", "corner"], "corner.txt");
    assert_ne!(corner, cut("7", &[], "tiles.txt"));
    run(&work, &[&["shade"], &SHADE, &["-o", "whole.exr"]]).done();
    let tiles: Vec<String> = (0..7).map(|i| format!("tile.{i}.exr")).collect();
    for (i, tile) in tiles.iter().enumerate() {
        let tile_of = format!("{i}/7");
        let part = ["--tile", &tile_of, "--tiles", "tiles.txt", "-o", tile];
        run(&work, &[&["shade"], &SHADE, &part]).done();
    }
    let tiles: Vec<&str> = tiles.iter().map(String::as_str).collect();
    run(&work, &[&["merge"], &tiles, &["-o", "merged.exr"]]).done();
    let bytes = |name: &str| fs::read(work.path(name)).unwrap();
    assert!(bytes("merged.exr") == bytes("whole.exr"));
}

#[test]
fn lists_of_other_frames_and_counts_are_refused() {
    let work = work();
    let cut = |count: &str| run(&work, &[&["tiles"], &SHADE, &["-n", count, "-o", "a.txt"]]);
    assert_eq!(cut("0").code, 2);
    cut("7576").refused(2, &["101x75 pixels into 7576 tiles"]);
    assert!(!work.path("a.txt").exists());
    let shade = |tile: &str, more: &[&str]| {
        let part = ["--tile", tile, "--tiles", "a.txt", "-o", "a.exr"];
        run(&work, &[&["shade"], &SHADE, &part, more])
    };
    shade("0/2", &[]).refused(2, &["a.txt"]);
    cut("2").done();
    shade("0/3", &[]).refused(2, &["a.txt: ", "each of 3 tiles, found 2"]);
    shade("0/1", &[]).refused(2, &["a.txt: ", "each of 1 tiles, found more"]);
    shade("0/2", &["--resolution", "102x75"]).refused(2, &["no tile has the pixels"]);
    shade("0/2", &["--resolution", "60x75"]).refused(2, &["a.txt: line ", "60x75"]);
    let alone = ["--tiles", "a.txt", "-o", "a.exr"];
    let without = run(&work, &[&["shade"], &SHADE, &alone]);
    assert_eq!((without.code, without.stderr.contains("--tile")), (2, true));
    // The list is an input.
    let over = ["--tile", "0/2", "--tiles", "a.txt", "-o", "./a.txt"];
    assert_eq!(run(&work, &[&["shade"], &SHADE, &over]).code, 2);
    for text in [
        "",
        "0 0 101 75\n",
        "--region 0 0 101 75\n--region 0 0 101 75\n",
    ] {
        fs::write(work.path("a.txt"), text).unwrap();
        shade("0/2", &[]).refused(2, &["a.txt: "]);
    }
    fs::write(work.path("a.txt"), [0xff, 0xfe, 0, 10].repeat(1 << 16)).unwrap();
    shade("0/2", &[]).refused(2, &["a.txt: line 1: "]);
    assert!(!work.path("a.exr").exists());
}
