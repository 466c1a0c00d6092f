//! Direct light at a point of a surface or of a medium, with shadow rays that see triangles and
//! media.
//!
//! What a light would send without anything between is computed in closed form; rays measure only
//! the share that arrives. So a point in full light has no noise at all.
//!
//! A *light* is any source of a scene: a *point light*, a *spot light*, a *sun* (a directional
//! light, which may have an angular radius), an *emitter* (an emissive triangle) or the *glow* of
//! emissive volumes. Those without
//! extent are *delta lights*. Points and directions are those of scene space, distances are scene
//! units, light is linear Rec.709.
//!
//! | file | holds |
//! | --- | --- |
//! | `lights` | [`Lights`]: all of a scene, and what a point gets of them |
//! | `direct` | [`DirectLight`] at a point, and the [`ShadowRatio`] of it that arrives |
//! | `visibility` | [`Visibility`]: which lights rays reach, that is, where edges of shadows are |
//! | `in_medium` | [`MediumLight`]: direct light in media, so split that it can be interpolated |
//! | `shading_point` | a point that light falls on, on a surface or in a medium |
//! | `shadow_rays` | [`ShadowRays`]: how many rays go to a light, and to which points of it |
//! | `shadows` | [`Shadows`]: what rays pass, from a vacuum to media made simple |
//! | `delta_lights` | point, spot and parallel lights, at a point and along a segment |
//! | `glow` | the light of emissive volumes |
//! | `groups` | what stands for the lights that are no triangles of a scene that has many |
//! | `sky` | an environment image: what gathers meet, and a light of what is brighter |
//! | `sun` | a directional light with an extent |
//! | `sun_depths` | [`SunDepths`]: the optical depth of media towards suns |
//! | `kept_light` | [`KeptLight`]: suns and skies in media from rays that are kept, for bakes |
//! | `baked_depth` | the depth towards a sun as bakes need it: exact only where light gets |
//! | `voxel_light` | [`VoxelLight`]: that light between the corners of a brick's voxels |
//! | `kept_rays`, `coarse` | such rays, and the coarse cells that they pass |
//! | `open_sky` | where surfaces leave the sky open to a volume |
//! | `checks` | which cells are fine enough, by exact rays |
//! | `emitter`, `emitters` | emissive triangles, their unshadowed light, and rays chosen by it |
//! | `emitter_parts` | the parts that stand for a textured one |
//! | `tree` | what stands for the emitters of a scene that has many |

mod baked_depth;
mod checks;
mod coarse;
mod delta_lights;
mod direct;
mod emitter;
mod emitter_parts;
mod emitters;
mod glow;
mod groups;
mod in_medium;
mod kept_light;
mod kept_rays;
mod lights;
mod open_sky;
mod shading_point;
mod shadow_rays;
mod shadows;
mod sky;
mod sun;
mod sun_depths;
mod tree;
mod visibility;
mod voxel_light;

pub use direct::{DirectLight, ShadowRatio, is_similar};
pub use emitter::Emitter;
pub use emitters::Unshadowed;
pub use in_medium::MediumLight;
pub use kept_light::KeptLight;
pub use lights::Lights;
pub use shadow_rays::ShadowRays;
pub use shadows::{MediaBeforeSuns, SceneMedia, Shadows, SoftShadowMedia, Vacuum};
pub use sun_depths::SunDepths;
pub use visibility::Visibility;
pub use voxel_light::VoxelLight;
