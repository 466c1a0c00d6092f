//! What may be spread into each pixel: how much it differs tells how many samples are needed.

use super::confusion::Confusion;
use super::film_light::FilmLight;
use crate::image::Region;
use crate::math::{Rgb, Spectrum};
use crate::shade::pixels::camera_media::PassedMedia;
use rayon::prelude::*;

/// Pixels along the edge of a square that is told as one.
pub const SQUARE: u32 = 4;

/// What is spread into a square of pixels.
#[derive(Clone, Copy, Debug)]
pub struct Spread {
    /// Least and most radiance by channel.
    least: [f32; 3],
    most: [f32; 3],
    /// The most that any of it is spread, pixels.
    pub radius: f32,
    /// The least and the most share of light that media let through.
    through: [f32; 2],
}

impl Spread {
    const NONE: Self = Self {
        least: [f32::INFINITY; 3],
        most: [f32::NEG_INFINITY; 3],
        radius: 0.0,
        through: [1.0, 0.0],
    };

    fn add(&mut self, Rgb(radiance): Rgb, through: f32, radius: f32) {
        *self = self.with(&Self {
            least: radiance,
            most: radiance,
            radius,
            through: [through; 2],
        });
    }

    fn with(mut self, other: &Self) -> Self {
        for c in 0..3 {
            self.least[c] = self.least[c].min(other.least[c]);
            self.most[c] = self.most[c].max(other.most[c]);
        }
        self.through = [
            self.through[0].min(other.through[0]),
            self.through[1].max(other.through[1]),
        ];
        self.radius = self.radius.max(other.radius);
        self
    }

    /// By how much radiance differs over its mean, at most.
    #[must_use]
    pub fn contrast(&self) -> f32 {
        let [least, most] = [self.least, self.most].map(|c| Rgb(c).luminance());
        let mean = (0.5 * (least + most)).max(1e-6);
        let differs = (0..3).map(|c| self.most[c] - self.least[c]);
        differs.fold(0.0, f32::max) / mean
    }

    /// By how much media differ.
    #[must_use]
    pub fn differs_in_media(&self) -> f32 {
        (self.through[1] - self.through[0]).max(0.0)
    }
}

/// What is spread into the squares of a region.
#[derive(Debug)]
pub struct SpreadMap {
    /// First square, and squares in a row.
    first: [u32; 2],
    width: usize,
    squares: Vec<Spread>,
}

impl SpreadMap {
    /// Of a region, by the light of all that spreads into it.
    #[must_use]
    pub fn new<T: PassedMedia>(
        confusion: &Confusion,
        light: &FilmLight<T>,
        region: Region,
        film: [u32; 2],
    ) -> Self {
        // A square more: reaches are told in whole ones.
        let around = confusion.around(region, SQUARE);
        let first = [around.x0 / SQUARE, around.y0 / SQUARE];
        let last = [around.x1.div_ceil(SQUARE), around.y1.div_ceil(SQUARE)];
        let [width, height] = [0, 1].map(|a| (last[a] - first[a]) as usize);
        let shown = |index: usize| {
            let at = [
                first[0] + (index % width) as u32,
                first[1] + (index / width) as u32,
            ];
            square(light, at.map(|c| c * SQUARE), film)
        };
        let shown: Vec<Spread> = (0..width * height).into_par_iter().map(shown).collect();
        let most = confusion.reach().div_ceil(SQUARE) as usize;
        let mut squares = shown.clone();
        let mut below = 0;
        for reach in (0..24).map(|i| reach_of_class(i).min(most)) {
            let is_of = |s: &Spread| {
                let own = ((s.radius / SQUARE as f32).ceil() as usize).min(most);
                s.radius > 0.0 && own > below && own <= reach
            };
            if shown.iter().any(is_of) {
                let of = |s: &Spread| if is_of(s) { *s } else { Spread::NONE };
                let spread = spread_by(reach, width, shown.iter().map(of).collect());
                (squares.par_iter_mut().zip(&spread)).for_each(|(s, more)| *s = s.with(more));
            }
            below = reach.max(below);
        }
        Self {
            first,
            width,
            squares,
        }
    }

    /// What is spread into the square of a pixel.
    #[must_use]
    pub fn at(&self, x: u32, y: u32) -> &Spread {
        let column = (x / SQUARE - self.first[0]) as usize;
        let row = (y / SQUARE - self.first[1]) as usize;
        &self.squares[row * self.width + column]
    }
}

/// Squares over which those of a class are spread: each class has those of up to its own.
fn reach_of_class(class: usize) -> usize {
    let root = 1 << (class / 2);
    if class.is_multiple_of(2) {
        root
    } else {
        root + root / 2
    }
}

/// What the corners of a square show.
fn square<T: PassedMedia>(light: &FilmLight<T>, [x0, y0]: [u32; 2], film: [u32; 2]) -> Spread {
    let mut shown = Spread::NONE;
    for y in y0..=(y0 + SQUARE).min(film[1] - 1) {
        for x in x0..=(x0 + SQUARE).min(film[0] - 1) {
            let Some(corner) = light.corner(x, y) else {
                continue;
            };
            shown.add(
                corner.radiance,
                corner.passed.transmittance().mean(),
                corner.radius,
            );
        }
    }
    shown
}

/// Every square with all that are at most `reach` from it.
fn spread_by(reach: usize, width: usize, squares: Vec<Spread>) -> Vec<Spread> {
    let height = squares.len() / width;
    let across: Vec<Spread> = squares
        .par_chunks(width)
        .flat_map_iter(|row| spread_row(reach, row.to_vec()))
        .collect();
    let columns: Vec<Vec<Spread>> = (0..width)
        .into_par_iter()
        .map(|x| {
            spread_row(
                reach,
                across.iter().skip(x).step_by(width).copied().collect(),
            )
        })
        .collect();
    (0..width * height)
        .map(|i| columns[i % width][i / width])
        .collect()
}

/// The same along a row: windows of powers of two are joined, two of which overlap.
fn spread_row(reach: usize, row: Vec<Spread>) -> Vec<Spread> {
    let len = row.len();
    let mut windows = vec![Spread::NONE; reach];
    windows.extend(row);
    windows.extend(std::iter::repeat_n(Spread::NONE, reach));
    let length = 2 * reach + 1;
    let mut size = 1;
    while 2 * size <= length {
        for i in 0..windows.len() - size {
            windows[i] = windows[i].with(&windows[i + size]);
        }
        size *= 2;
    }
    (0..len)
        .map(|i| windows[i].with(&windows[i + length - size]))
        .collect()
}
