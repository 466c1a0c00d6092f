//! Cloud and tree files that are not what they should be, given to the program.

use crate::messages::lvox;
use crate::{ROOM, Work};
use lvox::formats::record::MAX_VOXELS_ALONG;
use lvox::formats::{Cloud, Overwrite, Tree, TreeWriter};
use lvox::tree::OpenTree;
use std::fs;

/// Offset of the field that holds a section's offset and, after it, its length; the names are those
/// of the specification.
const SECTIONS: [(&str, usize); 3] = [("metadata", 24), ("summary", 48), ("block table", 72)];

fn section(file: &[u8], field: usize) -> std::ops::Range<usize> {
    let number = |at: usize| u64::from_le_bytes(file[at..at + 8].try_into().unwrap()) as usize;
    number(field)..number(field) + number(field + 8)
}

/// Positions of which one is in the header, and one in each section.
fn positions(file: &[u8]) -> Vec<(String, usize)> {
    let mut positions = vec![("header".into(), 30)];
    for (name, field) in SECTIONS {
        let range = section(file, field);
        assert!(!range.is_empty());
        positions.push((name.into(), (range.start + range.end) / 2));
    }
    positions
}

/// A file with one thing wrong: what that is, the bytes, and what the message has to say.
fn damaged(good: &[u8], blocks: &[(String, usize)]) -> Vec<(String, Vec<u8>, &'static str)> {
    let mut cases = Vec::new();
    let mut change = |name: &str, says, change: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = good.to_vec();
        change(&mut bytes);
        cases.push((name.to_string(), bytes, says));
    };
    change("magic", "not an lvox file", &|b| b[0] = b'X');
    change("text transfer", "not an lvox file", &|b| {
        b.remove(4);
    });
    change("newer", "version 4", &|b| b[12] = 4);
    change("empty", "not an lvox file", &|b| b.clear());
    for part in [10, 60, 104, good.len() / 2, good.len() - 1] {
        change("truncated", "expected a file of", &|b| b.truncate(part));
    }
    for (name, at) in positions(good).iter().chain(blocks) {
        change(name, "", &|b| b[*at] ^= 0x10);
    }
    cases
}

struct Files {
    work: Work,
    cloud: Vec<u8>,
    tree: Vec<u8>,
}

fn files() -> Files {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 3000);
    let read = |name: &str| {
        let bytes = fs::read(work.path(name)).unwrap();
        fs::remove_file(work.path(name)).unwrap();
        bytes
    };
    Files {
        cloud: read("scene.lvc"),
        tree: read("scene.lvt"),
        work,
    }
}

/// Both a verb and `verify` refuse what is put into `file`, name it and leave nothing behind.
fn refuses(work: &Work, file: &str, verb: &[&str], damaged: Vec<(String, Vec<u8>, &str)>) {
    for (name, bytes, says) in damaged {
        fs::write(work.path(file), bytes).unwrap();
        for args in [verb, &["verify", file]] {
            let run = lvox(work, &[args, &["--progress", "none"]].concat());
            run.refused(2, &[file, says]);
        }
        assert_eq!(work.names(), [file, "scene.toml", "smoke.raw"], "{name}");
    }
}

/// Files of other formats, or of those of lvox that are no results: a list of tiles.
#[test]
fn what_is_no_such_file_is_told_what_may_be_read() {
    let work = Work::new(ROOM);
    let png = b"\x89PNG\r\n\x1a\n0000";
    let files: [(&str, &[u8]); 3] = [
        ("a.png", png),
        ("a.npy", b"\x93NUMPY\x01\0"),
        ("tiles.txt", b"--region 0 0 24 40\n"),
    ];
    for (name, bytes) in files {
        fs::write(work.path(name), bytes).unwrap();
        let kinds = [name, "not an lvox file", ".lvs", ".exr.sums"];
        lvox(&work, &["verify", name]).refused(2, &kinds);
        lvox(&work, &["inspect", name]).refused(2, &[&kinds[..], &["a scene"]].concat());
    }
}

