//! Regions of the frame as a camera with a lens, or with an open shutter, sees them.
//!
//! Visibility is sampled, light is not: what a pinhole in the middle of the lens sees has its light
//! at the corners of pixels, with gathers and shadow rays that neighbours share, and a sample over
//! the lens takes that of the place where it ends (decoupled sampling, Ragan-Kelley et al. 2011).
//! Only what a pinhole does not see is lit for itself. Where all that may be spread into a pixel is
//! alike, the pinhole's own pixel is what the lens shows, too.
//!
//! | file | what it does |
//! | --- | --- |
//! | `confusion` | how far points are spread over the film |
//! | `lamps` | small lamps out of focus, in closed form |
//! | `film_light` | light of what the film shows, by corners |
//! | `spread` | what may be spread into each pixel, and how much it differs |
//! | `pixel` | a pixel by samples over the lens |
//! | `smooth` | means over neighbours where all is far out of focus |

mod confusion;
mod film_light;
mod lamps;
mod pixel;
mod smooth;
mod spread;

use super::blocks::{BLOCK_SIZES, blocks_of};
use super::corners::{Corners, LitCorner};
use super::emitter_borders::EmitterBorders;
use super::layers::{Planes, Quantity};
use super::planes::values;
use super::shader::PixelShader;
use crate::Result;
use crate::image::{Onlooker, Region};
use crate::math::Rgb;
use crate::math::segment::Composite;
use crate::run::{Job, Task, memory};
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
pub use confusion::Confusion;
use film_light::FilmLight;
use lamps::Lamps;
use pixel::{LensSampler, LensSamples};
use rayon::prelude::*;
use smooth::{RIM, Row, Rows};
use spread::{SQUARE, SpreadMap};

/// Radius in pixels up to which what is spread is sharp.
const SHARP: f32 = 0.35;
/// Contrast of what is spread into a pixel up to which a pinhole's pixel does.
const EVEN: f32 = 0.05;
/// Contrast from which on a pixel has more first samples.
const MUCH: f32 = 0.25;
/// First samples, where contrast is little or much.
const FIRST: [u32; 2] = [4, 8];

/// A region with all around it that a camera spreads into it: its lattice and borders of emitters
/// have to be of that.
#[must_use]
pub fn spread_into(confusion: &Confusion, region: Region) -> Region {
    confusion.around(region, MORE)
}

/// Pixels around a region that take part in it, beside those that are spread into it.
const MORE: u32 = RIM + 3 * SQUARE;

/// The same at most, and the bytes of a pixel there beside its numbers, before there is a camera's
/// view.
#[must_use]
pub fn most_spread_into(region: Region, film: [u32; 2]) -> (Region, u64) {
    let reach = Confusion::most_reach(film[0]) + MORE;
    // While blocks are put together there are two of all corners.
    let bytes = 2 * size_of::<LitCorner<Composite>>() + size_of::<Rgb>() + 8;
    (grown(region, reach, film), bytes as u64)
}

/// Shades the pixels of a region, and keeps some quantities of them.
///
/// # Errors
/// If cancelled, or if there is no memory for the pixels.
pub fn shade_region<A: CameraMedia>(
    shader: &PixelShader<A>,
    confusion: &Confusion,
    region: Region,
    quantities: &[Quantity],
    onlooker: Option<&dyn Onlooker>,
    job: &Job,
    task: &Task,
) -> Result<Planes> {
    let film = [shader.view.film.width, shader.view.film.height];
    let with_rim = grown(region, RIM, film);
    let pinhole = Pinhole::new(shader, confusion, region, with_rim, quantities, job)?;
    let spread = SpreadMap::new(confusion, &pinhole.light, with_rim, film);
    let lamps = Lamps::of(&shader.view, confusion);
    let nothing = EmitterBorders::none_but(region, lamps.triangles().to_vec());
    let plain = shader.with_borders(&nothing);
    let sampler = LensSampler {
        shader: &plain,
        confusion,
        light: &pinhole.light,
    };
    let count = pinhole.count;
    let mut rows = Rows::new(with_rim, count)?;
    let width = with_rim.width() as usize;
    let shade_row = |(row, y): (Row<'_>, u32)| -> Result<()> {
        job.cancel.check()?;
        let Row {
            numbers,
            radii,
            glow,
        } = row;
        for (i, x) in (with_rim.x0..with_rim.x1).enumerate() {
            let at = (y - with_rim.y0) as usize * width + i;
            let own = &mut numbers[i * count..(i + 1) * count];
            let shown = spread.at(x, y);
            let border = [x, y, film[0] - 1 - x, film[1] - 1 - y];
            let is_inside = border.into_iter().all(|away| away as f32 >= shown.radius);
            let has_lamps = lamps.may_be_in(x, y);
            if pinhole.is_known[at]
                && !has_lamps
                && (shown.radius < SHARP || (is_inside && shown.contrast() < EVEN))
            {
                own.copy_from_slice(&pinhole.numbers[at * count..(at + 1) * count]);
                continue;
            }
            let first = FIRST[usize::from(shown.contrast() > MUCH || !is_inside)];
            let counts = LensSamples {
                first,
                most: first.max(2 * shader.counts.edge),
                contrast: shown.contrast(),
                even_media: shown.differs_in_media() < EVEN,
            };
            let shaded = sampler.shade(x, y, counts);
            put(quantities, &shaded.pixel, own);
            radii[i] = shaded.radius;
            if has_lamps {
                glow[i] = lamps.seen(&shader.view, shader.lights, x, y);
            }
        }
        if (region.y0..region.y1).contains(&y) {
            task.add(u64::from(region.width()));
        }
        Ok(())
    };
    (rows.each().zip(with_rim.y0..with_rim.y1)).try_for_each(shade_row)?;
    let planes = rows.smooth(region, quantities)?;
    if let Some(onlooker) = onlooker {
        onlooker.see(region, &planes);
    }
    Ok(planes)
}

