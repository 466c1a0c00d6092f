//! Faults by chance in every stage that writes a file.
//!
//! Under a final name is nothing but a whole file, an error is one line with exit code 1, nothing
//! else is left, and the next run writes what an undisturbed one does.

use crate::stage::{Bench, STAGES, Stage};
use crate::support::random::Random;
use crate::support::skip::skip;
use std::fs::{self, File};
use std::process::Command;
use std::thread::sleep;
use std::time::Duration;

/// Tries for each stage and kind of fault, where `LVOX_FAULTS` does not say.
const TRIES: u64 = 2;

fn number(name: &str, default: u64) -> u64 {
    match std::env::var(name) {
        Ok(text) => text.parse().unwrap_or_else(|_| panic!("{name}={text}")),
        Err(_) => default,
    }
}

/// Runs `one` so often for each stage, each time with numbers of its own, and tells how often it
/// came out how.
fn each(
    fault: &str,
    stages: &[&'static Stage],
    one: impl Fn(&'static Stage, &mut Random) -> &'static str,
) {
    let mut counts = std::collections::BTreeMap::new();
    for i in 0..number("LVOX_FAULTS", TRIES) {
        for (j, &stage) in stages.iter().enumerate() {
            let seed = number("LVOX_FAULTS_SEED", 1);
            let mut random = Random(seed ^ i << 16 ^ (j as u64) << 48);
            // The first numbers of near seeds are alike.
            random.next();
            *counts.entry(one(stage, &mut random)).or_insert(0) += 1;
        }
    }
    eprintln!("{fault}: {counts:?}");
}

fn all() -> Vec<&'static Stage> {
    STAGES.iter().collect()
}

/// A moment in a stage, or shortly after its usual end.
fn moment(bench: &Bench, random: &mut Random) -> Duration {
    bench.takes().mul_f32(1.1 * random.unit())
}

fn how(is_done: bool) -> &'static str {
    if is_done { "done" } else { "refused" }
}

#[test]
fn kills() {
    each("kills", &all(), |stage, random| {
        let bench = Bench::of(stage);
        let at = moment(&bench, random);
        let mut child = bench.command().spawn().unwrap();
        sleep(at);
        child.kill().unwrap();
        let run = child.wait_with_output().unwrap();
        let told = format!("killed after {at:?}");
        bench.is_whole_or_not_there(&told);
        let is_clean = run.status.success()
            || fs::read_dir(bench.out()).unwrap().count()
                + fs::read_dir(bench.temporary()).unwrap().count()
                == 0;
        bench.next_is_whole(&told);
        match (run.status.success(), is_clean) {
            (true, _) => "done",
            (_, true) => "nothing left",
            _ => "left and swept",
        }
    });
}

#[test]
fn little_memory() {
    each("little memory", &all(), |stage, random| {
        let bench = Bench::of(stage);
        let kib = 20_000.0 * 16_f32.powf(random.unit());
        let limit = format!("ulimit -v {kib:.0}");
        if !bench.is_loaded_after(&limit) {
            return "not loaded";
        }
        let run = bench.run(&mut bench.shell(&format!("{limit}; exec \"$@\"")));
        how(bench.ended_well(&run, &[1], &limit))
    });
}

#[test]
fn little_disk() {
    each("files that may not grow", &all(), |stage, random| {
        let bench = Bench::of(stage);
        let blocks = 2048.0_f32.powf(random.unit());
        let run = bench.run(&mut bench.shell(&format!("ulimit -f {blocks:.0}; exec \"$@\"")));
        how(bench.ended_well(&run, &[1], &format!("ulimit -f {blocks:.0}")))
    });
}

#[test]
fn few_descriptors() {
    each("few descriptors", &all(), |stage, random| {
        let bench = Bench::of(stage);
        // With three and one more the system can load the program.
        let count = 4 + random.below(6);
        let run = bench.run(&mut bench.shell(&format!("ulimit -n {count}; exec \"$@\"")));
        how(bench.ended_well(&run, &[1], &format!("ulimit -n {count}")))
    });
}

