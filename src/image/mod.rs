//! Pictures: frames and tiles as OpenEXR files, previews, merging of tiles, and error metrics.
//!
//! Radiance is linear Rec.709; pixel (0,0) is top left. A tile is a [`Frame`] whose [`Region`] is
//! smaller than the frame: in the file the display window is the whole frame and the data window is
//! the region.

mod coverage;
pub mod exr;
pub mod frame;
mod header;
pub mod heat;
pub mod kind;
pub mod load;
pub mod merge;
pub mod metrics;
pub mod picture;
pub mod png;
pub mod region;
pub mod samples;
pub mod subject;
pub mod tone;

pub use frame::{Frame, Layer};
pub use kind::ImageKind;
pub use picture::Picture;
pub use region::Region;
pub use subject::Subject;
