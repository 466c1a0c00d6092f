//! What the pixels of a frame cost, and its cut into tiles of about equal cost.

use super::Region;
use crate::{Error, Result};

/// What the parts of a frame cost, in any one unit.
///
/// A region costs what its own pixels do, and what lies around it within a reach: each tile makes
/// that again.
#[derive(Clone, Debug)]
pub struct CostMap {
    film: [u32; 2],
    /// Pixels from one good cut to the next.
    step: u32,
    /// Pixels around a region that it pays for, too: of what is its own, and of the rest.
    reach: [u32; 2],
    own: Sums,
    around: Sums,
    /// The pixels of cells that make a tile do what is done once in each.
    swept: Sums,
    /// What that costs.
    once: f64,
}

/// What a pixel of a cell costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CellCost {
    /// For its own tile.
    pub own: f64,
    /// For each tile in whose reach it is.
    pub around: f64,
    /// Whether it makes a tile do what is done once in each.
    pub is_swept: bool,
}

/// A part of a frame that is still to be cut.
#[derive(Clone, Copy, Debug)]
struct Part {
    region: Region,
    tiles: u64,
}

impl CostMap {
    /// The costs of a film's square cells with edges of `cell` pixels, row by row. Tiles are cut at
    /// multiples of `step` pixels where that can be, and pay for `reach` pixels around them.
    #[must_use]
    pub fn new(film: [u32; 2], cell: u32, costs: &[CellCost], step: u32, reach: [u32; 2]) -> Self {
        let sums = |of: fn(&CellCost) -> f64| Sums::new(film, cell, costs.iter().map(of));
        Self {
            film,
            step: step.max(1),
            reach,
            own: sums(|c| c.own),
            around: sums(|c| c.around),
            swept: sums(|c| f64::from(u8::from(c.is_swept))),
            once: 0.0,
        }
    }

    /// With what is done once in each tile that has a part of certain cells.
    #[must_use]
    pub fn with_sweeps(self, once: f64) -> Self {
        Self { once, ..self }
    }

    /// What a region of the film costs.
    #[must_use]
    pub fn cost(&self, region: &Region) -> f64 {
        let once = if self.swept.over(region) > 0.5 {
            self.once
        } else {
            0.0
        };
        once + self.with_reach(region)
    }

    /// Cuts the frame into so many tiles that cover it exactly once and cost about the same each.
    ///
    /// The frame is cut across its longer side, where both halves cost the same by what each of
    /// their tiles will, until one tile is left.
    ///
    /// # Errors
    /// [`crate::Kind::Input`] if `count` is 0 or exceeds the number of pixels.
    pub fn cut(&self, count: u32) -> Result<Vec<Region>> {
        let [width, height] = self.film;
        let pixels = u64::from(width) * u64::from(height);
        if count == 0 || u64::from(count) > pixels {
            return Err(Error::input(format!(
                "cannot split {width}x{height} pixels into {count} tiles"
            ))
            .hint("use fewer tiles, and one at least"));
        }
        let mut tiles = Vec::with_capacity(count as usize);
        let mut parts = vec![Part {
            region: Region::full(width, height),
            tiles: count.into(),
        }];
        while let Some(part) = parts.pop() {
            match self.halves(&part) {
                // The first one next, so that tiles come in the order of the frame.
                Some([first, second]) => parts.extend([second, first]),
                None => tiles.push(part.region),
            }
        }
        Ok(tiles)
    }

    /// What a region costs, and what lies in its reach.
    fn with_reach(&self, region: &Region) -> f64 {
        let [width, height] = self.film;
        let Region { x0, y0, x1, y1 } = *region;
        let wider = |reach: u32| Region {
            x0: x0.saturating_sub(reach),
            y0: y0.saturating_sub(reach),
            x1: width.min(x1.saturating_add(reach)),
            y1: height.min(y1.saturating_add(reach)),
        };
        let [own, around] = self.reach.map(wider);
        self.own.over(&own) + self.around.over(&around)
    }

    /// What each tile of a part costs on average, if they are about square.
    fn of_each(&self, part: &Part) -> f64 {
        let tiles = part.tiles as f64;
        if part.tiles == 1 {
            return self.cost(&part.region);
        }
        let [w, h] = [part.region.width(), part.region.height()].map(f64::from);
        let edge = (w * h / tiles).sqrt();
        let across = edge.min(w).max(edge * edge / h);
        let down = edge * edge / across;
        // Around the part it is paid once already, as far as it is on the film.
        let again = self.reach.map(|reach| {
            let twice = 2.0 * f64::from(reach);
            let paid = tiles * (across + twice) * (down + twice);
            (paid - (w + twice) * (h + twice)).max(0.0)
        });
        let mean = |sums: &Sums| sums.over(&part.region) / (w * h);
        let again = mean(&self.own) * again[0] + mean(&self.around) * again[1];
        self.once * mean(&self.swept) + (self.with_reach(&part.region) + again) / tiles
    }

