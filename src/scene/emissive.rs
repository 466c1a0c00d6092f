//! What media send out by themselves: fire, and other gases that glow.

use super::Volume;
use super::grid::{BRICK_CELLS, Cell};
use crate::math::{Rgb, blackbody, unflatten};
use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

/// A grid of values that light comes from, in a box placed anywhere. It takes no light: what does,
/// such as its smoke, is a [`Volume`] in the same place.
#[derive(Debug)]
pub struct EmissiveVolume {
    /// The values, in the place of the extinction of a medium.
    pub values: Volume,
    /// The light that they stand for.
    pub emission: Emission,
}

/// From values to light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Emission {
    /// The value times this radiance per scene unit of length, in every direction.
    Proportional {
        /// Radiance per scene unit of length where the value is 1.
        radiance: [f32; 3],
    },
    /// That of a black body whose kelvin are the value, per scene unit of length.
    Blackbody {
        /// Factor on `5.670373e-8 T^4 1e-6 / pi` times its colour of luminance 1.
        scale: f32,
    },
}

impl Emission {
    /// Radiance per scene unit of length.
    #[must_use]
    #[inline]
    pub fn of(&self, value: f32) -> Rgb {
        match *self {
            Self::Proportional { radiance } => Rgb(radiance) * value,
            Self::Blackbody { scale } => blackbody(value) * scale,
        }
    }

    /// Whether nothing comes from any value.
    #[must_use]
    pub fn is_black(&self) -> bool {
        match *self {
            Self::Proportional { radiance } => radiance == [0.0; 3],
            Self::Blackbody { scale } => scale == 0.0,
        }
    }
}

/// A part of an emissive volume, as a light: about a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EmissiveBlock {
    /// Mean place of what it sends, scene space.
    pub centre: Vec3,
    /// Of the even ball that is as wide.
    pub radius: f32,
    /// Radiant intensity in every direction: radiance per length, summed over its space.
    pub intensity: Rgb,
}

impl EmissiveBlock {
    /// Blocks as one.
    #[must_use]
    pub fn joined<'a>(blocks: impl Iterator<Item = &'a Self> + Clone) -> Option<Self> {
        let mut sums = Sums::default();
        for block in blocks {
            let spread = 0.6 * f64::from(block.radius).powi(2);
            sums.add(
                block.centre.as_dvec3(),
                spread,
                block.intensity.0.map(f64::from),
            );
        }
        sums.block(0.0)
    }
}

/// Sums over what parts send, times their places.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    intensity: [f64; 3],
    place: DVec3,
    square: f64,
}

impl Sums {
    /// Adds what is sent from around a place; `spread` is the mean square of how far off.
    fn add(&mut self, place: DVec3, spread: f64, intensity: [f64; 3]) {
        let weight = intensity.iter().sum::<f64>();
        (self.intensity.iter_mut().zip(intensity)).for_each(|(sum, v)| *sum += v);
        self.place += place * weight;
        self.square += (place.length_squared() + spread) * weight;
    }

    /// The block that sends this, of at least a radius; `None` if that is nothing.
    fn block(&self, least: f64) -> Option<EmissiveBlock> {
        let weight = self.intensity.iter().sum::<f64>();
        if weight <= 0.0 || weight.is_nan() {
            return None;
        }
        let centre = self.place / weight;
        let spread = (self.square / weight - centre.length_squared()).max(0.0);
        // The mean square of the distance from the middle of a ball is 3/5 of its radius squared.
        Some(EmissiveBlock {
            centre: centre.as_vec3(),
            radius: (spread / 0.6).sqrt().max(least) as f32,
            intensity: Rgb(self.intensity.map(|v| v as f32)),
        })
    }
}

impl EmissiveVolume {
    /// Cells along an edge of a block, where blocks are few.
    const BLOCK_CELLS: usize = 4;
    /// Bricks up to which blocks are so small; of more, a brick is one.
    const MOST_SMALL: usize = 1 << 13;

    /// Its light in blocks of a few voxels, in the order of bricks. The grid has to be read.
    #[must_use]
    pub fn blocks(&self) -> Vec<EmissiveBlock> {
        let bricks: Vec<[usize; 3]> = self.values.sigma_t.bricks().collect();
        let of_brick = |&b: &[usize; 3]| self.of_brick(b);
        let of_bricks: Vec<Vec<EmissiveBlock>> = match bricks.len() <= Self::MOST_SMALL {
            true => bricks.par_iter().map(of_brick).collect(),
            false => {
                let join = |blocks: Vec<EmissiveBlock>| EmissiveBlock::joined(blocks.iter());
                let joined = |b| join(of_brick(b)).into_iter().collect();
                bricks.par_iter().map(joined).collect()
            }
        };
        of_bricks.concat()
    }

