//! Plain linear RGB pixels, as metrics and previews want them.

use super::Region;
use crate::Result;

/// Linear Rec.709 pixels, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    /// Pixels in a row.
    pub width: usize,
    /// Rows of pixels.
    pub height: usize,
    /// `width * height` pixels, top row first.
    pub pixels: Vec<[f32; 3]>,
}

impl Picture {
    /// Copies the part of the picture inside a region.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if the region is empty or reaches outside.
    pub fn crop(&self, region: &Region) -> Result<Self> {
        let side = |v: usize| u32::try_from(v).unwrap_or(u32::MAX);
        region.check(side(self.width), side(self.height))?;
        let columns = region.x0 as usize..region.x1 as usize;
        let rows = self.pixels.chunks_exact(self.width);
        let rows = rows.skip(region.y0 as usize).take(region.height() as usize);
        Ok(Self {
            width: columns.len(),
            height: region.height() as usize,
            pixels: rows
                .flat_map(|row| &row[columns.clone()])
                .copied()
                .collect(),
        })
    }

    /// Counts the pixels of which a channel is infinite or not a number.
    #[must_use]
    pub fn non_finite(&self) -> usize {
        let bad = |p: &&[f32; 3]| !p.iter().all(|v| v.is_finite());
        self.pixels.iter().filter(bad).count()
    }
}
