//! Tells the program what it is made of: `LVOX_COMMIT` is the commit of its sources, where that is known,
//! `LVOX_TARGET` the platform that it is for, and `LVOX_PATH_TRACER` a digest of the sources that samples of
//! the path tracer come from, by which kept samples of other code are known.

use std::io;
use std::path::{Path, PathBuf};
use std::process::Command;
use xxhash_rust::xxh3::Xxh3;

/// What a sample depends on: its own code, and that of the crates, by their versions.
const SOURCES: &[&str] = &[
    "Cargo.lock",
    "src/math",
    "src/lab/reference",
    "src/scene",
    "src/trace",
];

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    let mut files = Vec::new();
    for source in SOURCES {
        println!("cargo::rerun-if-changed={source}");
        collect(Path::new(source), &mut files)?;
    }
    files.sort();
    let mut digest = Xxh3::new();
    for file in &files {
        let bytes = std::fs::read(file)?;
        let name = file.to_string_lossy().replace('\\', "/");
        digest.update(format!("{name} {}\n", bytes.len()).as_bytes());
        digest.update(&bytes);
    }
    println!(
        "cargo::rustc-env=LVOX_PATH_TRACER={:032x}",
        digest.digest128()
    );
    println!(
        "cargo::rustc-env=LVOX_COMMIT={}",
        commit().unwrap_or_default()
    );
    let target = std::env::var("TARGET").unwrap_or_default();
    println!("cargo::rustc-env=LVOX_TARGET={target}");
    Ok(())
}

/// The commit that the sources are of, with a plus if they were changed since. A published package has it in
/// a file, a clone in its history.
fn commit() -> Option<String> {
    const SHORT: usize = 12;
    const PACKAGED: &str = ".cargo_vcs_info.json";
    println!("cargo::rerun-if-env-changed=LVOX_COMMIT");
    if let Ok(given) = std::env::var("LVOX_COMMIT") {
        return Some(given);
    }
    if let Ok(packaged) = std::fs::read_to_string(PACKAGED) {
        let after = packaged.split("\"sha1\": \"").nth(1)?;
        return after.get(..SHORT).map(str::to_owned);
    }
    // A clone of something else may be around these sources.
    if !Path::new(".git").exists() {
        return None;
    }
    let git = |words: &[&str]| {
        let done = Command::new("git").args(words).output().ok()?;
        let text = String::from_utf8(done.stdout).ok()?;
        done.status.success().then(|| text.trim_end().to_owned())
    };
    // Not where the history says what is checked out: a commit alone is no reason to build again. What was
    // built before it is that of its parent, with a plus.
    const OF_PROGRAM: [&str; 5] = ["build.rs", "Cargo.toml", "Cargo.lock", "formats", "src"];
    for path in OF_PROGRAM {
        println!("cargo::rerun-if-changed={path}");
    }
    let length = format!("--short={SHORT}");
    let commit = git(&["rev-parse", &length, "HEAD"])?;
    let status = ["status", "--porcelain", "--"];
    let changed = git(&[&status[..], &OF_PROGRAM].concat())?;
    Some(commit + if changed.is_empty() { "" } else { "+" })
}

/// All files below a path; none if it is not there, as `Cargo.lock` is not everywhere.
fn collect(path: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    if path.is_dir() {
        for entry in path.read_dir()? {
            collect(&entry?.path(), files)?;
        }
    } else if path.is_file() {
        files.push(path.into());
    }
    Ok(())
}
