//! What media of one grid send and stop, on cells that all rays of a direction pass layer by layer.

use super::rows::{Arriving, TAPS, Taps};
use super::weights::{Look, ScatteringWeights};
use crate::gather::LvoxelBlock;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::sparse::SparseLattice;
use crate::math::exp::exp_neg_in_place;
use crate::math::lanes::Lanes;
use crate::math::ray_lattice::RayLattice;
use crate::math::{Rgb, Spectrum, unflatten};
use crate::scene::Volume;
use crate::tree::media::in_lobe;
use glam::Vec3;
use rayon::prelude::*;
use wide::f32x4;

/// The lvoxels of volumes on one grid as means over cells of one size.
pub struct SourceCells {
    /// Voxels along an edge of a cell.
    edge: usize,
    /// Cells along x, y and z.
    dims: [usize; 3],
    /// Radiance that is scattered per length, and extinction of the densest channel, x fastest.
    cells: Vec<f32x4>,
    /// Extinction by channel, of that.
    color: f32x4,
    /// Mean directions in which the light of cells leaves, but for what has scattered once where
    /// that is apart; none if it leaves in all alike.
    lobes: Vec<Vec3>,
    /// What has scattered once; none if no lvoxel tells.
    singles: Vec<Single>,
    /// What of light that has scattered once goes into each part of the sphere.
    once: Option<ScatteringWeights>,
}

/// The light of a cell that has scattered once.
#[derive(Clone, Copy, Debug, Default)]
struct Single {
    /// Its share of all light of the cell.
    share: f32,
    /// Mean direction in which it leaves.
    lobe: Vec3,
    /// Against that.
    look: Look,
    /// Share of it which scatters by the phase function, and not alike in all directions.
    lobed: f32,
}

/// A part of the sphere that light goes to.
#[derive(Clone, Copy, Debug, Default)]
pub struct Towards {
    /// Unit direction of the scene in its middle.
    pub travel: Vec3,
    /// Where it is among the quarters of the far field.
    pub row_and_column: [usize; 2],
}

/// The cells in layers along the first of three axes, in rows along the second.
pub struct SourceLayers<'a> {
    of: &'a SourceCells,
    axes: [usize; 3],
    /// Row after row, with an empty cell before and behind each.
    cells: Vec<f32x4>,
    /// By row, the first cell that is not empty, and one past the last.
    spans: Vec<[u32; 2]>,
    empty: Vec<f32x4>,
}

/// Vertices of a lattice by their layer.
pub struct VertexLayers {
    /// The first in each layer of cells' corners among all.
    first: Vec<usize>,
    /// By layer, where they are across in cells, and their numbers.
    vertices: Vec<([u32; 2], u32)>,
    /// The first and the last, cells.
    bounds: [[usize; 3]; 2],
}

impl SourceCells {
    /// Cells of a volume, at most.
    const MOST: usize = 1 << 21;
    /// Voxels of a volume, at least: on fewer, cells blur where it ends.
    const LEAST_VOXELS: usize = 1 << 18;

    /// Whether a volume has voxels enough.
    pub fn are_enough(volume: &Volume) -> bool {
        volume.sigma_t.dims().iter().product::<usize>() >= Self::LEAST_VOXELS
    }

    /// Voxels along an edge of the cells of a volume.
    pub fn edge(volume: &Volume) -> usize {
        let mut edge = 1;
        while volume.sigma_t.blocks([edge; 3]).iter().product::<usize>() > Self::MOST {
            edge *= 2;
        }
        edge
    }

    /// Bytes that cells of a volume take, in layers as well, for vertices at most so many voxels
    /// apart and so many directions together.
    pub fn bytes(volume: &Volume, coarsest: usize, together: usize) -> u64 {
        let cells: usize = Self::dims(volume, coarsest).iter().map(|n| n + 2).product();
        let copies = match volume.phase.is_isotropic() {
            true => 2 * size_of::<f32x4>(),
            // Layers of all directions that are passed together.
            false => (1 + together) * size_of::<f32x4>() + size_of::<(Vec3, Single)>(),
        };
        (cells * copies) as u64
    }

