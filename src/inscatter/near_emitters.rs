//! How close vertices of direct light must stand beside emitters: light changes there over what is
//! left of the way to them, whatever the medium, and on either side of a lamp it is another.

use super::direct::DIRECT_LEVELS;
use crate::math::unflatten;
use crate::scene::Volume;
use glam::Vec3;
use std::collections::HashMap;

/// Lattices whose cells are small enough beside emitters, of the finest ones on.
#[derive(Debug)]
pub struct NearEmitters(Option<Blocks>);

/// Blocks of voxels, from the corner of the volume on.
#[derive(Debug)]
struct Blocks {
    finest: usize,
    along: [usize; 3],
    /// How many of the lattices serve each as a whole.
    counts: Vec<u8>,
    /// And its voxels, if fewer may serve some.
    voxels: HashMap<usize, Box<[u8; BLOCK_VOXELS]>>,
}

/// Emissive triangles in index space, on their way into cells.
struct Touched {
    /// By level, of those that are near enough to the volume.
    cells: [Vec<Cell>; DIRECT_LEVELS],
    dims: [i32; 3],
    finest: usize,
}

/// A cell of a lattice, which may be outside of the volume.
type Cell = [i32; 3];

/// Log2 of the voxels along a block.
const BLOCK_LEVEL: usize = 3;
const BLOCK_EDGE: usize = 1 << BLOCK_LEVEL;
const BLOCK_VOXELS: usize = BLOCK_EDGE * BLOCK_EDGE * BLOCK_EDGE;

/// All lattices serve what is further away.
const FAR: u8 = u8::MAX;

/// Cells so near to one that an emitter touches are too large: up to two away, but for corners.
/// Where none are finer, one away: rays' own points cost more than vertices.
const REACH: i32 = 2;
const REACH_SQUARED: i32 = 5;
const FINEST_REACH_SQUARED: i32 = 3;

/// Touched cells whose surroundings are listed together: those of a large lamp are dozens of
/// millions.
const CELLS_AT_A_TIME: usize = 1 << 12;

impl NearEmitters {
    /// Of emissive triangles in scene space, for lattices of this level and coarser ones.
    pub fn new(volume: &Volume, triangles: impl Iterator<Item = [Vec3; 3]>, finest: usize) -> Self {
        let mut touched = Touched {
            cells: Default::default(),
            dims: volume.sigma_t.dims().map(|n| n as i32),
            finest,
        };
        for corners in triangles {
            let to_index = &volume.index_from_scene;
            touched.add(corners.map(|c| to_index.transform_point3(c)));
        }
        if touched.cells.iter().all(Vec::is_empty) {
            return Self(None);
        }
        let mut blocks = Blocks::new(volume.sigma_t.dims(), finest);
        for (level, cells) in touched.cells.into_iter().enumerate().rev() {
            blocks.add(level, cells);
        }
        Self(Some(blocks))
    }

    /// Whether there are any so near to the volume that they matter.
    pub fn are_any(&self) -> bool {
        self.0.is_some()
    }

    /// How many lattices serve a point of index space, from the finest on.
    #[inline]
    pub fn levels(&self, point_in_index: Vec3) -> usize {
        let blocks = self.0.as_ref();
        blocks.map_or(FAR.into(), |blocks| blocks.count(point_in_index))
    }

    /// Whether an emitter is too near for a cell of a lattice.
    pub fn are_near(&self, level: usize, cell: [usize; 3]) -> bool {
        let first = cell.map(|c| (c << level) as f32 + 0.5);
        self.levels(first.into()) <= level
    }
}

impl Touched {
    fn add(&mut self, triangle: [Vec3; 3]) {
        let level = DIRECT_LEVELS - 1;
        let edge = (1 << level) as f32;
        let [a, b, c] = triangle;
        let bounds = [a.min(b).min(c), a.max(b).max(c)];
        if !bounds.iter().all(|c| c.is_finite()) {
            return;
        }
        let [first, last] = [0, 1].map(|end| (bounds[end] / edge).floor().as_ivec3());
        let most = self.dims.map(|n| ((n - 1) >> level) + REACH);
        let range = |a: usize| first[a].max(-REACH)..=last[a].min(most[a]);
        for z in range(2) {
            for y in range(1) {
                for x in range(0) {
                    self.descend(level, [x, y, z], &triangle, bounds);
                }
            }
        }
    }

