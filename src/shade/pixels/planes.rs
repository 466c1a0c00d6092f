//! What is kept of shaded pixels: the numbers that were asked for, in planes.

use super::layers::{Aov, Planes, Quantity};
use super::pixel::Pixel;
use crate::Result;
use crate::image::Region;
use crate::math::Rgb;
use crate::run::memory;

/// What was asked for of a pixel, one number for each plane.
pub fn values(quantity: Quantity, pixel: &Pixel) -> [f32; 3] {
    match quantity {
        Quantity::Radiance => pixel.radiance().0,
        Quantity::Aov(Aov::Direct) => without(pixel.direct, pixel.sky_of_direct),
        Quantity::Aov(Aov::Environment) => (pixel.sky_of_direct + pixel.sky_of_indirect).0,
        Quantity::Aov(Aov::Indirect) => without(pixel.indirect, pixel.sky_of_indirect),
        Quantity::Aov(Aov::Volume) => pixel.volume.0,
        Quantity::Aov(Aov::Depth) => [pixel.ends.depth; 3],
        Quantity::Aov(Aov::Distance) => [pixel.distance; 3],
        Quantity::Aov(Aov::Normal) => pixel.normal.to_array(),
        Quantity::Aov(Aov::Position) => pixel.ends.position.to_array(),
        Quantity::Aov(Aov::Albedo) => pixel.ends.albedo.0,
        Quantity::Aov(Aov::Alpha) => [pixel.ends.alpha; 3],
        Quantity::EmitterBorder => [f32::from(u8::from(pixel.has_emitter_border)); 3],
    }
}

/// What is left of light without a part of it, which rounding may have made larger.
fn without(all: Rgb, part: Rgb) -> [f32; 3] {
    std::array::from_fn(|c| match part.0[c] {
        0.0 => all.0[c],
        part => (all.0[c] - part).max(0.0),
    })
}

/// Planes of a part of the frame, filled pixel by pixel.
#[derive(Debug)]
pub struct Block {
    region: Region,
    planes: Planes,
}

impl Block {
    /// No pixels yet.
    ///
    /// # Errors
    /// If there is no memory for them.
    pub fn new(region: Region, quantities: &[Quantity]) -> Result<Self> {
        let count: usize = quantities.iter().map(|p| p.planes()).sum();
        let planes = (0..count).map(|_| memory::room("a block of pixels", region.pixels()));
        Ok(Self {
            region,
            planes: planes.collect::<Result<_>>()?,
        })
    }

    /// The planes of the pixels so far.
    #[must_use]
    pub fn planes(&self) -> &[Vec<f32>] {
        &self.planes
    }

    /// The next pixel, row by row.
    pub fn push(&mut self, quantities: &[Quantity], pixel: &Pixel) {
        let mut planes = self.planes.iter_mut();
        for quantity in quantities {
            let values = values(*quantity, pixel);
            for (value, plane) in values.into_iter().take(quantity.planes()).zip(&mut planes) {
                plane.push(value);
            }
        }
    }
}

/// Puts blocks that cover a region together.
///
/// # Errors
/// If there is no memory for the planes.
pub fn assemble(region: Region, quantities: &[Quantity], blocks: &[Block]) -> Result<Planes> {
    let count: usize = quantities.iter().map(|p| p.planes()).sum();
    let width = region.width() as usize;
    let assemble = |k: usize| {
        let mut plane = memory::filled("a plane of the frame", 0.0, region.pixels())?;
        for block in blocks {
            let part = block.region;
            let rows = block.planes[k].chunks_exact(part.width() as usize);
            for (row, y) in rows.zip(part.y0..) {
                let first = (y - region.y0) as usize * width + (part.x0 - region.x0) as usize;
                plane[first..first + row.len()].copy_from_slice(row);
            }
        }
        Ok(plane)
    };
    (0..count).map(assemble).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_find_their_places() {
        let region = Region {
            x0: 3,
            y0: 5,
            x1: 10,
            y1: 9,
        };
        let quantities = [
            Quantity::Radiance,
            Quantity::Aov(Aov::Distance),
            Quantity::EmitterBorder,
        ];
        let shaded = |x: u32, y: u32| Pixel {
            direct: Rgb([x as f32, y as f32, 0.0]),
            volume: Rgb([0.0, 0.0, 1.0]),
            distance: (x * y) as f32,
            has_emitter_border: x == y,
            ..Pixel::default()
        };
        let blocks: Vec<Block> = region
            .blocks([3; 2])
            .into_iter()
            .map(|part| {
                let mut block = Block::new(part, &quantities).unwrap();
                for (x, y) in part.coordinates() {
                    block.push(&quantities, &shaded(x, y));
                }
                block
            })
            .collect();
        let planes = assemble(region, &quantities, &blocks).unwrap();
        assert_eq!(planes.len(), 5);
        for (i, (x, y)) in region.coordinates().enumerate() {
            let got: Vec<f32> = planes.iter().map(|p| p[i]).collect();
            let border = f32::from(u8::from(x == y));
            assert_eq!(got, [x as f32, y as f32, 1.0, (x * y) as f32, border]);
        }
    }
}
