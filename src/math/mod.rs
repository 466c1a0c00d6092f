//! Leaf mathematics: no I/O, nothing of the rest of the crate.
//!
//! | file | what it holds |
//! | --- | --- |
//! | `ray` | rays, and boxes along the axes |
//! | `boxes` | which of many boxes a ray meets |
//! | `hit` | where rays meet triangles |
//! | `color` | linear RGB |
//! | `blackbody` | the light of a black body |
//! | `observer` | colours of spectra |
//! | `spectrum` | optical depths and shares of light, of all channels or of each |
//! | `lanes` | light and shares of light that are summed together |
//! | `segment` | emission and absorption along a ray, front to back |
//! | `dda` | a ray through a regular grid of boxes |
//! | `ray_lattice` | parallel rays through a regular grid |
//! | `phase` | phase functions: values, moments, samples |
//! | `polygon` | closed forms of what a triangle sends to a point |
//! | `sampling` | hashes, low-discrepancy points, and maps to disks and spheres |
//! | `distribution` | a choice of cells of a grid by their weights |
//! | `sphere_map` | light by direction |
//! | `exp` | exponentials that are the same on every machine |
//! | `magnitude` | lengths of any scale brought near 1 |
//! | `index` | numbers of cells in a grid |
//! | `vec3x4` | four vectors at a time |

mod blackbody;
mod boxes;
pub mod color;
pub mod dda;
pub mod distribution;
pub mod exp;
mod hit;
mod index;
pub mod lanes;
pub mod magnitude;
pub mod observer;
mod phase;
pub mod polygon;
mod ray;
pub mod ray_lattice;
pub mod sampling;
pub mod segment;
mod spectrum;
mod sphere_map;
mod vec3x4;

pub use blackbody::blackbody;
pub use boxes::Boxes;
pub use color::Rgb;
pub use hit::Hit;
pub use index::unflatten;
pub use phase::{PhaseFunction, SeenPhase};
pub use ray::{Aabb, Ray};
pub use spectrum::Spectrum;
pub use sphere_map::{Environment, EnvironmentMap, SphereMap};
