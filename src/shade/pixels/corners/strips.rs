//! Rows of corners on their way from camera rays to pixels, a strip at a time.
//!
//! Each step needs what the one before made of rows further on: media and indirect light go from
//! corners that are up to four apart to those between, and penumbrae are told by two rows on either
//! side. Strips end at rows in which the coarsest corners stand, so that nothing between needs the
//! strip after.

use super::{Corners, Visit};
use crate::gather::Medium;
use crate::shade::air::{Air, Passed};
use crate::tree::Pages;
use std::ops::Range;

impl<'a, P: Pages, M: Medium, A: Air> Corners<'a, P, M, A> {
    /// Most corners from one to the next where few are looked at first, a power of two.
    const COARSEST: usize = 4;
    /// Rows of a strip, a multiple of that.
    const STRIP: usize = 16;

    /// Makes four rows of corners from `first` on ready for pixels. Those before `first` are not
    /// needed any more.
    pub(super) fn prepare(&mut self, first: usize) {
        // Corners between those of the last row and of the strip to come look at both.
        let last = self.sampled().saturating_sub(1);
        let mut keep = first.min(last);
        if self.has_penumbrae() {
            keep = keep.min(self.first_for_penumbrae());
        }
        self.forget(keep);
        while first + 3 >= self.ready && self.sampled() < self.height {
            let rows = self.sampled()..self.end_of_strip();
            self.sampler.add_rows(rows.clone(), &mut self.corners);
            // Before any corner asks more of the lights: those of the outer rings do not, but they
            // do in regions of their own, and whether media are alike must not depend on the
            // region.
            if !A::Passed::IS_VACUUM {
                self.pass_media(rows.clone());
            }
            self.look_around(rows.clone());
            self.ready = rows.end;
            if self.has_penumbrae() {
                self.ready = self.look_into_penumbrae();
            }
        }
    }

    /// Rows of which camera rays are known.
    pub(super) fn sampled(&self) -> usize {
        self.first_row + self.corners.len() / self.width
    }

    /// Where a corner is among those in memory.
    #[inline]
    pub(super) fn index(&self, row: usize, column: usize) -> usize {
        (row - self.first_row) * self.width + column
    }

    /// One past the last row of the strip to come.
    fn end_of_strip(&self) -> usize {
        let offset = self.region.y0 as usize % Self::COARSEST;
        let least = self.sampled() + offset + Self::STRIP - 1;
        let last = least.next_multiple_of(Self::COARSEST) - offset;
        (last + 1).min(self.height)
    }

    /// Gives the memory of rows before one to those to come.
    fn forget(&mut self, row: usize) {
        let gone = self.index(row, 0);
        self.corners.drain(..gone);
        self.is_full_light
            .drain(..gone.min(self.is_full_light.len()));
        self.first_row = row;
    }

    /// Visits those of some rows that are inside a rim, and around them what those between need:
    /// first those that are `spacing` apart, then those half as far apart, down to all. Rows before
    /// them have been visited, and they end at one of the coarsest, or with the last.
    pub(super) fn coarse_to_fine(
        &mut self,
        rows: Range<usize>,
        rim: usize,
        spacing: usize,
        mut visit: impl FnMut(&mut Self, Visit),
    ) {
        let [x0, y0] = [self.region.x0, self.region.y0].map(|c| c as usize);
        let mut step = spacing;
        while step > 0 {
            let is_first = step == spacing;
            // Corners between need those up to one step less one away.
            let rim = rim + 1 - step;
            let rows = rows.start.max(rim)..rows.end.min(self.height - rim);
            for row in from_multiple(rows, y0, step, 0) {
                let row_is_between = (y0 + row) % (2 * step) != 0;
                // In rows of the steps before, every second was visited then.
                let (apart, offset) = if is_first || row_is_between {
                    (step, 0)
                } else {
                    (2 * step, step)
                };
                for column in from_multiple(rim..self.width - rim, x0, apart, offset) {
                    let column_is_between = (x0 + column) % (2 * step) != 0;
                    let is_between = [column_is_between, row_is_between];
                    let at = Visit {
                        index: self.index(row, column),
                        moved: [x0 + column, y0 + row].map(|c| c as u32),
                        between: (!is_first).then_some((is_between, step)),
                    };
                    visit(self, at);
                }
            }
            step /= 2;
        }
    }
}

/// Those of some places, counted from `origin`, that are `offset` past a multiple of `apart`.
fn from_multiple(
    places: Range<usize>,
    origin: usize,
    apart: usize,
    offset: usize,
) -> impl Iterator<Item = usize> {
    let past = (origin + places.start + apart - offset) % apart;
    let first = places.start + (apart - past) % apart;
    (first..places.end).step_by(apart)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_as_far_apart_as_asked_wherever_they_begin() {
        for (origin, start, apart) in (0..9)
            .flat_map(|o| (0..9).map(move |s| (o, s)))
            .flat_map(|(o, s)| [1, 2, 4, 8].map(|a| (o, s, a)))
        {
            for offset in [0, apart / 2] {
                let is_one = |p: &usize| (origin + p) % apart == offset;
                let expected: Vec<_> = (start..start + 20).filter(is_one).collect();
                let found = from_multiple(start..start + 20, origin, apart, offset);
                assert_eq!(found.collect::<Vec<_>>(), expected);
            }
        }
    }
}
