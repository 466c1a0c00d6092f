//! How deep the cells of a medium lie in it: where little light gets, few rays tell it.

use crate::math::unflatten;
use crate::run::List;
use crate::scene::Volume;
use rayon::prelude::*;

/// The least optical depth from cells of a volume to its border, of the directions to their 26
/// neighbours.
#[derive(Debug)]
pub struct Cover {
    /// Voxels along an edge of a cell.
    edge: usize,
    dims: [usize; 3],
    /// x fastest.
    depths: List<f32>,
}

impl Cover {
    /// Cells of a volume, at most.
    const MOST: usize = 1 << 21;
    /// Directions whose depths are held together.
    const TOGETHER: usize = 4;
    /// Bytes while it is made: of what is known, of the extinction, and of those depths.
    pub const BYTES: u64 = ((2 + Self::TOGETHER) * Self::MOST * size_of::<f32>()) as u64;

    /// Whether a volume has so many voxels that it is soon made, beside their light.
    pub fn is_worth_it(volume: &Volume) -> bool {
        /// Bricks.
        const LARGE: usize = 1 << 10;
        volume.sigma_t.stored_bricks() >= LARGE
    }

    /// That of a volume with the media of others on its grid.
    pub fn new(volume: &Volume, others: &[&Volume]) -> Self {
        let grid = &volume.sigma_t;
        let mut edge = 1;
        while grid.blocks([edge; 3]).iter().product::<usize>() > Self::MOST {
            edge *= 2;
        }
        let dims = grid.blocks([edge; 3]);
        let lists = grid.lists();
        let cells = || lists.zeros_surely::<f32>(dims.iter().product());
        let mut sigma_t = cells();
        grid.write_means([edge; 3], &mut sigma_t);
        for other in others {
            let mut means = cells();
            other.sigma_t.write_means([edge; 3], &mut means);
            let sums = sigma_t.iter_mut().zip(&means[..]);
            sums.for_each(|(sum, other)| *sum += other);
        }
        let cell = volume.longest_voxel_edge() * edge as f32;
        let mut depths = cells();
        depths.fill(f32::INFINITY);
        let neighbours: Vec<usize> = (0..27).filter(|i| *i != 13).collect();
        for some in neighbours.chunks(Self::TOGETHER) {
            let way = |&i: &usize| unflatten(i, [3; 3]).map(|c| c as isize - 1);
            let ways = some.par_iter().map(|i| {
                let mut depths = cells();
                write_along(way(i), &sigma_t, dims, cell, &mut depths);
                depths
            });
            for way in ways.collect::<Vec<_>>() {
                let all = depths.iter_mut().zip(&way[..]);
                all.for_each(|(least, depth)| *least = least.min(*depth));
            }
        }
        Self { edge, dims, depths }
    }

    /// The depth of a voxel.
    pub fn at(&self, voxel: [usize; 3]) -> f32 {
        let [x, y, z] = voxel.map(|c| c / self.edge);
        self.depths[(z * self.dims[1] + y) * self.dims[0] + x]
    }
}

/// Writes the optical depths from cells to the border, a neighbour after the other.
fn write_along(way: [isize; 3], sigma_t: &[f32], dims: [usize; 3], cell: f32, depths: &mut [f32]) {
    let length = way.iter().map(|c| (c * c) as f32).sum::<f32>().sqrt();
    let half = 0.5 * cell * length;
    // Each behind the one that its way leads to.
    let inward = |a: usize| {
        let count = dims[a];
        (0..count).map(move |i| if way[a] > 0 { count - 1 - i } else { i })
    };
    for z in inward(2) {
        for y in inward(1) {
            for x in inward(0) {
                let at = [x, y, z];
                let to: [usize; 3] = std::array::from_fn(|a| at[a].wrapping_add_signed(way[a]));
                let index = |[x, y, z]: [usize; 3]| (z * dims[1] + y) * dims[0] + x;
                let own = half * sigma_t[index(at)];
                depths[index(at)] = match (0..3).all(|a| to[a] < dims[a]) {
                    true => own + half * sigma_t[index(to)] + depths[index(to)],
                    false => own,
                };
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::{DAffine3, DVec3};

    #[test]
    fn a_voxel_is_as_deep_as_the_shortest_way_out() {
        let place = DAffine3::from_scale(DVec3::splat(0.5));
        let grid = Grid::from_fn([16, 12, 8], |[x, ..]| if x < 10 { 2.0 } else { 0.0 });
        let volume = Volume::new("slab".into(), grid, [0.5; 3], place);
        let thin = Volume::new(
            "haze".into(),
            Grid::from_fn([16, 12, 8], |_| 0.2),
            [0.5; 3],
            place,
        );
        let cover = Cover::new(&volume, &[]);
        // In voxels of a depth of 1.
        for (voxel, expected) in [
            ([9, 6, 4], 0.5),
            ([12, 6, 4], 0.0),
            ([5, 6, 0], 0.5),
            ([5, 6, 3], 3.5),
            ([1, 6, 3], 1.5),
        ] {
            let found = cover.at(voxel);
            assert!((found - expected).abs() < 1e-4, "{voxel:?}: {found}");
        }
        let with = Cover::new(&volume, &[&thin]);
        assert!((with.at([5, 6, 3]) - 3.85).abs() < 1e-4);
    }
}
