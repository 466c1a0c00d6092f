//! `lvox study` from outside: what it writes, that a stop loses nothing, and that a browser shows
//! the report.

mod browser;
#[path = "../support/mod.rs"]
mod support;

use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// A study of the demo, as small as can be.
fn command(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
    command.args([
        "study",
        "--demo",
        "--width",
        "40",
        "--quality",
        "draft",
        "-o",
    ]);
    command.arg(folder).args(args);
    for (name, value) in [
        ("--reference-spp", "16"),
        ("--spp", "1,2,4"),
        ("--surfels", "2000,8000"),
        ("--block-depth", "0.7,1.4"),
        ("--block-voxels", "8"),
        ("--samples", "8"),
        ("--max-solid-angle", "0.04"),
    ] {
        command.args([name, value]);
    }
    command
}

fn study(folder: &Path, args: &[&str]) -> Output {
    command(folder, args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn json(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("study.json")).unwrap()).unwrap()
}

/// Times of every run by its name.
fn times(study: &Value) -> BTreeMap<String, Vec<Value>> {
    let runs = study["runs"].as_array().unwrap().iter();
    runs.map(|r| {
        let name = r["name"].as_str().unwrap().to_owned();
        (name, r["rounds"].as_array().unwrap().clone())
    })
    .collect()
}

