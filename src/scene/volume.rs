//! A participating medium: a grid of density in a box placed anywhere.

use super::Grid;
use super::albedo_grid::{AlbedoGrid, has_step, mean_over};
use super::grid::{Allowed, BRICK_CELLS, Errors, Pyramid, VolumeGrid, VoxelBox};
use crate::Result;
use crate::formats::{BrickEntry, PackedVolume};
use crate::math::{Aabb, PhaseFunction, Rgb};
use glam::{Affine3A, DAffine3, DVec3, Vec3};

/// A scattering and absorbing medium. There is none outside its box.
#[derive(Debug)]
pub struct Volume {
    /// Name, for messages.
    pub name: String,
    /// Extinction sigma_t per scene unit, sampled on a grid, of the channel that has most; scale
    /// and value window are already applied.
    pub sigma_t: VolumeGrid,
    /// Extinction of red, green and blue over `sigma_t`, each in `[0,1]` and one of them 1: all of
    /// a grey medium.
    pub extinction_color: [f32; 3],
    /// Single-scattering albedo, sigma_s / sigma_t, each channel in `[0,1]`; where that varies, its
    /// mean, weighted by the extinction.
    pub albedo: [f32; 3],
    /// The albedo of each voxel, if that varies; [`Volume::albedo_at`] asks it.
    pub albedo_grid: Option<AlbedoGrid>,
    /// How scattered light is spread over directions.
    pub phase: PhaseFunction,
    /// Maps the box `0..dims` of the grid into the scene; any invertible affine map.
    pub scene_from_index: DAffine3,
    /// Inverse of `scene_from_index`, rounded, for rays.
    pub index_from_scene: Affine3A,
    /// The same, as exact as it is known: where a ray enters decides how deep a dense volume is.
    pub index_from_scene_f64: DAffine3,
    levels: Pyramid,
}

impl Volume {
    /// A medium that scatters alike in all directions, whose box is placed by an invertible map.
    #[must_use]
    pub fn new(
        name: String,
        sigma_t: impl Into<VolumeGrid>,
        albedo: [f32; 3],
        scene_from_index: DAffine3,
    ) -> Self {
        let mut volume = Self {
            name,
            sigma_t: sigma_t.into(),
            extinction_color: [1.0; 3],
            albedo,
            albedo_grid: None,
            phase: PhaseFunction::ISOTROPIC,
            scene_from_index: DAffine3::IDENTITY,
            index_from_scene: Affine3A::IDENTITY,
            index_from_scene_f64: DAffine3::IDENTITY,
            levels: Pyramid::default(),
        };
        volume.place(scene_from_index);
        volume
    }

    /// The same medium with another phase function.
    #[must_use]
    pub fn with_phase(self, phase: PhaseFunction) -> Self {
        Self { phase, ..self }
    }

    /// The same medium with such an extinction of red, green and blue over that of its grid, each
    /// in `[0,1]` and one of them 1.
    #[must_use]
    pub fn with_extinction_color(self, extinction_color: [f32; 3]) -> Self {
        Self {
            extinction_color,
            ..self
        }
    }

    /// The least of its extinctions of red, green and blue over the largest: what stops no light of
    /// this channel is beyond no depth.
    #[must_use]
    pub fn clearest(&self) -> f32 {
        self.extinction_color.into_iter().fold(1.0, f32::min)
    }

    /// The same medium with an albedo that varies, on the voxels of its extinction; its mean is
    /// left to the caller.
    #[must_use]
    pub fn with_albedo_grid(self, albedo_grid: Option<AlbedoGrid>) -> Self {
        Self {
            albedo_grid,
            ..self
        }
    }

    /// The albedo at a point of index space.
    #[must_use]
    #[inline]
    pub fn albedo_at(&self, point_in_index: Vec3) -> Rgb {
        match &self.albedo_grid {
            None => Rgb(self.albedo),
            Some(grid) => grid.at(point_in_index),
        }
    }

    /// The albedo at a point of scene space.
    #[must_use]
    #[inline]
    pub fn albedo_in_scene(&self, point: Vec3) -> Rgb {
        match &self.albedo_grid {
            None => Rgb(self.albedo),
            Some(grid) => grid.at(self.index_from_scene.transform_point3(point)),
        }
    }

    /// The mean albedo over a cube of voxels, as far as it is in the grid, weighted by the
    /// extinction.
    #[must_use]
    pub fn mean_albedo(&self, first: [usize; 3], edge: usize) -> Rgb {
        let Some(grid) = &self.albedo_grid else {
            return Rgb(self.albedo);
        };
        let dims = self.sigma_t.dims();
        let dims = std::array::from_fn(|a| edge.min(dims[a].saturating_sub(first[a])));
        let mean = mean_over(grid, &self.sigma_t, VoxelBox { first, dims });
        mean.unwrap_or(Rgb(self.albedo))
    }

