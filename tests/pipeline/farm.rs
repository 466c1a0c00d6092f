//! Jobs for farms: what is printed runs as it is, and leads to the images of one process.

use crate::Work;
use crate::animation::{args, done, read, smoke};
use crate::messages::lvox;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

const JOB: &str = "scene.toml --frames 1-3x2 --resolution 12x8 --seed 3 --task-progress none \
                   --task-threads 1";
const BAKE: &str = "--surfels 500";
const SHADE: &str = "--quality draft --aov depth";

/// Prints a job.
fn printed(work: &Work, form: &str, more: &[&str]) -> String {
    let line = format!("farm {form} {JOB}");
    let mut words = args(&line);
    words.extend(["--bake", BAKE, "--shade", SHADE]);
    words.extend(more);
    let run = lvox(work, &words);
    assert_eq!(run.code, 0, "{}", run.stderr);
    run.stdout
}

/// Runs a script in the folder, with programs of its own before those of the system.
fn sh(work: &Work, script: &str) -> Output {
    let paths = std::env::var("PATH").unwrap();
    let own = work.path("bin");
    Command::new("bash")
        .args(["-c", script])
        .current_dir(work.path(""))
        .env("PATH", format!("{}:{paths}", own.display()))
        .output()
        .unwrap()
}

#[track_caller]
fn run(work: &Work, script: &str) -> String {
    let output = sh(work, script);
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{script}\n{told}");
    String::from_utf8(output.stdout).unwrap()
}

/// Puts a program into the folder `bin`.
fn program(work: &Work, name: &str, text: &str) {
    fs::create_dir_all(work.path("bin")).unwrap();
    let path = work.path(&format!("bin/{name}"));
    fs::write(&path, text).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
}

/// `lvox` in the folder `bin`.
fn with_lvox(work: &Work) {
    let lvox = env!("CARGO_BIN_EXE_lvox");
    program(work, "lvox", &format!("#!/bin/sh\nexec '{lvox}' \"$@\"\n"));
}

/// The image of a frame as one process makes it from what the job has packed.
fn whole(work: &Work, frame: i32) -> Vec<u8> {
    let line =
        format!("shade farm/scene/scene.####.lvp --seed 3 {SHADE} --frames {frame} -o whole.exr");
    done(work, &line);
    read(work, "whole.exr")
}

#[test]
fn commands_lead_to_the_images() {
    let work = smoke();
    with_lvox(&work);
    let job = ["-o", "a.####.exr", "--tiles", "3", "--parts", "2"];
    let text = printed(&work, "commands", &job);
    // Two frames, two parts of a bake, three tiles.
    assert_eq!(text.lines().count(), 2 * 2 + 2 + 2 + 2 * 3 + 2);
    for line in text.lines() {
        run(&work, line);
    }
    for frame in [1, 3] {
        assert!(read(&work, &format!("a.000{frame}.exr")) == whole(&work, frame));
    }
    // All of it again takes nothing but what is missing.
    fs::remove_file(work.path("farm/scene/tile.0003.1.exr")).unwrap();
    let told = sh(&work, &text.replace("--progress none", "--progress plain"));
    let told = String::from_utf8(told.stderr).unwrap();
    let shaded = |line: &&str| line.starts_with("shade: ") && line.contains(" pixels in ");
    assert_eq!(told.lines().filter(shaded).count(), 1, "{told}");
    // The steps one by one are the same lines.
    let steps = ["bake", "tree", "cut", "tile", "merge"];
    let of_step = |step: &&str| printed(&work, "commands", &[&job[..], &["--step", step]].concat());
    assert_eq!(steps.iter().map(of_step).collect::<String>(), text);
}

