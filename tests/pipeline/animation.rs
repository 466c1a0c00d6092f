//! Ranges of frames: each is what it is by itself, what does not change is made once, and a run
//! that goes on makes what is missing or of another origin.

use crate::Work;
use crate::messages::lvox;
use std::fs;

/// A block on a floor, seen by a camera that moves.
const FLIGHT: &str = r#"
[film]
width = 24
height = 16

[[camera]]
name = "flight"
fov_x_deg = 40

[[camera.key]]
frame = 1
position = [0, 1, 4]
target = [0, 0.5, 0]

[[camera.key]]
frame = 5
position = [2, 1, 3]
target = [0, 0.5, 0]
fov_x_deg = 60

[[mesh]]
file = "builtin:quad"
scale = 4

[[mesh]]
file = "builtin:cube"
translate = [0, 0.5, 0]
albedo = [0.8, 0.2, 0.1]

[[light]]
type = "point"
position = [1, 3, 2]
intensity = [5, 5, 5]
"#;

/// The same in smoke that moves, too; needs `smoke.0001.raw` and so on.
const SMOKE: &str = r#"
[[volume]]
file = "smoke.####.raw"
dims = [4, 4, 4]
dtype = "f32"
sigma_t_scale = 3
albedo = [0.8, 0.8, 0.8]
unitcube_to_world = [[1, 0, 0, -0.5], [0, 1, 0, 0.5], [0, 0, 1, 0.5], [0, 0, 0, 1]]
"#;

/// A folder with a scene of moving smoke, for frames 1 to 3.
pub fn smoke() -> Work {
    let work = Work::new(&(FLIGHT.to_owned() + SMOKE));
    for frame in 1..=3 {
        let voxels = (0..64).map(|i| (i % (3 + frame)) as f32);
        let bytes: Vec<u8> = voxels.flat_map(f32::to_le_bytes).collect();
        fs::write(work.path(&format!("smoke.{frame:04}.raw")), bytes).unwrap();
    }
    work
}

/// A line of arguments; quick and quiet.
pub fn args(line: &str) -> Vec<&str> {
    let mut words: Vec<&str> = line.split_whitespace().collect();
    words.extend(["--progress", "none"]);
    words
}

#[track_caller]
pub fn done(work: &Work, line: &str) {
    lvox(work, &args(line)).done();
}

