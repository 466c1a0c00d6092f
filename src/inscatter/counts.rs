//! What the light of media takes, counted: steadier than seconds, and held by tests.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Counts while threads work.
#[derive(Debug, Default)]
pub struct Counters {
    /// Cells of a lone volume that camera rays passed.
    pub marched: AtomicU64,
    /// Segments of camera rays whose source function was asked for.
    pub segments: AtomicU64,
    /// Points of media that were lit directly: vertices, and points of rays.
    pub lit: AtomicU64,
    /// Points of media that gathered.
    pub gathered: AtomicU64,
    /// Vertices that were swept.
    pub swept: AtomicU64,
    /// Lvoxels that gather rays and sweeps passed.
    pub lvoxels: AtomicU64,
    /// Cells that all rays of a sweep passed layer by layer.
    pub cells: AtomicU64,
}

/// What lighting the media of a frame took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MediaCounts {
    /// Cells of a lone volume that camera rays passed.
    pub marched: u64,
    /// Segments of camera rays whose source function was asked for.
    pub segments: u64,
    /// Points of media that were lit directly: vertices, and points of rays.
    pub lit: u64,
    /// Points of media that gathered.
    pub gathered: u64,
    /// Vertices that were swept.
    pub swept: u64,
    /// Lvoxels that gather rays of media and sweeps passed.
    pub lvoxels: u64,
    /// Cells that all rays of a sweep passed layer by layer.
    pub cells: u64,
}

impl Counters {
    /// What was counted so far.
    pub fn counts(&self) -> MediaCounts {
        MediaCounts {
            marched: self.marched.load(Relaxed),
            segments: self.segments.load(Relaxed),
            lit: self.lit.load(Relaxed),
            gathered: self.gathered.load(Relaxed),
            swept: self.swept.load(Relaxed),
            lvoxels: self.lvoxels.load(Relaxed),
            cells: self.cells.load(Relaxed),
        }
    }
}

impl MediaCounts {
    /// Adds them to those of a report, by name.
    pub fn list(&self, counts: &mut std::collections::BTreeMap<String, f64>) {
        for (name, count) in [
            ("media_cells_marched", self.marched),
            ("media_segments", self.segments),
            ("media_points_lit", self.lit),
            ("media_points_gathered", self.gathered),
            ("media_vertices_swept", self.swept),
            ("lvoxels_passed", self.lvoxels),
            ("cells_swept", self.cells),
        ] {
            counts.insert(name.to_owned(), count as f64);
        }
    }
}

/// Adds to a count.
#[inline]
pub fn add(counter: &AtomicU64, n: u64) {
    counter.fetch_add(n, Relaxed);
}