/// One scene file a frame, as exports of animations are, with smoke in some of them alone.
#[test]
fn each_frame_may_have_a_scene_of_its_own() {
    let work = smoke();
    with_lvox(&work);
    let scene = fs::read_to_string(work.path("scene.toml")).unwrap();
    let without = &scene[..scene.find("[[volume]]").unwrap()];
    for (frame, text) in [(1, without), (2, &scene), (3, without)] {
        let name = format!("s e.{frame:04}.toml");
        fs::write(work.path(&name), text).unwrap();
    }
    let printed = |more: &[&str]| {
        let line = "--frames 1-3 --resolution 12x8 -o p.####.exr --set light.0.intensity=[5,5,$F]";
        let words = [
            &["farm", "commands", "s e.####.toml"],
            &args(line)[..],
            more,
        ]
        .concat();
        let found = lvox(&work, &words);
        assert_eq!(found.code, 0, "{}", found.stderr);
        found.stdout
    };
    let text = printed(&["--bake", BAKE, "--shade", SHADE]);
    assert_eq!(text.lines().count(), 3 * 3, "{text}");
    fs::write(work.path("job.sh"), &text).unwrap();
    run(&work, "sh -e job.sh");
    for frame in 1..=3 {
        assert!(work.path(&format!("p.000{frame}.exr")).exists(), "{frame}");
        let light = format!("farm/s e/light.000{frame}.lvs");
        let verified = lvox(&work, &["verify", &light, "--progress", "none"]);
        assert_eq!(verified.code, 0, "{}", verified.stderr);
    }
    let words = [
        &["farm", "files", "s e.####.toml"],
        &args("--frames 1-2")[..],
    ]
    .concat();
    let files = lvox(&work, &words);
    let files: Vec<&str> = files.stdout.lines().collect();
    assert_eq!(files, ["s e.0001.toml", "s e.0002.toml", "smoke.0002.raw"]);
    let words = [&["farm", "files", "s e.####.toml"], &args("")[..]].concat();
    lvox(&work, &words).refused(2, &["####", "--frames"]);
}

#[test]
fn smoke_may_rise_after_the_first_frame_and_be_gone_again() {
    let work = smoke();
    with_lvox(&work);
    let scene = fs::read_to_string(work.path("scene.toml")).unwrap();
    let flame = "emission = { scale = 0.1, color = [1, 0.4, 0.1] }\n";
    fs::write(work.path("scene.toml"), scene + flame).unwrap();
    for frame in [1, 3] {
        fs::write(work.path(&format!("smoke.000{frame}.raw")), [0; 4 * 64]).unwrap();
    }
    let line = "farm commands scene.toml --frames 1-3 --resolution 12x8 -o r.####.exr";
    let words = [&args(line)[..], &["--bake", BAKE, "--shade", SHADE]].concat();
    let printed = lvox(&work, &words);
    assert_eq!(printed.code, 0, "{}", printed.stderr);
    fs::write(work.path("job.sh"), &printed.stdout).unwrap();
    run(&work, "sh -e job.sh");
    let bytes =
        [1, 2, 3].map(|frame| read(&work, &format!("farm/scene/light.000{frame}.lvs")).len());
    assert!(bytes[1] > bytes[0] && bytes[1] > bytes[2], "{bytes:?}");
    // An empty file of light is that of a frame, which is there already, and is described.
    run(&work, "sh -e job.sh");
    let told = lvox(&work, &["inspect", "farm/scene/light.0001.lvs"]);
    assert!(told.stdout.contains("0 clusters"), "{}", told.stdout);
}

#[test]
fn folders_of_images_are_made_and_strict_jobs_have_strict_tasks() {
    let work = smoke();
    with_lvox(&work);
    let more = ["-o", "out a/{camera}/s.####.exr", "--cameras", "flight"];
    let text = printed(&work, "commands", &[&more[..], &["--strict"]].concat());
    let is_strict = |line: &str| line.matches("lvox ").count() == line.matches(" --strict").count();
    assert!(text.lines().all(is_strict), "{text}");
    let text = printed(&work, "commands", &more);
    assert!(!text.contains("--strict"), "{text}");
    fs::write(work.path("job.sh"), &text).unwrap();
    run(&work, "sh -e job.sh");
    assert!(work.path("out a/flight/s.0003.exr").exists());
}

