//! Tests that need what is not in the repository, and say so where it is not there.

use std::io::Write;
use std::path::{Path, PathBuf};

/// A file or folder of the data beside the repository; without it the test is skipped.
pub fn shared(path: &str) -> Option<PathBuf> {
    let found = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    let found = found.join(path);
    if !found.exists() {
        skip(&format!("needs ../shared/{path}"));
        return None;
    }
    Some(found)
}

/// Says that this test ends without having tested. Past the harness, which keeps what a test prints
/// to itself if the test returns; `.ci/run` counts these lines.
pub fn skip(why: &str) {
    let thread = std::thread::current();
    let line = format!("SKIPPED: {}: {why}\n", thread.name().unwrap_or("a test"));
    let _ = std::io::stderr().write_all(line.as_bytes());
}
