//! scene → cloud: samples surfaces into surfels and media into lvoxels, each with its direct light.

pub mod creases;
pub mod lvoxels;
pub mod surfels;
