//! Memory of files that the system may have back.

use std::fmt::Debug;

/// Memory that comes from a file, and comes again when it is next read.
pub trait GiveBack: Debug + Send + Sync {
    /// Gives all of it back to the system. Whoever reads it meanwhile reads the same.
    fn give_back(&self);
}
