//! The program from outside: what it refuses, what it says, what it leaves behind.

use crate::support::program::{self, Run};
use crate::{ROOM, Work};
use std::fs;

/// Runs the program in the folder.
pub fn lvox(work: &Work, args: &[&str]) -> Run {
    program::lvox(work.0.path(), args)
}

const QUIET: [&str; 6] = [
    "--progress",
    "none",
    "--samples",
    "8",
    "--volume-samples",
    "4",
];
const FEW: [&str; 2] = ["--surfels", "2000"];
/// Renders, and keeps the tree.
const RENDER: [&str; 6] = [
    "render",
    "scene.toml",
    "-o",
    "out.exr",
    "--keep-tree",
    "out.lvt",
];

#[test]
fn rendering_is_baking_building_bouncing_and_shading() {
    let work = Work::new(ROOM);
    let render = [
        "render",
        "scene.toml",
        "-o",
        "a.exr",
        "--keep-tree",
        "a.lvt",
    ];
    lvox(&work, &[&render[..], &FEW, &QUIET].concat()).done();
    let bake = ["bake", "scene.toml", "-o", "b.lvc", "--progress", "none"];
    lvox(&work, &[&bake[..], &FEW].concat()).done();
    lvox(
        &work,
        &["build", "b.lvc", "-o", "b.lvt", "--progress", "none"],
    )
    .done();
    let bounce = [
        "bounce",
        "scene.toml",
        "-t",
        "b.lvt",
        "-o",
        "all.lvt",
        "--progress",
        "none",
    ];
    lvox(&work, &bounce).done();
    let again = ["bounce", "scene.toml", "-t", "all.lvt", "-o", "more.lvt"];
    lvox(&work, &again).refused(2, &["error: all.lvt: expected a tree as `build` made it"]);
    let shade = ["shade", "scene.toml", "--tree", "all.lvt", "-o", "b.exr"];
    let run = lvox(&work, &[&shade[..], &QUIET].concat());
    run.done();
    assert_eq!(run.stderr, "");
    let read = |name: &str| fs::read(work.path(name)).unwrap();
    assert!(read("a.lvt") == read("all.lvt"));
    assert!(read("a.exr") == read("b.exr"));
    // One bounce is the light of the tree as it was built.
    let once = [&render[..], &["--bounces", "1", "--force"], &FEW, &QUIET].concat();
    lvox(&work, &once).done();
    assert!(read("a.lvt") == read("b.lvt"));
    assert!(read("a.exr") != read("b.exr"));

    // Clouds and trees are replaced when told to, images always.
    for args in [&bake[..], &["build", "b.lvc", "-o", "b.lvt"]] {
        lvox(&work, args).refused(2, &["already there", "--force"]);
    }
    lvox(&work, &[&shade[..], &QUIET].concat()).done();
    let force = [
        "build",
        "b.lvc",
        "-o",
        "b.lvt",
        "--force",
        "--progress",
        "none",
    ];
    lvox(&work, &force).done();
}

#[test]
fn a_tree_that_was_kept_is_told_with_how_to_go_on() {
    let work = Work::new(ROOM);
    let small = ["--resolution", "4x4"];
    let render = [&RENDER[..], &small, &FEW, &QUIET].concat();
    lvox(&work, &render).done();
    let tree = fs::read(work.path("out.lvt")).unwrap();
    // As a run leaves it that ends while it shades.
    fs::remove_file(work.path("out.exr")).unwrap();
    let told = ["out.lvt: a tree is already there", "--resume", "--force"];
    lvox(&work, &render).refused(2, &told);
    lvox(&work, &[&render[..], &["--resume"]].concat()).done();
    assert!(work.path("out.exr").exists());
    assert!(fs::read(work.path("out.lvt")).unwrap() == tree);
    // What is no tree is none to go on from.
    fs::write(work.path("out.lvt"), "notes").unwrap();
    let run = lvox(&work, &render);
    run.refused(2, &["out.lvt: the file is already there", "--force"]);
    assert!(!run.stderr.contains("--resume"), "{}", run.stderr);
}

