//! Pictures: frames and tiles as OpenEXR files, previews, merging of tiles, and error metrics.
//!
//! Radiance is linear Rec.709; pixel (0,0) is top left. A tile is a [`Frame`] whose [`Region`] is
//! smaller than the frame: in the file the display window is the whole frame and the data window is
//! the region. Shaded pixels enter as layers of a [`Frame`] and leave as a file; a picture that is
//! to be compared enters as a file and becomes a [`Picture`], one layer of linear RGB.
//!
//! | file | holds |
//! | --- | --- |
//! | `frame`, `region` | [`Frame`], its [`Layer`]s, and the [`Region`] of a tile |
//! | `picture`, `load` | [`Picture`], and how one is read from a file of either [`ImageKind`] |
//! | `exr`, `header` | frames in OpenEXR files, with the same bytes from any number of threads |
//! | `npy` | frames as arrays of NumPy |
//! | `exposure` | of pictures of eight bits, given or found |
//! | `png`, `tone`, `heat` | eight bits: the tone map, its inverse, and colours of errors |
//! | `merge`, `coverage` | tiles made one frame, once they are known to cover it |
//! | `mix` | images of groups of lights added up |
//! | `write` | a frame in a file of the kind that its name tells |
//! | `cost_map`, `tile_list` | a frame cut into tiles of equal cost, and such tiles in a file |
//! | `onlooker` | one who sees parts of a frame as they are finished |
//! | `metrics` | how far a picture is from a reference |
//! | `samples` | files of samples that a path tracer goes on from |
//! | `subject` | whether two pictures show the same |

mod cost_map;
mod coverage;
mod exposure;
pub mod exr;
mod frame;
mod header;
#[cfg(feature = "lab")]
pub(crate) mod heat;
mod kind;
pub mod load;
mod merge;
pub mod metrics;
pub mod mix;
pub mod npy;
mod onlooker;
mod picture;
pub mod png;
mod region;
// The laboratory alone writes samples; what is left without it inspects them.
#[cfg_attr(not(feature = "lab"), allow(dead_code, unused_imports))]
pub(crate) mod samples;
#[cfg(feature = "lab")]
pub(crate) mod subject;
pub mod tile_list;
pub mod tone;
mod write;

pub use cost_map::{CellCost, CostMap};
pub use exposure::Exposure;
pub use frame::{BACKGROUND_DEPTH, COLOR_SPACE, CameraMatrices, EXPOSURE, Frame, Layer, NotFinite};
pub use kind::ImageKind;
pub use merge::{Merged, Missing, merge, missing};
pub use onlooker::Onlooker;
pub use picture::Picture;
pub use region::Region;
pub use write::write;
