//! A rectangle of pixels, and the exact split of a frame into tiles.

use crate::{Error, Result};
use std::fmt;

/// Half-open rectangle of pixels: `x0 <= x < x1`, `y0 <= y < y1`, in the frame's pixels from its
/// top left corner.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Region {
    /// First column, 0 at the left of the frame.
    pub x0: u32,
    /// First row, 0 at the top of the frame.
    pub y0: u32,
    /// One past the last column.
    pub x1: u32,
    /// One past the last row.
    pub y1: u32,
}

impl Region {
    /// The region that is the whole of a frame.
    #[must_use]
    pub fn full(width: u32, height: u32) -> Self {
        Self {
            x0: 0,
            y0: 0,
            x1: width,
            y1: height,
        }
    }

    /// Finds tile `index` (from 0) of `count` tiles that together cover a frame exactly once.
    ///
    /// The frame is cut across its longer side, in proportion to the tiles that each half will
    /// hold, until one tile is left; so tiles are compact, their areas differ little, and every
    /// count has a split.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if `count` is 0 or exceeds the number of pixels, or if `index` is not
    /// below `count`.
    pub fn tile(full_width: u32, full_height: u32, index: u32, count: u32) -> Result<Self> {
        if index >= count {
            return Err(Error::input(format!("there is no tile {index} of {count}"))
                .hint("tiles are numbered from 0: `tile` 0/4 is the first of four"));
        }
        let pixels = u64::from(full_width) * u64::from(full_height);
        if u64::from(count) > pixels {
            return Err(Error::input(format!(
                "cannot split {full_width}x{full_height} pixels into {count} tiles"
            ))
            .hint("use fewer tiles"));
        }
        let mut tile = Self::full(full_width, full_height);
        let (mut index, mut count) = (u64::from(index), u64::from(count));
        while count > 1 {
            let across = tile.width() >= tile.height();
            let (long, short) = if across {
                (u64::from(tile.width()), u64::from(tile.height()))
            } else {
                (u64::from(tile.height()), u64::from(tile.width()))
            };
            let cut = (long * (count / 2) / count).clamp(1, long - 1);
            // How many tiles go before the cut: in proportion to its pixels, and no more on either
            // side than pixels.
            let rest = (long - cut) * short;
            let before = (count * cut + long / 2) / long;
            let before = before.clamp(
                count.saturating_sub(rest).max(1),
                (count - 1).min(cut * short),
            );
            // Below u32::MAX: it lies inside a side of the tile.
            let cut = cut as u32;
            let first = index < before;
            match (across, first) {
                (true, true) => tile.x1 = tile.x0 + cut,
                (true, false) => tile.x0 += cut,
                (false, true) => tile.y1 = tile.y0 + cut,
                (false, false) => tile.y0 += cut,
            }
            if first {
                count = before;
            } else {
                index -= before;
                count -= before;
            }
        }
        Ok(tile)
    }

    /// Checks that the region holds pixels and lies inside a frame.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] naming the region and the frame.
    pub fn check(&self, full_width: u32, full_height: u32) -> Result<()> {
        if self.x0 >= self.x1 || self.y0 >= self.y1 {
            return Err(Error::input(format!("region {self} holds no pixels"))
                .hint("a region is X0 Y0 X1 Y1 with X1 and Y1 exclusive"));
        }
        if self.x1 > full_width || self.y1 > full_height {
            return Err(Error::input(format!(
                "region {self} reaches outside the frame of {full_width}x{full_height} pixels"
            ))
            .hint(format!(
                "a region is X0 Y0 X1 Y1 with X1 and Y1 exclusive; the whole frame is 0 0 \
                 {full_width} {full_height}"
            )));
        }
        Ok(())
    }

