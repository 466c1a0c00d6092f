//! What the program says of itself: help, the manual, completions, the version; and what the
//! environment says to it.

use crate::support::program::{Run, command, lvox};
use std::fs;

#[test]
fn help_is_data_and_success() {
    let dir = tempfile::tempdir().unwrap();
    for args in [
        &["--help"][..],
        &["merge", "-h"],
        &["compare", "--help"],
        &["--version"],
    ] {
        let run = lvox(dir.path(), args);
        assert_eq!((run.code, run.stderr.as_str()), (0, ""), "{args:?}");
        assert!(run.stdout.contains("lvox"));
    }
    let help = lvox(dir.path(), &["merge", "--help"]).stdout;
    for part in [
        "Shared options:",
        "--threads <N>",
        "--output <FILE>",
        "[default: auto]",
    ] {
        assert!(help.contains(part), "{part:?} is not in {help}");
    }
}

#[test]
fn every_verb_has_help() {
    let dir = tempfile::tempdir().unwrap();
    let help = lvox(dir.path(), &["help"]).stdout;
    let verbs = help.split("Commands:\n").nth(1).unwrap();
    let lines = verbs.lines().map_while(|line| line.strip_prefix("  "));
    // Lines that go on with what is said of a verb stand further in.
    let lines = lines.filter(|line| !line.starts_with(' '));
    let verbs: Vec<&str> = lines.filter_map(|l| l.split(' ').next()).collect();
    assert!(verbs.len() > 15, "{verbs:?}");
    for verb in verbs.into_iter().filter(|v| *v != "help") {
        let run = lvox(dir.path(), &["help", verb]);
        assert_eq!(run.code, 0, "{verb}");
        assert!(
            run.stdout.contains(&format!("lvox {verb}")),
            "{}",
            run.stdout
        );
    }
    let run = lvox(dir.path(), &["help", "farm", "slurm"]);
    assert!(run.stdout.contains("lvox farm slurm"), "{}", run.stdout);
}

#[test]
fn the_version_is_what_a_report_of_a_fault_needs() {
    let dir = tempfile::tempdir().unwrap();
    let short = lvox(dir.path(), &["-V"]).stdout;
    assert_eq!(short, format!("lvox {}\n", env!("CARGO_PKG_VERSION")));
    let long = lvox(dir.path(), &["--version"]).stdout;
    for part in ["commit ", "built for ", "threads", "of format 1"] {
        assert!(long.contains(part), "{part:?} is not in {long}");
    }
}

#[test]
fn shells_complete_and_the_manual_has_a_page_for_each_verb() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let run = lvox(dir.path(), &["completions", shell]);
        assert_eq!((run.code, run.stderr.as_str()), (0, ""), "{shell}");
        assert!(run.stdout.contains("memory-limit"), "{shell}");
    }
    let run = lvox(dir.path(), &["completions", "cmd"]);
    assert_eq!((run.code, run.stdout.as_str()), (2, ""));
    assert!(run.stderr.contains("bash"), "{}", run.stderr);
    lvox(dir.path(), &["man", "."]).done();
    for (page, part) in [("lvox.1", "lvox\\-shade"), ("lvox-shade.1", "quality")] {
        let text = fs::read_to_string(dir.path().join(page)).unwrap();
        assert!(text.contains(part), "{part} is not in {page}");
    }
    lvox(dir.path(), &["man", "none"]).refused(2, &["none", "expected a folder"]);
}

#[test]
fn the_environment_has_defaults() {
    let dir = tempfile::tempdir().unwrap();
    let with = |name: &str, value: &str, args: &[&str]| {
        Run::of(command(dir.path(), args).env(name, value))
    };
    let bake = [
        "bake",
        "--demo",
        "--surfels",
        "100",
        "-o",
        "a.lvc",
        "--force",
    ];
    let run = with("LVOX_PROGRESS", "json", &bake);
    assert!(run.stderr.starts_with('{'), "{}", run.stderr);
    let quiet = [&bake[..], &["-q"]].concat();
    let run = with("LVOX_PROGRESS", "json", &quiet);
    assert_eq!((run.code, run.stderr.as_str()), (0, ""));
    with("LVOX_MEMORY_LIMIT", "1M", &bake).refused(2, &["this bake needs", "1.00 MiB"]);
    let typed = [&bake[..], &["--memory-limit", "1G"]].concat();
    assert_eq!(with("LVOX_MEMORY_LIMIT", "1M", &typed).code, 0);
    let run = with("LVOX_THREADS", "none", &bake);
    assert_eq!(run.code, 2);
    assert!(
        run.stderr.contains("value of LVOX_THREADS"),
        "{}",
        run.stderr
    );
    let help = lvox(dir.path(), &["help", "build"]).stdout;
    assert!(help.contains("[env: LVOX_TEMP_DIR]"), "{help}");
}
