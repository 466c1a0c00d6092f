//! Direct light at a point of a surface or of a medium, with shadow rays that see triangles and
//! media.
//!
//! What a light would send without anything between is computed in closed form; rays measure only
//! the share that arrives. So a point in full light has no noise at all.
//!
//! Points and directions are those of scene space, distances are scene units, light is linear
//! Rec.709.

mod cut;
mod direct;
mod emitter;
mod emitters;
mod environment;
mod few_emitters;
mod in_medium;
mod lamps;
mod lights;
mod many_emitters;
mod prospect;
mod rays;
mod receiver;
mod shading_point;
mod shadows;
mod sharp;
mod sight;
mod soft_shadows;
mod sun;
mod sun_depth;
#[cfg(test)]
mod tests;
mod tree;
mod vacuum;

pub use direct::{Arrival, Direct, is_alike};
pub use emitter::Emitter;
pub use in_medium::InMedium;
pub use lights::Lights;
pub use prospect::Prospect;
pub use rays::ShadowRays;
pub use shadows::{OpticalDepth, SceneMedia, Shadows};
pub use sight::{Dimmed, Dimming, Sight};
pub use soft_shadows::SoftShadows;
pub use sun_depth::SunDepths;
pub use vacuum::Vacuum;
