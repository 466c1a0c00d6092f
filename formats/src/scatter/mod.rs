//! The file of scattered light, `.lvs`: light that arrives at vertices inside media.
//!
//! - `cluster`: some of 32 x 32 x 32 vertices and their light, to columns and back.
//! - `write`: clusters to a file.
//! - `read`: a file to clusters.

mod cluster;
mod read;
mod write;

pub use cluster::{CLUSTER_CUBES, CLUSTER_EDGE, CUBE_EDGE, ClusterId, VertexCluster};
pub use read::{Scatter, ScatterFormat};
pub use write::ScatterWriter;
