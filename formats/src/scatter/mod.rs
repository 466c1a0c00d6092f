//! Light that media scatter, `.lvs`: what arrives at vertices of their grids, in parts of 32
//! vertices a side.

mod part;
mod read;
mod write;

pub use part::{PART_CUBES, PART_EDGE, Part, PartPlace, VERTEX_CUBE};
pub use read::Scatter;
pub use write::ScatterWriter;
