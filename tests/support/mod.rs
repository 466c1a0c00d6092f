//! What several test binaries share.
#![allow(dead_code)] // Each of them uses a part.

pub mod browser;
// Files of ours with anything changed and right checksums, as the tests of `formats` make them.
#[path = "../../formats/tests/common/parts.rs"]
pub mod parts;
pub mod program;
// One generator serves both packages: the golden files of `formats` depend on it.
#[path = "../../formats/tests/common/random.rs"]
pub mod random;
pub mod skip;
pub mod trees;

use std::path::Path;

/// Names in a folder, sorted.
pub fn names(dir: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(dir).unwrap();
    let mut names: Vec<String> = entries
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}
