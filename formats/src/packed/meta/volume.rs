//! The media of a packed scene.

use super::rules::{are_shares, check, cross};
use crate::Result;
use crate::record::MAX_VOXELS_ALONG;

/// Extent of a voxel in any direction, at least: half of what scenes may have.
const MIN_VOXEL_EDGE: f64 = 0.5e-15;

/// A phase function of two lobes (Henyey & Greenstein 1941).
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedPhase {
    /// Mean cosine of each, from -0.99 to 0.99.
    pub g: [f32; 2],
    /// Weight of the first, 0 to 1.
    pub mix: f32,
}

/// A medium in a box.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedVolume {
    /// Name, for messages.
    pub name: String,
    /// Voxels along x, y, z of index space.
    pub dims: [u32; 3],
    /// Single-scattering albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Lobes of the phase function; `None` if it is isotropic.
    pub phase: Option<PackedPhase>,
    /// Affine map from index to scene space: three columns, then the translation.
    pub scene_from_index: [[f64; 3]; 4],
    /// Bricks that are stored of each level, the finest first.
    pub levels: Vec<u64>,
}

impl PackedVolume {
    pub(super) fn validate(&self) -> Result<()> {
        let what = || format!("volume {:?}", self.name);
        let dims = self.dims;
        let sides = 1..=MAX_VOXELS_ALONG;
        check(
            dims.iter().all(|n| sides.contains(n)),
            &what,
            "voxels along each axis",
            dims,
        )?;
        let [x, y, z, _] = self.scene_from_index;
        let c = cross(x, y);
        let determinant = c[0] * z[0] + c[1] * z[1] + c[2] * z[2];
        let fits = |v: &f64| v.abs() <= f64::from(f32::MAX);
        // Voxels are as thin as their volume over the areas of their faces.
        let area = |a: [f64; 3], b: [f64; 3]| {
            let c = cross(a, b);
            (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]).sqrt()
        };
        let is_thick = |face: f64| determinant.abs() >= MIN_VOXEL_EDGE * face;
        let is_map = self.scene_from_index.as_flattened().iter().all(fits)
            && determinant.is_finite()
            && determinant != 0.0
            && [area(x, y), area(y, z), area(z, x)]
                .into_iter()
                .all(is_thick);
        let expected =
            "a map of finite numbers that can be inverted, to voxels that have an extent";
        check(is_map, &what, expected, self.scene_from_index)?;
        check(
            are_shares(self.albedo),
            &what,
            "an albedo from 0 to 1",
            self.albedo,
        )?;
        let is_right = self
            .phase
            .is_none_or(|p| p.g.iter().all(|g| g.abs() <= 0.99) && (0.0..=1.0).contains(&p.mix));
        let expected = "lobes of mean cosines from -0.99 to 0.99, and a weight from 0 to 1";
        check(is_right, &what, expected, self.phase)?;
        let count = self.levels.len();
        let is_right = (1..=Self::MOST_LEVELS).contains(&count)
            && (count == 1 || self.dims_of_level(count - 2) != [1; 3]);
        let expected = "levels down to one of a single voxel at most";
        check(is_right, &what, expected, count)?;
        for (level, bricks) in self.levels.iter().enumerate() {
            let dims = self.dims_of_level(level).map(|n| u128::from(n / 8 + 1));
            let most = dims.iter().product::<u128>();
            let expected = format!("at most {most} bricks of level {level}");
            check(u128::from(*bricks) <= most, &what, &expected, bricks)?;
        }
        Ok(())
    }

    /// Levels of a volume, at most.
    const MOST_LEVELS: usize = 20;

    /// Voxels of a level along each axis: half as many as of the one before, rounded up.
    #[must_use]
    pub fn dims_of_level(&self, level: usize) -> [u32; 3] {
        self.dims.map(|n| n.div_ceil(1 << level.min(31)))
    }

    /// Bricks of 8^3 cells of a level along each axis, stored or not; there is a cell before the
    /// first sample and one behind the last.
    #[must_use]
    pub fn brick_dims(&self, level: usize) -> [u64; 3] {
        self.dims_of_level(level).map(|n| u64::from(n) / 8 + 1)
    }

    /// Voxels from which on the errors of the bricks of a level on coarser ones are worth a column.
    pub const MANY_VOXELS: u64 = 1 << 22;

    /// Levels of so many voxels, the finest first.
    #[must_use]
    pub fn levels_of_many_voxels(&self) -> usize {
        let voxels = |level| {
            let dims = self.dims_of_level(level).into_iter();
            dims.fold(1, |n: u64, d| n.saturating_mul(d.into()))
        };
        let is_large = |level: &usize| voxels(*level) >= Self::MANY_VOXELS;
        (0..self.levels.len()).take_while(is_large).count()
    }

    /// Bricks of these levels.
    #[must_use]
    pub fn bricks_with_errors(&self) -> u64 {
        let levels = &self.levels[..self.levels_of_many_voxels()];
        levels.iter().fold(0, |n, bricks| n.saturating_add(*bricks))
    }
}
