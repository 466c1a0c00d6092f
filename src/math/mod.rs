//! Leaf mathematics: no I/O, nothing of the rest of the crate.

pub mod color;
pub mod dda;
pub mod exp;
mod hit;
mod index;
pub mod magnitude;
pub mod polygon;
mod ray;
pub mod ray_lattice;
pub mod sampling;
pub mod segment;
mod vec3x4;

pub use color::Rgb;
pub use hit::Hit;
pub use index::unflatten;
pub use ray::{Aabb, Ray};