    /// Whether the albedo steps from a voxel to the next in a cube of voxels, or beside it.
    #[must_use]
    pub fn has_albedo_step(&self, first: [usize; 3], edge: usize) -> bool {
        let Some(grid) = &self.albedo_grid else {
            return false;
        };
        let dims = self.sigma_t.dims();
        let from = first.map(|v| v.saturating_sub(1));
        let to: [usize; 3] = std::array::from_fn(|a| (first[a] + edge + 1).min(dims[a]));
        let voxels = VoxelBox {
            first: from,
            dims: std::array::from_fn(|a| to[a].saturating_sub(from[a])),
        };
        has_step(grid, &self.sigma_t, voxels)
    }

    /// Whether it stands on the grid of another, and stops red, green and blue in the same
    /// proportions: together they are as deep as one whose extinction is the sum.
    #[must_use]
    pub fn adds_to(&self, other: &Self) -> bool {
        self.scene_from_index == other.scene_from_index
            && self.sigma_t.dims() == other.sigma_t.dims()
            && self.sigma_t.size() == other.sigma_t.size()
            && self.extinction_color == other.extinction_color
    }

    /// Whether it stops red, green and blue alike.
    #[must_use]
    pub fn is_grey(&self) -> bool {
        self.extinction_color == [1.0; 3]
    }

    /// The medium on voxels of 2^`level` times the edge, made when first asked for, in the same
    /// box. Their means darken what is sharper than they are.
    #[must_use]
    pub fn at_level(&self, level: usize) -> Self {
        let grid = self.level(level);
        let size = |grid: &VolumeGrid| DVec3::from(grid.size().map(f64::from));
        let voxels = DAffine3::from_scale(size(&self.sigma_t) / size(grid));
        let place = self.scene_from_index * voxels;
        let coarser = Self::new(self.name.clone(), grid.clone(), self.albedo, place);
        let coarser = coarser.with_extinction_color(self.extinction_color);
        let coarser = coarser.with_albedo_grid(self.albedo_grid_at_level(level));
        coarser.with_phase(self.phase)
    }

    /// The same medium with bricks on levels of their own, as [`VolumeGrid::adapted`]; `None` also
    /// if its albedo varies.
    ///
    /// # Errors
    /// As [`VolumeGrid::adapted`].
    pub fn adapted(&self, allowed: impl Fn([usize; 3]) -> Allowed + Sync) -> Result<Option<Self>> {
        if self.albedo_grid.is_some() {
            return Ok(None);
        }
        let with_grid = |grid| {
            let volume = Self::new(self.name.clone(), grid, self.albedo, self.scene_from_index);
            let volume = volume.with_extinction_color(self.extinction_color);
            volume.with_phase(self.phase)
        };
        Ok(self.sigma_t.adapted(allowed)?.map(with_grid))
    }

    /// Voxels from which on shadows of each are too many to be exact, and bricks are worth levels
    /// of their own.
    const MANY_VOXELS: u64 = PackedVolume::MANY_VOXELS;

    /// Whether it has as many.
    #[must_use]
    pub fn has_many_voxels(&self) -> bool {
        let voxels: usize = self.sigma_t.dims().iter().product();
        voxels as u64 >= Self::MANY_VOXELS
    }

    /// The middle of a brick of cells, in scene space.
    #[must_use]
    pub fn middle_of_brick(&self, brick: [usize; 3]) -> Vec3 {
        let middle = Vec3::from(brick.map(|c| (c * BRICK_CELLS + BRICK_CELLS / 2) as f32));
        let middle = self.scene_from_index.transform_point3(middle.as_dvec3());
        middle.as_vec3()
    }

    fn albedo_grid_at_level(&self, level: usize) -> Option<AlbedoGrid> {
        let mut albedo = self.albedo_grid.clone()?;
        for level in 1..=level {
            let (finer, coarser) = (self.level(level - 1), self.level(level));
            if finer.dims() != coarser.dims() {
                albedo = albedo.coarser(finer, coarser);
            }
        }
        Some(albedo)
    }

    /// The grid of voxels of 2^`level` times the edge, made when first asked for.
    #[must_use]
    pub fn level(&self, level: usize) -> &VolumeGrid {
        self.levels.level(&self.sigma_t, level)
    }

