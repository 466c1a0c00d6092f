//! Files and folders of killed processes go away with the next run; those of living ones stay.

use crate::stage::{Bench, stage};
use crate::support::names;
use std::fs;
use std::path::Path;
use std::process::{Child, Command};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A process that is killed where the test ends early.
struct Running(Child);

impl Running {
    fn start(bench: &Bench) -> Self {
        Self(bench.command().arg("--force").spawn().unwrap())
    }

    /// Waits until a folder holds for a while a file whose name has this part, longer than one that
    /// only tries whether it may be written; the process may not end before.
    fn wait_for(&mut self, dir: &Path, part: &str) -> String {
        let started = Instant::now();
        let mut seen = None;
        loop {
            let found = names(dir).into_iter().find(|name| name.contains(part));
            if let Some(name) = found.clone().filter(|_| found == seen) {
                return name;
            }
            seen = found;
            let ended = self.0.try_wait().unwrap();
            assert!(ended.is_none(), "it ended before {part} was there");
            assert!(started.elapsed() < Duration::from_secs(60), "no {part}");
            sleep(Duration::from_millis(3));
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
    let bench = Bench::of(stage("bake"));
    let mut bake = Running::start(&bench);
    let left = bake.wait_for(&bench.out(), ".part");
    bake.kill();
    assert_eq!(names(&bench.out()), [left]);
    bench.next_is_whole("killed");
}

#[test]
fn a_living_bake_is_left_alone() {
    let bench = Bench::of(stage("bake"));
    let mut bake = Running::start(&bench);
    bake.wait_for(&bench.out(), ".part");
    bake.signal("-STOP");
    sleep(Duration::from_millis(20));
    let living = names(&bench.out());
    let next = bench.command().arg("--force").output().unwrap();
    assert!(next.status.success());
    assert_eq!(
        names(&bench.out()),
        [living, vec!["scene.lvc".into()]].concat()
    );
    fs::remove_file(bench.output()).unwrap();
    bake.signal("-CONT");
    assert!(bake.0.wait().unwrap().success());
    assert_eq!(names(&bench.out()), ["scene.lvc"]);
    bench.is_whole_or_not_there("living");
}

#[test]
fn the_folder_of_a_killed_render_is_swept_by_the_next() {
    let bench = Bench::of(stage("render"));
    let temporary = bench.temporary();
    let mut killed = Running::start(&bench);
    let left = killed.wait_for(&temporary, "lvox-");
    killed.kill();
    assert_eq!(names(&temporary), std::slice::from_ref(&left));
    let mut living = Running::start(&bench);
    // Its own is there, and that of the killed one is swept.
    let own = loop {
        let own = living.wait_for(&temporary, "lvox-");
        if own != left && names(&temporary) == [own.clone()] {
            break own;
        }
    };
    living.signal("-STOP");
    assert!(bench.command().output().unwrap().status.success());
    assert_eq!(names(&temporary), [own]);
    living.kill();
    bench.next_is_whole("killed");
}