    fn of_brick(&self, b: [usize; 3]) -> Vec<EmissiveBlock> {
        const ACROSS: usize = BRICK_CELLS / EmissiveVolume::BLOCK_CELLS;
        let volume = &self.values;
        let Some(brick) = volume.sigma_t.brick(b) else {
            return Vec::new();
        };
        let size = DVec3::from(volume.sigma_t.size().map(f64::from));
        let base = DVec3::from(b.map(|n| (n * BRICK_CELLS) as f64)) - 0.5;
        let axes = volume.scene_from_index.matrix3;
        let voxel = axes.determinant().abs();
        // Mean square of the distance from the middle of a cell to its points.
        let lengths = [axes.x_axis, axes.y_axis, axes.z_axis].map(DVec3::length_squared);
        let spread = lengths.iter().sum::<f64>() / 12.0;
        let mut sums = [Sums::default(); ACROSS * ACROSS * ACROSS];
        for i in 0..BRICK_CELLS.pow(3) {
            let c = unflatten(i, [BRICK_CELLS; 3]);
            let cell = brick.cell::<true>(c);
            if cell.is_empty() {
                continue;
            }
            let corner = base + DVec3::from(c.map(|n| n as f64));
            let light = self.mean_over(&cell, corner, size);
            let [x, y, z] = c.map(|n| n / Self::BLOCK_CELLS);
            let place = volume.scene_from_index.transform_point3(corner + 0.5);
            let light = light.0.map(|v| f64::from(v) * voxel);
            sums[(z * ACROSS + y) * ACROSS + x].add(place, spread, light);
        }
        let least = 0.5 * f64::from(volume.shortest_voxel_edge());
        sums.iter().filter_map(|sums| sums.block(least)).collect()
    }

    /// Mean of what a cell sends over its space, of which the parts outside of the box send
    /// nothing.
    fn mean_over(&self, cell: &Cell, corner: DVec3, size: DVec3) -> Rgb {
        /// Along each axis of a cell, where polynomials up to cubics are summed exactly.
        const POINTS: [f32; 2] = [0.211_324_87, 0.788_675_1];
        let is_within = corner.cmpge(DVec3::ZERO).all() && (corner + 1.0).cmple(size).all();
        if let Emission::Proportional { .. } = self.emission
            && is_within
        {
            return self.emission.of(cell.value(Vec3A::splat(0.5)));
        }
        let mut sum = Rgb::BLACK;
        for point in 0..8 {
            let f = Vec3A::from([0, 1, 2].map(|a| POINTS[point >> a & 1]));
            let at = corner + f.as_dvec3();
            if is_within || at.cmpge(DVec3::ZERO).all() && at.cmple(size).all() {
                sum += self.emission.of(cell.value(f));
            }
        }
        sum * 0.125
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Grid;
    use glam::DAffine3;

    #[test]
    fn blocks_send_what_the_volume_does() {
        let value = |[i, j, k]: [usize; 3]| (i + 2 * j + 3 * k) as f32;
        let grid = Grid::from_fn([19, 9, 12], value);
        let place = DAffine3::from_scale(DVec3::new(0.5, 0.25, 0.125));
        let volume = EmissiveVolume {
            values: Volume::new("fire".into(), grid, [0.0; 3], place),
            emission: Emission::Proportional {
                radiance: [1.0, 0.5, 0.0],
            },
        };
        let blocks = volume.blocks();
        let sum = |c: usize| {
            blocks
                .iter()
                .map(|b| f64::from(b.intensity.0[c]))
                .sum::<f64>()
        };
        let mean = 9.0 + 2.0 * 4.0 + 3.0 * 5.5;
        let expected = mean * (19.0 * 9.0 * 12.0) * 0.5 * 0.25 * 0.125;
        assert!(
            (sum(0) / expected - 1.0).abs() < 1e-3,
            "{} {expected}",
            sum(0)
        );
        assert!((sum(1) / sum(0) - 0.5).abs() < 1e-6 && sum(2) == 0.0);
        let one = EmissiveBlock::joined(blocks.iter()).unwrap();
        assert!((f64::from(one.intensity.0[0]) / expected - 1.0).abs() < 1e-3);
        // More comes from where values are larger.
        assert!(one.centre.x > 4.75 && one.centre.y > 1.125 && one.centre.z > 0.75);
        assert!(one.radius > 2.0 && one.radius < 6.0, "{}", one.radius);
    }
}
