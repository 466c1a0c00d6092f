//! What a ray found at vertices last: most of its next points lie between the same.

use super::front::SeenFront;
use crate::inscatter::direct::{DIRECT_LEVELS, LightVectors};
use crate::inscatter::lvoxel_light::LvoxelMemo;
use crate::inscatter::sweep::SWEPT_LEVELS;
use crate::inscatter::vertices::CellCache;
use wide::f32x4;

/// What one ray found at vertices last, by lattice.
#[derive(Debug, Default)]
pub struct RayMemo {
    /// By volume.
    pub(super) direct: [CellCache<usize, LightVectors>; DIRECT_LEVELS],
    /// By volume, and whether they are swept.
    pub(super) indirect: [CellCache<(usize, bool), f32x4>; SWEPT_LEVELS],
    /// By volume and level.
    pub(super) fronts: CellCache<(usize, usize), SeenFront>,
    /// Of the only volume that has such light.
    pub(super) lvoxels: LvoxelMemo,
    /// Scene units between the vertices that light was between last, direct and indirect; 0 where
    /// it was not between any.
    pub(super) between: [f32; 2],
}

impl RayMemo {
    /// Scene units of a ray over which light is as good as that in their middle: what vertices are
    /// apart.
    pub fn evenly_lit(&self) -> f32 {
        let [direct, indirect] = self.between;
        direct.min(indirect)
    }
}