#[test]
fn the_demo_needs_no_file_and_makes_both_kinds_of_image() {
    let work = Work::new("");
    fs::remove_file(work.path("scene.toml")).unwrap();
    fs::remove_file(work.path("smoke.raw")).unwrap();
    let demo = ["render", "--demo", "--region", "300", "200", "308", "206"];
    for (name, magic) in [("demo.exr", b"\x76\x2f\x31\x01"), ("demo.png", b"\x89PNG")] {
        lvox(&work, &[&demo[..], &["-o", name], &FEW, &QUIET].concat()).done();
        assert!(fs::read(work.path(name)).unwrap().starts_with(magic));
    }
    assert_eq!(work.names(), ["demo.exr", "demo.png"]);
}

#[test]
fn reports_tell_times_counts_and_failures() {
    let work = Work::new(ROOM);
    let render = ["render", "scene.toml", "-o", "a.exr", "--report", "a.json"];
    lvox(&work, &[&render[..], &FEW, &QUIET].concat()).done();
    let report = || -> serde_json::Value {
        serde_json::from_slice(&fs::read(work.path("a.json")).unwrap()).unwrap()
    };
    let json = report();
    let stages = json["stages"].as_array().unwrap();
    let names: Vec<_> = stages
        .iter()
        .map(|s| s["stage"].as_str().unwrap())
        .collect();
    assert_eq!(names, ["load", "bake", "build", "bounce", "shade", "write"]);
    assert_eq!(stages[1]["counts"]["surfels"], 2000.0);
    assert_eq!(stages[4]["counts"]["pixels"], 64.0 * 48.0);
    assert!(json["peak_memory_bytes"].as_u64().unwrap() > 1 << 20);
    lvox(
        &work,
        &[&render[..], &["--camera", "nobody"], &FEW, &QUIET].concat(),
    )
    .refused(2, &["nobody"]);
    let json = report();
    assert_eq!(json["ok"], false);
    assert!(json["error"].as_str().unwrap().contains("nobody"));
}

