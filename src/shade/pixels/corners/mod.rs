//! Pixels shaded from samples at their corners, which neighbours share.
//!
//! Where the four corners of a pixel end on one smooth piece of surface they are its samples, one
//! primary ray a pixel over the frame, and the shadow rays of the 16 corners around it make one
//! well-spread set (interleaved sampling, Keller & Heidrich 2001). Other pixels take samples of
//! their own.

mod coarse_to_fine;
mod lit;
mod media;
mod penumbra;
mod sampler;
mod shadow_rays;
mod wide;

use super::piece::Piece;
use super::pixel::Pixel;
use super::pixel_sum::PixelSum;
use super::sample::Sample;
use super::shader::PixelShader;
use crate::image::Region;
use crate::light::{ShadowRays, Visibility};
use crate::math::sampling;
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::shade::surfaces::WithSky;
use coarse_to_fine::FirstCorners;
pub use lit::{LitCorner, LitEnd};
use penumbra::LightAtPixel;
use sampler::Sampler;
use shadow_rays::PENUMBRA_REACH;
use wide::SquareSums;

/// Corners of the pixels of a region and around it, as pixels need them.
pub struct Corners<'a, A: CameraMedia> {
    shader: &'a PixelShader<'a, A>,
    region: Region,
    /// Rings of corners around those of the region's own pixels.
    rings: u32,
    /// Corners in a row, and rows in all.
    width: usize,
    height: usize,
    /// Row by row.
    corners: Vec<Corner<A::Passed>>,
    /// By corner; where it is so all around, a pixel need not ask the corners themselves. Empty if
    /// no light has an extent.
    is_full_light: Vec<bool>,
    /// Shadow rays of more corners than those around a pixel.
    squares: SquareSums,
}

/// A corner of a pixel.
pub struct Corner<T: PassedMedia> {
    sample: Sample<T>,
    irradiance: WithSky,
}

/// Where a corner is.
struct CornerPosition {
    /// Film coordinates moved so far that none is negative.
    moved: [u32; 2],
    /// Pixels from the film's top left.
    film: [f32; 2],
}

impl CornerPosition {
    /// Shadow rays of the corner after the first few.
    fn rays<A: CameraMedia>(&self, shader: &PixelShader<A>, first: u8, count: u8) -> ShadowRays {
        // Every four by four corners ask all cells; every two by two ask four quarters, and so do
        // two by two of every second corner.
        const CELL_ORDER: [u8; 16] = [0, 8, 10, 2, 12, 4, 6, 14, 15, 7, 5, 13, 11, 3, 1, 9];
        let [x, y] = self.moved;
        ShadowRays::Cells {
            cell: CELL_ORDER[(y % 4 * 4 + x % 4) as usize],
            square: (y / 4 % 2 * 2 + x / 4 % 2) as u8,
            first,
            count,
            seed: sampling::hash(&[shader.view.seed, 1, u64::from(x), u64::from(y)]),
            shared_seed: sampling::hash(&[shader.view.seed, 2]),
        }
    }
}

impl<'a, A: CameraMedia> Corners<'a, A> {
    /// Rings of corners around those of a region's own pixels. The first takes part in its pixels.
    /// The next, two or in media three, tell whether it may take its indirect light, or the media
    /// before it, from neighbours. Of lights with an extent two more tell wide penumbrae, and two
    /// around these whether they are in one.
    fn rings(shader: &PixelShader<A>) -> u32 {
        match (shader.lights.rest_is_exact(), A::Passed::IS_VACUUM) {
            (false, _) => Self::RINGS_OF_PENUMBRAE + PENUMBRA_REACH as u32,
            (true, true) => 3,
            (true, false) => 4,
        }
    }
    /// Rings whose shadow rays take part in pixels.
    const RINGS_OF_PENUMBRAE: u32 = 3;

    /// Pixels between gathers from which on indirect light is looked up at every fourth corner, not
    /// every second: what is smooth over so many is smooth over four.
    const COARSE_LATTICE_STEP: u32 = 6;

    /// Samples the corners of a region's pixels, and what they need around them.
    pub fn new(shader: &'a PixelShader<'a, A>, region: Region) -> Self {
        // Corners between those at even coordinates ask them on both sides, in all regions the
        // same.
        let region = Region {
            x0: region.x0 - region.x0 % 2,
            y0: region.y0 - region.y0 % 2,
            x1: region.x1 + region.x1 % 2,
            y1: region.y1 + region.y1 % 2,
        };
        let rings = Self::rings(shader);
        let width = (region.width() + 1 + 2 * rings) as usize;
        let height = (region.height() + 1 + 2 * rings) as usize;
        let mut corners = Self {
            shader,
            region,
            rings,
            width,
            height,
            corners: Sampler::new(shader, region, rings).sample(height),
            is_full_light: Vec::new(),
            squares: SquareSums::default(),
        };
        // Before any corner asks more of the lights: those of the outer rings do not, but they do
        // in regions of their own, and whether media are alike must not depend on the region.
        if !A::Passed::IS_VACUUM {
            corners.pass_media();
        }
        corners.look_around();
        // None is of lights without an extent.
        if !shader.lights.rest_is_exact() {
            corners.look_into_penumbrae();
        }
        corners
    }

    /// Which of the corners one is.
    #[inline]
    fn index(&self, row: usize, column: usize) -> usize {
        row * self.width + column
    }

