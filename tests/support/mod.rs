//! What several test binaries share.
#![allow(dead_code)] // Each of them uses a part.

pub mod program;
// One generator serves both packages: the golden files of `formats` depend on it.
#[path = "../../formats/tests/common/random.rs"]
pub mod random;
pub mod skip;
pub mod trees;
