//! The laboratory: what judges lvox. Nothing that renders imports it.

pub mod reference;
pub mod stability;
pub mod study;
pub mod tune;
