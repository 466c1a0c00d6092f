//! Pictures in the making, for one who looks on.

use super::Region;

/// One who looks on while a frame is made.
pub trait Onlooker: Sync + std::fmt::Debug {
    /// A part of the frame is finished: its pixels row by row, in planes of which the first three
    /// are the beauty, and the fourth alpha where it was asked for. Called by many threads; what it
    /// takes is taken from the frame.
    fn see(&self, region: Region, planes: &[Vec<f32>]);
}
