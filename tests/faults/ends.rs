//! The program ends with one line where no error can be returned.

use crate::stage::{Bench, is_one_error, stage};
use std::fs::File;
use std::process::{Child, Command, Output};
use std::thread::sleep;
use std::time::Duration;

fn signal(child: &Child, signal: &str) {
    let pid = child.id().to_string();
    let kill = Command::new("kill").args([signal, &pid]).status();
    assert!(kill.unwrap().success());
}

fn told(run: &Output) -> String {
    String::from_utf8_lossy(&run.stderr).into_owned()
}

#[test]
#[cfg(target_os = "linux")]
fn a_cut_cloud_is_named_by_the_build_that_reads_it() {
    // The whole file is mapped when it is opened, which is before the tree is begun.
    let bench = Bench::with_own_inputs(stage("build"));
    let cloud = bench.input("scene.lvc");
    for _ in 0..20 {
        let child = bench.command().spawn().unwrap();
        let maps = format!("/proc/{}/maps", child.id());
        let is_mapped = || std::fs::read_to_string(&maps).is_ok_and(|m| m.contains("scene.lvc"));
        while !is_mapped() && std::path::Path::new(&maps).exists() {
            sleep(Duration::from_micros(100));
        }
        signal(&child, "-STOP");
        let bytes = std::fs::read(&cloud).unwrap();
        File::options()
            .write(true)
            .open(&cloud)
            .unwrap()
            .set_len(0)
            .unwrap();
        signal(&child, "-CONT");
        let run = child.wait_with_output().unwrap();
        std::fs::write(&cloud, bytes).unwrap();
        let is_done = bench.ended_well(&run, &[1, 2], "cut");
        if run.status.code() == Some(1) {
            assert!(
                told(&run).starts_with("error: scene.lvc: the file was cut"),
                "{}",
                told(&run)
            );
            return;
        }
        if is_done {
            std::fs::remove_file(bench.output()).unwrap();
        }
    }
    panic!("the cloud was never cut while it was read");
}

#[test]
#[cfg(target_os = "linux")]
fn memory_that_is_refused_is_one_line() {
    // Of some limits one is too small for the work, and large enough for the program.
    let bench = Bench::of(stage("render"));
    let mut refused = 0;
    for mib in (20..60).step_by(4) {
        let limit = format!("ulimit -v {}", mib * 1024);
        if !bench.is_loaded_after(&limit) {
            continue;
        }
        let run = bench.run(&mut bench.shell(&format!("{limit}; exec \"$@\"")));
        if bench.ended_well(&run, &[1], &format!("{mib} MiB")) {
            std::fs::remove_file(bench.output()).unwrap();
        } else {
            refused += usize::from(told(&run).contains("memory"));
        }
    }
    assert!(
        refused > 0,
        "every limit was enough, or no limit was for the program"
    );
}

#[test]
fn a_render_without_descriptors_leaves_nothing() {
    for count in 4..10 {
        let bench = Bench::of(stage("render"));
        let run = bench.run(&mut bench.shell(&format!("ulimit -n {count}; exec \"$@\"")));
        bench.ended_well(&run, &[1], &format!("{count} descriptors"));
    }
}

#[test]
fn threads_that_are_refused_are_one_line() {
    let bench = Bench::of(stage("merge"));
    let run = bench.run(&mut bench.shell(
        "ulimit -v 300000; exec \"$1\" merge 0.exr 1.exr -o never.exr \
         --progress none --threads 1024",
    ));
    is_one_error(&run, &[1], &told(&run));
    assert!(told(&run).contains("1024 threads"), "{}", told(&run));
}

#[test]
fn a_disk_that_is_full_is_told_of_the_file_that_is_written() {
    let bench = Bench::of(stage("bounce"));
    let run = bench.run(&mut bench.shell("ulimit -f 1; exec \"$@\""));
    assert!(!bench.ended_well(&run, &[1], "ulimit -f 1"));
    // Not of the tree that is read.
    let error = format!("error: {}: cannot write", bench.output().display());
    assert!(told(&run).starts_with(&error), "{}", told(&run));
}
