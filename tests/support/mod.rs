//! What several test binaries share.
#![allow(dead_code)] // Each of them uses a part.

pub mod program;
pub mod random;
pub mod skip;
pub mod trees;
