//! Bytes on disk and nothing else: the cloud (`.lvc`) and tree (`.lvt`) files of lvox. `SPEC.md` is the one statement
//! of both formats.

pub mod record;