    /// Cells along each axis: as many as vertices have between them.
    fn dims(volume: &Volume, coarsest: usize) -> [usize; 3] {
        let blocks = volume.sigma_t.blocks([coarsest; 3]);
        blocks.map(|n| n * (coarsest / Self::edge(volume)))
    }

    /// The lvoxels of so many volumes on one grid, of which this is one, for vertices at most so
    /// many voxels apart; `None` if its gatherer does not tell lvoxels, or those of other media.
    pub fn new<G: GatherInMedia>(
        gatherer: &G,
        volumes: usize,
        volume: &Volume,
        coarsest: usize,
    ) -> Option<Self> {
        let edge = Self::edge(volume);
        // Voxels of the lvoxels are those of the finest level.
        let finest = gatherer.lvoxel_dims(0)?;
        let is_same = |v| gatherer.lvoxel_dims(v) == Some(finest);
        if !(1..volumes).all(is_same) {
            return None;
        }
        let dims_at = |level: usize| finest.map(|n: usize| n.div_ceil(1 << level));
        let level = (0..usize::BITS as usize / 2).find(|l| dims_at(*l) == volume.sigma_t.dims())?;
        let own_edge = edge << level;
        let dims = Self::dims(volume, coarsest);
        let mut cells = vec![f32x4::ZERO; dims.iter().product()];
        let has_lobes = !volume.phase.is_isotropic();
        let mut lobes = vec![Vec3::ZERO; if has_lobes { cells.len() } else { 0 }];
        let mut singles = Vec::new();
        let count = cells.len();
        let per_cell = 1.0 / own_edge.pow(3) as f32;
        let color = Rgb(volume.extinction_color);
        let mut add = |block: LvoxelBlock| {
            let [r, g, b] = (block.source * block.sigma_t * color).0;
            let value = f32x4::new([r, g, b, block.sigma_t]);
            let first = block.first.map(|v| v / own_edge);
            let across = block.edge.div_ceil(own_edge);
            let share = (block.edge.min(own_edge).pow(3)) as f32 * per_cell;
            for i in 0..across.pow(3) {
                let part = unflatten(i, [across; 3]);
                let at: [usize; 3] = std::array::from_fn(|a| first[a] + part[a]);
                if (0..3).all(|a| at[a] < dims[a]) {
                    let cell = (at[2] * dims[1] + at[1]) * dims[0] + at[0];
                    cells[cell] += value * share;
                    if has_lobes {
                        let (own, light) = (block.lobes(), (r + g + b) * share);
                        let single = light * own.single_share;
                        lobes[cell] += own.rest * (light - single);
                        if single > 0.0 {
                            singles.resize(count, Single::default());
                            singles[cell].share += single;
                            singles[cell].lobe += own.single * single;
                        }
                    }
                }
            }
        };
        (0..volumes).for_each(|v| gatherer.each_lvoxel(v, &mut add));
        let over = |sum: Vec3, light: f32| if light > 0.0 { sum / light } else { Vec3::ZERO };
        for (i, (lobe, cell)) in lobes.iter_mut().zip(&cells).enumerate() {
            let [r, g, b, _] = cell.to_array();
            let light = r + g + b;
            let mut single = 0.0;
            if let Some(of_cell) = singles.get_mut(i) {
                single = of_cell.share;
                of_cell.lobe = over(of_cell.lobe, single);
                of_cell.share = if light > 0.0 { single / light } else { 0.0 }.min(1.0);
            }
            *lobe = over(*lobe, light - single);
        }
        Some(Self {
            edge,
            dims,
            cells,
            color: f32x4::new([color.0[0], color.0[1], color.0[2], 0.0]),
            lobes,
            singles,
            once: None,
        })
    }

