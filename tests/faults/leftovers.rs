//! Files and folders of killed processes go away with the next run; those of living ones stay.

use crate::support::names;
use crate::support::program::{command, lvox};
use std::fs;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

const BAKE: [&str; 8] = [
    "bake",
    "--demo",
    "-o",
    "demo.lvc",
    "--surfels",
    "100000",
    "--progress",
    "none",
];

/// A process that is killed where the test ends early.
struct Running(Child);

impl Running {
    fn start(dir: &Path, args: &[&str]) -> Self {
        let mut command = command(dir, args);
        Self(command.stderr(Stdio::null()).spawn().unwrap())
    }

    /// Waits until a folder holds a file whose name has this part; the process may not end before.
    fn wait_for(&mut self, dir: &Path, part: &str) -> String {
        let started = Instant::now();
        loop {
            let mut found = names(dir).into_iter().filter(|name| name.contains(part));
            if let Some(name) = found.next() {
                return name;
            }
            let ended = self.0.try_wait().unwrap();
            assert!(ended.is_none(), "it ended before {part} was there");
            assert!(started.elapsed() < Duration::from_secs(60), "no {part}");
            sleep(Duration::from_millis(1));
        }
    }

    fn signal(&self, signal: &str) {
        let pid = self.0.id().to_string();
        let kill = Command::new("kill").args([signal, &pid]).status();
        assert!(kill.unwrap().success());
    }

    /// SIGKILL.
    fn kill(mut self) {
        self.0.kill().unwrap();
        assert_eq!(self.0.wait().unwrap().code(), None);
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_killed_bake_is_swept_by_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    lvox(dir, &BAKE).done();
    let whole = fs::read(dir.join("demo.lvc")).unwrap();
    fs::remove_file(dir.join("demo.lvc")).unwrap();
    let mut bake = Running::start(dir, &BAKE);
    let left = bake.wait_for(dir, ".part");
    bake.kill();
    assert_eq!(names(dir), [left]);
    lvox(dir, &BAKE).done();
    assert_eq!(names(dir), ["demo.lvc"]);
    assert!(fs::read(dir.join("demo.lvc")).unwrap() == whole);
}

#[test]
fn a_living_bake_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let dir = dir.path();
    let forced = [&BAKE[..], &["--force"]].concat();
    let mut bake = Running::start(dir, &forced);
    let living = bake.wait_for(dir, ".part");
    bake.signal("-STOP");
    lvox(dir, &forced).done();
    assert_eq!(names(dir), [living, "demo.lvc".into()]);
    fs::remove_file(dir.join("demo.lvc")).unwrap();
    bake.signal("-CONT");
    assert!(bake.0.wait().unwrap().success());
    assert_eq!(names(dir), ["demo.lvc"]);
}

#[test]
fn the_folder_of_a_killed_render_is_swept_by_the_next() {
    let dir = tempfile::tempdir().unwrap();
    let (dir, temporary) = (dir.path(), tempfile::tempdir().unwrap());
    let temporary = temporary.path();
    let folder = temporary.to_str().unwrap();
    let render: Vec<&str> = "render --demo -o demo.exr --resolution 16x12 --quality draft --surfels 20000 --progress none"
        .split(' ')
        .chain(["--temp-dir", folder])
        .collect();
    let mut killed = Running::start(dir, &render);
    killed.wait_for(temporary, "lvox-");
    killed.kill();
    assert_eq!(names(temporary).len(), 1);
    let mut living = Running::start(dir, &render);
    let own = loop {
        let own = living.wait_for(temporary, "lvox-");
        if names(temporary).len() == 1 && temporary.join(&own).join("scene.lvc").exists() {
            break own;
        }
    };
    living.signal("-STOP");
    lvox(dir, &render).done();
    assert_eq!(names(temporary), [own]);
    living.kill();
    lvox(dir, &render).done();
    assert!(names(temporary).is_empty());
    assert_eq!(names(dir), ["demo.exr"]);
}