/// Walls whose backs get no light at all: that they are dark is known.
#[test]
fn dark_backs_of_walls_are_not_taken_for_places_without_surfels() {
    let quad = |scale: f32, rest: &str| {
        format!(
            "[[mesh]]\nfile = \"builtin:quad\"\nscale = {scale}\nalbedo = [0.7, 0.7, 0.7]\n{rest}\n"
        )
    };
    let text = String::from(
        "[film]\nwidth = 32\nheight = 24\n[[camera]]\nposition = [-2.5, 1.5, -2.5]\n\
         target = [0, 1, 0]\nfov_x_deg = 60\n[[light]]\ntype = \"directional\"\n\
         direction = [-1, -1.5, -1]\nirradiance = [3, 3, 3]\n",
    ) + &quad(6.0, "")
        + &quad(2.0, "rotate_deg = [90, 0, 0]\ntranslate = [0, 1, -1]")
        + &quad(2.0, "rotate_deg = [0, 0, -90]\ntranslate = [-1, 1, 0]");
    let work = Work::new(&text);
    let render = ["render", "scene.toml", "-o", "a.exr", "--report", "a.json"];
    let many = ["--surfels", "100000"];
    lvox(&work, &[&render[..], &many, &QUIET].concat()).done();
    let report = fs::read(work.path("a.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&report).unwrap();
    let stages = json["stages"].as_array().unwrap();
    let counts = &stages.iter().find(|s| s["stage"] == "shade").unwrap()["counts"];
    let [patches, unknown] =
        ["patches", "patches_without_surfels"].map(|name| counts[name].as_f64().unwrap());
    assert!(
        patches > 100.0 && unknown < 0.02 * patches,
        "{unknown} of {patches}"
    );
}

#[test]
fn wrong_scenes_and_settings_leave_nothing_behind() {
    let textured = "[[mesh]]\nfile = \"builtin:quad\"\ntexture = \"tiles.png\"\n";
    let cases: [(&str, &[&str], &[&str]); 9] = [
        (
            ROOM,
            &["--camera", "nobody"],
            &["`nobody`", "hint: ", "`front`"],
        ),
        (ROOM, &["--region", "0", "0", "65", "4"], &["65"]),
        (ROOM, &["--region", "4", "4", "4", "8"], &[]),
        (ROOM, &["--tile", "3/0"], &["--tile"]),
        (ROOM, &["--samples", "0"], &["--samples", "1 to"]),
        (ROOM, &["--max-solid-angle", "nan"], &["--max-solid-angle"]),
        (textured, &[], &["tiles.png"]),
        (
            "[[mesh]]\nfile = \"builtin:quad\"\nemision = [1, 1, 1]\n",
            &[],
            &["emision", "line 3", "hint: ", "`emission`"],
        ),
        ("", &[], &["scene.toml"]),
    ];
    for (text, options, parts) in cases {
        let work = Work::new(text);
        let run = lvox(&work, &[&RENDER[..], options, &FEW, &QUIET].concat());
        let what = format!("{options:?} {}", text.lines().nth(2).unwrap_or_default());
        if run.stderr.contains("Usage") || run.stderr.contains("For more information") {
            // The option parser has its own words.
            assert_eq!(run.code, 2, "{what}");
        } else {
            run.refused(2, parts);
        }
        assert_eq!(work.names(), ["scene.toml", "smoke.raw"], "{what}");
    }
    let work = Work::new(ROOM);
    lvox(&work, &["render", "none.toml", "-o", "out.exr"]).refused(2, &["none.toml"]);
    lvox(
        &work,
        &["shade", "scene.toml", "-t", "none.lvt", "-o", "out.exr"],
    )
    .refused(2, &["none.lvt"]);
    lvox(&work, &["build", "none.lvc", "-o", "out.lvt"]).refused(2, &["none.lvc"]);
    lvox(&work, &["render", "scene.toml", "-o", "out.jpg"]).refused(2, &["out.jpg", ".exr"]);
    assert_eq!(work.names(), ["scene.toml", "smoke.raw"]);
}

#[test]
fn volumes_of_more_blocks_than_can_be_numbered_are_refused() {
    let long = ROOM
        .replace("dims = [16, 16, 16]", "dims = [70000, 2, 2]")
        .replace("sigma_t_scale = 6", "sigma_t_scale = 1.5");
    assert!(long != ROOM);
    let work = Work::new(&long);
    fs::write(work.path("smoke.raw"), vec![255; 70_000 * 4]).unwrap();
    let bake = ["bake", "scene.toml", "-o", "a.lvc", "--progress", "none"];
    let parts = ["smoke", "70000 x 2 x 2", "65536", "--block-voxels 2"];
    lvox(&work, &[&bake[..], &FEW].concat()).refused(2, &parts);
    let blocks = |n: &'static str| [&bake[..], &FEW, &["--block-voxels", n]].concat();
    lvox(&work, &blocks("1")).refused(2, &parts);
    assert_eq!(work.names(), ["scene.toml", "smoke.raw"]);
    // What the message offers does.
    lvox(&work, &blocks("2")).done();
    let cloud = lvox::formats::Cloud::open_path(&work.path("a.lvc")).unwrap();
    let chunks = (0..cloud.lvoxel_chunks()).flat_map(|i| cloud.lvoxel_chunk(i).unwrap());
    assert_eq!(chunks.map(|v| v.block[0]).max(), Some(34_999));
}

#[test]
fn surfels_that_floats_cannot_hold_are_no_fault_of_a_file() {
    let quad = |scale: &str, light: &str| {
        format!(
            "[[camera]]\nposition = [0, 0, 1]\ntarget = [0, 0, 0]\n\
             [[mesh]]\nfile = \"builtin:quad\"\nscale = {scale}\n\
             [[light]]\n{light}\n"
        )
    };
    let sky = "type = \"environment\"\nradiance = [1, 1, 1]";
    let point = "type = \"point\"\nposition = [0, 1e-6, 0]\nintensity = [1e30, 1, 1]";
    for (scene, part) in [
        (
            quad("1e-22", sky),
            "expected an area that 32-bit floats hold, found",
        ),
        (quad("1e-6", point), "more than 32-bit floats hold"),
    ] {
        let work = Work::new(&scene);
        let run = lvox(
            &work,
            &[&RENDER[..], &FEW, &["--resolution", "8x8"], &QUIET].concat(),
        );
        run.refused(2, &["error: the surfel at [", part]);
        assert!(!run.stderr.contains(".lvc"), "{}", run.stderr);
    }
}

#[test]
fn what_halves_cannot_hold_is_said() {
    let work = Work::new(&ROOM.replace("[10, 9, 7]", "[1e6, 9e5, 7]"));
    let scene = work.scene();
    work.bake(&scene, 2000);
    let shade = |options: &[&str]| {
        let args = ["shade", "scene.toml", "-t", "scene.lvt", "-o", "a.exr"];
        let run = lvox(&work, &[&args[..], options, &QUIET].concat());
        run.done();
        run.stderr
    };
    let said = shade(&["--aov", "indirect,depth"]);
    assert_eq!(said.lines().count(), 1, "{said}");
    for part in [
        "warning: a.exr: ",
        " 2 channels (R, G) ",
        "65504",
        "--float",
    ] {
        assert!(said.contains(part), "{part} is not in {said}");
    }
    assert_eq!(shade(&["--float"]), "");
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_any_work() {
    let work = Work::new(ROOM);
    fs::create_dir(work.path("folder.exr")).unwrap();
    // The scene is not there either: outputs are looked at first.
    for output in ["no/such/folder/a.exr", "folder.exr"] {
        lvox(&work, &["render", "none.toml", "-o", output]).refused(2, &[output]);
        lvox(
            &work,
            &["shade", "none.toml", "-t", "none.lvt", "-o", output],
        )
        .refused(2, &[output]);
        lvox(&work, &["bake", "none.toml", "-o", output]).refused(2, &[output]);
        lvox(&work, &["build", "none.lvc", "-o", output]).refused(2, &[output]);
        let keep = ["render", "none.toml", "-o", "a.exr", "--keep-tree", output];
        lvox(&work, &keep).refused(2, &[output]);
    }
    assert_eq!(work.names(), ["folder.exr", "scene.toml", "smoke.raw"]);
}

#[test]
fn the_tree_of_another_scene_is_used_with_a_warning() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 2000);
    let shade = |text: &str, tree: &str| {
        fs::write(work.path("other.toml"), text).unwrap();
        let shade = ["shade", "other.toml", "-t", tree, "-o", "a.exr"];
        let run = lvox(&work, &[&shade[..], &QUIET].concat());
        run.done();
        run.stderr
    };
    let changed = |from: &str, to: &str| {
        assert!(ROOM.contains(from));
        ROOM.replace(from, to)
    };
    // What a bake does not read.
    for (from, to) in [
        ("position = [0, 1, 3.9]", "position = [0, 1.1, 3.8]"),
        ("width = 64", "width = 32"),
        ("name = \"room\"", "name = \"hall\" # or chamber"),
    ] {
        assert_eq!(shade(&changed(from, to), "scene.lvt"), "", "{to}");
    }
    for (from, to, parts) in [
        ("[0.6, 0.05, 0.05]", "[0.05, 0.6, 0.05]", "materials"),
        ("emission = [10, 9, 7]", "emission = [1, 9, 7]", "lights"),
        (
            "translate = [0.4, 0.4, -0.3]",
            "translate = [0.4, 0.4, -0.4]",
            "surfaces",
        ),
        ("sigma_t_scale = 6", "sigma_t_scale = 5", "volumes"),
        (
            "[[volume]]",
            "[[light]]\ntype = \"environment\"\nradiance = [1, 1, 1]\n\
             [[mesh]]\nfile = \"builtin:cube\"\ntranslate = [0, 5, 0]\n[[volume]]",
            "surfaces, materials and lights",
        ),
    ] {
        let said = shade(&changed(from, to), "scene.lvt");
        let expected = format!("warning: scene.lvt: baked from a scene of other {parts};");
        assert!(said.starts_with(&expected), "{said}");
        assert_eq!(said.matches("baked from").count(), 1);
    }
    // Surfels that a camera chose are those of its place.
    let bake = [
        "bake",
        "scene.toml",
        "-o",
        "c.lvc",
        "--surfels-from-camera",
        "--camera-rate",
        "0.5",
    ];
    lvox(&work, &[&bake[..], &["--progress", "none"]].concat()).done();
    lvox(
        &work,
        &["build", "c.lvc", "-o", "c.lvt", "--progress", "none"],
    )
    .done();
    let moved = changed(
        "position = [0, 1, 3.9]\ntarget = [0, 1, 0]",
        "position = [0, 1, 3.8]\ntarget = [0, 1, 0]",
    );
    let said = shade(&moved, "c.lvt");
    assert!(said.contains("a scene of other camera;"), "{said}");
    let said = shade(&changed("width = 64", "width = 32"), "c.lvt");
    assert!(!said.contains("baked from"), "{said}");
}

#[test]
fn tiles_of_processes_are_the_frame_of_one() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 2000);
    let shade = |name: &str, options: &[&str]| {
        let args = ["shade", "scene.toml", "-t", "scene.lvt", "-o", name];
        lvox(&work, &[&args[..], options, &QUIET].concat()).done();
    };
    shade("whole.exr", &["--aov", "depth,normal", "--float"]);
    let mut merge = vec!["merge", "-o", "merged.exr", "--progress", "none"];
    let names: Vec<String> = (0..7).map(|i| format!("{i}.exr")).collect();
    for (i, name) in names.iter().enumerate() {
        let tile = format!("{i}/7");
        let threads = if i % 2 == 0 { "1" } else { "2" };
        let mut options = vec![
            "--aov",
            "depth,normal",
            "--float",
            "--tile",
            &tile,
            "--threads",
            threads,
        ];
        // The first camera is the same by name.
        if i % 3 == 0 {
            options.extend(["--camera", "front"]);
        }
        shade(name, &options);
        merge.push(name);
    }
    lvox(&work, &merge).done();
    let read = |name: &str| fs::read(work.path(name)).unwrap();
    assert!(read("merged.exr") == read("whole.exr"));

    let other = ["--aov", "depth,normal", "--float", "--tile", "2/7"];
    shade("2.exr", &[&other[..], &["--camera", "corner"]].concat());
    lvox(&work, &merge).refused(2, &["2.exr", "camera"]);
}

