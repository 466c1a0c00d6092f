//! Light that media scatter towards the camera, looked up on lattices of their own.

mod bricks;
mod density;
mod direct;
mod far_field;
mod filled;
mod inscatter;
mod sparse;
mod stiff;
mod stored;
mod sweep;
#[cfg(test)]
mod tests;
mod vertices;

pub use inscatter::{InScatter, Known, Light};
pub use stored::{Made, pack};
