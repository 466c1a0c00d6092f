//! `--plan`: what a verb would read, write and take; nothing is written.

use crate::support::names;
use crate::support::program::lvox;

#[test]
fn verbs_say_what_they_would_take_and_write_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path();
    let scene = "[[camera]]\nname = \"a\"\nposition = [0, 1, 3]\ntarget = [0, 0, 0]\n\
                 [film]\nwidth = 40\nheight = 30\n\
                 [[mesh]]\nfile = \"builtin:cube\"\n[[light]]\ntype = \"directional\"\n\
                 direction = [0, -1, 0]\nirradiance = [1, 1, 1]\n\
                 [[volume]]\nfile = \"builtin:plume\"\nsigma_t_scale = 1\n\
                 albedo = [0.5, 0.5, 0.5]\nunitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 1], \
                 [0, 0, 1, 0], [0, 0, 0, 1]]\n";
    std::fs::write(path.join("a.toml"), scene).unwrap();
    std::fs::write(path.join("points.ply"), POINTS).unwrap();
    for made in [
        &["bake", "a.toml", "--surfels", "1000", "-o", "a.lvc"][..],
        &["build", "a.lvc", "-o", "a.lvt"],
    ] {
        lvox(path, made).done();
    }
    let before = names(path);
    let tree = ["a.toml", "-t", "a.lvt"];
    for (words, parts) in [
        (
            &["bake", "a.toml", "-o", "b.lvc"][..],
            &[
                "a.toml (",
                "b.lvc",
                "triangles  12",
                "voxels",
                "surfels    ",
                "lvoxels    ",
                "written    about ",
                "CPU s",
            ][..],
        ),
        (
            &["render", "a.toml", "-o", "b.exr"],
            &["b.exr", "pixels     1200"],
        ),
        (
            &["bounce", tree[0], tree[1], tree[2], "-o", "b.lvt"],
            &["a.lvt (", "surfels    1"],
        ),
        (
            &["scatter", tree[0], tree[1], tree[2], "-o", "b.lvs"],
            &["b.lvs", "lvoxels"],
        ),
        (
            &["shade", tree[0], tree[1], tree[2], "-o", "b.exr"],
            &["pixels     1200", "CPU s"],
        ),
        (
            &[
                "shade", tree[0], tree[1], tree[2], "--tile", "0/2", "-o", "b.exr",
            ],
            &["pixels     600"],
        ),
        (&["pack", "a.toml", "-o", "b.lvp"], &["b.lvp", "CPU s"]),
        (
            &["tiles", tree[0], tree[1], tree[2], "-n", "3", "-o", "b.txt"],
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
    ] {
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
    // What the run itself would refuse.
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

const POINTS: &str = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
    property float z\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n\
    0 2 0 0 1 0\n";
