//! `lvox reference` from outside: what it writes, and that a stop loses nothing.

use std::path::Path;
use std::process::{Command, Output};
use std::time::{Duration, Instant};

fn command(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
    command
        .current_dir(dir)
        .args([
            "reference",
            "--demo",
            "--region",
            "300",
            "200",
            "340",
            "230",
        ])
        .args(args);
    command
}

fn lvox(dir: &Path, args: &[&str]) -> Output {
    command(dir, args).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn wrong_use_is_refused_at_once() {
    let dir = tempfile::tempdir().unwrap();
    for (args, part) in [
        (&["-o", "a.png"][..], ".exr"),
        (&["-o", "a.exr", "--spp", "0"], "0"),
        (&["-o", "a.exr", "--time", "0"], "--time"),
        (&["-o", "a.exr", "--strands", "0"], "--strands"),
        (&["-o", "no/a.exr"], "no"),
        (&["-o", "a.exr", "--camera", "nobody"], "nobody"),
    ] {
        let output = lvox(dir.path(), args);
        assert_eq!(output.status.code(), Some(2), "{args:?}");
        let stderr = text(&output.stderr);
        assert!(stderr.contains(part), "{args:?}: {stderr}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    }
}

#[test]
fn fewer_samples_than_are_kept_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let run = |spp: &str, more: &[&str]| {
        let args = [&["-o", "a.exr", "--max-depth", "2", "--spp", spp], more].concat();
        let output = lvox(dir.path(), &args);
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    assert!(!run("3", &[]).contains("warning"));
    let stderr = run("2", &[]);
    let told = "warning: a.exr.sums keeps 3 samples per pixel, more than --spp 2";
    assert!(stderr.contains(told), "{stderr}");
    assert!(!run("4", &[]).contains("warning"));
    assert!(!run("2", &["--force"]).contains("warning"));
}

#[test]
fn samples_and_noise_are_told_and_compare_has_the_noise_too() {
    let dir = tempfile::tempdir().unwrap();
    let run = |args: &[&str]| {
        let output = lvox(dir.path(), &[&["--max-depth", "2"], args].concat());
        assert!(output.status.success(), "{}", text(&output.stderr));
        let stderr = text(&output.stderr);
        stderr.lines().last().unwrap_or_default().to_owned()
    };
    let told = run(&["-o", "a.exr", "--spp", "8"]);
    let (start, noise) = told.rsplit_once(' ').unwrap();
    assert_eq!(start, "8 samples per pixel; its noise is of relMSE");
    let noise: f64 = noise.parse().unwrap();
    let told = run(&["-o", "b.exr", "--spp", "2", "--strands", "1"]);
    assert!(told.starts_with("2 samples") && told.contains("does not tell"));
    assert_eq!(
        run(&["-o", "c.exr", "--spp", "1", "--progress", "none"]),
        ""
    );

    let read = |verb: &str, part: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
        let output = command.current_dir(&dir).args([verb, "a.exr.sums"]);
        let output = output.output().unwrap();
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(said.contains(part), "{verb}: {said}");
        output.status.code()
    };
    assert_eq!(read("inspect", "300 200 to 340 230"), Some(0));
    assert_eq!(read("verify", "samples undamaged"), Some(0));
    let kept = dir.path().join("a.exr.sums");
    let whole = std::fs::read(&kept).unwrap();
    let mut damaged = whole.clone();
    damaged[whole.len() / 2] ^= 1;
    std::fs::write(&kept, damaged).unwrap();
    for verb in ["inspect", "verify"] {
        assert_eq!(read(verb, "its checksum is wrong"), Some(2));
    }
    std::fs::write(&kept, whole).unwrap();

    let compare = |images: [&str; 2], more: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
        let region = ["--region", "300", "200", "340", "230"];
        command.current_dir(&dir).arg("compare").args(images);
        let output = command.args(region).args(more).output().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        text(&output.stdout)
    };
    let table = compare(["b.exr", "a.exr"], &[]);
    let row = table.lines().find(|l| l.starts_with("reference_noise"));
    let value = row.unwrap().split_whitespace().nth(1).unwrap();
    let value: f64 = value.parse().unwrap();
    assert!((value / noise - 1.0).abs() < 0.01, "{value} and {noise}");
    // A single sequence tells none, and of a layer nobody knows.
    assert!(!table.contains("image_noise"), "{table}");
    let json = compare(["a.exr", "b.exr"], &["--json"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert!((json["image_noise"].as_f64().unwrap() / noise - 1.0).abs() < 0.01);
    assert!(json.get("reference_noise").is_none());
}

#[test]
fn what_differs_is_named_and_a_camera_goes_by_its_name() {
    let dir = tempfile::tempdir().unwrap();
    let base = ["-o", "a.exr", "--spp", "1"];
    assert!(lvox(dir.path(), &base).status.success());
    let output = lvox(dir.path(), &[&base[..], &["--max-depth", "2"]].concat());
    assert_eq!(output.status.code(), Some(2));
    let stderr = text(&output.stderr);
    assert!(stderr.contains("max_depth 0, here 2"), "{stderr}");
    let camera = ::lvox::scene::Scene::demo().unwrap().cameras[0]
        .name
        .clone();
    let output = lvox(dir.path(), &[&base[..], &["--camera", &camera]].concat());
    assert!(output.status.success(), "{}", text(&output.stderr));
}

#[cfg(unix)]
#[test]
fn a_signal_keeps_what_is_finished_and_the_same_command_goes_on() {
    let dir = tempfile::tempdir().unwrap();
    let image = |name: &str| std::fs::read(dir.path().join(name)).unwrap();
    let output = lvox(dir.path(), &["-o", "once.exr", "--spp", "96"]);
    assert!(output.status.success(), "{}", text(&output.stderr));

    let sums = dir.path().join("twice.exr.sums");
    let args = ["-o", "twice.exr", "--spp", "96", "--threads", "1"];
    let mut child = command(dir.path(), &args)
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    // Far enough to have begun, whatever the machine's speed; if it has ended, rerunning it is tested still.
    std::thread::sleep(Duration::from_millis(700));
    let killed = Command::new("kill")
        .args(["-TERM", &child.id().to_string()])
        .status()
        .unwrap();
    let asked = Instant::now();
    let status = child.wait().unwrap();
    assert!(asked.elapsed() < Duration::from_secs(10));
    if killed.success() && !status.success() {
        assert_eq!(status.code(), Some(1));
        assert!(sums.exists());
        let output = child.stderr.take().map(std::io::read_to_string);
        let stderr = output.unwrap().unwrap();
        assert!(stderr.contains("the same command goes on"), "{stderr}");
    }
    let output = lvox(dir.path(), &args);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(image("once.exr") == image("twice.exr"));
}
