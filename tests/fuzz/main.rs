//! Damaged files of every format that is read, made from small whole ones: an error or a result
//! comes of each, soon and within bounded memory, never a panic.
//!
//! A fixed number of cases runs each time. More run by the environment: `LVOX_FUZZ_CASES` for each
//! reader, from `LVOX_FUZZ_FIRST` on, of the sequence `LVOX_FUZZ_SEED`.
//!
//! - `harness`: changes to files, what may come of them, counted memory.
//! - `corpus`: small whole files. `scenes`: meshes, volumes, textures, scenes, tiles. `own`: the
//!   formats of lvox.

mod corpus;
mod harness;
mod own;
mod scenes;
#[path = "../support/mod.rs"]
mod support;