#[cfg(unix)]
mod signals {
    use super::*;

    /// Starts a verb, waits for a stage to begin, and asks it to stop.
    fn stop(work: &Work, args: &[&str], stage: &str) {
        let mut command = program::command(work.0.path(), args);
        let run = program::stopped_at(&mut command, |l| l.starts_with(stage));
        let last = run.stderr.lines().last().unwrap_or_default();
        assert_eq!(
            (run.code, last),
            (1, "error: stopped on request"),
            "{stage}"
        );
    }

    /// Starts a render that takes long, waits for a stage to begin, asks it to stop, and looks at
    /// what it leaves.
    fn stopped_in(stage: &str, options: &[&str]) {
        let work = Work::new(ROOM);
        fs::create_dir(work.path("temporary")).unwrap();
        let more = [
            "--report",
            "out.json",
            "--temp-dir",
            "temporary",
            "--progress",
            "plain",
        ];
        let args = [&RENDER[..], &more, options].concat();
        stop(&work, &args, stage);
        let left: &[&str] = match stage {
            "surfels" => &["out.json", "scene.toml", "smoke.raw", "temporary"],
            // Both are whole: the tree was asked for and was done.
            _ => &[
                "out.json",
                "out.lvt",
                "scene.toml",
                "smoke.raw",
                "temporary",
            ],
        };
        assert_eq!(work.names(), left, "{stage}");
        assert_eq!(fs::read_dir(work.path("temporary")).unwrap().count(), 0);
        let report: serde_json::Value =
            serde_json::from_slice(&fs::read(work.path("out.json")).unwrap()).unwrap();
        assert_eq!(report["error"], "stopped on request");
    }