    fn place(region: Region, rings: u32, column: usize, row: usize) -> CornerPosition {
        let of = |first: u32, step: usize| {
            let moved = first + step as u32;
            (moved, moved as f32 - rings as f32)
        };
        let (x, y) = (of(region.x0, column), of(region.y0, row));
        CornerPosition {
            moved: [x.0, y.0],
            film: [x.1, y.1],
        }
    }

    /// Indirect light of the corners of the region's own pixels.
    fn look_around(&mut self) {
        // It is looked up some corners apart, then at those between which do not lie on one piece
        // of surface with their neighbours.
        let first = FirstCorners {
            spacing: if self.shader.lattice.step() < Self::COARSE_LATTICE_STEP {
                2
            } else {
                4
            },
            // In vacuum between gathers: `curved` has 4 % less error so than at them.
            origin: u32::from(A::Passed::IS_VACUUM),
        };
        self.coarse_to_fine(self.rings as usize, first, |corners, visit| {
            let i = visit.index;
            let Some(surface) = corners.corners[i].sample.surface else {
                return;
            };
            let between = (visit.between).and_then(|(is, step)| corners.between(i, is, step));
            // Rings before the film's own corners are as good as its first row for a key.
            let [x, y] = visit.film;
            corners.corners[i].irradiance =
                between.unwrap_or_else(|| corners.shader.indirect(&surface, x, y));
        });
    }

    /// Four corners, some of them twice, `step` away from one that lies between them in some of its
    /// coordinates.
    fn around(&self, i: usize, [column_is, row_is]: [bool; 2], step: usize) -> [usize; 4] {
        let (a, b) = (step, step * self.width);
        match (column_is, row_is) {
            (true, false) => [i - a, i + a, i - a, i + a],
            (false, true) => [i - b, i + b, i - b, i + b],
            _ => [i - b - a, i - b + a, i + b - a, i + b + a],
        }
    }

    /// The mean irradiance of the corners `step` beside or around one, if all lie on its piece of
    /// surface.
    fn between(&self, i: usize, is_between: [bool; 2], step: usize) -> Option<WithSky> {
        let around = self.around(i, is_between, step);
        let like = &self.corners[i].sample;
        let mut sum = WithSky::BLACK;
        for j in around {
            let corner = &self.corners[j];
            if !self.shader.same_end(like, &corner.sample) {
                return None;
            }
            sum += corner.irradiance;
        }
        Some(sum * (1.0 / around.len() as f32))
    }

    /// The first of the 16 corners around pixel (x, y).
    fn first_around(&self, x: u32, y: u32) -> usize {
        let row = (y - self.region.y0 + self.rings - 1) as usize;
        let column = (x - self.region.x0 + self.rings - 1) as usize;
        self.index(row, column)
    }

    /// Shades pixel (x, y) of the region.
    pub fn shade(&self, x: u32, y: u32) -> Pixel {
        self.shade_between(x, y, self.first_around(x, y))
    }

    /// Shades pixel (x, y), around which `first` is the first of 16 corners.
    fn shade_between(&self, x: u32, y: u32, first: usize) -> Pixel {
        let at = |column: usize, row: usize| &self.corners[first + row * self.width + column];
        let own = [at(1, 1), at(2, 1), at(1, 2), at(2, 2)];
        if self.shader.end_alike(own.iter().map(|c| &c.sample))
            && !self.hides_an_emitter(own[0], x, y)
            && let Some(pixel) = self.mean_of_corners(PixelSum::of(x, y), first, own, at)
        {
            return pixel;
        }
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
        self.shader
            .refine(x, y, own.map(|c| &c.sample), &mut pieces)
    }

    /// Whether an emissive triangle that the corners of a pixel do not show covers much of it.
    fn hides_an_emitter(&self, corner: &Corner<A::Passed>, x: u32, y: u32) -> bool {
        const MUCH: f32 = 0.1;
        let PixelShader { view, borders, .. } = self.shader;
        borders.covered(view, x, y) > MUCH && !borders.has(x, y, corner.sample.triangle)
    }

    /// The mean of four corners on one piece of surface, unless an edge of a shadow runs between
    /// them.
    fn mean_of_corners<'c>(
        &self,
        mut pixel: PixelSum,
        first: usize,
        own: [&Corner<A::Passed>; 4],
        at: impl Fn(usize, usize) -> &'c Corner<A::Passed>,
    ) -> Option<Pixel> {
        let passed = self.media_over_pixel(own.map(|c| &c.sample), &at);
        if own[0].sample.surface.is_none() {
            for (c, p) in own.into_iter().zip(&passed) {
                let direction = c.sample.direction;
                self.shader.add_nothing(&mut pixel, 1.0, direction, p);
            }
            return Some(self.shader.finish(pixel));
        }
        let mut visibility = Visibility::default();
        own.iter()
            .for_each(|c| visibility += c.sample.direct.visibility);
        if visibility.has_edge() {
            return None;
        }
        let LightAtPixel::Arrived { lamps, sky } = self.lit(first, own[0], at) else {
            return None;
        };
        let [x, y] = pixel.at();
        let paint = self.shader.paint(x, y, own.map(|c| &c.sample));
        let emission = self.shader.emission_over(x, y, own.map(|c| &c.sample));
        for (c, passed) in own.into_iter().zip(&passed) {
            let direct = c.sample.direct.arriving(&lamps, &sky);
            let irradiance = [direct.into(), c.irradiance];
            let mut add = |sample| {
                self.shader
                    .add_surface(&mut pixel, 1.0, sample, passed, irradiance, emission);
            };
            match paint {
                Some(albedo) => add(&c.sample.with_albedo(albedo)),
                None => add(&c.sample),
            }
        }
        Some(self.shader.finish(pixel))
    }
}
