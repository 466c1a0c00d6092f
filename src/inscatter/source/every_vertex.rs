//! Light at all vertices that any camera may ask for.

use super::InScatter;
use crate::Result;
use crate::inscatter::direct::{
    DIRECT_LEVELS, DirectLevels, LightVectors, Spread, Vertex, has_edge,
};
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::sparse::{SparseLattice, SparseValues};
use crate::inscatter::sweep::{Sweep, SweptLevels};
use crate::inscatter::vertices::blend;
use crate::inscatter::{memory, occupied};
use crate::run::Job;
use crate::scene::Grid;
use crate::scene::grid::Cell;
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Light at the vertices of one volume.
#[derive(Debug, Default)]
pub struct VolumeLight {
    /// Direct light.
    pub direct: DirectLevels,
    /// Light of other surfaces and media.
    pub indirect: SweptLevels,
}

impl<G: GatherInMedia> InScatter<'_, G> {
    /// Lights the vertices of all volumes. Of direct light those of the lattice that each brick
    /// uses, and finer ones where light changes so much between those that a camera near by would
    /// ask for them; of indirect light those that were swept. All else is asked for by few rays.
    /// None of a volume whose light differs with the camera.
    ///
    /// # Errors
    /// If cancelled.
    pub fn light_all(mut self, job: &Job) -> Result<Vec<VolumeLight>> {
        let sweeps: Vec<_> = self.lattices.iter_mut().map(|l| l.sweep.take()).collect();
        let light = |(index, sweep): (usize, Option<Sweep>)| {
            if !self.volumes[index].phase.is_isotropic() {
                return Ok(VolumeLight::default());
            }
            let mut indirect = sweep.map_or_else(Default::default, Sweep::into_levels);
            self.gather_rest(index, &mut indirect, job)?;
            let direct = self.light_directly(index, job)?;
            Ok(VolumeLight { direct, indirect })
        };
        sweeps.into_iter().enumerate().map(light).collect()
    }

    /// Gathers at vertices that surfaces are too near to for a sweep.
    fn gather_rest(&self, index: usize, levels: &mut SweptLevels, job: &Job) -> Result<()> {
        for (level, swept) in levels.iter_mut().enumerate() {
            let Some(SparseValues { set, values }) = swept else {
                continue;
            };
            let vertices: Vec<[usize; 3]> = set.vertices().collect();
            (vertices.par_iter().zip(values)).try_for_each(|(&v, value)| {
                if value.is_none() {
                    job.cancel.check()?;
                    let at = at(v, level);
                    let point = self.to_scene(index, at);
                    let key = self.key(index, level, v);
                    *value = Some(self.gathered(index, at, point, key));
                }
                Ok::<(), crate::Error>(())
            })?;
        }
        Ok(())
    }

    fn light_directly(&self, index: usize, job: &Job) -> Result<DirectLevels> {
        let (volume, lattices) = (&self.volumes[index], &self.lattices[index]);
        let grid = &volume.sigma_t;
        let mut bricks: [Vec<[usize; 3]>; DIRECT_LEVELS] = Default::default();
        for brick in grid.bricks() {
            let depth = lattices.densities.of(brick) * lattices.voxel;
            if depth > 0.0 {
                bricks[Self::level(depth)].push(brick);
            }
        }
        // Deeper cells are lit at their own points.
        let uses_vertices =
            |cell: Cell| !cell.is_empty() && cell.least() * lattices.voxel <= Self::MAX_CELL_DEPTH;
        let longest = grid.dims().into_iter().max().unwrap_or(1);
        let finest = (longest / MOST_ALONG).max(1).ilog2() as usize;
        let mut finer: Vec<[usize; 3]> = Vec::new();
        let mut levels = DirectLevels::default();
        let mut all = 0;
        for level in (0..DIRECT_LEVELS).rev() {
            let mut cells = occupied::cells(grid, &bricks[level], 1 << level, uses_vertices);
            cells.append(&mut finer);
            let mut cells = each_once(cells);
            if lattices.emitters.are_any() {
                let is_near = |&c: &[usize; 3]| lattices.emitters.are_near(level, c);
                let (near, far): (Vec<_>, _) = cells.into_iter().partition(is_near);
                cells = far;
                if level > finest {
                    finer.extend(halves(grid, level, near));
                }
            }
            if cells.is_empty() {
                continue;
            }
            let count = occupied::vertices_along(grid, 1 << level);
            let set = SparseLattice::new(count, |choose| {
                let vertices = cells.iter().flat_map(|&c| occupied::around(c, count));
                vertices.for_each(choose);
            });
            all += set.len() as u64;
            let places = set.len() + cells.len() + finer.len();
            let lists = set.bytes() + places * size_of::<[usize; 3]>();
            let bytes = all * size_of::<Vertex>() as u64 + lists as u64;
            memory::check_scattered(volume, all, bytes, job)?;
            let vertices: Vec<[usize; 3]> = set.vertices().collect();
            let task = (job.progress).task("scatter", vertices.len() as u64, "vertices");
            let done = AtomicU64::new(0);
            let mut values = vec![Vertex::default(); vertices.len()];
            (vertices.par_iter().zip(&mut values)).try_for_each(|(&v, value)| {
                job.cancel.check()?;
                *value = self.vertex(index, level, at(v, level), v);
                if done.fetch_add(1, Ordering::Relaxed) % TOLD_AT_A_TIME == TOLD_AT_A_TIME - 1 {
                    task.add(TOLD_AT_A_TIME);
                }
                Ok::<(), crate::Error>(())
            })?;
            task.add(done.into_inner() % TOLD_AT_A_TIME);
            let lit = SparseValues { set, values };
            if level > finest {
                let changes = |cell: &&[usize; 3]| self.changes(index, &lit, **cell, level);
                let changing = cells.par_iter().filter(changes).copied().collect();
                finer.extend(halves(grid, level, changing));
            }
            levels[level] = Some(lit);
        }
        Ok(levels)
    }

    /// Whether rays may ask for vertices between those of a cell.
    fn changes(
        &self,
        index: usize,
        lit: &SparseValues<Vertex>,
        cell: [usize; 3],
        level: usize,
    ) -> bool {
        let (volume, lattices) = (&self.volumes[index], &self.lattices[index]);
        let dims = Vec3::from(volume.sigma_t.size());
        let middle = (Vec3::from(cell.map(|c| c as f32)) + 0.5) * (1 << level) as f32;
        if self.bends(index, lattices.emitters.levels(middle), level, cell) {
            return true;
        }
        let densest = lattices.densities.at(middle.min(dims)) * lattices.voxel;
        let count = lit.set.count();
        let mut values = [LightVectors::default(); 8];
        for (value, v) in values.iter_mut().zip(occupied::around(cell, count)) {
            *value = lit.get(v).map(LightVectors::of).unwrap_or_default();
        }
        let weights = [0.125; 8];
        if densest * (1 << level) as f32 <= Self::FLAT_DEPTH {
            return self.any_is_sharp && has_edge(&values, &weights);
        }
        let mean = blend(&values, &weights, |v| v.light);
        self.differs(Spread::of(&values, &weights, mean))
    }
}

