//! What the program leaves when it ends before its time, and what it says.
//!
//! - `leftovers`, `ends`: one case of each kind, made to happen.
//! - `campaign`: many of them at moments and limits by chance, in every stage that writes. As many
//!   as `LVOX_FAULTS` says for each stage and kind, from the seed `LVOX_FAULTS_SEED`.
//! - `stage`: the stages, what they write undisturbed, and what is right after a fault.
#![cfg(unix)]

mod campaign;
mod ends;
mod leftovers;
mod stage;
#[path = "../support/mod.rs"]
mod support;