/// How often each of these stages ran, by the report.
fn stages(work: &Work, names: &[&str]) -> Vec<usize> {
    let text = fs::read_to_string(work.path("report.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&text).unwrap();
    let stages = report["stages"].as_array().unwrap();
    let count = |name: &&str| stages.iter().filter(|s| s["stage"] == **name).count();
    names.iter().map(count).collect()
}

pub fn read(work: &Work, name: &str) -> Vec<u8> {
    fs::read(work.path(name)).unwrap()
}

const MADE: [&str; 5] = ["load", "bake", "build", "bounce", "shade"];

#[test]
fn frames_of_a_range_are_those_of_single_runs() {
    let work = smoke();
    let render = "render scene.toml --surfels 500 --quality draft --frames";
    done(
        &work,
        &format!("{render} 1-3x2 -o range.####.exr --report report.json"),
    );
    assert_eq!(stages(&work, &MADE), [2; 5]);
    for frame in [1, 3] {
        done(&work, &format!("{render} {frame} -o one.$F.exr"));
        let one = read(&work, &format!("one.{frame}.exr"));
        assert!(
            one == read(&work, &format!("range.000{frame}.exr")),
            "frame {frame}"
        );
    }
    assert_ne!(read(&work, "one.1.exr"), read(&work, "one.3.exr"));
    assert!(!work.path("range.0002.exr").exists());
}

#[test]
fn what_does_not_change_is_made_once() {
    let work = Work::new(FLIGHT);
    let render = "render scene.toml --surfels 500 --quality draft --frames";
    done(
        &work,
        &format!("{render} 1-5 -o a.%d.exr --keep-tree scene.lvt --report report.json"),
    );
    assert_eq!(stages(&work, &MADE), [1, 1, 1, 1, 5]);
    // The tree of all frames, and a packed scene with all places of its camera.
    done(&work, "pack scene.toml -t scene.lvt -o scene.lvp");
    let shade = "--quality draft --frames 2-5 --report report.json";
    done(
        &work,
        &format!("shade scene.toml -t scene.lvt -o b.%d.exr {shade}"),
    );
    assert_eq!(stages(&work, &MADE), [1, 0, 0, 0, 4]);
    done(&work, &format!("shade scene.lvp -o c.%d.exr {shade}"));
    for frame in 2..=5 {
        let [a, b, c] = ["a", "b", "c"].map(|name| read(&work, &format!("{name}.{frame}.exr")));
        assert!(a == b && a == c, "frame {frame}");
    }
    // The gathers of another frame are not those of this one.
    let kept = "--quality draft --gather-cache gathers --frames";
    done(
        &work,
        &format!("shade scene.toml -t scene.lvt -o e.%d.exr {kept} 5"),
    );
    assert!(read(&work, "a.5.exr") == read(&work, "e.5.exr"));
    let other = format!("shade scene.toml -t scene.lvt -o e.%d.exr {kept} 4");
    lvox(&work, &args(&other)).refused(2, &["gathers"]);
    // Within a memory limit each frame opens the tree anew.
    done(
        &work,
        &format!("shade scene.toml -t scene.lvt -o d.%d.exr {shade} --memory-limit 256M"),
    );
    assert!(read(&work, "a.5.exr") == read(&work, "d.5.exr"));
}

#[test]
fn cameras_move_from_key_to_key() {
    let work = Work::new(FLIGHT);
    let reference = "reference scene.toml --max-depth 2 --spp 1 --frames 1-6 -o key.$F.exr";
    done(&work, reference);
    // Behind the last key the camera stays; without frames it is at the first.
    assert_ne!(read(&work, "key.4.exr"), read(&work, "key.5.exr"));
    let head = &FLIGHT[..FLIGHT.find("fov_x_deg").unwrap()];
    let rest = &FLIGHT[FLIGHT.find("[[mesh]]").unwrap()..];
    let [middle, first] = [
        "fov_x_deg = 50\nposition = [1, 1, 3.5]\ntarget = [0, 0.5, 0]\n",
        "fov_x_deg = 40\nposition = [0, 1, 4]\ntarget = [0, 0.5, 0]\n",
    ]
    .map(|place| format!("{head}{place}{rest}"));
    let picture = |name: &str| {
        let frame = lvox::image::exr::read(&work.path(name)).unwrap();
        frame.layers[0].channels.clone()
    };
    for (text, name, frame) in [(middle, "middle", 3), (first, "first", 1)] {
        fs::write(work.path(&format!("{name}.toml")), text).unwrap();
        done(
            &work,
            &format!("reference {name}.toml --max-depth 2 --spp 1 -o {name}.exr"),
        );
        assert_eq!(
            picture(&format!("{name}.exr")),
            picture(&format!("key.{frame}.exr"))
        );
    }
}

#[test]
fn a_range_goes_on_where_it_was_left() {
    let work = Work::new(FLIGHT);
    let render = "render scene.toml --surfels 500 --quality draft --frames 1-3 -o a.####.exr \
                  --resume --report report.json";
    done(&work, render);
    let whole = read(&work, "a.0002.exr");
    done(&work, render);
    assert_eq!(stages(&work, &MADE), [1, 0, 0, 0, 0]);
    fs::remove_file(work.path("a.0002.exr")).unwrap();
    done(&work, render);
    assert_eq!(stages(&work, &MADE), [1, 1, 1, 1, 1]);
    assert!(read(&work, "a.0002.exr") == whole);
    // Of other settings, all are made again.
    done(&work, &(render.to_owned() + " --samples 20"));
    assert_eq!(stages(&work, &MADE), [1, 1, 1, 1, 3]);
    // A file that is no image of this scene is one of another.
    fs::write(work.path("a.0002.exr"), b"not an image").unwrap();
    done(&work, &(render.to_owned() + " --samples 20"));
    assert_eq!(stages(&work, &MADE)[4], 1);
    // With another camera the tree stays.
    let keep = render.to_owned() + " --keep-tree scene.lvt";
    done(&work, &keep);
    let moved = FLIGHT.replace("position = [2, 1, 3]", "position = [2, 1, 2]");
    fs::write(work.path("scene.toml"), moved).unwrap();
    done(&work, &keep);
    assert_eq!(stages(&work, &MADE), [1, 0, 0, 0, 3]);
    // With another light it does not.
    let lit = FLIGHT.replace("intensity = [5, 5, 5]", "intensity = [6, 5, 5]");
    fs::write(work.path("scene.toml"), lit).unwrap();
    done(&work, &keep);
    assert_eq!(stages(&work, &MADE), [1, 1, 1, 1, 3]);
}

#[test]
fn stages_leave_what_is_made() {
    let work = smoke();
    let lines = [
        (
            "bake",
            "bake scene.toml --part 0/2 --surfels 500 -o part.0.lvc",
        ),
        (
            "bake",
            "bake scene.toml --part 1/2 --surfels 500 -o part.1.lvc",
        ),
        ("build", "build part.1.lvc part.0.lvc -o built.lvt"),
        ("bounce", "bounce scene.toml -t built.lvt -o scene.lvt"),
        ("scatter", "scatter scene.toml -t scene.lvt -o scene.lvs"),
        (
            "pack",
            "pack scene.toml -t scene.lvt --scatter scene.lvs -o scene.lvp",
        ),
        ("shade", "shade scene.lvp --quality draft -o scene.exr"),
    ];
    let run = |line: &str, stage: &str| {
        done(&work, &format!("{line} --frames 2 --report report.json"));
        stages(&work, &[stage])[0]
    };
    for (stage, line) in lines {
        assert_eq!(run(line, stage), 1, "{line}");
    }
    let again = |(stage, line): (&str, &str)| run(&format!("{line} --resume"), stage);
    assert_eq!(lines.map(again), [0; 7]);
    // What is there is not replaced for nothing, and never a file of another kind.
    for (_, line) in &lines[..6] {
        let run = lvox(&work, &args(&format!("{line} --frames 2")));
        run.refused(2, &["--force"]);
    }
    let output = lvox(
        &work,
        &args("bake scene.toml --frames 2 -o scene.lvt --resume"),
    );
    output.refused(2, &["scene.lvt", "--force"]);
    // Of another frame, whose smoke is another, all of it is made again; the packed scene is found
    // to be that of another frame by itself.
    let next = |(stage, line): (&str, &str)| {
        done(
            &work,
            &format!("{line} --resume --frames 3 --report report.json"),
        );
        stages(&work, &[stage])[0]
    };
    assert_eq!(lines.map(next), [1; 7]);
}

#[test]
fn frames_that_cannot_be_are_told_before_the_work() {
    let work = smoke();
    let before = work.names();
    for (line, parts) in [
        ("render scene.toml -o a.exr", &["####", "--frames"][..]),
        (
            "render scene.toml -o a.####.exr",
            &["#### in a.####.exr", "--frames"],
        ),
        (
            "render scene.toml -o a.exr --frames 1-2",
            &["frames 1 and 2", "same file"],
        ),
        (
            "render scene.toml -o a.$F.exr --frames 4",
            &["frame 4", "smoke.0004.raw"],
        ),
    ] {
        lvox(&work, &args(line)).refused(2, parts);
        assert_eq!(work.names(), before, "{line}");
    }
    for range in ["3-1", "a", "1-", "1-4x0"] {
        let line = format!("render scene.toml -o a.$F.exr --frames {range}");
        let run = lvox(&work, &args(&line));
        assert_eq!(run.code, 2);
        assert!(run.stderr.contains("expected frames"), "{}", run.stderr);
    }
    done(&work, "pack scene.toml --frames 2 -o scene.lvp");
    let run = lvox(&work, &args("bake scene.lvp --frames 3 -o a.lvc"));
    run.refused(2, &["frame 2", "found frame 3"]);
    for (from, to, parts) in [
        ("frame = 5", "frame = 1", &["two keys", "frame 1"][..]),
        (
            "frame = 5",
            "frame = 1.5",
            &["the number of a frame", "1.5"],
        ),
        (
            "position = [2, 1, 3]",
            "position = [0, 0.5, 0]",
            &["its own target"],
        ),
        ("frame = 5\n", "", &["`frame` is missing"]),
        (
            "fov_x_deg = 40\n",
            "position = [0, 0, 0]\n",
            &["`key` and `position`"],
        ),
    ] {
        let text = FLIGHT.replacen(from, to, 1);
        assert_ne!(text, FLIGHT);
        fs::write(work.path("scene.toml"), text).unwrap();
        lvox(&work, &args("bake scene.toml -o a.lvc")).refused(2, parts);
    }
}