#[test]
fn two_jobs_beside_each_other_make_pictures_of_their_own() {
    let work = smoke();
    with_lvox(&work);
    let scene = fs::read_to_string(work.path("scene.toml")).unwrap();
    let other = scene.replace("[5, 5, 5]", "[50, 5, 5]");
    assert_ne!(other, scene);
    fs::write(work.path("other.toml"), other).unwrap();
    let run_job = |line: &str| {
        let line = format!("farm commands {line} --frames 1 --resolution 12x8");
        let mut words = args(&line);
        words.extend(["--bake", BAKE, "--shade", SHADE]);
        let printed = lvox(&work, &words);
        assert_eq!(printed.code, 0, "{}", printed.stderr);
        run(&work, &printed.stdout);
    };
    let scenes = ["scene", "other"];
    for step in ["bake", "tree", "frame"] {
        for scene in scenes {
            run_job(&format!("{scene}.toml -o {scene}.####.exr --step {step}"));
        }
    }
    let of_both = scenes.map(|scene| {
        run_job(&format!("{scene}.toml -o whole.####.exr --folder {scene}"));
        let found = read(&work, &format!("{scene}.0001.exr"));
        assert!(found == read(&work, "whole.0001.exr"), "{scene}");
        found
    });
    assert!(of_both[0] != of_both[1]);

    // In one folder they are in each other's way, which is told.
    run_job("other.toml -o x.####.exr --folder one --step bake");
    let line = "farm commands scene.toml --frames 1 -o x.####.exr --folder one --step tree";
    let printed = lvox(&work, &args(line)).stdout;
    let refused = sh(&work, &printed);
    assert_eq!(refused.status.code(), Some(2), "{printed}");
    let told = String::from_utf8(refused.stderr).unwrap();
    assert!(told.contains("of other lights"), "{told}");
    assert!(told.contains("a folder of its own"), "{told}");
}

#[test]
fn every_task_may_run_beside_itself() {
    let work = smoke();
    with_lvox(&work);
    let text = printed(&work, "commands", &["-o", "g.####.exr", "--parts", "2"]);
    for line in text.lines() {
        let both = format!("{line} & one=$!; {line} & two=$!; wait $one && wait $two");
        run(&work, &both);
    }
    for frame in [1, 3] {
        assert!(read(&work, &format!("g.000{frame}.exr")) == whole(&work, frame));
    }
}

/// Fails at a verb as if its process was killed.
const FLAKY: &str = r#"#!/bin/sh
[ "$1" = "$FAILS" ] && exit 137
exec LVOX "$@"
"#;

#[test]
fn a_shell_stops_where_a_command_fails() {
    let work = smoke();
    let lvox = env!("CARGO_BIN_EXE_lvox");
    program(&work, "lvox", &FLAKY.replace("LVOX", &format!("'{lvox}'")));
    let text = printed(&work, "commands", &["-o", "f.####.exr"]);
    fs::write(work.path("job.sh"), &text).unwrap();
    run(&work, "sh -e job.sh");
    let made = read(&work, "f.0001.exr");
    // What was made of another scene is not taken where what replaces it cannot be made.
    let scene = fs::read_to_string(work.path("scene.toml")).unwrap();
    fs::write(
        work.path("scene.toml"),
        scene.replace("[5, 5, 5]", "[50, 5, 5]"),
    )
    .unwrap();
    for verb in ["bake", "build", "bounce", "scatter", "pack", "shade"] {
        let output = sh(&work, &format!("FAILS={verb} sh -e job.sh"));
        assert_eq!(output.status.code(), Some(137), "{verb}");
        assert!(read(&work, "f.0001.exr") == made, "{verb}");
    }
}