    /// Whether cells tell what of their light has scattered once.
    pub fn tell_single(&self) -> bool {
        !self.singles.is_empty()
    }

    /// The same for sweeps along the directions of a far field, where these are the means of the
    /// phase function over parts of the sphere: light that has scattered once leaves in lobes so
    /// narrow that few directions meet them or miss them.
    pub fn seen_in(mut self, once: ScatteringWeights) -> Self {
        let looking = self.singles.par_iter_mut();
        looking.for_each(|single| single.look(&once));
        self.once = Some(once);
        self
    }

    /// The lattice of rays against the light along a direction in index space of the volume.
    pub fn lattice(&self, direction_in_index: Vec3) -> RayLattice {
        RayLattice::new(direction_in_index, self.edge as f32)
    }

    /// Whether cells send more light some ways than others.
    pub fn have_lobes(&self) -> bool {
        !self.lobes.is_empty()
    }

    /// Light of a cell that leaves for a part of the sphere, over the mean of all directions.
    #[inline]
    fn along(&self, cell: usize, towards: Towards) -> f32 {
        let rest = in_lobe(self.lobes[cell], towards.travel);
        match self.singles.get(cell) {
            None => rest,
            Some(single) => {
                let once = self.once.as_ref();
                rest * (1.0 - single.share) + single.along(once, towards)
            }
        }
    }

    /// The cells in layers along the first of three axes, with the light that leaves them for a
    /// part of the sphere.
    pub fn layers(&self, axes: [usize; 3], towards: Towards) -> SourceLayers<'_> {
        let [count, width, height] = axes.map(|a| self.dims[a]);
        let strides = [1, self.dims[0], self.dims[0] * self.dims[1]];
        let [layer, column, row] = axes.map(|a| strides[a]);
        let mut cells = vec![f32x4::ZERO; count * height * (width + 2)];
        let mut spans = vec![[0; 2]; count * height];
        let rows = cells.par_chunks_mut(width + 2).zip(&mut spans);
        rows.enumerate().for_each(|(i, (cells, span))| {
            let from = i / height * layer + i % height * row;
            let (mut first, mut end) = (width, 0);
            for (u, cell) in cells[1..=width].iter_mut().enumerate() {
                let i = from + u * column;
                *cell = self.cells[i];
                if self.have_lobes() && cell.to_array()[3] > 0.0 {
                    let sent = self.along(i, towards);
                    *cell *= f32x4::new([sent, sent, sent, 1.0]);
                }
                if cell.to_array()[3] > 0.0 {
                    first = first.min(u);
                    end = u + 1;
                }
            }
            *span = [first.min(end), end].map(|n| n as u32);
        });
        SourceLayers {
            of: self,
            axes,
            cells,
            spans,
            empty: vec![f32x4::ZERO; width + 2],
        }
    }
}

impl Single {
    /// Prepares for what goes into each part of the sphere.
    fn look(&mut self, once: &ScatteringWeights) {
        let mean_cosine = once.mean_cosine();
        let length = self.lobe.length();
        if self.share > 0.0 && length > 0.0 && mean_cosine != 0.0 {
            // Looks are against light.
            let ahead = self.lobe / length * mean_cosine.signum();
            self.look = once.look_along(-ahead);
            self.lobed = (length / mean_cosine.abs()).min(1.0);
        }
    }

    /// What of it leaves for a part of the sphere, over the mean of all light in all directions.
    #[inline]
    fn along(&self, once: Option<&ScatteringWeights>, towards: Towards) -> f32 {
        let sent = match once {
            Some(once) => {
                let weight = once.weight(&self.look, towards.row_and_column);
                1.0 + self.lobed * (weight - 1.0)
            }
            None => in_lobe(self.lobe, towards.travel),
        };
        self.share * sent
    }
}

