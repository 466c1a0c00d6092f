//! From primary rays to pixels: samples at their corners, which neighbours share, and of their own where those disagree.

mod blocks;
mod corners;
mod emitter_borders;
mod piece;
mod pixel;
mod pixel_sum;
mod sample;
mod shader;

pub use blocks::shade_region;
pub use emitter_borders::EmitterBorders;
pub use pixel::Pixel;
pub use sample::SampleCounts;
pub use shader::PixelShader;