    /// Notes a cell and those in it that a triangle touches; whether there are any.
    fn descend(
        &mut self,
        level: usize,
        cell: Cell,
        triangle: &[Vec3; 3],
        bounds: [Vec3; 2],
    ) -> bool {
        let is_near =
            |a: usize| (-REACH..=((self.dims[a] - 1) >> level) + REACH).contains(&cell[a]);
        if !(0..3).all(is_near) {
            return false;
        }
        let edge = (1 << level) as f32;
        let low = Vec3::from(cell.map(|c| c as f32)) * edge;
        let [least, most] = bounds;
        if least.cmpgt(low + edge).any() || most.cmplt(low).any() {
            return false;
        }
        // What is smaller than a cell touches hardly more of them than its box does.
        let mut is_touched = (most - least).max_element() <= edge;
        if !is_touched {
            let middle = low + 0.5 * edge;
            let off = (closest(triangle, middle) - middle).abs();
            if off.length_squared() > 0.75 * edge * edge {
                return false;
            }
            is_touched = off.max_element() <= 0.5 * edge;
        }
        if level > self.finest {
            for i in 0..8 {
                let half = std::array::from_fn(|a| 2 * cell[a] + (i >> a & 1));
                is_touched |= self.descend(level - 1, half, triangle, bounds);
            }
        }
        let cells = &mut self.cells[level];
        if is_touched && cells.last() != Some(&cell) {
            cells.push(cell);
        }
        is_touched
    }
}

impl Blocks {
    fn new(dims: [usize; 3], finest: usize) -> Self {
        let along = dims.map(|n| n.div_ceil(BLOCK_EDGE));
        Self {
            finest,
            along,
            counts: vec![FAR; along.iter().product()],
            voxels: HashMap::new(),
        }
    }

    fn count(&self, point_in_index: Vec3) -> usize {
        let most = self.along.map(|n| (n * BLOCK_EDGE - 1) as f32);
        let voxel = point_in_index.clamp(Vec3::ZERO, most.into()).to_array();
        let voxel = voxel.map(|c| c as usize);
        let block = self.block(voxel.map(|c| c / BLOCK_EDGE));
        let voxels = self.voxels.get(&block);
        let count = voxels.map_or(self.counts[block], |v| v[within(voxel)]);
        usize::from(count)
    }

    fn block(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.along[1] + y) * self.along[0] + x
    }

    /// No lattice of this level or a coarser one serves around such cells. Coarser ones come first.
    fn add(&mut self, level: usize, mut touched: Vec<Cell>) {
        touched.sort_unstable();
        touched.dedup();
        let reach_squared = match level == self.finest {
            true => FINEST_REACH_SQUARED,
            false => REACH_SQUARED,
        };
        let per_block = BLOCK_LEVEL.saturating_sub(level);
        let per_cell = level.saturating_sub(BLOCK_LEVEL);
        let count = self.along.map(|n| (n << per_block).div_ceil(1 << per_cell));
        let mut around: Vec<[usize; 3]> = Vec::new();
        for some in touched.chunks(CELLS_AT_A_TIME) {
            for cell in some {
                around.extend(offsets(reach_squared).filter_map(|off| {
                    let at =
                        [0, 1, 2].map(|a| usize::try_from(cell[a] + off[a]).unwrap_or(usize::MAX));
                    (0..3).all(|a| at[a] < count[a]).then_some(at)
                }));
            }
            around.sort_unstable();
            around.dedup();
            for cell in around.drain(..) {
                if level < BLOCK_LEVEL {
                    self.lower_voxels(level, cell);
                } else {
                    self.lower_blocks(level, cell);
                }
            }
        }
    }

    fn lower_blocks(&mut self, level: usize, cell: [usize; 3]) {
        let edge = 1 << (level - BLOCK_LEVEL);
        for i in 0..edge * edge * edge {
            let off = unflatten(i, [edge; 3]);
            let at: [usize; 3] = std::array::from_fn(|a| cell[a] * edge + off[a]);
            if (0..3).all(|a| at[a] < self.along[a]) {
                let block = self.block(at);
                self.counts[block] = level as u8;
            }
        }
    }

    fn lower_voxels(&mut self, level: usize, cell: [usize; 3]) {
        let edge = 1 << level;
        let first = cell.map(|c| c * edge);
        let block = self.block(first.map(|c| c / BLOCK_EDGE));
        let whole = self.counts[block];
        let voxels = self.voxels.entry(block);
        let voxels = voxels.or_insert_with(|| Box::new([whole; BLOCK_VOXELS]));
        for i in 0..edge * edge * edge {
            let off = unflatten(i, [edge; 3]);
            voxels[within(std::array::from_fn(|a| first[a] + off[a]))] = level as u8;
        }
    }
}

