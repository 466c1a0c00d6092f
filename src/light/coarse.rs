//! A volume on coarser cells, for rays that pass it from end to end.

use crate::math::unflatten;
use crate::run::List;
use crate::scene::Volume;
use glam::Vec3;
use rayon::prelude::*;

/// A volume's extinction as means over cubes of voxels.
#[derive(Debug)]
pub struct CoarseVolume<'a> {
    /// The volume.
    pub volume: &'a Volume,
    /// Voxels along an edge of a cell: a power of 2, or a half.
    pub edge: f32,
    /// Cells along x, y and z.
    pub dims: [usize; 3],
    /// Mean extinction of each cell, x fastest; what is beyond the volume counts as empty.
    sigma_t: List<f32>,
}

/// The same in layers along one axis.
#[derive(Debug)]
pub struct Layers {
    /// Cells across a layer along both axes.
    across: [usize; 2],
    /// Row after row, with an empty cell before and behind each.
    cells: List<f32>,
    empty: Vec<f32>,
}

impl<'a> CoarseVolume<'a> {
    /// Levels of a volume, each with cells of twice the edge of those of the one before. The first
    /// is the finest of whole voxels with at most `most` cells.
    #[must_use]
    pub fn levels(volume: &'a Volume, most: usize, count: usize) -> Vec<Self> {
        let mut levels = vec![Self::finest(volume, most)];
        while levels.len() < count
            && let Some(last) = levels.last().filter(|l| l.dims != [1; 3])
        {
            levels.push(last.coarser());
        }
        levels
    }

    /// Cells of the finest of all that are at most `most`; more of a flat volume, as its rays take
    /// the memory of those of so many.
    #[must_use]
    pub fn most_cells(volume: &Volume, most: usize) -> usize {
        let halves = volume.sigma_t.dims().map(|n| n.saturating_mul(2));
        let dims = match Self::are_at_most(halves, most) {
            true => halves,
            false => Self::finest_dims(volume, most).1,
        };
        Self::count(dims).max(Self::depths(dims) / Self::DEPTHS_OF_CUBE)
    }

    /// Depths that rays have for each cell of a cube, at most.
    const DEPTHS_OF_CUBE: usize = 4;

    /// Whether cells, of so many along each axis, are no more than `most`, and rays through them
    /// not many times as many: most of those that run along a flat volume pass beside it.
    fn are_at_most(dims: [usize; 3], most: usize) -> bool {
        let depths = most.saturating_mul(3 * Self::DEPTHS_OF_CUBE / 2);
        Self::count(dims) <= most && Self::depths(dims) <= depths
    }

    fn count(dims: [usize; 3]) -> usize {
        dims.into_iter().fold(1, usize::saturating_mul)
    }

    /// Depths along the rays of any one direction, at most: as rays slant, those across an axis
    /// reach further by its length.
    fn depths(dims: [usize; 3]) -> usize {
        let along = |main: usize| {
            let across = [1, 2].map(|a| dims[(main + a) % 3].saturating_add(dims[main]));
            Self::count([dims[main], across[0], across[1]])
        };
        (0..3).map(along).fold(0, usize::max)
    }

    /// Voxels along an edge of the finest cells of whole voxels that are at most `most`, and their
    /// numbers along each axis.
    fn finest_dims(volume: &Volume, most: usize) -> (usize, [usize; 3]) {
        let cells = |edge: usize| volume.sigma_t.dims().map(|n| n.div_ceil(edge));
        let mut edge = 1;
        while !Self::are_at_most(cells(edge), most.max(1)) {
            edge *= 2;
        }
        (edge, cells(edge))
    }

    fn finest(volume: &'a Volume, most: usize) -> Self {
        let grid = &volume.sigma_t;
        let (edge, dims) = Self::finest_dims(volume, most);
        let mut sigma_t = grid.lists().zeros_surely(Self::count(dims));
        grid.write_means([edge; 3], &mut sigma_t);
        sigma_t.par_iter_mut().enumerate().for_each(|(i, mean)| {
            let cell = unflatten(i, dims);
            let inside = (0..3).map(|a| edge.min(grid.dims()[a] - cell[a] * edge));
            let inside: usize = inside.product();
            if inside < edge.pow(3) {
                *mean *= inside as f32 / edge.pow(3) as f32;
            }
        });
        Self {
            volume,
            edge: edge as f32,
            dims,
            sigma_t,
        }
    }

    /// Cells of half a voxel, if they are at most `most`. The field is linear in these along each
    /// axis: their middles have their means.
    #[must_use]
    pub fn in_halves(volume: &'a Volume, most: usize) -> Option<Self> {
        let dims = volume.sigma_t.dims().map(|n| 2 * n);
        if !Self::are_at_most(dims, most) {
            return None;
        }
        let mut sigma_t = volume.sigma_t.lists().zeros_surely(Self::count(dims));
        let rows = sigma_t.par_chunks_mut(dims[0]).enumerate();
        rows.for_each(|(row, cells)| {
            let [y, z] = [row % dims[1], row / dims[1]];
            for (x, cell) in cells.iter_mut().enumerate() {
                let middle = [x, y, z].map(|i| 0.5 * i as f32 + 0.25);
                *cell = volume.sigma_t.sample(Vec3::from(middle));
            }
        });
        Some(Self {
            volume,
            edge: 0.5,
            dims,
            sigma_t,
        })
    }

