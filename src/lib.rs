//! lvox renders colour bleeding in scenes with smoke, cloud and CT volumes from a point cloud.
//!
//! ```text
//! scene ──bake──▶ cloud (.lvc) ──build──▶ tree (.lvt) ──shade──▶ tile.exr … ──merge──▶ image.exr
//!                                             └─scatter─▶ light in media (.lvs) ─┘
//! ```
//!
//! Folders follow that line. Stages (`bake`, `build`, `shade`) share file formats and the leaf
//! modules (`math`, `scene`, `trace`, `light`, `gather`), never each other's code.
//!
//! | what | unit and convention |
//! | --- | --- |
//! | space | right-handed, y up; scene space is world space less a translation, see [`scene::Scene`] |
//! | light | radiance, linear Rec.709 |
//! | extinction | per scene unit |
//! | image | pixel (0,0) top left |

pub mod bake;
pub mod build;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
pub mod error;
pub mod gather;
pub mod image;
pub mod inspect;
#[cfg(feature = "lab")]
pub mod lab;
pub mod light;
pub mod math;
pub mod run;
pub mod scene;
pub mod shade;
pub mod trace;
pub mod tree;

pub use error::{Error, Kind, Result};
pub use lvox_formats as formats;
