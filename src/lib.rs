//! lvox renders colour bleeding in scenes with smoke, cloud and CT volumes from a point cloud.
//!
//! ```text
//! scene ──bake──▶ cloud (.lvc) ──build──▶ tree (.lvt) ──shade──▶ tile.exr … ──merge──▶ image.exr
//!                                             └─scatter─▶ light in media (.lvs) ─┘
//! ```
//!
//! A scene is baked and its tree built once; any number of frames and tiles are then shaded from
//! the tree, on any number of machines. Light can be gathered from a tree alone, too, at points of
//! the caller's choice:
//!
//! ```
//! use glam::{DAffine3, DVec3, Vec3};
//! use lvox::formats::Overwrite;
//! use lvox::gather::{self, PointGatherer};
//! use lvox::image::Region;
//! use lvox::scene::{CameraInput, Film, Grid, LightInput, MeshInput, SceneBuilder, VolumeInput};
//! use lvox::{bake, build, run::Job, shade, tree::OpenTree};
//!
//! // A red floor, a light over it, and a cube of fog between them.
//! let corners = [[-1.0, 0.0, -1.0], [-1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, -1.0]];
//! let floor = MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]]);
//! let fog = Grid::from_fn([4; 3], |_| 1.0);
//! let world_from_fog =
//!     DAffine3::from_translation(DVec3::new(-0.5, 0.2, -0.5)) * DAffine3::from_scale(DVec3::splat(0.25));
//! let scene = SceneBuilder::new("floor and fog")
//!     .film(Film { width: 16, height: 12, exposure: 1.0 })
//!     .camera(CameraInput::look_at("front", [0.0, 1.0, 4.0], [0.0, 0.5, 0.0], [0.0, 1.0, 0.0], 0.7)?)
//!     .mesh(floor.albedo([0.8, 0.1, 0.1]))
//!     .light(LightInput::point([0.0, 3.0, 0.0], [8.0; 3]))
//!     .volume(VolumeInput::new("fog", fog, [0.9; 3], world_from_fog))
//!     .build()?;
//!
//! let folder = tempfile::tempdir()?;
//! let (cloud, tree) = (folder.path().join("scene.lvc"), folder.path().join("scene.lvt"));
//! // A job carries limits, progress and cancellation; this one is silent and has no limits.
//! let job = Job::default();
//! let settings = bake::Settings {
//!     surfels: bake::SurfelSampling::Area { count: 1000 },
//!     ..bake::Settings::default()
//! };
//! bake::run(&scene, &settings, &cloud, Overwrite::Refuse, &job)?;
//! build::run(&cloud, &tree, &build::Settings::default(), Overwrite::Refuse, &job)?;
//!
//! let tree = OpenTree::open(&tree, job.memory_limit)?;
//! let frame = Region::full(scene.film.width, scene.film.height);
//! let image = shade::run(&scene, &tree, &shade::Settings::default(), frame, &[], &job)?;
//! assert_eq!((image.width, image.height), (16, 12));
//!
//! // What the floor and the fog send to a point beside them, that faces them: it is reddish.
//! let gatherer = PointGatherer::new(&tree, gather::Settings::default());
//! let [red, green, _] = gatherer.irradiance(Vec3::new(0.0, 0.5, 2.0), Vec3::NEG_Z, 0)?.light.0;
//! assert!(red > 2.0 * green && green > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The modules are the stages and what passes between them: [`scene`] (load or make one), [`bake`],
//! [`build`], [`bounce`] (every bounce), [`scatter`] (light of media for all cameras), [`shade`],
//! [`tree`] and [`gather`] (open trees, light at points), [`points`] (files of points), [`image`]
//! (read, write, merge and compare pictures), [`inspect`] (what files hold, and whether they are
//! whole), [`pack`] (a scene as one file), [`formats`] (the files themselves), and [`run`] (what
//! each stage gets beside its data).
//!
//! | what | unit and convention |
//! | --- | --- |
//! | space | right-handed, y up; scene space is world space less a translation, see [`scene::Scene`] |
//! | light | radiance, linear Rec.709 |
//! | extinction | per scene unit |
//! | image | pixel (0,0) top left |

pub mod bake;
pub mod bounce;
pub mod build;
#[cfg(feature = "cli")]
#[doc(hidden)]
pub mod cli;
mod column;
mod error;
pub mod gather;
pub mod image;
mod inscatter;
pub mod inspect;
#[cfg(feature = "lab")]
mod lab;
mod light;
mod math;
pub mod pack;
pub mod points;
pub mod run;
pub mod scatter;
pub mod scene;
pub mod shade;
mod trace;
pub mod tree;
mod view;

pub use error::{Error, Kind, Result};
pub use lvox_formats as formats;
pub use math::{Aabb, Ray, Rgb};

/// What the benchmarks and tests of lvox need beside the public surface. It promises nothing:
/// names here come, change and go with any version.
#[doc(hidden)]
pub mod internals {
    pub use crate::gather::cone::Scratch;
    pub use crate::gather::patch_radiance::MAX_PACKET;
    pub use crate::light::{Lights, SceneMedia, ShadowRays};
    pub use crate::math::Environment;
    pub use crate::math::sampling::{
        cosine_hemisphere, hash, mix, r2, sobol2, sphere, tangents, unit2,
    };
    pub use crate::math::segment::Composite;
    pub use crate::trace::{Surface, Tracer, offset};

    /// What a process has taken from the machine.
    pub mod usage {
        pub use crate::run::usage::{cpu_secs, peak_memory_bytes, with_peak_memory};
    }

    /// Gathers as stages make them, over any store and with any kernel.
    pub mod gather {
        pub use crate::gather::crossing::Crossing;
        pub use crate::gather::gatherer::{Gatherer, RayKernel, RaySettings, SampleRange};
        pub use crate::gather::medium::{Medium, NoMedia};
        pub use crate::gather::neighbours::SurfacePoint;
        pub use crate::gather::patch_radiance::{PatchRadiance, PatchRequest};
    }

    /// What an open tree holds.
    pub mod tree {
        use crate::tree::OpenTree;
        pub use crate::tree::media::Media;
        pub use crate::tree::pages::{Page, SurfelStore};

        /// The pages of surfels of a tree.
        #[must_use]
        pub fn surfels(tree: &OpenTree) -> &SurfelStore {
            &tree.surfels
        }

        /// The lvoxels of a tree.
        #[must_use]
        pub fn media(tree: &OpenTree) -> &Media {
            &tree.media
        }
    }

    /// The kernel that takes nodes whole.
    pub mod cone {
        pub use crate::gather::cone::cast;
    }

    /// The kernel of the paper.
    pub mod plain {
        pub use crate::gather::plain::{cast, cast_in_order};
    }

    /// Metrics of images, one by one.
    pub mod metric {
        pub use crate::image::metrics::flip::error_map as flip_map;
        pub use crate::image::metrics::grain::rms as grain;
        pub use crate::image::metrics::linear::compare as linear;
        pub use crate::image::metrics::pdiff::fraction as pdiff;
        pub use crate::image::metrics::ssim::mean as ssim;
    }

    /// The path tracer.
    #[cfg(feature = "lab")]
    pub mod reference {
        pub use crate::lab::reference::{
            PathTracer, Sampler, Settings, Start, Sums, accumulate, begin, frame, relmse, run,
            sums, sums_path,
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
