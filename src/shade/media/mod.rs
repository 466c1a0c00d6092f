//! Light that media scatter towards the camera, looked up on lattices of their own.

mod bricks;
mod density;
mod direct;
mod far_field;
mod inscatter;
mod sparse;
mod stiff;
mod sweep;
#[cfg(test)]
mod tests;
mod vertices;

pub use inscatter::{InScatter, Known};
