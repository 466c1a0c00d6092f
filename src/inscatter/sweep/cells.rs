//! What a lone medium sends and stops, on cells that all rays of a direction pass layer by layer.

use super::rows::{Arriving, TAPS, Taps};
use crate::gather::LvoxelBlock;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::sparse::SparseLattice;
use crate::math::exp::exp_neg_in_place;
use crate::math::ray_lattice::RayLattice;
use crate::math::unflatten;
use crate::scene::Volume;
use crate::tree::media::in_lobe;
use glam::Vec3;
use rayon::prelude::*;
use wide::f32x4;

/// The lvoxels of a volume as means over cells of one size.
pub struct SourceCells {
    /// Voxels along an edge of a cell.
    edge: usize,
    /// Cells along x, y and z.
    dims: [usize; 3],
    /// Radiance that is scattered per length, and extinction, x fastest.
    cells: Vec<f32x4>,
    /// Mean directions in which the light of cells leaves; none if it leaves in all alike.
    lobes: Vec<Vec3>,
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
            false => (1 + together) * size_of::<f32x4>() + size_of::<Vec3>(),
        };
        (cells * copies) as u64
    }

    /// Cells along each axis: as many as vertices have between them.
    fn dims(volume: &Volume, coarsest: usize) -> [usize; 3] {
        let blocks = volume.sigma_t.blocks([coarsest; 3]);
        blocks.map(|n| n * (coarsest / Self::edge(volume)))
    }

    /// The lvoxels of the only volume, for vertices at most so many voxels apart; `None` if its
    /// gatherer does not tell lvoxels, or those of other media.
    pub fn new<G: GatherInMedia>(gatherer: &G, volume: &Volume, coarsest: usize) -> Option<Self> {
        let edge = Self::edge(volume);
        // Voxels of the lvoxels are those of the finest level.
        let finest = gatherer.lvoxel_dims(0)?;
        let dims_at = |level: usize| finest.map(|n: usize| n.div_ceil(1 << level));
        let level = (0..usize::BITS as usize / 2).find(|l| dims_at(*l) == volume.sigma_t.dims())?;
        let own_edge = edge << level;
        let dims = Self::dims(volume, coarsest);
        let mut cells = vec![f32x4::ZERO; dims.iter().product()];
        let has_lobes = !volume.phase.is_isotropic();
        let mut lobes = vec![Vec3::ZERO; if has_lobes { cells.len() } else { 0 }];
        let per_cell = 1.0 / own_edge.pow(3) as f32;
        gatherer.each_lvoxel(0, &mut |block: LvoxelBlock| {
            let [r, g, b] = (block.source * block.sigma_t).0;
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
                        lobes[cell] += block.mean_direction() * ((r + g + b) * share);
                    }
                }
            }
        });
        for (lobe, cell) in lobes.iter_mut().zip(&cells) {
            let [r, g, b, _] = cell.to_array();
            let sent = r + g + b;
            *lobe = if sent > 0.0 { *lobe / sent } else { Vec3::ZERO };
        }
        Some(Self {
            edge,
            dims,
            cells,
            lobes,
        })
    }

    /// The lattice of rays against the light along a direction in index space of the volume.
    pub fn lattice(&self, direction_in_index: Vec3) -> RayLattice {
        RayLattice::new(direction_in_index, self.edge as f32)
    }

    /// Whether cells send more light some ways than others.
    pub fn have_lobes(&self) -> bool {
        !self.lobes.is_empty()
    }

    /// The cells in layers along the first of three axes, with the light that leaves them in a unit
    /// direction of the scene.
    pub fn layers(&self, axes: [usize; 3], travel: Vec3) -> SourceLayers<'_> {
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
                if let Some(lobe) = self.lobes.get(i) {
                    let sent = in_lobe(*lobe, travel);
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
    pub fn pass(&self, rays: &RayLattice, sets: &[VertexLayers]) -> (Vec<Vec<Arriving>>, u64) {
        let mut arriving: Vec<Vec<Arriving>> = (sets.iter())
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
    fn pass_layer(&self, layer: usize, rays: &RayLattice, state: &mut State) -> u64 {
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
                depths.push(sum.to_array()[3]);
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
            for ((light, emitted), (left, through)) in rays.zip(depths.iter().zip(through.iter())) {
                let left = f32x4::new([*left, *left, *left, 0.0]);
                *light = *light * f32x4::splat(*through) + *emitted * left;
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
struct State {
    /// First ray and number of rays along both axes across.
    extent: [(i32, usize); 2],
    /// Radiance and transmittance of each ray, row by row.
    light: Vec<f32x4>,
    emitted: Vec<f32x4>,
    depths: Vec<f32>,
    through: Vec<f32>,
}

impl State {
    fn new(extent: [(i32, usize); 2]) -> Self {
        let [(_, width), (_, rows)] = extent;
        let none_yet = f32x4::new([0.0, 0.0, 0.0, 1.0]);
        Self {
            extent,
            light: vec![none_yet; width * rows],
            emitted: Vec::with_capacity(width),
            depths: Vec::with_capacity(width),
            through: Vec::with_capacity(width),
        }
    }

    /// What arrives at the vertices of a plane.
    fn arrive(&self, taps: &Taps, vertices: &[([u32; 2], u32)], arriving: &mut [Arriving]) {
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
mod tests {
    use super::*;
    use crate::math::Rgb;
    use crate::math::sampling;
    use crate::scene::Grid;
    use glam::DAffine3;

    /// Cells of noise, some of them empty.
    fn noise(dims: [usize; 3]) -> SourceCells {
        let cell = |i: usize| {
            let unit = |c: u64| sampling::unit(sampling::hash(&[i as u64, c]));
            let is_empty = unit(0) < 0.4 || i % dims[0] == 3;
            let sigma_t = if is_empty { 0.0 } else { unit(1) };
            f32x4::new([unit(2) * sigma_t, sigma_t, unit(3) * sigma_t, sigma_t])
        };
        SourceCells {
            edge: 2,
            dims,
            cells: (0..dims.iter().product()).map(cell).collect(),
            lobes: Vec::new(),
        }
    }

    /// The same as [`SourceLayers::pass`] for one ray, which has passed all layers.
    fn plain(cells: &SourceCells, rays: &RayLattice, ray: [f32; 2], end: usize) -> [f32; 4] {
        let count = cells.dims[rays.axes[0]];
        let mut light = [0.0, 0.0, 0.0, 1.0];
        let steps = if rays.upwards { count - end } else { end };
        for step in 0..steps {
            let layer = if rays.upwards { count - 1 - step } else { step };
            let at = rays.across(ray, layer as f32 + 0.5);
            let mut sum = [0.0; 4];
            for (u, w) in (-1..=1).flat_map(|u| (-1..=1).map(move |w| (u, w))) {
                let cell = [at[0].floor() as i32 + u, at[1].floor() as i32 + w];
                let weight = |a: usize| 1.0 - (at[a] - cell[a] as f32 - 0.5).abs();
                let mut place = [0; 3];
                place[rays.axes[0]] = layer as i32;
                place[rays.axes[1]] = cell[0];
                place[rays.axes[2]] = cell[1];
                let inside = (0..3).all(|a| (0..cells.dims[a] as i32).contains(&place[a]));
                if inside && weight(0) > 0.0 && weight(1) > 0.0 {
                    let [x, y, z] = place.map(|c| c as usize);
                    let i = (z * cells.dims[1] + y) * cells.dims[0] + x;
                    for (sum, value) in sum.iter_mut().zip(cells.cells[i].to_array()) {
                        *sum += f64::from(value * weight(0) * weight(1));
                    }
                }
            }
            let depth = sum[3] * f64::from(rays.between);
            if depth > 0.0 {
                for c in 0..3 {
                    light[c] = light[c] * (-depth).exp() + sum[c] / sum[3] * -(-depth).exp_m1();
                }
                light[3] *= (-depth).exp();
            }
        }
        light.map(|v| v as f32)
    }

    #[test]
    fn layers_bring_what_each_ray_does_by_itself() {
        let cells = noise([12, 9, 10]);
        for direction in [
            Vec3::new(0.9, 0.3, -0.2),
            Vec3::new(0.5, -2.0, 0.7),
            Vec3::new(-0.1, 0.4, -3.0),
            Vec3::new(0.0, 0.0, 1.0),
        ] {
            let rays = cells.lattice(direction);
            let layers = cells.layers(rays.axes, Vec3::ZERO);
            for (step, every) in [(2, 1), (4, 1), (2, 7)] {
                let count = cells.dims.map(|n| n / (step / 2) + 1);
                let set = SparseLattice::new(count, |choose| {
                    let all = (0..count.iter().product()).map(|i| unflatten(i, count));
                    let chosen = |v: &[usize; 3]| (v[0] * 5 + v[1] + v[2]).is_multiple_of(every);
                    all.filter(chosen).for_each(choose);
                });
                let vertices = VertexLayers::new(&set, step, &cells, rays.axes);
                let (arriving, passed) = layers.pass(&rays, &[vertices]);
                assert!(passed > 0);
                for (v, found) in set.vertices().zip(&arriving[0]) {
                    let place = rays.axes.map(|a| v[a] * step / 2);
                    let taps = Taps::new(&rays, place[0]);
                    let first = taps.first_rays([place[1] as i32, place[2] as i32]);
                    let ray = |k: usize, i: usize| {
                        let ray = [first[0] + i as i32, first[1] + k as i32].map(|c| c as f32);
                        f32x4::new(plain(&cells, &rays, ray, place[0]))
                    };
                    let rows: [[f32x4; TAPS]; TAPS] =
                        std::array::from_fn(|k| std::array::from_fn(|i| ray(k, i)));
                    let expected = taps.between([0, 1, 2, 3].map(|k| &rows[k][..]));
                    let off = (0..3)
                        .map(|c| (found.radiance.0[c] - expected.radiance.0[c]).abs())
                        .fold(
                            (found.transmittance - expected.transmittance).abs(),
                            f32::max,
                        );
                    assert!(off < 2e-5, "{direction} {v:?} {found:?} {expected:?}");
                }
            }
        }
    }

    #[test]
    fn what_arrives_at_a_vertex_does_not_depend_on_others() {
        let cells = noise([60, 37, 41]);
        let count = cells.dims.map(|n| n + 1);
        // All vertices, and those in a corner that is far from the first.
        let sets = [[0; 3], [43, 21, 29]].map(|least| {
            SparseLattice::new(count, |choose| {
                let all = (0..count.iter().product()).map(|i| unflatten(i, count));
                let chosen = |v: &[usize; 3]| (0..3).all(|a| v[a] >= least[a]);
                all.filter(chosen).for_each(choose);
            })
        });
        for direction in [[0.9, 0.3, -0.2], [0.5, -2.0, 0.7], [-0.1, 0.41, -3.0]].map(Vec3::from) {
            let rays = cells.lattice(direction);
            let layers = cells.layers(rays.axes, Vec3::ZERO);
            let [all, few] = sets.each_ref().map(|set| {
                let vertices = VertexLayers::new(set, 2, &cells, rays.axes);
                let (mut arriving, _) = layers.pass(&rays, &[vertices]);
                let bits =
                    |a: Arriving| (a.radiance.0.map(f32::to_bits), a.transmittance.to_bits());
                let arriving = arriving.remove(0).into_iter().map(bits);
                set.vertices().zip(arriving).collect::<Vec<_>>()
            });
            let all: std::collections::BTreeMap<_, _> = all.into_iter().collect();
            assert!(few.iter().all(|(v, bits)| all[v] == *bits), "{direction}");
        }
    }

    /// Tells lvoxels, and nothing else.
    struct Lvoxels {
        dims: [usize; 3],
        blocks: Vec<LvoxelBlock>,
    }

    impl GatherInMedia for Lvoxels {
        type Share = f32;

        fn settings(&self) -> &crate::gather::RaySettings<'_> {
            unreachable!()
        }

        fn scattered(
            &self,
            _: Vec3,
            _: crate::gather::SampleRange,
            _: Option<crate::math::SeenPhase>,
        ) -> crate::gather::Gathered {
            unreachable!()
        }

        fn incident_from_surfaces(
            &self,
            _: &crate::math::Ray,
            _: &mut crate::gather::cone::Scratch,
        ) -> crate::gather::Incident {
            unreachable!()
        }

        fn walk(
            &self,
            _: &crate::math::Ray,
            _: &mut impl FnMut(crate::math::segment::Segment) -> bool,
        ) -> bool {
            unreachable!()
        }

        fn pass(&self, _: &crate::math::Ray, _: &mut crate::math::segment::Composite) -> u64 {
            unreachable!()
        }

        fn lvoxel_dims(&self, _: usize) -> Option<[usize; 3]> {
            Some(self.dims)
        }

        fn each_lvoxel(&self, _: usize, take: &mut impl FnMut(LvoxelBlock)) {
            self.blocks.iter().for_each(|b| take(*b));
        }
    }

    #[test]
    fn cells_hold_what_their_lvoxels_do_on_whatever_level_the_volume_is() {
        let block = |first: [usize; 3], edge: usize, sigma_t: f32| LvoxelBlock {
            first,
            edge,
            sigma_t,
            source: Rgb([2.0, 1.0, 0.5]),
            lobe: [0; 3],
        };
        let lvoxels = Lvoxels {
            dims: [256, 200, 170],
            blocks: vec![
                block([0; 3], 1, 8.0),
                block([1, 0, 0], 1, 8.0),
                block([8, 16, 24], 8, 3.0),
                block([252, 196, 168], 2, 16.0),
            ],
        };
        let volume = Volume::new(
            "cloud".into(),
            Grid::from_fn(lvoxels.dims, |_| 1.0),
            [0.9; 3],
            DAffine3::IDENTITY,
        );
        let depth = |cells: &SourceCells, at: [usize; 3]| {
            let i = (at[2] * cells.dims[1] + at[1]) * cells.dims[0] + at[0];
            cells.cells[i].to_array()
        };
        // Cells of two voxels an edge, which are four of the finest on the other level.
        let finest = SourceCells::new(&lvoxels, &volume, 8).unwrap();
        assert_eq!((finest.edge, finest.dims), (2, [128, 100, 88]));
        assert_eq!(depth(&finest, [0; 3]), [4.0, 2.0, 1.0, 2.0]);
        assert_eq!(depth(&finest, [4, 8, 12]), [6.0, 3.0, 1.5, 3.0]);
        assert_eq!(depth(&finest, [7, 11, 15]), [6.0, 3.0, 1.5, 3.0]);
        assert_eq!(depth(&finest, [8, 11, 15]), [0.0; 4]);
        assert_eq!(depth(&finest, [126, 98, 84])[3], 16.0);
        let coarser = SourceCells::new(&lvoxels, &volume.at_level(1), 2).unwrap();
        assert_eq!((coarser.edge, coarser.dims), (1, [128, 100, 86]));
        assert_eq!(depth(&coarser, [0; 3])[3], 2.0);
        let other = Lvoxels {
            dims: [100; 3],
            ..lvoxels
        };
        assert!(SourceCells::new(&other, &volume, 8).is_none());
    }
}
