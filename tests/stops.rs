//! The program stops soon when it is asked to, also while it loads what is large.

#![cfg(unix)]

use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};
use std::{fs, thread};

/// Time within which every stage hears of it.
const PROMISED: Duration = Duration::from_secs(5);

/// Runs the program and asks it to stop after a while. How it ended, and how long after that.
fn stopped(dir: &Path, args: &[&str], after: Duration) -> (ExitStatus, Duration) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_lvox"))
        .args(args)
        .current_dir(dir)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let started = Instant::now();
    while started.elapsed() < after && child.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_millis(5).min(after));
    }
    let pid = child.id().to_string();
    // It may have ended by then.
    let _ = Command::new("kill")
        .args(["-TERM", &pid])
        .stderr(Stdio::null())
        .status();
    let asked = Instant::now();
    let status = child.wait().unwrap();
    (status, asked.elapsed())
}

/// A height field with normals to be made, so that all of loading takes its time.
fn terrain(side: u32) -> String {
    let mut text = String::new();
    for i in 0..side * side {
        let (x, z) = (i % side, i / side);
        writeln!(text, "v {x} {} {z}", (x * 7 + z * 13) % 11).unwrap();
    }
    for i in 0..(side - 1) * (side - 1) {
        let a = i / (side - 1) * side + i % (side - 1) + 1;
        writeln!(text, "f {a} {} {} {}", a + side, a + side + 1, a + 1).unwrap();
    }
    text
}

/// A face that turns in and out at each corner.
fn gear(corners: u32) -> String {
    let mut text = String::new();
    for i in 0..corners {
        let angle = f64::from(i) / f64::from(corners) * std::f64::consts::TAU;
        let r = if i % 2 == 0 { 1.0 } else { 0.99 };
        writeln!(text, "v {} 0 {}", r * angle.cos(), r * angle.sin()).unwrap();
    }
    text.push('f');
    for i in 0..corners {
        write!(text, " {}", i + 1).unwrap();
    }
    text.push('\n');
    text
}

fn lights(count: u32) -> String {
    let mut text = String::new();
    for i in 0..count {
        let (x, z) = (i % 300, i / 300);
        writeln!(
            text,
            "[[light]]\ntype = \"point\"\nposition = [{x}, 3, {z}]\nintensity = [1, 1, 1]"
        )
        .unwrap();
    }
    text
}

#[test]
fn a_stop_is_heard_whatever_is_loaded() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| fs::write(dir.path().join(name), text).unwrap();
    write("terrain.obj", &terrain(600));
    write("gear.obj", &gear(300_000));
    let mesh =
        |file: &str| format!("[[mesh]]\nfile = \"{file}\"\nnormals = {{ crease_deg = 40 }}\n");
    write("terrain.toml", &mesh("terrain.obj"));
    write("gear.toml", &mesh("gear.obj"));
    write("lights.toml", &(mesh("builtin:quad") + &lights(40_000)));
    let mut stops = 0;
    for scene in ["terrain.toml", "gear.toml", "lights.toml"] {
        for millis in [30, 200, 500, 1200] {
            let args = [
                "bake",
                scene,
                "-o",
                "c.lvc",
                "--force",
                "--retry-code",
                "99",
            ];
            let (status, took) = stopped(dir.path(), &args, Duration::from_millis(millis));
            assert!(took < PROMISED, "{scene} after {millis} ms: {took:?}");
            assert!(
                status.success() || status.code() == Some(99),
                "{scene}: {status:?}"
            );
            if !status.success() {
                stops += 1;
                let left: Vec<_> = fs::read_dir(dir.path()).unwrap().collect();
                let names = left.into_iter().map(|e| e.unwrap().file_name());
                let part = names.filter(|n| n.to_string_lossy().contains("c.lvc"));
                assert_eq!(part.count(), 0, "{scene} after {millis} ms");
            }
            let _ = fs::remove_file(dir.path().join("c.lvc"));
        }
    }
    assert!(stops > 3, "{stops}");
}

/// Files of the folder whose names hold that of an output.
fn left(dir: &Path, output: &str) -> usize {
    let names = fs::read_dir(dir).unwrap().map(|e| e.unwrap().file_name());
    names
        .filter(|n| n.to_string_lossy().contains(output))
        .count()
}

#[test]
fn a_stop_is_heard_while_light_bounces_and_scenes_are_packed() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str, bytes: &[u8]| fs::write(dir.path().join(name), bytes).unwrap();
    write("terrain.obj", terrain(400).as_bytes());
    let voxels: Vec<u8> = (0..96 * 96 * 96_u32).map(|i| (i * 7 % 97) as u8).collect();
    write("fog.raw", &voxels);
    let scene = "[[mesh]]\nfile = \"terrain.obj\"\n\
        [[light]]\ntype = \"directional\"\ndirection = [0.3, -1, 0.2]\nirradiance = [3, 3, 3]\n\
        [[volume]]\nfile = \"fog.raw\"\ndims = [96, 96, 96]\ndtype = \"u8\"\n\
        sigma_t_scale = 0.001\nalbedo = [0.9, 0.9, 0.9]\n\
        unitcube_to_world = [[300, 0, 0, 50], [0, 60, 0, 5], [0, 0, 300, 50], [0, 0, 0, 1]]\n";
    write("s.toml", scene.as_bytes());
    for args in [
        ["bake", "s.toml", "-o", "s.lvc"],
        ["build", "s.lvc", "-o", "s.lvt"],
    ] {
        let (status, _) = stopped(dir.path(), &args, Duration::from_secs(300));
        assert!(status.success(), "{args:?}");
    }
    let mut stops = 0;
    for (verb, output) in [("bounce", "out.lvt"), ("pack", "out.lvp")] {
        for millis in [30, 150, 400, 900, 2000] {
            let args = [verb, "s.toml", "-t", "s.lvt", "-o", output, "--force"];
            let (status, took) = stopped(dir.path(), &args, Duration::from_millis(millis));
            let told = format!("{verb} after {millis} ms: {status:?}, {took:?}");
            assert!(took < PROMISED, "{told}");
            assert!(status.success() || status.code() == Some(1), "{told}");
            if !status.success() {
                stops += 1;
                assert_eq!(left(dir.path(), output), 0, "{told}");
            }
            let _ = fs::remove_file(dir.path().join(output));
        }
    }
    assert!(stops > 2, "{stops}");
}
