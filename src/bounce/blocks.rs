//! The lvoxels of one volume, numbered, and the way of a ray through them.

use super::light::Light;
use crate::math::dda::{Passage, Steps};
use crate::math::{Ray, Spectrum};
use crate::scene::Volume;
use glam::{Affine3A, DAffine3, DMat3, DVec3};
use lvox_formats::record::{Lvoxel, MAX_LEVEL, VolumeInfo};

const BRICK: usize = 1 << MAX_LEVEL;
const EMPTY: u32 = u32::MAX;

/// The lvoxels of one volume, in the order in which they came.
#[derive(Debug)]
pub struct Blocks {
    /// Single-scattering albedo; where that varies, its mean.
    pub albedo: [f32; 3],
    /// By block, where it varies.
    albedos: Vec<Light>,
    /// The mean cosine of the phase function that its medium had before it was made to scatter
    /// alike in all directions.
    mean_cosine: f32,
    /// By block: extinction per scene unit, of the channel that has most of it.
    pub sigma_t: Vec<f32>,
    /// By channel: what extinction is of that.
    extinction_color: [f32; 3],
    /// What extinction is of that of the medium.
    pub scale: f32,
    /// By block: log2 of its voxels along an edge.
    pub levels: Vec<u8>,
    /// By block: its lowest voxel.
    pub corners: Vec<[u32; 3]>,
    /// Maps the box of voxels into the scene.
    pub scene_from_index: DAffine3,
    /// Voxels along each axis.
    pub dims: [f32; 3],
    index_from_scene: Affine3A,
    index_from_scene_f64: DAffine3,
    table_dims: [usize; 3],
    /// By brick: the first of its places, and its level; none if it is empty.
    table: Vec<(u32, u8)>,
    /// Number of the block in each place, or [`EMPTY`].
    places: Vec<u32>,
}

impl Blocks {
    /// Bytes of each, and of the places around it that are empty.
    pub const BYTES: usize = size_of::<f32>() + size_of::<u8>() + 7 * size_of::<u32>();

    /// Bytes of the albedo of each, where it varies.
    pub const BYTES_OF_ALBEDO: u64 = size_of::<Light>() as u64;

    /// A volume without lvoxels.
    pub fn new(info: &VolumeInfo) -> Self {
        let [x, y, z, t] = info.index_from_scene.map(DVec3::from);
        let exact = DAffine3 {
            matrix3: DMat3::from_cols(x, y, z),
            translation: t,
        };
        let table_dims = info.dims.map(|n| (n as usize).div_ceil(BRICK));
        Self {
            albedo: info.albedo,
            albedos: Vec::new(),
            mean_cosine: 0.0,
            scale: 1.0,
            sigma_t: Vec::new(),
            extinction_color: info.extinction_color,
            levels: Vec::new(),
            corners: Vec::new(),
            scene_from_index: exact.inverse(),
            dims: info.dims.map(|n| n as f32),
            index_from_scene: Affine3A::from_cols_array(&exact.to_cols_array().map(|v| v as f32)),
            index_from_scene_f64: exact,
            table_dims,
            table: vec![(EMPTY, 0); table_dims.iter().product()],
            places: Vec::new(),
        }
    }

    /// The same with the medium that scatters alike in all directions, and spreads light as one
    /// does whose phase function has this mean cosine (similarity, van de Hulst 1980).
    pub fn spreading(mut self, mean_cosine: f32) -> Self {
        let most = self.albedo.into_iter().fold(0.0, f32::max);
        self.scale = 1.0 - most * mean_cosine;
        self.albedo = (self.albedo).map(|a| a * (1.0 - mean_cosine) / (1.0 - a * mean_cosine));
        self.mean_cosine = mean_cosine;
        self
    }

    /// Takes the albedo that each block has in a medium, whose albedo varies.
    pub fn take_albedos(&mut self, volume: &Volume) {
        let g = self.mean_cosine;
        let blocks = self.corners.iter().zip(&self.levels);
        let albedos = blocks.map(|(corner, level)| {
            let albedo = volume.mean_albedo(corner.map(|v| v as usize), 1 << level);
            Light::from(albedo.0.map(|a| a * (1.0 - g) / (1.0 - a * g)))
        });
        self.albedos = albedos.collect();
    }

