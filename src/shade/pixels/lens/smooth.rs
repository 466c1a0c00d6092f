//! Means over neighbours where all that they show is far out of focus: light that is spread over
//! many pixels does not change within few.

use crate::Result;
use crate::image::Region;
use crate::math::Rgb;
use crate::run::memory;
use crate::shade::pixels::layers::{Aov, Planes, Quantity};
use rayon::prelude::*;

/// Pixels on each side that a mean takes at most.
pub const RIM: u32 = 3;

/// Radius over which light is spread, for each pixel that a mean takes on each side.
pub const RADIUS_PER_PIXEL: f32 = 4.0;

/// Numbers of pixels of a region, row by row, and how far all is spread that each shows.
#[derive(Debug)]
pub struct Rows {
    region: Region,
    /// Of a pixel.
    count: usize,
    numbers: Vec<f32>,
    /// 0 where nothing may be taken of neighbours.
    radii: Vec<f32>,
    /// Light that neighbours do not share.
    glow: Vec<Rgb>,
}

/// A row of those.
pub struct Row<'a> {
    /// Numbers of pixels, each with its own.
    pub numbers: &'a mut [f32],
    /// How far all is spread that a pixel shows.
    pub radii: &'a mut [f32],
    /// Light that neighbours do not share.
    pub glow: &'a mut [Rgb],
}

impl Rows {
    /// So many numbers a pixel, all 0.
    ///
    /// # Errors
    /// If there is no memory for them.
    pub fn new(region: Region, count: usize) -> Result<Self> {
        Ok(Self {
            region,
            count,
            numbers: memory::filled("pixels", 0.0, region.pixels() * count)?,
            radii: memory::filled("pixels", 0.0, region.pixels())?,
            glow: memory::filled("pixels", Rgb::BLACK, region.pixels())?,
        })
    }

    /// Each row.
    pub fn each(&mut self) -> impl IndexedParallelIterator<Item = Row<'_>> + use<'_> {
        let width = self.region.width() as usize;
        (self.numbers.par_chunks_exact_mut(width * self.count))
            .zip(self.radii.par_chunks_exact_mut(width))
            .zip(self.glow.par_chunks_exact_mut(width))
            .map(|((numbers, radii), glow)| Row {
                numbers,
                radii,
                glow,
            })
    }

    /// Planes of a region within the rows, each pixel averaged with those around it as far as all
    /// of them are out of focus.
    ///
    /// # Errors
    /// If there is no memory for them.
    pub fn smooth(&self, region: Region, quantities: &[Quantity]) -> Result<Planes> {
        let is_light: Vec<bool> = quantities
            .iter()
            .flat_map(|q| std::iter::repeat_n(is_light(*q), q.planes()))
            .collect();
        let width = region.width() as usize;
        let mut all = memory::filled("pixels", 0.0, region.pixels() * self.count)?;
        (all.par_chunks_exact_mut((width * self.count).max(1)))
            .zip(region.y0..region.y1)
            .for_each(|(row, y)| {
                let pixels = row.chunks_exact_mut(self.count.max(1));
                for (pixel, x) in pixels.zip(region.x0..) {
                    self.mean([x, y], &is_light, pixel);
                    let glow = self.glow[self.index([x, y])];
                    if !glow.is_black() {
                        add(quantities, glow, pixel);
                    }
                }
            });
        let plane = |k: usize| {
            let mut plane = memory::room("a plane of the frame", region.pixels())?;
            plane.extend(all.iter().skip(k).step_by(self.count));
            Ok(plane)
        };
        (0..self.count).map(plane).collect()
    }

    fn index(&self, [x, y]: [u32; 2]) -> usize {
        let Region { x0, y0, .. } = self.region;
        (y - y0) as usize * self.region.width() as usize + (x - x0) as usize
    }

    /// The mean around a pixel of what is light, and what else it has.
    fn mean(&self, [x, y]: [u32; 2], is_light: &[bool], to: &mut [f32]) {
        let own = self.index([x, y]);
        to.copy_from_slice(&self.numbers[own * self.count..(own + 1) * self.count]);
        let reach = reach(self.radii[own]);
        if reach == 0 {
            return;
        }
        let Region { x0, y0, x1, y1 } = self.region;
        let mut sums = [0.0_f32; MOST_NUMBERS];
        let mut weights = 0.0;
        for j in y.saturating_sub(reach).max(y0)..(y + reach + 1).min(y1) {
            for i in x.saturating_sub(reach).max(x0)..(x + reach + 1).min(x1) {
                let away = i.abs_diff(x).max(j.abs_diff(y));
                let at = self.index([i, j]);
                if self::reach(self.radii[at]) < away {
                    continue;
                }
                let tent = |d: u32| (reach + 1 - d) as f32;
                let weight = tent(i.abs_diff(x)) * tent(j.abs_diff(y));
                weights += weight;
                let numbers = &self.numbers[at * self.count..(at + 1) * self.count];
                for (sum, number) in sums.iter_mut().zip(numbers) {
                    *sum += number * weight;
                }
            }
        }
        let share = 1.0 / weights;
        for ((to, sum), _) in (to.iter_mut().zip(sums))
            .zip(is_light)
            .filter(|(_, is)| **is)
        {
            *to = sum * share;
        }
    }
}

/// Adds light that comes straight from lamps.
fn add(quantities: &[Quantity], Rgb(light): Rgb, to: &mut [f32]) {
    let mut to = to.iter_mut();
    for quantity in quantities {
        let has = matches!(quantity, Quantity::Radiance | Quantity::Aov(Aov::Direct));
        for (c, to) in (0..quantity.planes()).zip(&mut to) {
            if has {
                *to += light[c];
            }
        }
    }
}

/// Numbers of a pixel, at most.
const MOST_NUMBERS: usize = 32;

/// Pixels on each side whose light is that of one where all is spread so far.
fn reach(radius: f32) -> u32 {
    ((radius / RADIUS_PER_PIXEL) as u32).min(RIM)
}

/// Whether a mean of neighbours makes sense.
fn is_light(quantity: Quantity) -> bool {
    !matches!(
        quantity,
        Quantity::EmitterBorder
            | Quantity::Aov(Aov::Depth | Aov::Distance | Aov::Position | Aov::Normal)
    )
}