/// Finer vertices that stand where light changes much are no closer than this part of the volume:
/// a camera that needs more is near, and lights what it sees.
const MOST_ALONG: usize = 192;

/// Vertices of which progress is told together: each is lit as fast as a clock is read.
const TOLD_AT_A_TIME: u64 = 64;

/// Cells in order, each once, of a list that has some of them twice.
fn each_once(cells: Vec<[usize; 3]>) -> Vec<[usize; 3]> {
    /// Enough for any cell of a grid whose bits are kept.
    const BITS: usize = 21;
    let key = |cell: [usize; 3]| {
        let [x, y, z] = cell.map(|c| c as u64);
        (z << BITS | y) << BITS | x
    };
    let mut keys: Vec<u64> = cells.into_par_iter().map(key).collect();
    keys.par_sort_unstable();
    keys.dedup();
    let along = |key: u64| key as usize & ((1 << BITS) - 1);
    let cell = |key: u64| [0, 1, 2].map(|a| along(key >> (a * BITS)));
    keys.into_par_iter().map(cell).collect()
}

/// The cells of the next finer lattice that are in such cells.
fn halves(grid: &Grid, level: usize, cells: Vec<[usize; 3]>) -> impl Iterator<Item = [usize; 3]> {
    let count = occupied::vertices_along(grid, 1 << (level - 1));
    let below = cells
        .into_iter()
        .flat_map(|c| occupied::around(c.map(|c| 2 * c), [usize::MAX; 3]));
    below.filter(move |c| (0..3).all(|a| c[a] + 1 < count[a]))
}

/// A vertex in index space.
fn at(v: [usize; 3], level: usize) -> Vec3 {
    Vec3::from(v.map(|c| c as f32)) * (1 << level) as f32
}
