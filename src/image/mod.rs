//! Pictures: frames and tiles as OpenEXR files, previews, merging of tiles, and error metrics.
//!
//! Radiance is linear Rec.709; pixel (0,0) is top left. A tile is a [`Frame`] whose [`Region`] is
//! smaller than the frame: in the file the display window is the whole frame and the data window is
//! the region.

mod coverage;
pub mod exr;
pub(crate) mod frame;
mod header;
pub mod heat;
pub(crate) mod kind;
pub mod load;
pub mod merge;
pub mod metrics;
pub(crate) mod picture;
pub mod png;
pub(crate) mod region;
// The path tracer of the laboratory writes samples; everybody may inspect them.
#[cfg_attr(not(feature = "lab"), allow(dead_code, unused_imports))]
pub(crate) mod samples;
pub(crate) mod subject;
pub mod tone;

pub use frame::{Frame, Layer};
pub use kind::ImageKind;
pub use picture::Picture;
pub use region::Region;
pub use subject::Subject;