#[test]
fn a_full_disk() {
    if !can_mount() {
        return skip("needs a tmpfs of its own");
    }
    each("a full disk", &all(), |stage, random| {
        let bench = Bench::of(stage);
        let kib = 4.0 * 512.0_f32.powf(random.unit());
        let (out, temporary) = (bench.out(), bench.temporary());
        // What was in the file system is looked at before it goes away with the shell.
        let script = format!(
            "mount -t tmpfs -o size={kib:.0}k lvox '{0}' && mount --bind '{0}' '{1}' || exit 99\n\
             \"$@\"; code=$?; cp -r '{0}' '{0}.seen'; exit $code",
            out.display(),
            temporary.display()
        );
        let mut shell = in_namespace(bench.shell(&script));
        let run = bench.run(&mut shell);
        let seen = out.with_extension("seen");
        fs::remove_dir(&out).unwrap();
        fs::rename(seen, &out).unwrap();
        how(bench.ended_well(&run, &[1], &format!("a disk of {kib:.0} KiB")))
    });
}

#[test]
fn a_folder_that_may_not_be_written() {
    if !can_mount() {
        return skip("needs a tmpfs of its own");
    }
    each("a folder that may not be written", &all(), |stage, _| {
        let bench = Bench::of(stage);
        let script = format!(
            "mount -t tmpfs -o ro lvox '{}' || exit 99; exec \"$@\"",
            bench.out().display()
        );
        let run = bench.run(&mut in_namespace(bench.shell(&script)));
        // A disk that is read-only may be writable again.
        how(bench.ended_well(&run, &[1, 2], "read-only"))
    });
}

#[test]
fn a_folder_that_goes_away() {
    each("a folder that goes away", &all(), |stage, random| {
        let bench = Bench::of(stage);
        let at = moment(&bench, random);
        let child = bench.command().spawn().unwrap();
        sleep(at);
        let was_done = bench.output().exists();
        // In the moment of a rename something may be in it that was not there before.
        while fs::remove_dir_all(bench.out()).is_err() {}
        let run = child.wait_with_output().unwrap();
        if was_done || run.status.success() {
            return "done";
        }
        how(bench.ended_well(&run, &[1, 2], &format!("without a folder after {at:?}")))
    });
}

#[test]
fn files_that_are_cut_while_they_are_read() {
    let stages: Vec<&Stage> = STAGES.iter().filter(|s| !s.maps.is_empty()).collect();
    each("cut files", &stages, |stage, random| {
        let bench = Bench::with_own_inputs(stage);
        let at = moment(&bench, random);
        let input = stage.maps[random.below(stage.maps.len() as u64) as usize];
        let file = File::options()
            .write(true)
            .open(bench.input(input))
            .unwrap();
        let len = random.below(file.metadata().unwrap().len());
        let child = bench.command().spawn().unwrap();
        sleep(at);
        file.set_len(len).unwrap();
        let run = child.wait_with_output().unwrap();
        // A file that was cut before it was opened is wrong input.
        let is_done =
            bench.ended_well(&run, &[1, 2], &format!("{input} cut to {len} after {at:?}"));
        match (is_done, run.status.code()) {
            (true, _) => "done",
            (_, Some(2)) => "refused as damaged",
            _ => "refused as cut",
        }
    });
}

/// A command in a name space of its own, where it may mount.
fn in_namespace(command: Command) -> Command {
    let mut unshare = Command::new("unshare");
    unshare
        .arg("-rm")
        .arg(command.get_program())
        .args(command.get_args());
    if let Some(dir) = command.get_current_dir() {
        unshare.current_dir(dir);
    }
    unshare.env_remove("RUST_BACKTRACE");
    unshare
}

fn can_mount() -> bool {
    let dir = tempfile::tempdir().unwrap();
    let mut mount = Command::new("mount");
    mount.args(["-t", "tmpfs", "lvox"]).arg(dir.path());
    in_namespace(mount)
        .output()
        .is_ok_and(|o| o.status.success())
}
