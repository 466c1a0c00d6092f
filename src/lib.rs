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
mod error;
pub mod gather;
pub mod image;
pub mod inspect;
#[cfg(feature = "lab")]
mod lab;
mod light;
mod math;
pub mod run;
pub mod scene;
pub mod shade;
mod trace;
pub mod tree;

pub use error::{Error, Kind, Result};
pub use lvox_formats as formats;
pub use math::Rgb;

/// What the benchmarks and tests of lvox need beside the public surface. It promises nothing:
/// names here come, change and go with any version.
#[doc(hidden)]
pub mod internals {
    pub use crate::light::{Lights, ShadowRays};
    pub use crate::math::Ray;
    pub use crate::math::sampling::{
        cosine_hemisphere, hash, mix, r2, sobol2, sphere, tangents, unit2,
    };
    pub use crate::math::segment::Composite;
    pub use crate::trace::{Surface, Tracer, offset};

    /// The path tracer.
    #[cfg(feature = "lab")]
    pub mod reference {
        pub use crate::lab::reference::{
            PathTracer, Sampler, Settings, Sums, accumulate, begin, frame, relmse, run, sums,
            sums_path,
        };
    }

    /// Checks against closed forms.
    #[cfg(feature = "lab")]
    pub mod stability {
        pub use crate::lab::stability::{Effort, Family, Row, markdown, run};
    }

    /// Error against run time.
    #[cfg(feature = "lab")]
    pub mod study {
        pub use crate::lab::study::record::Slope;
        pub use crate::lab::study::{Method, Settings, Study, Sweep, run};
    }

    /// Settings for an error.
    #[cfg(feature = "lab")]
    pub mod tune {
        pub use crate::lab::tune::{Choice, Outcome, choose};
    }
}