#[test]
fn everything_is_written_and_a_second_call_measures_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("study");
    let output = study(&folder, &["--rounds", "1"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(output.stdout.is_empty());
    let found = json(&folder);
    // 3 of Monte Carlo; base, a cloud, a number of samples and a solid angle of each other; 2 sizes
    // of lvoxels.
    assert_eq!(times(&found).len(), 3 + 2 * 4 + 2);
    let csv = fs::read_to_string(folder.join("study.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 13);
    let table = fs::read_to_string(folder.join("table.md")).unwrap();
    for part in [
        "monte-carlo-4",
        "traditional-base",
        "extended-base",
        "surfel-radius",
        "floor",
    ] {
        assert!(table.contains(part), "{part}: {table}");
    }
    let front = found["findings"]["pareto"].as_array().unwrap();
    assert!(front.len() >= 2, "{front:?}");
    let settings: Vec<&str> = found["findings"]["slopes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| s["setting"].as_str().unwrap())
        .collect();
    for setting in [
        "spp",
        "samples",
        "max-solid-angle",
        "surfel-radius",
        "block-depth",
    ] {
        assert!(settings.contains(&setting), "{setting}: {settings:?}");
    }
    for name in ["monte-carlo-1", "extended-base", "traditional-surfels-2000"] {
        for end in ["png", "flip.png"] {
            let image = folder.join(format!("images/{name}.{end}"));
            assert!(image.is_file(), "{}", image.display());
        }
    }

    let output = study(&folder, &["--rounds", "1"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(json(&folder), found);

    let output = study(&folder, &["--rounds", "1", "--seed", "5"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("--force"));

    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(!report.contains("src=\"http") && !report.contains("href="));
}

#[cfg(unix)]
#[test]
fn a_signal_keeps_what_is_finished_and_the_same_command_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("study");
    let args = ["--rounds", "2"];
    let mut child = command(&folder, &args)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let started = Instant::now();
    let runs = || -> usize {
        let bytes = fs::read(folder.join("study.json")).unwrap_or_default();
        let found: Value = serde_json::from_slice(&bytes).unwrap_or_default();
        found["runs"].as_array().map_or(0, Vec::len)
    };
    while runs() < 3 {
        assert!(started.elapsed() < Duration::from_secs(120));
        std::thread::sleep(Duration::from_millis(5));
    }
    let killed = Command::new("kill")
        .args(["-TERM", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(killed.success());
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(1));
    let stderr = std::io::read_to_string(child.stderr.take().unwrap()).unwrap();
    assert!(stderr.contains("the same command goes on"), "{stderr}");
    let kept = times(&json(&folder));
    assert!(kept.len() >= 3);
    // The reports hold what there is.
    let csv = fs::read_to_string(folder.join("study.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + kept.len());
    assert!(folder.join("report.html").is_file() && folder.join("pareto.svg").is_file());

    let output = study(&folder, &args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let all = times(&json(&folder));
    assert_eq!(all.len(), 13);
    assert!(all.values().all(|rounds| rounds.len() == 2));
    for (name, rounds) in &kept {
        assert_eq!(all[name][..rounds.len()], rounds[..], "{name}");
    }
    // No cloud is left beside the trees.
    let left = fs::read_dir(folder.join("trees")).unwrap();
    let names: Vec<_> = left
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    assert!(names.iter().all(|n| n.ends_with(".lvt")), "{names:?}");
}

#[test]
fn light_of_media_is_made_with_each_tree_and_studies_without_it_are_kept_apart() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("study");
    let args = ["--rounds", "1", "--scatter"];
    let output = study(&folder, &args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let found = json(&folder);
    assert_eq!(found["origin"]["light of media"], "made beforehand");
    let cloud = found["clouds"][0]["name"].as_str().unwrap();
    for kind in ["lvt", "lvs"] {
        assert!(folder.join(format!("trees/{cloud}.{kind}")).is_file());
    }
    let output = study(&folder, &args[..2]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("light of media"));
}

#[test]
fn a_reference_without_variance_is_judged_by_and_another_of_its_name_refused() {
    let dir = tempfile::tempdir().unwrap();
    let run = |line: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
        command.current_dir(&dir).args(line.split_whitespace());
        let child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn();
        let mut child = child.unwrap();
        let started = Instant::now();
        let status = loop {
            match child.try_wait().unwrap() {
                Some(status) => break status,
                None if started.elapsed() > Duration::from_secs(120) => {
                    child.kill().unwrap();
                    panic!("{line} takes for ever");
                }
                None => std::thread::sleep(Duration::from_millis(10)),
            }
        };
        let stderr = std::io::read_to_string(child.stderr.take().unwrap()).unwrap();
        (status.code(), stderr)
    };
    let reference = |seed: u32| {
        let line =
            "reference --demo --resolution 16x12 --spp 1 --max-depth 3 --force -o r.exr --seed";
        let (code, stderr) = run(&format!("{line} {seed}"));
        assert_eq!(code, Some(0), "{stderr}");
    };
    let study = "study --demo --width 16 --base-only --spp 1,2 --surfels 500 --quality draft \
                 --rounds 1 --reference r.exr -o s";
    reference(1);
    let (code, stderr) = run(study);
    assert_eq!(code, Some(0), "{stderr}");
    // The same image again is no other.
    reference(1);
    assert_eq!(run(study).0, Some(0));
    reference(2);
    let (code, stderr) = run(study);
    assert_eq!(code, Some(2));
    assert!(stderr.contains("another reference"), "{stderr}");
}

/// Runs a line of words in a folder: exit code and stderr.
fn run(dir: &Path, line: &str) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
    let output = command.current_dir(dir).args(line.split_whitespace());
    let output = output.output().unwrap();
    (output.status.code(), text(&output.stderr))
}

const TINY: &str = "study --demo --width 16 --base-only --spp 1,2 --surfels 500 --quality draft \
                    --rounds 1 --progress none -o s";

#[test]
fn a_reference_of_something_else_is_refused_and_leaves_no_folder() {
    let dir = tempfile::tempdir().unwrap();
    let reference = |more: &str| {
        let line = "reference --demo --resolution 16x12 --spp 2 --force --progress none -o r.exr";
        let (code, stderr) = run(dir.path(), &format!("{line} {more}"));
        assert_eq!(code, Some(0), "{stderr}");
    };
    let study = format!("{TINY} --reference r.exr");
    reference("");
    let (code, stderr) = run(dir.path(), &study);
    assert_eq!(code, Some(2), "{stderr}");
    for part in ["r.exr", "any length", "up to 3 segments", "--max-depth 3"] {
        assert!(stderr.contains(part), "{part}: {stderr}");
    }
    assert!(!dir.path().join("s").exists());
    // The corrected command finds nothing in its way, and has nothing to say.
    reference("--max-depth 3");
    let (code, stderr) = run(dir.path(), &study);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    reference("--max-depth 2");
    let (code, stderr) = run(dir.path(), &format!("{study} --max-depth 2 --force"));
    assert_eq!(code, Some(0), "{stderr}");
    assert!(stderr.contains("warning: point-based methods"), "{stderr}");
}

#[test]
fn a_study_grows_by_rounds_and_by_values_and_keeps_its_runs() {
    let dir = tempfile::tempdir().unwrap();
    let tiny = "study --demo --width 16 --reference-spp 4 --quality draft --surfels 500 \
                --block-depth 0.7 --block-voxels 8 --max-solid-angle 0.04 \
                --progress none -o s --threads";
    let grown = |more: &str| {
        let (code, stderr) = run(dir.path(), &format!("{tiny} {more}"));
        assert_eq!((code, stderr.as_str()), (Some(0), ""), "{more}");
        times(&json(&dir.path().join("s")))
    };
    let first = grown("1 --spp 1,4 --samples 8 --rounds 1");
    let second = grown("1 --spp 1,2,4 --samples 16 --rounds 2");
    let found = json(&dir.path().join("s"));
    let clouds = found["clouds"].as_array().unwrap();
    let rounds = |c: &Value| c["rounds"].as_array().unwrap().len();
    assert!(clouds.iter().all(|c| rounds(c) == 2), "{clouds:?}");
    for (name, rounds) in &first {
        assert_eq!(second[name][0], rounds[0], "{name}");
        // What the second call does not ask for stays as it was.
        let expected = if name.ends_with("samples-8") { 1 } else { 2 };
        assert_eq!(second[name].len(), expected, "{name}");
    }
    let added: Vec<&str> = second
        .keys()
        .filter(|name| !first.contains_key(*name))
        .map(String::as_str)
        .collect();
    let expected = [
        "extended-samples-16",
        "monte-carlo-2",
        "traditional-samples-16",
    ];
    assert_eq!(added, expected);
    let csv = fs::read_to_string(dir.path().join("s/study.csv")).unwrap();
    let at = |name: &str| csv.find(name).unwrap();
    assert!(at("monte-carlo-1") < at("monte-carlo-2") && at("monte-carlo-2") < at("monte-carlo-4"));
    let (code, stderr) = run(dir.path(), &format!("{tiny} 1 --spp 1,2 --seed 3"));
    assert_eq!(code, Some(2));
    assert!(stderr.contains("another reference"), "{stderr}");
    // Another number of threads has no runs yet, and the same base all the same.
    let other_base = tiny.replace("draft", "good");
    for threads in ["1", "2"] {
        let (code, stderr) = run(dir.path(), &format!("{other_base} {threads} --spp 1"));
        assert_eq!(code, Some(2));
        assert!(stderr.contains("extended-base"), "{stderr}");
    }
}

#[test]
fn a_cut_tree_is_built_again_and_force_leaves_nothing_of_before() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join("s").join(name);
    let grown = |line: &str| {
        let (code, stderr) = run(dir.path(), &format!("{line} --reference-spp 2"));
        assert_eq!((code, stderr.as_str()), (Some(0), ""), "{line}");
    };
    grown(TINY);
    let tree = at("trees/surfels-500-depth-0.7.lvt");
    let whole = fs::read(&tree).unwrap();
    fs::write(&tree, &whole[..whole.len() / 2]).unwrap();
    let twice = TINY.replace("--rounds 1", "--rounds 2");
    grown(&format!("{twice} --spp 4"));
    assert!(fs::read(&tree).unwrap() == whole);
    let of_four = at("images/monte-carlo-4.png");
    assert!(of_four.is_file());
    for name in ["trees/old.lvt", "images/notes.txt", "time-over-surfels.svg"] {
        fs::write(at(name), "old").unwrap();
    }
    grown(&format!("{TINY} --force"));
    assert!(!of_four.exists() && !at("trees/old.lvt").exists());
    assert!(!at("time-over-surfels.svg").exists());
    assert!(tree.is_file() && at("images/extended-base.png").is_file());
    assert!(at("images/notes.txt").is_file());
}

/// Images of the demo by their names, samples per pixel and seeds.
fn images(dir: &Path, of: &[(&str, u32, u32)]) {
    for (name, spp, seed) in of {
        let line = format!(
            "reference --demo --resolution 16x12 --max-depth 3 --progress none -o {name}.exr \
             --spp {spp} --seed {seed}"
        );
        let (code, stderr) = run(dir, &line);
        assert_eq!(code, Some(0), "{stderr}");
    }
}

#[test]
fn other_renderers_seeds_and_the_noise_of_the_reference_are_in_the_report() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    images(
        dir.path(),
        &[("r", 16, 1), ("r2", 16, 2), ("p4", 4, 3), ("p8", 8, 4)],
    );
    fs::write(
        at("others.csv"),
        "name,seconds,relmse,note\n<b>,0.5,0.02,x\n<b>,2,0.005,y\n",
    )
    .unwrap();
    let study = format!("{TINY} --reference r.exr");
    let more = "--reference-noise r2.exr --seeds 3 --peer paths=p8.exr,0.2 --peer paths=p4.exr,0.1 \
                --peer second=r2.exr,1 --peers others.csv";
    let (code, stderr) = run(dir.path(), &format!("{study} {more}"));
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    let found = json(&at("s"));
    let peers = found["peers"].as_array().unwrap();
    let names: Vec<&str> = peers.iter().map(|p| p["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["<b>", "<b>", "paths", "paths", "second"]);
    // More samples, less error, by the measure of the study's own runs.
    let error = |i: usize| peers[i]["errors"]["relmse"].as_f64().unwrap();
    assert!(error(2) < error(3) && error(3) < 1.0, "{peers:?}");
    let reference = &found["reference"];
    assert_eq!(reference["noise"], "image");
    // Half the distance between both images, and less than the error of fewer samples.
    let noise = reference["relmse"].as_f64().unwrap();
    assert_eq!(noise, 0.5 * error(4));
    assert!(noise < error(2), "{noise} {peers:?}");
    let runs = found["runs"].as_array().unwrap();
    for run in runs {
        let seeds = run["seeds"].as_object().unwrap();
        assert_eq!(seeds.keys().collect::<Vec<_>>(), ["1", "2"], "{run}");
        let relmse = |errors: &Value| errors["relmse"].as_f64().unwrap();
        assert!(
            seeds.values().all(|s| relmse(s) != relmse(&run["errors"])),
            "{run}"
        );
        assert_eq!(run["rounds"].as_array().unwrap().len(), 1);
    }
    assert!(!at("s/trees/of-a-seed").exists());
    let report = fs::read_to_string(at("s/report.html")).unwrap();
    for part in [
        "Other renderers",
        "Several seeds",
        "&lt;b&gt;",
        "below the noise of the reference",
        "by a second image",
    ] {
        assert!(report.contains(part), "{part}");
    }
    assert!(!report.contains("<b>"));
    let csv = fs::read_to_string(at("s/study.csv")).unwrap();
    assert!(
        csv.lines()
            .next()
            .unwrap()
            .ends_with("relmse_less_noise,seeds,relmse_mean,relmse_least,relmse_most")
    );
    // A second call measures no seed again, and another adds one.
    let line = format!("{study} --reference-noise 1e-3 --seeds 4");
    assert_eq!(run(dir.path(), &line).0, Some(0));
    let again = json(&at("s"));
    assert_eq!(again["reference"]["relmse"], 1e-3);
    assert!(again["peers"].as_array().unwrap().is_empty());
    for (run, before) in again["runs"].as_array().unwrap().iter().zip(runs) {
        let (seeds, known) = (run["seeds"].as_object().unwrap(), &before["seeds"]);
        assert_eq!(seeds.len(), 3);
        assert!(
            known
                .as_object()
                .unwrap()
                .iter()
                .all(|(seed, errors)| seeds[seed] == *errors)
        );
    }
}

#[test]
fn wrong_renderers_seeds_and_noise_are_told_before_the_work() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    images(dir.path(), &[("r", 16, 1), ("p4", 4, 3)]);
    let study = format!("{TINY} --reference r.exr");
    fs::write(at("bad.csv"), "name,seconds,relmse\na,0,1\n").unwrap();
    fs::write(at("a.png"), b"\x89PNG\r\n\x1a\n").unwrap();
    for (words, part) in [
        (
            "--peers bad.csv",
            "bad.csv: line 2: expected a number above 0 as seconds",
        ),
        ("--peers no.csv", "no.csv"),
        ("--peer p4.exr,1", "NAME=IMAGE,SECONDS"),
        ("--peer a=no.exr,1", "no.exr"),
        ("--peer a=a.png,1", "expected radiance, found a PNG file"),
        ("--reference-noise no.exr", "no.exr"),
        ("--reference-noise -1", "--reference-noise"),
        ("--seeds 0", "--seeds"),
    ] {
        let (code, stderr) = run(
            dir.path(),
            &format!("{study} {words}").replace("-o s", "-o new"),
        );
        assert_eq!(code, Some(2), "{words}: {stderr}");
        assert!(stderr.contains(part), "{words}: {stderr}");
        assert!(!at("new").exists(), "{words}");
    }
    let small = "reference --demo --resolution 8x6 --spp 1 --progress none -o small.exr";
    assert_eq!(run(dir.path(), small).0, Some(0));
    let (code, stderr) = run(dir.path(), &format!("{study} --peer a=small.exr,1"));
    assert_eq!(code, Some(2));
    assert!(
        stderr.contains("small.exr: expected 16x12 pixels") && stderr.contains("found 8x6"),
        "{stderr}"
    );
    assert!(!at("s").exists());
}

#[test]
fn a_scene_without_media_is_spared_what_only_media_need() {
    let dir = tempfile::tempdir().unwrap();
    let scene = "[film]\nwidth = 16\nheight = 12\n[[camera]]\nposition = [0, 1, 2]\n\
                 target = [0, 0, 0]\nfov_x_deg = 60\n[[mesh]]\nfile = \"builtin:quad\"\n\
                 albedo = [0.5, 0.5, 0.5]\n[[light]]\ntype = \"point\"\nposition = [0, 1, 0]\n\
                 intensity = [1, 1, 1]\n";
    fs::write(dir.path().join("scene.toml"), scene).unwrap();
    let line = "study scene.toml --quick --width 16 --spp 1,2 --reference-spp 2 --surfels 200,400 \
                --progress none -o s";
    let (code, stderr) = run(dir.path(), line);
    assert_eq!((code, stderr.as_str()), (Some(0), ""));
    let found = json(&dir.path().join("s"));
    let runs: Vec<String> = times(&found).into_keys().collect();
    // One of samples and one of solid angles beside the clouds; none of lvoxels, and none of
    // surfels alone.
    let expected = [
        "extended-base",
        "extended-max-solid-angle-0.04",
        "extended-samples-16",
        "extended-surfels-200",
        "monte-carlo-1",
        "monte-carlo-2",
    ];
    assert_eq!(runs, expected);
    let table = fs::read_to_string(dir.path().join("s/table.md")).unwrap();
    assert!(table.contains("no media"), "{table}");
}

#[test]
fn times_of_other_numbers_of_threads_are_taken_again_and_kept_apart() {
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("s");
    let run = |threads: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
        command.args(["study", "--demo", "--base-only", "--quality", "draft", "-o"]);
        command.arg(&folder).args(["--threads", threads]);
        for (name, value) in [
            ("--width", "16"),
            ("--spp", "1,2"),
            ("--surfels", "500"),
            ("--rounds", "1"),
            ("--reference-spp", "16"),
        ] {
            command.args([name, value]);
        }
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        (json(&folder), text(&output.stderr))
    };
    let of = |study: &Value, key: &str| -> Vec<Value> {
        let runs = study["runs"].as_array().unwrap().iter();
        runs.map(|r| r[key].clone()).collect()
    };
    let (two, said) = run("2");
    assert!(!said.contains("kept apart"), "{said}");
    assert_eq!(two["machine"]["threads"], 2);
    let (one, said) = run("1");
    assert!(said.contains("kept apart"), "{said}");
    assert_eq!(one["machine"]["threads"], 1);
    assert_eq!(of(&one, "errors"), of(&two, "errors"));
    for (key, one, two) in [
        ("rounds", of(&one, "rounds"), of(&two, "rounds")),
        (
            "clouds",
            vec![one["clouds"].clone()],
            vec![two["clouds"].clone()],
        ),
    ] {
        assert_eq!(one.len(), two.len(), "{key}");
        assert!(one.iter().zip(&two).all(|(a, b)| a != b), "{key}: {one:?}");
    }
    assert!(
        fs::read_to_string(folder.join("table.md"))
            .unwrap()
            .contains("1 threads")
    );
    // Nothing that was timed is lost or timed again.
    let (again, _) = run("2");
    assert_eq!(again["runs"], two["runs"]);
    assert_eq!(again["clouds"], two["clouds"]);
    assert_eq!(again["others"][0]["runs"], one["runs"]);
}

#[test]
fn wrong_use_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    for (args, part) in [
        (&["--rounds", "0"][..], "--rounds"),
        (&["--long=-1"], "--long"),
        (&["--camera", "nobody"], "nobody"),
        (&["--base-only"], "--base-only"),
        (&["--reference", "no.exr"], "--reference"),
    ] {
        let output = study(&dir.path().join("a"), args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        let stderr = text(&output.stderr);
        assert!(stderr.contains(part), "{args:?}: {stderr}");
        assert!(!dir.path().join("a").exists(), "{args:?}");
    }
}
