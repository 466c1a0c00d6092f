//! Rectangles of the frame's lattice.

use crate::image::Region;

/// A rectangle of the frame's lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct Area {
    pub first: [u32; 2],
    pub count: [u32; 2],
}

impl Area {
    /// What lies within `reach` steps of a region's pixels and their corners.
    pub fn around(region: Region, step: u32, reach: u32, film: [u32; 2]) -> Self {
        let from = |v: u32| (v / step).saturating_sub(reach);
        // A pixel's lower right corner has the next one's coordinates.
        let to = |v: u32, n: u32| (v / step + 1 + reach).min((n - 1) / step);
        let first = [from(region.x0), from(region.y0)];
        let last = [to(region.x1, film[0]), to(region.y1, film[1])];
        Self {
            first,
            count: [last[0] - first[0] + 1, last[1] - first[1] + 1],
        }
    }

    /// The squares of so many by so many places of the whole lattice that the area has a part in.
    pub fn squares(&self, side: u32) -> Vec<[u32; 2]> {
        let [columns, rows] = self.squares_along(side);
        rows.flat_map(|j| columns.clone().map(move |i| [i, j]))
            .collect()
    }

    pub fn squares_along(&self, side: u32) -> [std::ops::Range<u32>; 2] {
        [0, 1].map(|a| self.first[a] / side..(self.first[a] + self.count[a]).div_ceil(side))
    }

    /// How many places.
    pub fn len(&self) -> usize {
        self.count[0] as usize * self.count[1] as usize
    }

    pub fn columns(&self) -> std::ops::Range<u32> {
        self.first[0]..self.first[0] + self.count[0]
    }

    pub fn rows(&self) -> std::ops::Range<u32> {
        self.first[1]..self.first[1] + self.count[1]
    }

    /// All of them, row by row.
    pub fn places(&self) -> impl Iterator<Item = [u32; 2]> + use<> {
        let columns = self.columns();
        self.rows()
            .flat_map(move |j| columns.clone().map(move |i| [i, j]))
    }

    /// Which one it is, row by row.
    pub fn index(&self, at: [u32; 2]) -> Option<usize> {
        let [i, j] = [0, 1].map(|a| at[a].wrapping_sub(self.first[a]));
        let inside = i < self.count[0] && j < self.count[1];
        inside.then(|| j as usize * self.count[0] as usize + i as usize)
    }

    /// Columns and rows of the area that are at most `reach` from a point, all in steps.
    pub fn near(&self, centre: [f32; 2], reach: f32) -> [std::ops::Range<u32>; 2] {
        [0, 1].map(|a| {
            let from = (centre[a] - reach).ceil().max(self.first[a] as f32) as u32;
            let to = (centre[a] + reach).floor() as u32 + 1;
            from..to.min(self.first[a] + self.count[a])
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_of_the_largest_film_can_be_counted() {
        const SIDE: u32 = 65_536;
        let film = Region::full(SIDE, SIDE);
        let area = Area::around(film, 1, 2, [SIDE; 2]);
        assert_eq!(area.len(), 1 << 32);
        assert_eq!(area.index([SIDE - 1; 2]), Some((1 << 32) - 1));
        assert_eq!(area.index([SIDE, 0]), None);
    }

    #[test]
    fn what_is_near_a_point_is_in_the_area() {
        let area = Area {
            first: [3, 1],
            count: [4, 5],
        };
        assert_eq!(area.near([5.0, 3.5], 2.0), [3..7, 2..6]);
        assert_eq!(area.near([3.0, 5.5], 1.5), [3..5, 4..6]);
        let [columns, rows] = area.near([-0.5, 0.0], 1.5);
        assert!(columns.is_empty() && rows == (1..2));
    }
}