    /// The best cut of a part with more than one tile.
    fn halves(&self, part: &Part) -> Option<[Part; 2]> {
        if part.tiles < 2 {
            return None;
        }
        let (w, h) = (part.region.width(), part.region.height());
        let mut best = Best::default();
        // Tiles that are not much longer than wide have little around them.
        let is_near_square = 4 * u64::from(w.min(h)) >= 3 * u64::from(w.max(h));
        for across in [true, false] {
            if across == (w >= h) || is_near_square {
                self.look_along(part, across, self.step, &mut best);
            }
        }
        if best.halves.is_none() {
            self.look_along(part, w >= h, 1, &mut best);
        }
        best.halves
    }

    /// Tries all cuts across a part, or down it, that are multiples of `step`.
    fn look_along(&self, part: &Part, across: bool, step: u32, best: &mut Best) {
        let Region { x0, y0, x1, y1 } = part.region;
        let ([from, to], short) = match across {
            true => ([x0, x1], y1 - y0),
            false => ([y0, y1], x1 - x0),
        };
        let short = u64::from(short);
        let first = (u64::from(from) / u64::from(step) + 1) * u64::from(step);
        for at in (first..u64::from(to)).step_by(step as usize) {
            // Below `to`.
            let at = at as u32;
            let (first, second) = match across {
                true => (
                    Region {
                        x1: at,
                        ..part.region
                    },
                    Region {
                        x0: at,
                        ..part.region
                    },
                ),
                false => (
                    Region {
                        y1: at,
                        ..part.region
                    },
                    Region {
                        y0: at,
                        ..part.region
                    },
                ),
            };
            // No more tiles on either side than pixels.
            let before = u64::from(at - from) * short;
            let after = u64::from(to - at) * short;
            let least = part.tiles.saturating_sub(after).max(1);
            let most = before.min(part.tiles - 1);
            let half = part.tiles / 2;
            for tiles in [half, part.tiles - half] {
                let tiles = tiles.clamp(least, most);
                let halves = [
                    Part {
                        region: first,
                        tiles,
                    },
                    Part {
                        region: second,
                        tiles: part.tiles - tiles,
                    },
                ];
                let cost = self.of_each(&halves[0]).max(self.of_each(&halves[1]));
                best.take(cost, halves);
            }
        }
    }
}

/// The cheapest cut so far; of those that cost the same the one nearest to the middle.
#[derive(Default)]
struct Best {
    cost: f64,
    uneven: u64,
    halves: Option<[Part; 2]>,
}

impl Best {
    fn take(&mut self, cost: f64, halves: [Part; 2]) {
        let [a, b] = halves.map(|half| half.region.pixels() as u64 / half.tiles);
        let uneven = a.abs_diff(b);
        let is_better = match self.halves {
            None => true,
            Some(_) => cost < self.cost || cost == self.cost && uneven < self.uneven,
        };
        if is_better {
            *self = Self {
                cost,
                uneven,
                halves: Some(halves),
            };
        }
    }
}

/// Sums of a value of pixels over rectangles from the film's top left.
#[derive(Clone, Debug)]
struct Sums {
    film: [u32; 2],
    cell: u32,
    /// Corners of cells in a row.
    row: usize,
    /// By corner of cells, row by row.
    sums: Vec<f64>,
}

impl Sums {
    fn new(film: [u32; 2], cell: u32, values: impl Iterator<Item = f64>) -> Self {
        let cell = cell.max(1);
        let [columns, rows] = film.map(|n| n.div_ceil(cell) as usize);
        let edge = |i: usize, n: u32| f64::from(cell.min(n - i as u32 * cell));
        let row = columns + 1;
        let mut sums = vec![0.0; row * (rows + 1)];
        let mut values = values;
        for j in 0..rows {
            let mut before = 0.0;
            for i in 0..columns {
                let value = values.next().unwrap_or(0.0);
                before += value * edge(i, film[0]) * edge(j, film[1]);
                sums[(j + 1) * row + i + 1] = sums[j * row + i + 1] + before;
            }
        }
        Self {
            film,
            cell,
            row,
            sums,
        }
    }

    /// The sum over what is left of and above a corner of pixels.
    fn to(&self, x: u32, y: u32) -> f64 {
        let [(i, u), (j, v)] = [(x, self.film[0]), (y, self.film[1])].map(|(at, n)| {
            let i = (at / self.cell).min(n.div_ceil(self.cell) - 1);
            let first = i * self.cell;
            let edge = self.cell.min(n - first);
            (i as usize, f64::from(at - first) / f64::from(edge))
        });
        let at = |i: usize, j: usize| self.sums[j * self.row + i];
        let above = at(i, j) + u * (at(i + 1, j) - at(i, j));
        let below = at(i, j + 1) + u * (at(i + 1, j + 1) - at(i, j + 1));
        above + v * (below - above)
    }

