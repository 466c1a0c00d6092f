//! The frontier of a large cloud: cells of the octree that fit in memory each, and runs of them.

/// A cell that is built in one go, or, if it is too large for that, gone through again.
#[derive(Clone, Copy, Debug)]
pub struct Cell {
    pub level: u32,
    pub count: u64,
    /// Where its keys end, exclusively, at the last counted level.
    pub end: u32,
}

impl Cell {
    /// A cell that no other is dealt out with.
    pub fn whole(level: u32, count: u64) -> Self {
        Self {
            level,
            count,
            end: 0,
        }
    }
}

/// A run of cells: several that fit in memory together, or one.
pub type Bucket = Vec<Cell>;

/// Counts of a counting pass, and the frontier that follows from them.
pub struct Frontier<'a> {
    pub counts: &'a [u64],
    pub depth: u32,
    pub level: u32,
    pub most: u64,
}

impl Frontier<'_> {
    pub fn count(&self, depth: u32, at: u32) -> u64 {
        let width = 1usize << (3 * (self.depth - depth));
        let start = at as usize * width;
        self.counts[start..start + width].iter().sum()
    }

    pub fn is_cut(&self, depth: u32, at: u32) -> bool {
        depth == self.depth || self.count(depth, at) <= self.most
    }

    /// Frontier cells in order, in runs that fit in memory together; a cell that does not fit is a
    /// run of its own.
    pub fn buckets(&self) -> Vec<Bucket> {
        let mut buckets: Vec<Bucket> = Vec::new();
        let mut held = 0;
        self.frontier(0, 0, &mut |cell| match buckets.last_mut() {
            Some(last) if held + cell.count <= self.most => {
                last.push(cell);
                held += cell.count;
            }
            _ => {
                held = cell.count;
                buckets.push(vec![cell]);
            }
        });
        buckets
    }

    fn frontier(&self, depth: u32, at: u32, found: &mut impl FnMut(Cell)) {
        let count = self.count(depth, at);
        if count == 0 {
            return;
        }
        if self.is_cut(depth, at) {
            found(Cell {
                level: self.level + depth,
                count,
                end: (at + 1) << (3 * (self.depth - depth)),
            });
            return;
        }
        for child in 8 * at..8 * at + 8 {
            self.frontier(depth + 1, child, found);
        }
    }
}
