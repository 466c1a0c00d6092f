//! Plain linear RGB pixels, as metrics and previews want them.

/// Linear Rec.709 pixels, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// `width * height` pixels, top row first.
    pub pixels: Vec<[f32; 3]>,
}

impl Picture {
    /// How many pixels have a channel that is infinite or not a number.
    #[must_use]
    pub fn non_finite(&self) -> usize {
        let bad = |p: &&[f32; 3]| !p.iter().all(|v| v.is_finite());
        self.pixels.iter().filter(bad).count()
    }
}