/// A region with so many pixels around it, as far as they are on the film.
fn grown(region: Region, by: u32, film: [u32; 2]) -> Region {
    Region {
        x0: region.x0.saturating_sub(by),
        y0: region.y0.saturating_sub(by),
        x1: (region.x1 + by).min(film[0]),
        y1: (region.y1 + by).min(film[1]),
    }
}

/// Writes the numbers of a pixel, by plane.
fn put(quantities: &[Quantity], pixel: &super::pixel::Pixel, to: &mut [f32]) {
    let mut to = to.iter_mut();
    for quantity in quantities {
        let values = values(*quantity, pixel);
        for (value, to) in values.into_iter().take(quantity.planes()).zip(&mut to) {
            *to = value;
        }
    }
}

/// What a pinhole in the middle of the lens sees.
struct Pinhole<T> {
    /// Light of all that spreads into the region.
    light: FilmLight<T>,
    /// Numbers of a pixel.
    count: usize,
    /// Pixels of the region and its rim, those that are known.
    numbers: Vec<f32>,
    is_known: Vec<bool>,
}

/// A block of that.
struct PinholeBlock<T> {
    region: Region,
    corners: Vec<LitCorner<T>>,
    /// Those of its pixels that are in the region or its rim, row by row.
    pixels: Region,
    numbers: Vec<f32>,
    is_known: Vec<bool>,
}

impl<T: PassedMedia> Pinhole<T> {
    fn new<A: CameraMedia<Passed = T>>(
        shader: &PixelShader<A>,
        confusion: &Confusion,
        region: Region,
        with_rim: Region,
        quantities: &[Quantity],
        job: &Job,
    ) -> Result<Self> {
        let seen = spread_into(confusion, region);
        let count: usize = quantities.iter().map(|q| q.planes()).sum();
        let shade = |block: Region| {
            job.cancel.check()?;
            let corners = Corners::new(shader, block);
            let mut lit = memory::room("light of corners", block.pixels())?;
            for (x, y) in block.coordinates() {
                let sample = corners.sample(x, y);
                let mut radius = match &sample.surface {
                    Some(surface) => confusion.radius(surface.position),
                    None => confusion.radius_of_background(sample.direction),
                };
                let way = shader.way_to(sample);
                if sample.passed.shows()
                    && let Some(span) = confusion.span_of_media(&way)
                {
                    let [_, most] = confusion.radii_in_media(&way, span);
                    radius = radius.max(most);
                }
                lit.push(corners.lit_corner(x, y, radius));
            }
            let pixels = common(block, with_rim);
            let mut numbers = memory::filled("pixels", 0.0, pixels.pixels() * count)?;
            let mut is_known = memory::filled("pixels", false, pixels.pixels())?;
            let width = block.width();
            let radius = |x: u32, y: u32| {
                let [x, y] = [x.min(block.x1 - 1), y.min(block.y1 - 1)];
                lit[((y - block.y0) * width + (x - block.x0)) as usize].radius
            };
            for (i, (x, y)) in pixels.coordinates().enumerate() {
                job.cancel.check()?;
                let is_sharp = radius(x, y) < SHARP;
                if let Some(pixel) = corners.shade_if_known(x, y, is_sharp) {
                    put(quantities, &pixel, &mut numbers[i * count..(i + 1) * count]);
                    is_known[i] = true;
                }
            }
            Ok(PinholeBlock {
                region: block,
                corners: lit,
                pixels,
                numbers,
                is_known,
            })
        };
        let blocks = blocks_of(seen, BLOCK_SIZES).into_par_iter().map(shade);
        let blocks = blocks.collect::<Result<Vec<_>>>()?;
        Self::assemble(seen, with_rim, count, blocks)
    }

    fn assemble(
        seen: Region,
        with_rim: Region,
        count: usize,
        blocks: Vec<PinholeBlock<T>>,
    ) -> Result<Self> {
        let nothing = LitCorner {
            end: None,
            passed: T::default(),
            radiance: Rgb::BLACK,
            radius: 0.0,
        };
        let mut corners = memory::filled("light of corners", nothing, seen.pixels())?;
        let mut numbers = memory::filled("pixels", 0.0, with_rim.pixels() * count)?;
        let mut is_known = memory::filled("pixels", false, with_rim.pixels())?;
        for block in blocks {
            copy(seen, &mut corners, block.region, &block.corners, 1);
            copy(with_rim, &mut numbers, block.pixels, &block.numbers, count);
            copy(with_rim, &mut is_known, block.pixels, &block.is_known, 1);
        }
        Ok(Self {
            light: FilmLight::new(seen, corners),
            count,
            numbers,
            is_known,
        })
    }
}

/// Copies a part of a region, so many numbers a pixel, into that.
fn copy<V: Copy>(to: Region, all: &mut [V], from: Region, part: &[V], count: usize) {
    if part.is_empty() {
        return;
    }
    let width = from.width() as usize * count;
    for (row, y) in part.chunks_exact(width).zip(from.y0..) {
        let pixel = (y - to.y0) as usize * to.width() as usize + (from.x0 - to.x0) as usize;
        let first = pixel * count;
        all[first..first + width].copy_from_slice(row);
    }
}

/// What two regions share; empty at one of them if that is nothing.
fn common(a: Region, b: Region) -> Region {
    let (x0, y0) = (a.x0.max(b.x0), a.y0.max(b.y0));
    Region {
        x0,
        y0,
        x1: a.x1.min(b.x1).max(x0),
        y1: a.y1.min(b.y1).max(y0),
    }
}
