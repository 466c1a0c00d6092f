//! Shadow rays of more corners than those around a pixel, for penumbrae that are wider than these.

use super::penumbra::Squares;
use super::{Corner, Corners};
use crate::light::{DirectLight, ShadowRatio};
use crate::shade::pixels::camera_media::CameraMedia;

/// Corners along an edge of a square.
const EDGE: usize = 4;

/// Sums of what shadow rays brought over squares of 4 x 4 corners.
#[derive(Debug, Default)]
pub(super) struct SquareSums {
    lamps: SumsOfLights,
    /// Of the excess of an environment image; empty without one.
    sky: SumsOfLights,
}

/// Those of some of the lights, by the first corner of a square. Empty if there is no penumbra.
#[derive(Debug, Default)]
struct SumsOfLights {
    /// `None` of a square that lies on more pieces of surface than one.
    sums: Vec<Option<ShadowRatio>>,
    /// Squares of what the shares of the square's corners, and of those as far on in the three
    /// squares beside and below it, are off a plane by; added up.
    off_plane: Vec<f32>,
}

impl SquareSums {
    /// Those to lamps and suns of the four squares around a pixel, if all have one.
    pub fn of_lamps(&self, squares: [usize; 4]) -> Option<Squares> {
        self.lamps.of(squares)
    }

    /// The same to the excess of an environment image.
    pub fn of_sky(&self, squares: [usize; 4]) -> Option<Squares> {
        self.sky.of(squares)
    }
}

impl SumsOfLights {
    fn of(&self, squares: [usize; 4]) -> Option<Squares> {
        let [a, b, c, d] = squares.map(|i| self.sums.get(i).copied().flatten());
        Some(Squares {
            sums: [a?, b?, c?, d?],
            // Of four such corners that is four times the variance of one, of which a square has
            // 16.
            noise: (self.off_plane[squares[0]] / (4 * 16 * 16) as f32).sqrt(),
        })
    }
}

impl<A: CameraMedia> Corners<'_, A> {
    /// Corners of the squares around a pixel before the first of the 16 around it, in rows and in
    /// columns.
    pub(super) const BEFORE: usize = EDGE - 2;

    /// The first corners of the four squares around a pixel, of which `first` is the first of its
    /// 16 corners: upper left, upper right, lower left, lower right.
    pub(super) fn squares_around(&self, first: usize) -> [usize; 4] {
        let a = first - Self::BEFORE * (self.width + 1);
        let c = a + EDGE * self.width;
        [a, a + EDGE, c, c + EDGE]
    }

    /// Whether the squares around a pixel lie on the piece of surface of its first own corner.
    pub(super) fn is_like_squares(&self, like: &Corner<A::Passed>, squares: [usize; 4]) -> bool {
        let beyond = (EDGE - 1) * (1 + self.width);
        let [a, b, c, d] = squares;
        let outermost = [a, b + EDGE - 1, c + beyond - (EDGE - 1), d + beyond];
        (outermost.into_iter())
            .all(|i| (self.shader).same_end(&like.sample, &self.corners[i].sample))
    }

    /// Sums the shadow rays of all squares.
    pub(super) fn sum_squares(&self) -> SquareSums {
        let joins = |i: usize, j: usize| {
            let [a, b] = [i, j].map(|k| &self.corners[k].sample);
            b.surface.is_some() && self.shader.same_end(a, b)
        };
        let sums = |ratio: fn(&DirectLight) -> ShadowRatio| {
            let own: Vec<_> = (self.corners.iter())
                .map(|c| c.sample.surface.map(|_| ratio(&c.sample.direct)))
                .collect();
            let rows = self.runs(&own, 1, joins);
            SumsOfLights {
                off_plane: self.off_plane(&own),
                sums: self.runs(&rows, self.width, joins),
            }
        };
        SquareSums {
            lamps: sums(|direct| direct.ratio),
            sky: match self.shader.lights.has_excess() {
                true => sums(|direct| direct.sky.ratio),
                false => SumsOfLights::default(),
            },
        }
    }

    /// By the first corner of a square: by how much the shares of its corners, and of those as far
    /// on in the squares beside and below it, are off a plane, squared and added up. Corners as far
    /// on ask the same cells of the lights, so that is noise but for bends of a penumbra.
    fn off_plane(&self, of: &[Option<ShadowRatio>]) -> Vec<f32> {
        let shares: Vec<f32> = (of.iter())
            .map(|ratio| ratio.map_or(0.0, |ratio| ratio.share()))
            .collect();
        let below = EDGE * self.width;
        let off = |i: usize| {
            let [a, b, c, d] = [i, i + EDGE, i + below, i + below + EDGE].map(|i| shares.get(i));
            let off = Some(a? - b? - c? + d?);
            off.map(|off| off * off)
        };
        let each: Vec<f32> = (0..shares.len()).map(|i| off(i).unwrap_or(0.0)).collect();
        let runs = |of: &[f32], step: usize| -> Vec<f32> {
            let run = |i: usize| (0..EDGE).filter_map(|k| of.get(i + k * step)).sum();
            (0..of.len()).map(run).collect()
        };
        runs(&runs(&each, 1), self.width)
    }

    /// Sums over runs of four corners, `step` from one to the next, which all join. Those that
    /// leave their row are of no use to any pixel.
    fn runs(
        &self,
        of: &[Option<ShadowRatio>],
        step: usize,
        joins: impl Fn(usize, usize) -> bool,
    ) -> Vec<Option<ShadowRatio>> {
        let joins: Vec<bool> = (0..of.len())
            .map(|i| i + step < of.len() && joins(i, i + step))
            .collect();
        let run = |i: usize| {
            let mut sum = (*of.get(i)?)?;
            for k in 1..EDGE {
                let next = i + k * step;
                if !joins[next - step] {
                    return None;
                }
                sum += (*of.get(next)?)?;
            }
            Some(sum)
        };
        (0..of.len()).map(run).collect()
    }
}