    fn over(&self, region: &Region) -> f64 {
        let Region { x0, y0, x1, y1 } = *region;
        (self.to(x1, y1) - self.to(x0, y1)) - (self.to(x1, y0) - self.to(x0, y0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::coverage::{self, Faults};
    use proptest::prelude::*;

    fn map(film: [u32; 2], cell: u32, reach: u32, of: impl Fn([u32; 2]) -> CellCost) -> CostMap {
        let [columns, rows] = film.map(|n| n.div_ceil(cell));
        let cells = (0..rows).flat_map(|j| (0..columns).map(move |i| [i, j]));
        let costs: Vec<_> = cells.map(of).collect();
        CostMap::new(film, cell, &costs, 4, [0, reach])
    }

    fn cost(own: f64, around: f64) -> CellCost {
        CellCost {
            own,
            around,
            is_swept: false,
        }
    }

    /// What is least, the mean and the most of the tiles of a cut.
    fn spread(map: &CostMap, count: u32) -> [f64; 3] {
        let costs: Vec<f64> = map
            .cut(count)
            .unwrap()
            .iter()
            .map(|t| map.cost(t))
            .collect();
        let mean = costs.iter().sum::<f64>() / f64::from(count);
        let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
        [least, mean, costs.iter().copied().fold(0.0, f64::max)]
    }

    #[test]
    fn a_region_costs_its_pixels_and_what_is_around_it() {
        let map = map([50, 30], 8, 5, |[i, _]| cost(f64::from(i), 2.0));
        let all = map.cost(&Region::full(50, 30));
        let own: f64 = (0..50).map(|x| f64::from(x / 8) * 30.0).sum();
        assert!((all - own - 2.0 * 1500.0).abs() < 1e-6, "{all}");
        let tile = Region {
            x0: 10,
            y0: 0,
            x1: 20,
            y1: 7,
        };
        let own: f64 = (10..20).map(|x| f64::from(x / 8) * 7.0).sum();
        let around = 2.0 * 20.0 * 12.0;
        assert!((map.cost(&tile) - own - around).abs() < 1e-6);
    }

    #[test]
    fn tiles_are_small_where_pixels_are_dear() {
        // Most of the work is in a twentieth of the frame.
        let map = map([1920, 1080], 32, 28, |[i, j]| {
            let is_dear = (20..32).contains(&i) && (8..17).contains(&j);
            cost(if is_dear { 40.0 } else { 1.0 }, 1.5)
        });
        for count in [2, 7, 16, 64, 200] {
            let [least, mean, most] = spread(&map, count);
            assert!(
                most < 1.15 * mean && least > 0.8 * mean,
                "{count}: {least} {mean} {most}"
            );
        }
        let equal = (0..64).map(|i| map.cost(&Region::tile(1920, 1080, i, 64).unwrap()));
        let [_, mean, _] = spread(&map, 64);
        assert!(equal.fold(0.0, f64::max) > 4.0 * mean);
    }

    #[test]
    fn cuts_of_large_tiles_are_at_whole_steps() {
        let map = map([640, 480], 16, 28, |[i, j]| cost(f64::from(i * j), 1.0));
        for tile in map.cut(24).unwrap() {
            let edges = [
                (tile.x0, 640),
                (tile.x1, 640),
                (tile.y0, 480),
                (tile.y1, 480),
            ];
            assert!(
                edges.iter().all(|(at, end)| at % 4 == 0 || at == end),
                "{tile}"
            );
            // Where cost falls to nothing tiles are long, but no stripes.
            let (w, h) = (tile.width(), tile.height());
            assert!(w.max(h) <= 8 * w.min(h), "{tile}");
        }
    }

    #[test]
    fn frames_that_cost_nothing_are_cut_evenly() {
        let map = map([512, 384], 16, 28, |_| CellCost::default());
        for tile in map.cut(16).unwrap() {
            assert_eq!((tile.width(), tile.height()), (128, 96));
        }
    }

    #[test]
    fn impossible_cuts_are_input_errors() {
        let map = map([4, 3], 16, 28, |_| cost(1.0, 1.0));
        for count in [0, 13] {
            assert_eq!(map.cut(count).unwrap_err().kind(), crate::Kind::Input);
        }
    }

    proptest! {
        #[test]
        fn tiles_cover_exactly_once(
            width in 1u32..90, height in 1u32..90, cell in 1u32..40, count in 1u32..300, seed: u64,
        ) {
            prop_assume!(count <= width * height);
            let map = map([width, height], cell, 28, |[i, j]| {
                let hash = crate::math::sampling::hash(&[seed, i.into(), j.into()]);
                cost((hash % 100) as f64, (hash / 100 % 7) as f64)
            });
            let tiles = map.cut(count).unwrap();
            prop_assert_eq!(tiles.len(), count as usize);
            prop_assert_eq!(coverage::faults(width, height, &tiles), Faults::default());
        }

        #[test]
        fn every_pixel_may_be_a_tile(width in 1u32..12, height in 1u32..12) {
            let map = map([width, height], 4, 28, |[i, _]| cost(f64::from(i), 1.0));
            let tiles = map.cut(width * height).unwrap();
            prop_assert!(tiles.iter().all(|t| t.pixels() == 1));
        }
    }
}
