//! `--plan`: what a verb would read, write and take; nothing is written.

use crate::support::names;
use crate::support::program::lvox;
use tempfile::TempDir;

const SCENE: &str = "[[camera]]\nname = \"a\"\nposition = [0, 1, 3]\ntarget = [0, 0, 0]\n\
    [film]\nwidth = 40\nheight = 30\n\
    [[mesh]]\nfile = \"builtin:cube\"\n\
    [[light]]\ntype = \"directional\"\ndirection = [0, -1, 0]\nirradiance = [1, 1, 1]\n\
    [[volume]]\nfile = \"builtin:plume\"\nsigma_t_scale = 1\nalbedo = [0.5, 0.5, 0.5]\n\
    unitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]]\n";

const POINTS: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
    property float z\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n\
    0 2 0 0 1 0\n";

/// A folder of the scene, a point, a cloud and its tree.
fn folder() -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path();
    std::fs::write(path.join("a.toml"), SCENE).unwrap();
    std::fs::write(path.join("points.ply"), POINTS).unwrap();
    for made in [
        &["bake", "a.toml", "--surfels", "1000", "-o", "a.lvc"][..],
        &["build", "a.lvc", "-o", "a.lvt"],
    ] {
        lvox(path, made).done();
    }
    dir
}

/// Words of a call, and what its plan says.
const PLANS: &[(&[&str], &[&str])] = &[
    (
        &["bake", "a.toml", "-o", "b.lvc"],
        &[
            "a.toml (",
            "b.lvc",
            "triangles  12",
            "voxels",
            "surfels    ",
            "lvoxels    ",
            "written    about ",
            "CPU s",
        ],
    ),
    (
        &["render", "a.toml", "-o", "b.exr"],
        &["b.exr", "pixels     1200"],
    ),
    (
        &["bounce", "a.toml", "-t", "a.lvt", "-o", "b.lvt"],
        &["a.lvt (", "surfels    1"],
    ),
    (
        &["scatter", "a.toml", "-t", "a.lvt", "-o", "b.lvs"],
        &["b.lvs", "lvoxels"],
    ),
    (
        &["shade", "a.toml", "-t", "a.lvt", "-o", "b.exr"],
        &["pixels     1200", "CPU s"],
    ),
    (
        &[
            "shade", "a.toml", "-t", "a.lvt", "--tile", "0/2", "-o", "b.exr",
        ],
        &["pixels     600"],
    ),
    (&["pack", "a.toml", "-o", "b.lvp"], &["b.lvp", "CPU s"]),
    (
        &["tiles", "a.toml", "-t", "a.lvt", "-n", "3", "-o", "b.txt"],
        &["b.txt", "pixels     1200", "tiles      3", "not told"],
    ),
    (
        &["study", "a.toml", "--quick", "--seeds", "3", "-o", "s"],
        &[
            "study.json",
            "pixels     43200",
            "paths      5529600",
            "clouds     9",
            "runs       36",
        ],
    ),
    (
        &["gather", "a.lvt", "points.ply", "-o", "b.ply"],
        &["points     1\n"],
    ),
    (
        &["reference", "a.toml", "--time", "9", "-o", "r.exr"],
        &["r.exr.sums", "9.0 CPU s"],
    ),
];

#[test]
fn verbs_say_what_they_would_take_and_write_nothing() {
    let dir = folder();
    let path = dir.path();
    let before = names(path);
    for &(words, parts) in PLANS {
        let run = lvox(path, &[words, &["--plan"]].concat());
        assert_eq!(run.code, 0, "{words:?}: {}", run.stderr);
        for part in parts.iter().chain(&["memory     at least"]) {
            assert!(
                run.stdout.contains(part),
                "{words:?}: {part:?} is not in\n{}",
                run.stdout
            );
        }
        let json = lvox(path, &[words, &["--plan", "--json"]].concat()).stdout;
        let plan: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert!(plan["memory_bytes"].as_u64() > Some(1 << 20), "{plan}");
    }
    assert_eq!(names(path), before);
}

#[test]
fn plans_refuse_what_the_run_itself_would_refuse() {
    let dir = folder();
    let path = dir.path();
    let small = [
        "bake",
        "a.toml",
        "-o",
        "b.lvc",
        "--plan",
        "--memory-limit",
        "1M",
    ];
    lvox(path, &small).refused(2, &["this bake needs"]);
    let there = ["bake", "a.toml", "-o", "a.lvc", "--plan"];
    lvox(path, &there).refused(2, &["a.lvc"]);
}
