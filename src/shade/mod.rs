//! shade.