/// The number of a voxel in its block.
fn within(voxel: [usize; 3]) -> usize {
    let [x, y, z] = voxel.map(|c| c % BLOCK_EDGE);
    (z * BLOCK_EDGE + y) * BLOCK_EDGE + x
}

/// From a cell to those near it.
fn offsets(reach_squared: i32) -> impl Iterator<Item = Cell> {
    let edge = 2 * REACH as usize + 1;
    let all = (0..edge * edge * edge).map(move |i| unflatten(i, [edge; 3]));
    let all = all.map(|off| off.map(|c| c as i32 - REACH));
    all.filter(move |off| off.iter().map(|c| c * c).sum::<i32>() <= reach_squared)
}

/// The point of a triangle that is closest to another (Ericson, Real-Time Collision Detection).
fn closest([a, b, c]: &[Vec3; 3], p: Vec3) -> Vec3 {
    let (ab, ac) = (b - a, c - a);
    let share = |part: f32, whole: f32| if whole > 0.0 { part / whole } else { 0.0 };
    let [d1, d2] = [ab, ac].map(|e| e.dot(p - a));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let [d3, d4] = [ab, ac].map(|e| e.dot(p - b));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let [d5, d6] = [ab, ac].map(|e| e.dot(p - c));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * share(d1, d1 - d3);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * share(d2, d2 - d6);
    }
    let va = d3 * d6 - d5 * d4;
    let [to_c, to_b] = [d4 - d3, d5 - d6];
    if va <= 0.0 && to_c >= 0.0 && to_b >= 0.0 {
        return b + (c - b) * share(to_c, to_c + to_b);
    }
    let sum = va + vb + vc;
    a + ab * share(vb, sum) + ac * share(vc, sum)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use crate::scene::Grid;
    use glam::DAffine3;

    #[test]
    fn lattices_serve_what_is_far_enough_from_emitters() {
        const DIMS: [usize; 3] = [90, 40, 61];
        let number = |i: u64, c: u64| sampling::unit(sampling::hash(&[i, c]));
        let place = |i: u64| {
            let at = Vec3::from([0, 1, 2].map(|c| number(i, c)));
            // Some of them outside.
            (1.4 * at - 0.2) * Vec3::from(DIMS.map(|n| n as f32))
        };
        let grid = Grid::from_fn(DIMS, |_| 1.0);
        let volume = Volume::new("".into(), grid, [0.5; 3], DAffine3::IDENTITY);
        for (size, finest) in [(0.1, 0), (3.0, 0), (30.0, 0), (30.0, 1)] {
            let triangles: Vec<[Vec3; 3]> = (0..3)
                .map(|i| {
                    let corner = |c| place(i) + size * Vec3::from([0, 1, 2].map(|a| number(c, a)));
                    [
                        corner(10 * i + 100),
                        corner(10 * i + 101),
                        corner(10 * i + 102),
                    ]
                })
                .collect();
            let near = NearEmitters::new(&volume, triangles.iter().copied(), finest);
            let mut found = [0; DIRECT_LEVELS + 1];
            for i in 0..4000 {
                let p = place(1000 + i).clamp(Vec3::ZERO, volume.sigma_t.size().into());
                let distances = triangles.iter().map(|t| closest(t, p).distance(p));
                let distance = distances.fold(f32::INFINITY, f32::min);
                let levels = near.levels(p).min(DIRECT_LEVELS);
                assert!(levels == 0 || levels >= finest);
                found[levels] += 1;
                let edge = |level: usize| (1 << level) as f32;
                // Cells of which an emitter cuts off a corner are not among those it touches.
                assert!(
                    levels <= finest || distance > 0.6 * edge(levels - 1),
                    "{distance} {levels}"
                );
                assert!(
                    levels == DIRECT_LEVELS || distance < 5.0 * edge(levels),
                    "{distance} {levels}"
                );
            }
            assert!(found[4] > 0 && found[3] > 0, "{found:?}");
        }
        // Nothing is near.
        let far = [
            Vec3::splat(300.0),
            Vec3::splat(301.0),
            Vec3::new(300.0, 301.0, 300.0),
        ];
        let near = NearEmitters::new(&volume, std::iter::once(far), 0);
        assert!(near.0.is_none() && near.levels(Vec3::ZERO) >= DIRECT_LEVELS);
    }
}
