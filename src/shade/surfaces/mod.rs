//! Indirect light on surfaces.
//!
//! A view, lights and gathers from a tree enter; irradiance at any surface that a region sees
//! leaves ([`Lattice::irradiance`], or [`GatherAtSurfaces::gather`] where few pixels see it).
//!
//! | file | what it does |
//! | --- | --- |
//! | `gatherer` | gathers over the hemisphere, and from bright patches |
//! | `lattice/` | gathers at few pixels of the frame, averaged and spread to all; kept for other tiles |
//! | `with_sky` | light of which a part comes straight from the sky |
//! | `bright/` | bright patches as lights of their own, found by pilot gathers |

mod bright;
mod gatherer;
mod lattice;
mod with_sky;

pub use bright::BrightPatchLights;
pub use gatherer::{GatherAtSurfaces, SurfaceGatherer};
pub use lattice::{KeptGathers, Lattice};
pub use with_sky::WithSky;