impl VertexLayers {
    /// Those of a set, so many voxels apart, in layers along the first of three axes.
    pub fn new(set: &SparseLattice, step: usize, cells: &SourceCells, axes: [usize; 3]) -> Self {
        let step = step / cells.edge;
        let mut first = vec![0; cells.dims[axes[0]] + 2];
        let layer = |v: [usize; 3]| v[axes[0]] * step;
        set.vertices().for_each(|v| first[layer(v) + 1] += 1);
        for i in 1..first.len() {
            first[i] += first[i - 1];
        }
        let mut next = first.clone();
        let mut vertices = vec![([0; 2], 0); set.len()];
        for (i, v) in set.vertices().enumerate() {
            let at = &mut next[layer(v)];
            let across = [v[axes[1]], v[axes[2]]].map(|c| (c * step) as u32);
            vertices[*at] = (across, i as u32);
            *at += 1;
        }
        Self {
            first,
            vertices,
            bounds: set.bounds().map(|v| v.map(|c| c * step)),
        }
    }

    fn in_layer(&self, layer: usize) -> &[([u32; 2], u32)] {
        &self.vertices[self.first[layer]..self.first[layer + 1]]
    }
}

impl SourceLayers<'_> {
    /// Passes all rays of a lattice along these axes, and tells what arrives at the vertices of
    /// each set; returns how many cells that took.
    ///
    /// Rays stand a cell apart, each from end to end, so that what one brings does not depend on
    /// which others there are.
    pub fn pass<K: Spectrum>(
        &self,
        rays: &RayLattice,
        sets: &[VertexLayers],
    ) -> (Vec<Vec<Arriving<K>>>, u64) {
        let mut arriving: Vec<Vec<Arriving<K>>> = (sets.iter())
            .map(|set| vec![Arriving::default(); set.vertices.len()])
            .collect();
        let filled = || sets.iter().filter(|set| !set.vertices.is_empty());
        let Some(mut bounds) = filled().map(|set| set.bounds).next() else {
            return (arriving, 0);
        };
        for [first, last] in filled().map(|set| set.bounds) {
            for a in 0..3 {
                bounds[0][a] = bounds[0][a].min(first[a]);
                bounds[1][a] = bounds[1][a].max(last[a]);
            }
        }
        let count = self.of.dims[self.axes[0]];
        let mut state = State::new(rays.extent(bounds));
        let last = bounds.map(|v| v[self.axes[0]]);
        let mut passed = 0;
        for step in 0..=count {
            // From the light on.
            let plane = if rays.upwards { count - step } else { step };
            for (set, arriving) in sets.iter().zip(&mut arriving) {
                let vertices = set.in_layer(plane);
                if !vertices.is_empty() {
                    state.arrive(&Taps::new(rays, plane), vertices, arriving);
                }
            }
            let is_last = plane == if rays.upwards { last[0] } else { last[1] };
            if is_last || step == count {
                break;
            }
            let layer = if rays.upwards { plane - 1 } else { plane };
            passed += self.pass_layer(layer, rays, &mut state);
        }
        (arriving, passed)
    }

    /// Takes the rays through a layer of cells.
    fn pass_layer<K: Spectrum>(
        &self,
        layer: usize,
        rays: &RayLattice,
        state: &mut State<K>,
    ) -> u64 {
        let [(first_column, width), (first_row, _)] = state.extent;
        // Where rays pass the middle of the layer, from the middles of cells: by that of ray 0, as
        // rounding would tell which ray is the first.
        let [x, y] = rays.across([0.0; 2], layer as f32 + 0.5).map(|v| v - 0.5);
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let (x0, y0) = (x0 as i32 + first_column, y0 as i32 + first_row);
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        let [w00, w10, w01, w11] = weights.map(|w| f32x4::splat(w * rays.between));
        let mut passed = 0;
        let State {
            light,
            emitted,
            depths,
            through,
            ..
        } = state;
        for (j, light) in light.chunks_exact_mut(width).enumerate() {
            let (lower, below) = self.row(layer, y0 + j as i32);
            let (upper, above) = self.row(layer, y0 + j as i32 + 1);
            let from = below[0].min(above[0]) as i32;
            let end = below[1].max(above[1]) as i32;
            // Rays between a cell of the rows and the next.
            let start = from.saturating_sub(1 + x0).max(0);
            let end = (end - x0).min(width as i32);
            if end <= start || below[1].max(above[1]) == 0 {
                continue;
            }
            let cells = (x0 + 1 + start) as usize;
            let cells = cells..=cells + (end - start) as usize;
            let four = (lower[cells.clone()].windows(2)).zip(upper[cells].windows(2));
            emitted.clear();
            depths.clear();
            for (lower, upper) in four {
                let sum = lower[0] * w00 + lower[1] * w10 + (upper[0] * w01 + upper[1] * w11);
                emitted.push(sum);
                K::Lanes::add_depth(depths, sum.to_array()[3], self.of.color);
            }
            through.clone_from(depths);
            exp_neg_in_place(through);
            // What of it gets out of the layer: (1 - exp(-x)) / x.
            for (depth, through) in depths.iter_mut().zip(&*through) {
                let x = *depth;
                let near = 1.0 - x * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0)));
                let far = (1.0 - through) / x;
                *depth = if x < 0.1 { near } else { far };
            }
            let light = &mut light[start as usize..end as usize];
            let rays = light.iter_mut().zip(emitted.iter());
            let left = depths.chunks_exact(K::Lanes::DEPTHS);
            let through = through.chunks_exact(K::Lanes::DEPTHS);
            for ((light, emitted), (left, through)) in rays.zip(left.zip(through)) {
                light.pass(*emitted, left, through);
            }
            passed += emitted.len() as u64;
        }
        passed
    }

    /// A row of a layer, with an empty cell before its first and behind its last, and its span; an
    /// empty one beside the layer.
    fn row(&self, layer: usize, row: i32) -> (&[f32x4], [u32; 2]) {
        let [width, height] = [self.axes[1], self.axes[2]].map(|a| self.of.dims[a]);
        match usize::try_from(row) {
            Ok(row) if row < height => {
                let at = layer * height + row;
                let first = at * (width + 2);
                match self.spans[at] {
                    [_, 0] => (&self.empty, [u32::MAX >> 1, 0]),
                    span => (&self.cells[first..first + width + 2], span),
                }
            }
            _ => (&self.empty, [u32::MAX >> 1, 0]),
        }
    }
}

