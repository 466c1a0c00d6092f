//! Files of samples, such as `lvox reference` keeps beside its image to go on from: sums for every
//! pixel, and what they were made from. `formats/SPEC.md` has the layout.

mod head;
mod rows;

pub use head::{Head, Origin, Unreadable, VERSION};
pub use rows::{Row, Rows, count_range, sum_bytes, write};