/// Runs the tasks of an array one after the other, and notes how it was called.
const SBATCH: &str = r#"#!/bin/bash
echo "$*" >>calls
options=()
while [ "${1#--}" != "$1" ]; do
    case $1 in --array=*) range=${1#--array=} ;; esac
    shift
done
for i in $(seq "${range%-*}" "${range#*-}"); do SLURM_ARRAY_TASK_ID=$i bash "$@" >&2 || exit 1; done
wc -l <calls
"#;

#[test]
fn slurm_gets_arrays_that_wait_for_each_other() {
    let work = smoke();
    with_lvox(&work);
    program(&work, "sbatch", SBATCH);
    // Arrays of two tasks.
    program(&work, "scontrol", "#!/bin/sh\necho 'MaxArraySize = 3'\n");
    let more = [
        "-o",
        "b.####.exr",
        "--tiles",
        "3",
        "--sbatch",
        "--partition='a b'",
        "--task-memory",
        "1G",
        "--parts",
        "2",
    ];
    fs::write(work.path("submit.sh"), printed(&work, "slurm", &more)).unwrap();
    run(&work, "bash submit.sh");
    for frame in [1, 3] {
        assert!(read(&work, &format!("b.000{frame}.exr")) == whole(&work, frame));
    }
    let calls = fs::read_to_string(work.path("calls")).unwrap();
    let calls: Vec<&str> = calls.lines().collect();
    // Of each frame: bake, tree, cut, two arrays of tiles, merge after both.
    assert_eq!(calls.len(), 12, "{calls:#?}");
    assert!(!calls[0].contains("--dependency"), "{}", calls[0]);
    assert!(calls[1].contains("--dependency=afterok:1 "), "{}", calls[1]);
    assert!(calls[3].contains("--array=0-1") && calls[4].contains("--array=0-0"));
    assert!(
        calls[5].contains("--dependency=afterok:4:5 "),
        "{}",
        calls[5]
    );
    let all = [
        "--requeue",
        "--partition=a b",
        "--cpus-per-task=1",
        "--mem=1127M",
    ];
    assert!(
        calls
            .iter()
            .all(|call| all.iter().all(|word| call.contains(word)))
    );

    // With one task a frame, each waits for that of its own frame alone.
    fs::remove_file(work.path("calls")).unwrap();
    let text = printed(
        &work,
        "slurm",
        &["-o", "c.####.exr", "--parts", "1", "--folder", "f d"],
    );
    fs::write(work.path("submit.sh"), text).unwrap();
    run(&work, "bash submit.sh");
    let calls = fs::read_to_string(work.path("calls")).unwrap();
    assert_eq!(
        calls.matches("--dependency=aftercorr:").count(),
        2,
        "{calls}"
    );
    assert!(work.path("c.0003.exr").exists());

    fs::remove_file(work.path("bin/sbatch")).unwrap();
    let before = work.names();
    let output = sh(&work, "bash=$(command -v bash); PATH=bin $bash submit.sh");
    assert_eq!(output.status.code(), Some(2));
    let told = String::from_utf8(output.stderr).unwrap();
    assert_eq!(told.lines().count(), 1, "{told}");
    assert!(told.contains("sbatch"), "{told}");
    assert_eq!(work.names(), before);
}

#[test]
fn templates_have_every_step() {
    let work = smoke();
    let more = [
        "-o",
        "d.{camera}.####.exr",
        "--cameras",
        "flight",
        "--chunk",
        "4",
        "--parts",
        "2",
    ];
    let text = printed(&work, "openjd", &more);
    let template: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(template["extensions"][0], "TASK_CHUNKING");
    let steps = template["steps"].as_array().unwrap();
    let names: Vec<&str> = steps.iter().map(|s| s["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["Bake", "Tree", "Frame"]);
    let parameters = |i: usize| steps[i]["parameterSpace"]["taskParameterDefinitions"].clone();
    assert_eq!(parameters(0)[1]["range"], "0-1");
    assert_eq!(parameters(2)[0]["type"], "CHUNK[INT]");
    assert_eq!(parameters(2)[1]["range"][0], "flight");
    assert_eq!(steps[2]["dependencies"][0]["dependsOn"], "Tree");
    let script = steps[2]["script"]["embeddedFiles"][0]["data"]
        .as_str()
        .unwrap();
    for part in [
        "--frames={{Task.Param.Frame}}",
        "d.{{Task.Param.Camera}}.####.exr",
    ] {
        assert!(script.contains(part), "{part} in {script}");
    }
    assert!(!script.contains("{{Param"), "{script}");
    let frames = template["parameterDefinitions"][2]["default"].as_str();
    assert_eq!(frames, Some("1,3"));
}

/// What a template runs, as its runner does it: the script, and the parameters as words of their
/// own.
#[test]
fn templates_run_in_folders_of_any_name() {
    let work = smoke();
    let folder = work.path("Bob's \"shot\" $HOME");
    fs::create_dir(&folder).unwrap();
    for name in ["scene.toml", "smoke.0001.raw", "smoke.0003.raw"] {
        fs::copy(work.path(name), folder.join(name)).unwrap();
    }
    program(&work, "it's lvox", "#!/bin/sh\nexec lvox \"$@\"\n");
    with_lvox(&work);
    let own = work.path("bin/it's lvox");
    let more = ["-o", "o.####.exr", "--program", own.to_str().unwrap()];
    let text = printed(&work, "openjd", &more);
    let template: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(template["parameterDefinitions"][0]["default"], more[3]);
    let paths = std::env::var("PATH").unwrap();
    for step in template["steps"].as_array().unwrap() {
        let script = step["script"]["embeddedFiles"][0]["data"].as_str().unwrap();
        let script = script.replace("{{Task.Param.Frame}}", "3");
        fs::write(work.path("run"), script).unwrap();
        let action = &step["script"]["actions"]["onRun"];
        let words = action["args"].as_array().unwrap().iter();
        let words = words.map(|word| match word.as_str().unwrap() {
            "{{Task.File.Run}}" => "run",
            "{{Param.Folder}}" => folder.to_str().unwrap(),
            "{{Param.Lvox}}" => more[3],
            other => panic!("{other}"),
        });
        let output = Command::new(action["command"].as_str().unwrap())
            .args(words)
            .current_dir(work.path(""))
            .env("PATH", format!("{}:{paths}", work.path("bin").display()))
            .output()
            .unwrap();
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{told}");
    }
    assert!(folder.join("o.0003.exr").exists());
}

#[test]
fn all_files_of_the_scene_are_listed() {
    let work = smoke();
    let run = lvox(&work, &args("farm files scene.toml --frames 1-3"));
    let files = [
        "scene.toml",
        "smoke.0001.raw",
        "smoke.0002.raw",
        "smoke.0003.raw",
    ];
    assert_eq!(run.stdout.lines().collect::<Vec<_>>(), files);
}

#[test]
fn jobs_that_cannot_be_are_refused() {
    let work = smoke();
    let before = work.names();
    let refused = |line: &str, more: &[&str], parts: &[&str]| {
        let mut words = args(line);
        words.extend(more);
        lvox(&work, &words).refused(2, parts);
    };
    let job = "farm commands scene.toml --frames 1-3 -o a.####.exr";
    refused(
        job,
        &["--shade", "--qualty best"],
        &["lvox shade", "--qualty"],
    );
    refused(job, &["--bake", "--surfels many"], &["lvox bake", "many"]);
    // Of stages that this job does without, too.
    for (stage, verb) in [("--bounce", "lvox bounce"), ("--scatter", "lvox scatter")] {
        let more = ["--bounces", "1", "--no-scatter", stage, "--foo"];
        refused(job, &more, &[verb, "--foo"]);
    }
    for (stage, option, instead) in [
        ("--shade", "--group key", "--group"),
        ("--shade", "--set=film.width=3", "--set"),
        ("--shade", "--frames 3", "--frames"),
        ("--shade", "--tile 0/4", "--tiles"),
        ("--shade", "-ox.exr", "--output"),
        ("--bake", "--part 0/3", "--parts"),
        ("--bounce", "--bounces 2", "--bounces"),
        ("--scatter", "--force", "leave it out"),
    ] {
        refused(job, &[stage, option], &[stage, "itself", instead]);
    }
    refused(
        job,
        &["--step", "tile"],
        &["--step tile", "bake, tree, frame"],
    );
    refused(job, &["--cameras", "none"], &["no camera `none`", "flight"]);
    refused(job, &["--tiles", "2", "--chunk", "2"], &["--chunk"]);
    refused(job, &["--tiles", "385"], &["384 pixels", "385"]);
    for (line, parts) in [
        (
            "farm commands scene.toml --frames 1-3 -o a.exr",
            &["same file", "####"][..],
        ),
        (
            "farm slurm scene.toml --frames 1-3 -o a.####.png --tiles 2",
            &[".exr"],
        ),
        (
            "farm openjd scene.toml --frames 4 -o a.exr",
            &["smoke.0004.raw"],
        ),
        ("farm commands scene.toml -o a.exr", &["####", "--frames"]),
        ("farm files none.toml", &["none.toml"]),
    ] {
        refused(line, &[], parts);
    }
    for (typed, hint) in [
        ("--samples 64 --seed 1", "--shade \"--samples 64\""),
        ("--quality=best", "--shade \"--quality=best\""),
        ("--surfels 9", "--bake \"--surfels 9\""),
    ] {
        let line = format!("{job} {typed}");
        let told = lvox(&work, &args(&line));
        assert_eq!((told.code, told.stdout.as_str()), (2, ""), "{typed}");
        assert!(told.stderr.contains(hint), "{}", told.stderr);
    }
    let both = "bake scene.toml --frames 1 -o c.lvc --resume --force";
    refused(both, &[], &["--resume", "--force"]);
    assert_eq!(work.names(), before);
    assert!(Path::new(&work.path("")).exists());
}
