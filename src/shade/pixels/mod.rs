//! From primary rays to pixels: samples at their corners, which neighbours share, and of their own
//! where those disagree.
//!
//! A region and what a [`PixelShader`] may look at enter; planes of numbers leave, of which images
//! are made.
//!
//! | file | what it does |
//! | --- | --- |
//! | `blocks` | shares a region out to threads |
//! | `corners/` | samples at the corners of a block, and pixels as their means |
//! | `shader` | pixels by samples of their own |
//! | `sample`, `piece` | a primary ray; a smooth piece of surface in a pixel |
//! | `pattern`, `paint` | where samples lie inside a pixel; means of textures over it |
//! | `emitter_borders` | the share of a pixel that emitters cover, in closed form |
//! | `camera_media` | what camera rays pass, as a type |
//! | `lens/` | the same for cameras with a lens, or that move while their shutter is open |
//! | `pixel`, `pixel_sum` | a shaded pixel, and one in the making |
//! | `ends` | where samples end: depth, position, albedo, alpha |
//! | `pilot` | what a pixel takes, told by its corners |
//! | `planes`, `layers` | what is kept of pixels, and the layers of the image |

mod blocks;
mod camera_media;
mod corners;
mod emitter_borders;
mod ends;
mod layers;
mod lens;
mod paint;
mod pattern;
mod piece;
mod pilot;
mod pixel;
mod pixel_sum;
mod planes;
mod sample;
mod shader;

pub use blocks::shade_region;
pub use camera_media::{CameraMedia, EmissiveMedia, March, PassedMedia, ScatteringMedia};
pub use emitter_borders::EmitterBorders;
pub use layers::{Aov, Planes, Quantity, quantities, to_frame};
pub use lens::{Confusion, most_spread_into, shade_region as shade_region_by_lens, spread_into};
pub use pilot::{PilotMarch, PilotPixel};
pub use sample::SampleCounts;
pub use shader::{EndsOfView, PixelShader};
