//! The order in which corners are visited: first some that are far apart, then those between.

use super::Corners;
use crate::shade::pixels::camera_media::CameraMedia;
use std::ops::Range;

/// A corner on the way from coarse to fine.
pub(super) struct CornerVisit {
    /// Which of the block's corners it is.
    pub index: usize,
    /// Film coordinates moved so far that none is negative.
    pub moved: [u32; 2],
    /// Where others came before it: in which of its coordinates it lies between them, and how far
    /// away they are.
    pub between: Option<([bool; 2], usize)>,
}

impl<A: CameraMedia> Corners<'_, A> {
    /// Visits the corners inside a rim, and around them what those between need: first those that
    /// are `spacing` apart, a power of two, then those half as far apart, down to all.
    pub(super) fn coarse_to_fine(
        &mut self,
        rim: usize,
        spacing: usize,
        mut visit: impl FnMut(&mut Self, CornerVisit),
    ) {
        let [x0, y0] = [self.region.x0, self.region.y0].map(|c| c as usize);
        let mut step = spacing;
        while step > 0 {
            let is_first = step == spacing;
            // Corners between need those up to one step less one away.
            let rim = rim + 1 - step;
            for row in from_multiple(rim..self.height - rim, y0, step, 0) {
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
                    let at = CornerVisit {
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