    /// Splits the region into blocks of at most so many columns and rows of pixels that together
    /// cover it exactly once, row by row.
    #[must_use]
    pub fn blocks(&self, [width, height]: [u32; 2]) -> Vec<Self> {
        let cuts = |from: u32, to: u32, size: u32| {
            let size = size.max(1);
            (from..to)
                .step_by(size as usize)
                .map(move |a| (a, to.min(a.saturating_add(size))))
        };
        cuts(self.y0, self.y1, height)
            .flat_map(|(y0, y1)| {
                cuts(self.x0, self.x1, width).map(move |(x0, x1)| Self { x0, y0, x1, y1 })
            })
            .collect()
    }

    /// Columns of pixels; 0 if the last is before the first.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.x1.saturating_sub(self.x0)
    }

    /// Rows of pixels; 0 if the last is before the first.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.y1.saturating_sub(self.y0)
    }

    /// Column and row of each pixel, row by row.
    pub fn coordinates(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let Self { x0, y0, x1, y1 } = *self;
        (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (x, y)))
    }

    /// Pixels in all: columns times rows.
    #[must_use]
    pub fn pixels(&self) -> usize {
        self.width() as usize * self.height() as usize
    }

    /// Whether `other` lies inside.
    #[must_use]
    pub fn contains(&self, other: &Self) -> bool {
        self.x0 <= other.x0 && self.y0 <= other.y0 && self.x1 >= other.x1 && self.y1 >= other.y1
    }
}

/// As it is written on the command line: `X0 Y0 X1 Y1`.
impl fmt::Display for Region {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {} {} {}", self.x0, self.y0, self.x1, self.y1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn assert_covers_once(width: u32, height: u32, count: u32) {
        let mut seen = vec![0u8; width as usize * height as usize];
        for index in 0..count {
            let tile = Region::tile(width, height, index, count).unwrap();
            tile.check(width, height).unwrap();
            for y in tile.y0..tile.y1 {
                for x in tile.x0..tile.x1 {
                    seen[y as usize * width as usize + x as usize] += 1;
                }
            }
        }
        assert!(
            seen.iter().all(|&n| n == 1),
            "{width}x{height} in {count} tiles"
        );
    }

    #[test]
    fn every_count_covers_a_small_frame() {
        for (width, height) in [(1, 1), (1, 7), (7, 1), (3, 3), (5, 4), (8, 8)] {
            for count in 1..=width * height {
                assert_covers_once(width, height, count);
            }
        }
    }

    #[test]
    fn powers_of_two_split_evenly() {
        for index in 0..16 {
            let tile = Region::tile(512, 384, index, 16).unwrap();
            assert_eq!((tile.width(), tile.height()), (128, 96));
        }
    }

    #[test]
    fn impossible_splits_are_input_errors() {
        for (index, count) in [(0, 0), (4, 4), (0, 13)] {
            let error = Region::tile(4, 3, index, count).unwrap_err();
            assert_eq!(error.kind(), crate::Kind::Input);
        }
        Region::tile(u32::MAX, u32::MAX, u32::MAX - 1, u32::MAX).unwrap();
    }

    #[test]
    fn check_names_what_is_wrong() {
        let empty = Region {
            x0: 3,
            y0: 0,
            x1: 3,
            y1: 4,
        };
        assert!(
            empty
                .check(8, 8)
                .unwrap_err()
                .to_string()
                .contains("3 0 3 4")
        );
        let outside = Region {
            x0: 0,
            y0: 0,
            x1: 9,
            y1: 4,
        };
        assert!(outside.check(8, 8).unwrap_err().to_string().contains("8x8"));
    }

    proptest! {
        #[test]
        fn tiles_cover_exactly_once(width in 1u32..90, height in 1u32..90, count in 1u32..200) {
            prop_assume!(count <= width * height);
            assert_covers_once(width, height, count);
        }

        #[test]
        fn areas_differ_little(width in 64u32..2000, height in 64u32..2000, count in 1u32..64) {
            let areas: Vec<usize> = (0..count)
                .map(|i| Region::tile(width, height, i, count).unwrap().pixels())
                .collect();
            let mean = width as f64 * height as f64 / f64::from(count);
            let largest = *areas.iter().max().unwrap() as f64;
            prop_assert!(largest <= 1.5 * mean + f64::from(width.max(height)), "{areas:?}");
        }
    }
}