/// Rays of one direction on their way.
struct State<K: Spectrum> {
    /// First ray and number of rays along both axes across.
    extent: [(i32, usize); 2],
    /// Radiance and transmittance of each ray, row by row.
    light: Vec<K::Lanes>,
    emitted: Vec<f32x4>,
    depths: Vec<f32>,
    through: Vec<f32>,
}

impl<K: Spectrum> State<K> {
    fn new(extent: [(i32, usize); 2]) -> Self {
        let [(_, width), (_, rows)] = extent;
        Self {
            extent,
            light: vec![Arriving::<K>::none_yet().lanes(); width * rows],
            emitted: Vec::with_capacity(width),
            depths: Vec::with_capacity(K::Lanes::DEPTHS * width),
            through: Vec::with_capacity(K::Lanes::DEPTHS * width),
        }
    }

    /// What arrives at the vertices of a plane.
    fn arrive(&self, taps: &Taps, vertices: &[([u32; 2], u32)], arriving: &mut [Arriving<K>]) {
        let [(first_column, width), (first_row, _)] = self.extent;
        for &([x, y], i) in vertices {
            let [column, row] = taps.first_rays([x, y].map(|c| c as i32));
            let (column, row) = (column - first_column, row - first_row);
            let first = row as usize * width + column as usize;
            let rows = std::array::from_fn(|k| &self.light[first + k * width..][..TAPS]);
            arriving[i as usize] = taps.between(rows);
        }
    }
}

#[cfg(test)]
mod tests;
