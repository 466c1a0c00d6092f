//! Where light of emitters is not linear between the vertices of a cell.

use super::InScatter;
use crate::inscatter::direct::DIRECT_LEVELS;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::occupied;
use crate::inscatter::vertices::Vertices;

/// What is known of how light of emitters bends in the cells of each lattice of direct light.
#[derive(Debug)]
pub(super) struct Bends {
    /// By the first vertex of a cell, whether it does.
    pub in_cells: [Vertices<bool>; DIRECT_LEVELS],
    /// What emitters would send to vertices.
    pub unshadowed: [Vertices<f32>; DIRECT_LEVELS],
}

impl Bends {
    pub fn new(dims: [usize; 3]) -> Self {
        Self {
            in_cells: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
            unshadowed: std::array::from_fn(|level| Vertices::new(dims, 1 << level)),
        }
    }
}

impl<G: GatherInMedia> InScatter<'_, G> {
    /// Emitters further away than two to this power times twice what vertices are apart are too far
    /// to look whether their light bends.
    const FAR_LEVELS: usize = 3;
    /// Factor between light in the middle of a cell and what its vertices tell of it.
    const MAX_BEND: f32 = 1.2;

    /// Whether light of emitters in the middle of a cell, where so many lattices serve, is not what
    /// it is between its vertices, as in the plane of a flat lamp, which sends none along that.
    pub(super) fn bends(
        &self,
        volume: usize,
        levels: usize,
        level: usize,
        cell: [usize; 3],
    ) -> bool {
        let bends = self.lattices[volume].bends.as_ref();
        let Some(bends) = bends.filter(|_| levels <= level + Self::FAR_LEVELS) else {
            return false;
        };
        let unshadowed = |p| {
            let point = self.to_scene(volume, p);
            self.lights.unshadowed_of_emitters(point).luminance()
        };
        *bends.in_cells[level].get(cell, &|p, cell| {
            let at_vertex = |v| *bends.unshadowed[level].get(v, &|p, _| unshadowed(p));
            let count = bends.unshadowed[level].count();
            let linear = 0.125 * occupied::around(cell, count).map(at_vertex).sum::<f32>();
            let middle = unshadowed(p + 0.5 * (1 << level) as f32);
            linear.max(middle) > Self::MAX_BEND * linear.min(middle)
        })
    }
}