#[test]
fn building_refuses_damaged_clouds() {
    let Files { work, cloud, .. } = files();
    let opened = Cloud::open(&cloud[..]).unwrap();
    let mut blocks = Vec::new();
    for (i, b) in opened
        .surfel_blocks()
        .iter()
        .chain(opened.lvoxel_blocks())
        .enumerate()
    {
        let middle = b.offset as usize + b.stored_bytes as usize / 2;
        blocks.push((format!("block {i}"), middle));
    }
    assert!(blocks.len() >= 2);
    let build = ["build", "bad.lvc", "-o", "out.lvt"];
    refuses(&work, "bad.lvc", &build, damaged(&cloud, &blocks));
}

#[test]
fn shading_refuses_damaged_trees() {
    let Files { work, tree, .. } = files();
    let opened = Tree::open(&tree[..]).unwrap();
    let root = opened.root_page().unwrap() as usize;
    // A page that no ray needs is not read, and so not missed; the root is needed, and so are all
    // lvoxels.
    let needed = [opened.surfel_blocks()[root], opened.lvoxel_blocks()[0]];
    let blocks: Vec<_> = ["root page", "lvoxel page"]
        .iter()
        .zip(needed)
        .map(|(name, b)| {
            let middle = b.offset as usize + b.stored_bytes as usize / 2;
            ((*name).to_string(), middle)
        })
        .collect();
    let shade = ["shade", "scene.toml", "-t", "bad.lvt", "-o", "out.exr"];
    refuses(&work, "bad.lvt", &shade, damaged(&tree, &blocks));
}

#[test]
fn verify_finds_a_flipped_bit_anywhere() {
    let Files { work, cloud, tree } = files();
    for (name, good) in [("a.lvc", cloud), ("a.lvt", tree)] {
        fs::write(work.path(name), &good).unwrap();
        let run = lvox(&work, &["verify", name, "--progress", "none"]);
        assert_eq!(run.code, 0, "{}", run.stderr);
        for i in 0..40 {
            let at = good.len() * i / 40 + 5;
            let mut bytes = good.clone();
            bytes[at] ^= 1 << (i % 8);
            fs::write(work.path(name), bytes).unwrap();
            let run = lvox(&work, &["verify", name, "--progress", "none"]);
            run.refused(2, &[name]);
        }
        fs::remove_file(work.path(name)).unwrap();
    }
}

#[test]
fn one_kind_of_file_in_place_of_the_other() {
    let Files { work, cloud, tree } = files();
    fs::write(work.path("a.lvt"), cloud).unwrap();
    fs::write(work.path("a.lvc"), tree).unwrap();
    lvox(&work, &["build", "a.lvc", "-o", "b.lvt"]).refused(2, &["a.lvc", "cloud"]);
    lvox(
        &work,
        &["shade", "scene.toml", "-t", "a.lvt", "-o", "b.exr"],
    )
    .refused(2, &["a.lvt", "tree"]);
    assert_eq!(work.names(), ["a.lvc", "a.lvt", "scene.toml", "smoke.raw"]);
}

#[test]
fn volumes_that_memory_cannot_hold_are_refused() {
    let Files { work, tree, .. } = files();
    fs::write(work.path("good.lvt"), tree).unwrap();
    let good = Tree::open_path(&work.path("good.lvt")).unwrap();
    let mut meta = good.meta().clone();
    for dims in [[MAX_VOXELS_ALONG; 3], [1 << 19, 1 << 19, 8]] {
        meta.cloud.volumes[0].dims = dims;
        let path = work.path("bad.lvt");
        let writer = TreeWriter::create(&path, meta.clone(), Overwrite::Replace).unwrap();
        let sums = good.summary().cloud_sums.clone();
        writer.finish(None, sums, Vec::new()).unwrap();
        let error = OpenTree::open(&path, None).unwrap_err().to_string();
        assert!(error.contains("voxels"), "{error}");
    }
}
