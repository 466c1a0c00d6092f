//! Where light of emitters, and indirect light, is not linear between the vertices of a cell.

use super::InScatter;
use crate::inscatter::direct::DIRECT_LEVELS;
use crate::inscatter::gatherer::GatherInMedia;
use crate::inscatter::lvoxel_light::LvoxelMemo;
use crate::inscatter::occupied;
use crate::inscatter::vertices::Vertices;
use crate::math::Rgb;
use crate::run::walked::note_asked;

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
    /// Vertices of gathered light that are further apart than so many pixels are looked between:
    /// there, light has the noise of a gather, which finer ones have, too.
    pub(super) const BENDING_SPACING_PIXELS: f32 = 24.0;
    /// Factor as above, of all indirect light.
    const MAX_INDIRECT_BEND: f32 = 1.15;

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

    /// Indirect light at a vertex that is not swept.
    pub(super) fn indirect_vertex(&self, volume: usize, level: usize, v: [usize; 3]) -> Rgb {
        note_asked(true);
        *self.lattices[volume].indirect[level].get(v, &|p, v| {
            let key = self.key(volume, level, v);
            self.gathered(volume, p, self.to_scene(volume, p), key)
        })
    }

    /// Whether indirect light in the middle of a cell is not what it is between its vertices, of
    /// which `at` tells, as above a spot of light on a floor: that of surfaces, over all of it. The
    /// middle is a vertex of the next finer lattice.
    pub(super) fn indirect_bends(
        &self,
        volume: usize,
        level: usize,
        cell: [usize; 3],
        at: impl Fn([usize; 3]) -> Rgb,
    ) -> bool {
        let lattices = &self.lattices[volume];
        let (Some(bends), Some(finer)) = (&lattices.indirect_bends, level.checked_sub(1)) else {
            return false;
        };
        *bends[level].get(cell, &|_, cell| {
            let corners = occupied::around(cell, lattices.indirect[level].count());
            let linear = 0.125 * corners.map(|v| at(v).luminance()).sum::<f32>();
            let middle = cell.map(|c| 2 * c + 1);
            let of_lvoxels = lattices.lvoxels.as_ref().map_or(Rgb::BLACK, |lvoxels| {
                let point = self.to_scene(volume, lattices.indirect[finer].at(middle));
                lvoxels.at(point, &mut LvoxelMemo::default()).0
            });
            let rest = of_lvoxels.luminance();
            let middle = self.indirect_vertex(volume, finer, middle).luminance();
            rest + linear.max(middle) > Self::MAX_INDIRECT_BEND * (rest + linear.min(middle))
        })
    }
}