    /// The same blocks with an albedo each.
    pub fn with_albedos(mut self, albedos: Vec<Light>) -> Self {
        let mean = albedos.iter().copied().sum::<Light>() / albedos.len().max(1) as f32;
        self.albedo = mean.to_array();
        self.albedos = albedos;
        self
    }

    /// The albedo of a block.
    pub fn albedo_of(&self, block: usize) -> Light {
        let own = self.albedos.get(block);
        own.copied().unwrap_or_else(|| Light::from(self.albedo))
    }

    /// An optical depth of the channel of most extinction, by channel.
    #[inline]
    pub fn depth<K: Spectrum>(&self, tau: f32) -> K {
        K::tinted(tau, &self.extinction_color)
    }

    /// Adds an lvoxel. The first in a brick decides on the size of the brick's blocks; one that
    /// does not fit in is never met.
    pub fn push(&mut self, l: &Lvoxel) {
        let number = self.sigma_t.len() as u32;
        self.sigma_t.push(l.sigma_t * self.scale);
        self.levels.push(l.level);
        self.corners.push(l.block.map(|b| u32::from(b) << l.level));
        let per_axis = BRICK >> l.level;
        let block = l.block.map(usize::from);
        let [x, y, z] = block.map(|b| b / per_axis);
        let [nx, ny, nz] = self.table_dims;
        if x >= nx || y >= ny || z >= nz {
            return;
        }
        let (first, level) = &mut self.table[(z * ny + y) * nx + x];
        if *first == EMPTY {
            (*first, *level) = (self.places.len() as u32, l.level);
            let count = per_axis * per_axis * per_axis;
            self.places.resize(self.places.len() + count, EMPTY);
        }
        if *level == l.level {
            let [x, y, z] = block.map(|b| b % per_axis);
            let place = *first as usize + (z * per_axis + y) * per_axis + x;
            self.places[place] = number;
        }
    }

    /// Number of blocks.
    pub fn len(&self) -> usize {
        self.sigma_t.len()
    }

    /// The brick of a voxel: the first of its places, and its level.
    fn brick(&self, voxel: [u32; 3]) -> Option<(u32, u8)> {
        let [x, y, z] = voxel.map(|v| v as usize / BRICK);
        let [nx, ny, nz] = self.table_dims;
        let is_inside = x < nx && y < ny && z < nz;
        let brick = is_inside.then(|| self.table[(z * ny + y) * nx + x])?;
        (brick.0 != EMPTY).then_some(brick)
    }

    /// The block that holds a voxel.
    pub fn at(&self, voxel: [u32; 3]) -> Option<usize> {
        let (first, level) = self.brick(voxel)?;
        let per_axis = BRICK >> level;
        let [x, y, z] = voxel.map(|v| (v as usize % BRICK) >> level);
        let place = first as usize + (z * per_axis + y) * per_axis + x;
        let block = self.places[place];
        (block != EMPTY).then_some(block as usize)
    }

    /// Voxels along an edge of blocks around a voxel; of a whole brick that holds none.
    pub fn edge_at(&self, voxel: [u32; 3]) -> u32 {
        self.brick(voxel)
            .map_or(BRICK as u32, |(_, level)| 1 << level)
    }

    /// A direction of the scene in index space.
    pub fn in_index(&self, direction: DVec3) -> DVec3 {
        self.index_from_scene_f64.transform_vector3(direction)
    }

    /// Where a ray enters and leaves the box of the volume.
    pub fn ends(&self, ray: &Ray) -> Option<(f32, f32)> {
        let passage = self.passage(ray)?;
        Some((passage.start, passage.start + passage.end))
    }

    fn passage(&self, ray: &Ray) -> Option<Passage> {
        let map = (&self.index_from_scene, &self.index_from_scene_f64);
        Passage::new(map, self.dims, ray)
    }

