//! What the program leaves when it ends before its time, and what it says.
//!
//! - `leftovers`, `ends`: one case of each kind, made to happen.
//! - `stage`: the stages, what they write undisturbed, and what is right after a fault.
#![cfg(unix)]

mod ends;
mod leftovers;
mod stage;
#[path = "../support/mod.rs"]
mod support;