    /// A cloud so dense that its lvoxels have 192 samples a side: each block looks out of it along
    /// dozens of rays.
    #[test]
    fn a_signal_stops_the_bake_of_a_dense_volume() {
        const SIDE: usize = 192;
        let work = Work::new(&format!(
            r#"
            [[camera]]
            position = [0.5, 0.5, 3]
            target = [0.5, 0.5, 0.5]

            [[light]]
            type = "environment"
            radiance = [1, 1, 1]

            [[volume]]
            file = "dense.raw"
            dims = [{SIDE}, {SIDE}, {SIDE}]
            dtype = "u8"
            sigma_t_scale = 2000
            value_scale = 0.00392156862745098
            albedo = [0.9, 0.9, 0.9]
            unitcube_to_world = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
            "#
        ));
        let dense: Vec<u8> = (0..SIDE * SIDE * SIDE)
            .map(|i| (64 + i * 7 % 191) as u8)
            .collect();
        fs::write(work.path("dense.raw"), dense).unwrap();
        let args = ["bake", "scene.toml", "-o", "out.lvc", "--progress", "plain"];
        let args = [&args[..], &["--bake-shadow-rays", "16"]].concat();
        stop(&work, &args, "lvoxels");
        assert_eq!(work.names(), ["dense.raw", "scene.toml", "smoke.raw"]);
    }

    #[test]
    fn a_signal_stops_every_stage_and_leaves_nothing_half_written() {
        stopped_in("surfels", &["--surfels", "100000000"]);
        let few = ["--surfels", "20000"];
        stopped_in(
            "gather",
            &[&few[..], &["--samples", "65536", "--lattice", "1"]].concat(),
        );
        stopped_in("shade", &[&few[..], &["--pixel-samples", "65536"]].concat());
    }
}
