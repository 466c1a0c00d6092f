//! What the program leaves when it ends before its time, and what it says.
#![cfg(unix)]

mod leftovers;
#[path = "../support/mod.rs"]
mod support;
