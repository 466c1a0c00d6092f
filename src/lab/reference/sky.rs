//! The environment image, as a path asks for it: by where it is bright.

use super::sample::Sample;
use crate::math::Rgb;
use crate::math::distribution::GridDistribution;
use crate::scene::EnvironmentImage;
use glam::Vec3;
use std::f32::consts::PI;

/// An environment image and where it is bright.
#[derive(Debug)]
pub struct Sky<'a> {
    image: &'a EnvironmentImage,
    distribution: GridDistribution,
}

impl<'a> Sky<'a> {
    /// Cells across by which directions are chosen, at most.
    const MAX_CELLS_ACROSS: u32 = 2048;

    /// `None` for a black image.
    #[must_use]
    pub fn new(image: &'a EnvironmentImage) -> Option<Self> {
        let cells = image.reduced(Self::MAX_CELLS_ACROSS);
        let (width, height) = (cells.width as usize, cells.height as usize);
        let light =
            |row: usize, column: usize| f64::from(cells.texels[row * width + column].mean());
        // What is bilinear between the middles of cells has light where a neighbour has some.
        const SHARES: [(usize, f64); 3] = [(0, 0.125), (1, 0.75), (2, 0.125)];
        let weights = (0..width * height).map(|i| {
            let (row, column) = (i / width, i % width);
            let mut sum = 0.0;
            for (down, by_row) in SHARES {
                let row = (row + down).saturating_sub(1).min(height - 1);
                for (across, by_column) in SHARES {
                    let column = (column + across + width - 1) % width;
                    sum += light(row, column) * by_row * by_column;
                }
            }
            sum * cells.solid_angle(row as u32)
        });
        let weights: Vec<f64> = weights.collect();
        let distribution = GridDistribution::new(width, weights.into_iter())?;
        Some(Self {
            image,
            distribution,
        })
    }

    /// Radiance that a camera sees in a unit direction.
    #[must_use]
    pub fn seen(&self, direction: Vec3) -> Rgb {
        self.image.seen(direction)
    }

    /// Radiance that comes from a unit direction.
    #[must_use]
    pub fn light(&self, direction: Vec3) -> Rgb {
        self.image.light(direction)
    }

    /// A direction that two numbers in [0,1) choose.
    #[must_use]
    pub fn sample(&self, u: [f32; 2]) -> Option<Sample> {
        let place = self.distribution.choose(u).place;
        let direction = self.image.direction(place);
        let pdf = self.pdf(direction);
        (pdf > 0.0 && pdf.is_finite()).then(|| Sample {
            direction,
            distance: f32::INFINITY,
            light: self.light(direction) * (1.0 / pdf),
            pdf,
        })
    }

    /// Density, per steradian, with which [`Self::sample`] finds a unit direction.
    #[must_use]
    pub fn pdf(&self, direction: Vec3) -> f32 {
        let sin = (1.0 - direction.y * direction.y).max(1e-12).sqrt();
        self.distribution.pdf(self.image.place(direction)) / (2.0 * PI * PI * sin)
    }
}
