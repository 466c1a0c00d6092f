//! The laboratory: what judges lvox. Nothing that renders imports it.
//!
//! | folder | what it does |
//! | --- | --- |
//! | `reference` | traces paths without bias: the truth that pictures are compared with |
//! | `study` | measures error against run time, over sweeps of settings |
//! | `stability` | compares lvox with closed forms and at extremes |
//! | `tune` | picks the settings of a frame for an error |

pub mod reference;
pub mod stability;
pub mod study;
pub mod tune;
