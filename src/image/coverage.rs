//! Whether tiles cover a frame exactly once.

use super::Region;

/// Faults of a set of tiles that should cover a frame exactly once.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Faults {
    /// Rectangles that no tile covers.
    pub missing: Vec<Region>,
    /// Pairs of tiles, by index, that share pixels; one pair for each tile at most.
    pub overlaps: Vec<(usize, usize)>,
}

/// Finds what tiles leave out or cover twice, by a sweep down the frame. Between two neighbouring
/// tile edges every row looks the same, so the work is bounded by the tiles and not by the pixels.
pub(super) fn faults(width: u32, height: u32, tiles: &[Region]) -> Faults {
    let mut edges: Vec<u32> = tiles.iter().flat_map(|t| [t.y0, t.y1]).collect();
    edges.extend([0, height]);
    edges.sort_unstable();
    edges.dedup();
    let mut order: Vec<usize> = (0..tiles.len()).collect();
    order.sort_unstable_by_key(|&i| (tiles[i].x0, i));

    let mut found = Faults::default();
    for band in edges.windows(2) {
        let (y0, y1) = (band[0], band[1]);
        let mut covered_to = 0;
        let mut last: Option<usize> = None;
        let mut gap = |x0: u32, x1: u32| {
            if x0 < x1 {
                // A gap that goes on from the band above is one rectangle.
                let above = found
                    .missing
                    .iter_mut()
                    .find(|m| (m.x0, m.x1, m.y1) == (x0, x1, y0));
                match above {
                    Some(above) => above.y1 = y1,
                    None => found.missing.push(Region { x0, y0, x1, y1 }),
                }
            }
        };
        for &i in order
            .iter()
            .filter(|&&i| tiles[i].y0 <= y0 && tiles[i].y1 >= y1)
        {
            let tile = tiles[i];
            gap(covered_to, tile.x0);
            if let Some(before) = last.filter(|_| tile.x0 < covered_to)
                && !found.overlaps.iter().any(|&(_, b)| b == i)
            {
                found.overlaps.push((before, i));
            }
            if tile.x1 > covered_to {
                covered_to = tile.x1;
                last = Some(i);
            }
        }
        gap(covered_to, width);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_holes_and_overlaps() {
        let left = Region {
            x0: 0,
            y0: 0,
            x1: 4,
            y1: 8,
        };
        let right = Region {
            x0: 4,
            y0: 0,
            x1: 8,
            y1: 8,
        };
        assert_eq!(faults(8, 8, &[right, left]), Faults::default());
        assert_eq!(faults(8, 8, &[left]).missing, [right]);
        assert_eq!(faults(8, 8, &[left, right, left]).overlaps, [(0, 2)]);
        assert_eq!(faults(8, 8, &[]).missing, [Region::full(8, 8)]);
        let corner = Region {
            x0: 3,
            y0: 7,
            x1: 8,
            y1: 8,
        };
        let found = faults(8, 8, &[left, corner]);
        assert_eq!(found.overlaps, [(0, 1)]);
        assert_eq!(
            found.missing,
            [Region {
                x0: 4,
                y0: 0,
                x1: 8,
                y1: 7
            }]
        );
    }

    proptest! {
        #[test]
        fn a_missing_tile_is_found_whole(width in 1u32..60, height in 1u32..60, count in 1u32..40, pick: u32) {
            prop_assume!(count <= width * height);
            let mut tiles: Vec<Region> =
                (0..count).map(|i| Region::tile(width, height, i, count).unwrap()).collect();
            prop_assert_eq!(faults(width, height, &tiles), Faults::default());
            let lost = tiles.remove((pick % count) as usize);
            let found = faults(width, height, &tiles);
            prop_assert!(found.overlaps.is_empty());
            prop_assert_eq!(found.missing, vec![lost]);
        }
    }
}