    /// Whether each of its levels is what the one before makes it, and the first is constant beyond
    /// its outermost samples; they are all read.
    ///
    /// # Errors
    /// As [`Volume::ready`], for all levels.
    pub fn has_right_levels(&self) -> Result<bool> {
        let mut finer = self.level(0);
        finer.ready()?;
        if !finer.has_right_borders() {
            return Ok(false);
        }
        for level in 1.. {
            let grid = self.level(level);
            if grid.dims() == finer.dims() {
                break;
            }
            grid.ready()?;
            if **grid != Grid::coarser(finer) {
                return Ok(false);
            }
            finer = grid;
        }
        Ok(true)
    }

    /// The errors of the bricks of a level on the three above it, in the order of their entries;
    /// all are read.
    ///
    /// # Errors
    /// As [`Volume::ready`], for these levels.
    pub(super) fn errors_of_bricks(
        &self,
        level: usize,
        entries: &[BrickEntry],
    ) -> Result<Vec<Errors>> {
        let coarser = [1, 2, 3].map(|above| self.level(level + above));
        self.level(level).errors_of_bricks(coarser, entries)
    }

    /// Whether the errors of bricks that are stored with its levels are those of what is stored;
    /// all levels are read.
    ///
    /// # Errors
    /// As [`Volume::ready`], for all levels.
    pub fn has_right_errors(&self) -> Result<bool> {
        let mut level = 0;
        loop {
            let grid = self.level(level);
            if !grid.has_right_errors([1, 2, 3].map(|above| self.level(level + above)))? {
                return Ok(false);
            }
            level += 1;
            if self.level(level).dims() == grid.dims() {
                return Ok(true);
            }
        }
    }

    /// Reads its grid if that is in a file and was not read.
    ///
    /// # Errors
    /// Damage of the file, no memory for the grid, or a stop on request.
    pub fn ready(&self) -> Result<()> {
        self.sigma_t.ready()?;
        self.albedo_grid.as_ref().map_or(Ok(()), AlbedoGrid::ready)
    }

    /// Places its box anew; the map must be invertible.
    pub fn place(&mut self, scene_from_index: DAffine3) {
        let inverse = scene_from_index.inverse();
        self.scene_from_index = scene_from_index;
        self.index_from_scene =
            Affine3A::from_cols_array(&inverse.to_cols_array().map(|v| v as f32));
        self.index_from_scene_f64 = inverse;
    }

    /// Lowers extinction that is beyond what positions in f32 can tell apart: light gets into such
    /// a medium by less than their rounding, and whether a point is lit is left to that. A voxel
    /// stays opaque whatever its size, and the mean free path shorter than anything in a picture.
    pub fn limit_extinction(&mut self) {
        self.sigma_t.limit(self.most_extinction());
    }

    /// The most that extinction may be here; see [`Volume::limit_extinction`].
    #[must_use]
    pub fn most_extinction(&self) -> f32 {
        /// Mean free paths over the rounding of the largest coordinate.
        const PATH: f32 = 64.0 * f32::EPSILON;
        /// Depth of a voxel from which on nothing of light gets through.
        const OPAQUE: f32 = 128.0;
        let corners = self.corners();
        let farthest = corners.iter().map(|p| p.abs().max_element());
        let far = farthest.fold(0.0, f32::max);
        (1.0 / (PATH * far)).max(OPAQUE / self.shortest_voxel_edge())
    }

    /// Corners of its box in the scene.
    #[must_use]
    pub fn corners(&self) -> [Vec3; 8] {
        let dims = self.sigma_t.size().map(f64::from);
        std::array::from_fn(|i| {
            let corner: [f64; 3] = std::array::from_fn(|a| dims[a] * (i >> a & 1) as f64);
            let in_scene = self.scene_from_index.transform_point3(corner.into());
            in_scene.as_vec3()
        })
    }

    /// Box around it in the scene, along the axes of that.
    #[must_use]
    pub fn bounds(&self) -> Aabb {
        self.corners().into_iter().fold(Aabb::EMPTY, Aabb::with)
    }

    /// Longest edge of a voxel, scene units.
    #[must_use]
    pub fn longest_voxel_edge(&self) -> f32 {
        self.voxel_edges().into_iter().fold(0.0, f64::max) as f32
    }

    /// Shortest edge of a voxel, scene units.
    #[must_use]
    pub fn shortest_voxel_edge(&self) -> f32 {
        self.voxel_edges().into_iter().fold(f64::INFINITY, f64::min) as f32
    }

    fn voxel_edges(&self) -> [f64; 3] {
        let axes = self.scene_from_index.matrix3;
        [axes.x_axis, axes.y_axis, axes.z_axis].map(|a| a.length())
    }
}
