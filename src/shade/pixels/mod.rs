//! From primary rays to pixels: samples at their corners, which neighbours share, and of their own
//! where those disagree.

mod blocks;
mod corners;
mod emitter_borders;
mod paint;
mod pattern;
mod piece;
mod pixel;
mod pixel_sum;
mod planes;
mod sample;
mod shader;

pub use blocks::shade_region;
pub use emitter_borders::EmitterBorders;
pub use planes::Planes;
pub use sample::SampleCounts;
pub use shader::PixelShader;
