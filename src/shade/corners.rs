//! Pixels shaded from samples at their corners, which neighbours share.
//!
//! Where the four corners of a pixel end on one smooth piece of surface they are its samples, one primary ray a pixel
//! over the frame, and the shadow rays of the 16 corners around it make one well-spread set (interleaved sampling,
//! Keller & Heidrich 2001). Other pixels take samples of their own.

use super::pixel::{Piece, Pixel, PixelShader, PixelSum, Sample};
use crate::gather::Pages;
use crate::image::Region;
use crate::light::{Arrival, Direct, ShadowRays};
use crate::math::{Rgb, sampling};

/// Corners of the pixels of a region and around it.
pub struct Corners<'a, P> {
    shader: &'a PixelShader<'a, P>,
    region: Region,
    width: usize,
    corners: Vec<Corner>,
}

struct Corner {
    sample: Sample,
    irradiance: Rgb,
}

/// What the corners around a pixel say of its lights.
enum Lit {
    /// Share of the lights with an extent that arrives.
    Share(Rgb),
    /// A shadow whose edge is too narrow for the corners.
    Edge,
}

impl<'a, P: Pages> Corners<'a, P> {
    /// Share of an area light by which two halves of the 16 corners around a pixel may differ.
    const NARROW: f32 = 0.4;

    /// Samples the corners of a region's pixels and one ring more.
    pub fn new(shader: &'a PixelShader<'a, P>, region: Region) -> Self {
        let width = region.width() as usize + 3;
        let height = region.height() as usize + 3;
        let has_media = !shader.view.tracer.scene.volumes.is_empty();
        let corners = (0..width * height)
            .map(|i| {
                let (column, row) = (i % width, i / width);
                // One more than the film's coordinate, which may be -1.
                let (x, y) = (region.x0 + column as u32, region.y0 + row as u32);
                let rays = ShadowRays::Cell {
                    cell: cell(x, y),
                    seed: sampling::hash(&[shader.view.seed, 1, u64::from(x), u64::from(y)]),
                };
                let mut sample = shader.sample(x as f32 - 1.0, y as f32 - 1.0, rays);
                let own = column > 0 && row > 0 && column + 1 < width && row + 1 < height;
                let mut irradiance = Rgb::BLACK;
                if own {
                    if has_media {
                        sample.passed = shader.march(&sample);
                    }
                    if let Some(surface) = &sample.surface {
                        irradiance = shader.indirect(surface, x - 1, y - 1);
                    }
                }
                Corner { sample, irradiance }
            })
            .collect();
        Self {
            shader,
            region,
            width,
            corners,
        }
    }

    /// Shades pixel (x, y) of the region.
    pub fn shade(&self, x: u32, y: u32) -> Pixel {
        let first = (y - self.region.y0) as usize * self.width + (x - self.region.x0) as usize;
        let at = |column: usize, row: usize| &self.corners[first + row * self.width + column];
        let own = [at(1, 1), at(2, 1), at(1, 2), at(2, 2)];
        let whole = own[1..]
            .iter()
            .all(|c| self.shader.same_end(&own[0].sample, &c.sample));
        if whole && let Some(pixel) = self.from_corners(own, at) {
            return pixel;
        }
        let samples = own.map(|c| c.sample);
        let mut pieces: Vec<Piece> = Vec::with_capacity(4);
        for c in own {
            if let Some(surface) = &c.sample.surface
                && !pieces
                    .iter()
                    .any(|p| self.shader.same_piece(surface, &p.surface, c.sample.t))
            {
                pieces.push(Piece::new(*surface, c.irradiance));
            }
        }
        self.shader.refine(x, y, &samples, &mut pieces)
    }

    /// The mean of four corners on one piece of surface, unless an edge of a shadow runs between them.
    fn from_corners<'c>(
        &self,
        own: [&Corner; 4],
        at: impl Fn(usize, usize) -> &'c Corner,
    ) -> Option<Pixel> {
        let mut pixel = PixelSum::default();
        if own[0].sample.surface.is_none() {
            own.map(|c| self.shader.add_nothing(&mut pixel, &c.sample));
            return Some(pixel.mean());
        }
        let (seen, hidden) = own.iter().fold((0, 0), |(seen, hidden), c| {
            (
                seen | c.sample.direct.seen,
                hidden | c.sample.direct.hidden,
            )
        });
        if seen & hidden & Direct::SHARP != 0 {
            return None;
        }
        let Lit::Share(share) = self.lit(&own[0].sample, at) else {
            return None;
        };
        for c in own {
            let direct = c.sample.direct.sharp + c.sample.direct.open * share;
            self.shader
                .add_surface(&mut pixel, &c.sample, direct, c.irradiance);
        }
        Some(pixel.mean())
    }

    /// The lights with an extent, by the shadow rays of the corners around a pixel that lie on its piece of surface.
    fn lit<'c>(&self, like: &Sample, at: impl Fn(usize, usize) -> &'c Corner) -> Lit {
        let mut quarters = [Arrival::default(); 4];
        let (mut seen, mut hidden) = (0, 0);
        for row in 0..4 {
            for column in 0..4 {
                let sample = &at(column, row).sample;
                if self.shader.same_end(like, sample) {
                    quarters[row / 2 * 2 + column / 2] += sample.direct.rays;
                    seen |= sample.direct.seen;
                    hidden |= sample.direct.hidden;
                }
            }
        }
        let sum = |a: usize, b: usize| {
            let mut sum = quarters[a];
            sum += quarters[b];
            sum
        };
        if seen & hidden & !Direct::SHARP != 0 {
            let differ = |a: Arrival, b: Arrival| {
                let share = |of: Arrival| of.arriving.luminance() / of.all.luminance();
                (share(a) - share(b)).abs() > Self::NARROW
            };
            if differ(sum(0, 1), sum(2, 3)) || differ(sum(0, 2), sum(1, 3)) {
                return Lit::Edge;
            }
        }
        let mut all = sum(0, 1);
        all += sum(2, 3);
        Lit::Share(all.share())
    }
}

/// Which cell of the lights a corner asks: every four by four corners ask all, and every two by two ask four quarters
/// (the threshold matrix of Bayer 1973).
fn cell(x: u32, y: u32) -> u8 {
    const ORDER: [u8; 16] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];
    ORDER[(y % 4 * 4 + x % 4) as usize]
}