    fn coarser(&self) -> Self {
        let dims = self.dims.map(|n| n.div_ceil(2));
        let finer = &self.sigma_t[..];
        let mean = |i: usize| {
            let cell = unflatten(i, dims);
            let parts = (0..8).map(|part| [0, 1, 2].map(|a| 2 * cell[a] + (part >> a & 1)));
            let inside = parts.filter(|at| (0..3).all(|a| at[a] < self.dims[a]));
            inside.map(|at| finer[self.index(at)]).sum::<f32>() * 0.125
        };
        let mut sigma_t = self.sigma_t.lists().zeros_surely(Self::count(dims));
        let cells = sigma_t.par_iter_mut().enumerate();
        cells.for_each(|(i, cell)| *cell = mean(i));
        Self {
            volume: self.volume,
            edge: 2.0 * self.edge,
            dims,
            sigma_t,
        }
    }

    fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.dims[1] + y) * self.dims[0] + x
    }

    /// The cells in layers along the first of three axes, in rows along the second.
    #[must_use]
    pub fn layers(&self, axes: [usize; 3]) -> Layers {
        let [count, width, height] = axes.map(|a| self.dims[a]);
        let cells = count * height * (width + 2);
        let mut cells = self.sigma_t.lists().zeros_surely(cells);
        let sigma_t = &self.sigma_t[..];
        cells.write_pieces(width + 2, |i, row| {
            let mut at = [0; 3];
            at[axes[0]] = i / height;
            at[axes[2]] = i % height;
            for (u, cell) in row[1..=width].iter_mut().enumerate() {
                at[axes[1]] = u;
                *cell = sigma_t[self.index(at)];
            }
        });
        Layers {
            across: [width, height],
            cells,
            empty: vec![0.0; width + 2],
        }
    }
}

impl Layers {
    /// Cells of a row.
    #[must_use]
    pub fn width(&self) -> usize {
        self.across[0]
    }

    /// A row of a layer, with an empty cell before its first and behind its last; an empty one
    /// beside the layer.
    #[must_use]
    pub fn row(&self, layer: usize, row: i32) -> &[f32] {
        let [width, height] = self.across;
        match usize::try_from(row) {
            Ok(row) if row < height => {
                let first = (layer * height + row) * (width + 2);
                &self.cells[first..first + width + 2]
            }
            _ => &self.empty,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;

    #[test]
    fn every_level_holds_as_much_as_the_volume() {
        let grid = Grid::from_fn([37, 22, 50], |[i, j, k]| ((i * j + k) % 7) as f32);
        let mut sum = 0.0;
        for k in 0..50 {
            for j in 0..22 {
                sum += (0..37).map(|i| ((i * j + k) % 7) as f64).sum::<f64>();
            }
        }
        let volume = Volume::new("test".into(), grid, [0.5; 3], DAffine3::IDENTITY);
        let levels = CoarseVolume::levels(&volume, 10_000, 9);
        assert_eq!(levels[0].edge, 2.0);
        assert_eq!(levels.last().map(|l| l.dims), Some([1; 3]));
        for level in &levels {
            let cell = f64::from(level.edge).powi(3);
            let held: f64 = level.sigma_t.iter().map(|s| f64::from(*s) * cell).sum();
            assert!((held / sum - 1.0).abs() < 1e-5, "{}", level.edge);
            let axes = [1, 2, 0];
            let layers = level.layers(axes);
            let rows = (0..level.dims[1]).flat_map(|k| {
                let rows = -1..=level.dims[0] as i32;
                rows.map(move |row| (k, row))
            });
            let in_layers: f64 = rows
                .flat_map(|(k, row)| layers.row(k, row))
                .map(|s| f64::from(*s) * cell)
                .sum();
            assert!((in_layers / sum - 1.0).abs() < 1e-5);
        }
    }

    #[test]
    fn halves_of_voxels_have_the_means_of_the_field() {
        let grid = Grid::from_fn([9, 6, 7], |[i, j, k]| ((i * j + k) % 7) as f32);
        let volume = Volume::new("test".into(), grid, [0.5; 3], DAffine3::IDENTITY);
        assert!(CoarseVolume::in_halves(&volume, 3000).is_none());
        let halves = CoarseVolume::in_halves(&volume, 3024).unwrap();
        assert_eq!((halves.edge, halves.dims), (0.5, [18, 12, 14]));
        for cell in [[0, 0, 0], [5, 4, 3], [17, 11, 13], [8, 1, 6]] {
            let points = (0..64).map(|i| unflatten(i, [4; 3]));
            let mean = points.map(|p| {
                let at = [0, 1, 2].map(|a| 0.5 * (cell[a] as f32 + (p[a] as f32 + 0.5) / 4.0));
                volume.sigma_t.sample(Vec3::from(at)) / 64.0
            });
            assert!((mean.sum::<f32>() - halves.sigma_t[halves.index(cell)]).abs() < 1e-5);
        }
    }
}
