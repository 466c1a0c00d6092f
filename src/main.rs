//! The `lvox` program.
fn main() {}