    /// Gives each block on a ray, front to back, with where the ray enters and leaves it.
    #[inline]
    pub fn walk(&self, ray: &Ray, mut meet: impl FnMut(usize, f32, f32)) {
        let Some(Passage { line, start, end }) = self.passage(ray) else {
            return;
        };
        let dims = self.table_dims;
        let limit = dims.map(|n| n as i32);
        let mut bricks = Steps::new(&line, 0.0, [0; 3], BRICK as f32, limit);
        let mut t = 0.0;
        loop {
            let at = bricks.at();
            let leave = bricks.leave().min(end);
            let [x, y, z] = at.map(|v| v as usize);
            let (first, level) = self.table[(z * dims[1] + y) * dims[0] + x];
            if first != EMPTY && leave > t {
                let base = at.map(|v| v * BRICK as i32);
                let per_axis = BRICK >> level;
                let edge = (1 << level) as f32;
                let mut steps = Steps::new(&line, t, base, edge, [per_axis as i32; 3]);
                let mut near = t;
                loop {
                    let [x, y, z] = steps.at().map(|v| v as usize);
                    let place = first as usize + (z * per_axis + y) * per_axis + x;
                    let far = steps.leave();
                    let is_last = !steps.advance() | (far >= leave);
                    let far = if is_last { leave } else { far.max(near) };
                    let block = self.places[place];
                    if block != EMPTY && far > near {
                        meet(block as usize, start + near, start + far);
                    }
                    near = far;
                    if is_last {
                        break;
                    }
                }
            }
            t = leave.max(t);
            if leave >= end || !bricks.advance() {
                return;
            }
        }
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;
    use crate::math::sampling::{hash, unit2};
    use glam::Vec3;

    /// Blocks of two sizes and of many depths, some of them missing.
    pub fn uneven(albedo: f32) -> Blocks {
        let info = VolumeInfo {
            name: String::new(),
            dims: [24, 16, 20],
            index_from_scene: DAffine3::from_scale(DVec3::new(2.0, 2.0, 2.5)).to_cols_array_2d(),
            albedo: [albedo, 0.5 * albedo, albedo],
            extinction_color: [1.0; 3],
        };
        let mut blocks = Blocks::new(&info);
        for (brick, level) in (0..18).zip([0, 1].into_iter().cycle()) {
            let per_axis = BRICK as u32 >> level;
            for place in 0..per_axis.pow(3) {
                let [is_there, depth] = unit2(hash(&[brick, u64::from(place)]));
                if is_there < 0.2 {
                    continue;
                }
                let at = [brick as u32 % 3, brick as u32 / 3 % 2, brick as u32 / 6];
                let inside = [1, per_axis, per_axis * per_axis].map(|n| place / n % per_axis);
                blocks.push(&Lvoxel {
                    level,
                    block: std::array::from_fn(|a| (at[a] * per_axis + inside[a]) as u16),
                    sigma_t: 4.0 * depth * depth,
                    ..Lvoxel::default()
                });
            }
        }
        blocks
    }

    /// The same blocks with such extinction by channel.
    pub fn tinted(mut blocks: Blocks, color: [f32; 3]) -> Blocks {
        blocks.extinction_color = color;
        blocks
    }

    #[test]
    fn rays_meet_all_blocks_on_their_way() {
        let info = VolumeInfo {
            name: String::new(),
            dims: [12, 8, 8],
            index_from_scene: DAffine3::from_scale(DVec3::splat(2.0)).to_cols_array_2d(),
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        };
        let mut blocks = Blocks::new(&info);
        let mut add = |level, block| {
            blocks.push(&Lvoxel {
                level,
                block,
                sigma_t: 1.0,
                ..Lvoxel::default()
            });
        };
        add(3, [0, 0, 0]);
        (4..6).for_each(|x| add(1, [x, 0, 0]));
        let mut met = Vec::new();
        let ray = Ray::endless(Vec3::new(-1.0, 0.25, 0.25), Vec3::X);
        blocks.walk(&ray, |block, near, far| met.push((block, near, far)));
        assert_eq!(met, [(0, 1.0, 5.0), (1, 5.0, 6.0), (2, 6.0, 7.0)]);
        assert_eq!(blocks.ends(&ray), Some((1.0, 7.0)));
        let at = [[7, 7, 7], [8, 1, 1], [10, 0, 0], [8, 2, 0], [12, 0, 0]].map(|v| blocks.at(v));
        assert_eq!(at, [Some(0), Some(1), Some(2), None, None]);
        assert_eq!(
            [[1, 2, 3], [9, 3, 0], [1, 2, 8]].map(|v| blocks.edge_at(v)),
            [8, 2, 8]
        );
    }
}
