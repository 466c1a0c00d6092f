//! The order in which corners are visited: first some that are far apart, then those between.

use super::Corners;
use crate::shade::pixels::camera_media::CameraMedia;
use std::ops::Range;

/// A corner on the way from coarse to fine.
pub(super) struct CornerVisit {
    /// Which of the block's corners it is.
    pub index: usize,
    /// Film coordinates, or 0 where one is negative.
    pub film: [u32; 2],
    /// Where others came before it: in which of its coordinates it lies between them, and how far
    /// away they are.
    pub between: Option<([bool; 2], usize)>,
}

/// Which corners are visited first.
#[derive(Clone, Copy, Debug)]
pub(super) struct FirstCorners {
    /// Corners from one to the next: a power of two, at most 8.
    pub spacing: usize,
    /// Film coordinate of one.
    pub origin: u32,
}

impl<A: CameraMedia> Corners<'_, A> {
    /// By how much film coordinates are moved so that none is negative: more than there are rings
    /// or one that comes first may be past 0, and a multiple of all spacings.
    const MOVED: u32 = 8;

    /// Visits the corners inside a rim, and around them what those between need: first some, then
    /// those half as far apart, down to all.
    pub(super) fn coarse_to_fine(
        &mut self,
        rim: usize,
        first: FirstCorners,
        mut visit: impl FnMut(&mut Self, CornerVisit),
    ) {
        let FirstCorners { spacing, origin } = first;
        let moved = Self::MOVED - origin;
        let [x0, y0] = [self.region.x0, self.region.y0].map(|c| (c + moved - self.rings) as usize);
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
                        film: [x0 + column, y0 + row].map(|c| (c as u32).saturating_sub(moved)),
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
