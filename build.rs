//! Tells the path tracer what it is made of: `LVOX_PATH_TRACER` is a digest of the sources that its
//! samples come from, by which kept samples of other code are known.

use std::io;
use std::path::{Path, PathBuf};
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
    Ok(())
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
