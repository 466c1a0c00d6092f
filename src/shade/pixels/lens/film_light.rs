//! Light of what the film shows through a pinhole, by corners of its pixels.

use crate::image::Region;
use crate::math::Rgb;
use crate::shade::pixels::camera_media::PassedMedia;
use crate::shade::pixels::corners::{LitCorner, LitEnd};
use crate::shade::surfaces::WithSky;
use crate::trace::Surface;
use glam::Vec3;

/// Light at the corners of the pixels of a part of the film.
#[derive(Debug)]
pub struct FilmLight<T> {
    region: Region,
    /// Row by row, one for the upper left corner of each pixel.
    corners: Vec<LitCorner<T>>,
}

/// Light of a surface.
#[derive(Clone, Copy, Debug)]
pub struct LightOnFilm<T> {
    /// Direct irradiance; any where the edge of a shadow is near.
    pub direct: WithSky,
    /// Indirect irradiance.
    pub indirect: WithSky,
    /// Whether the edge of a shadow is near.
    pub is_edge: bool,
    /// Media before it.
    pub passed: T,
}

impl<T: PassedMedia> FilmLight<T> {
    /// Of the corners of a region, row by row.
    #[must_use]
    pub fn new(region: Region, corners: Vec<LitCorner<T>>) -> Self {
        Self { region, corners }
    }

    /// The upper left corner of a pixel, if that is in the region.
    #[must_use]
    #[inline]
    pub fn corner(&self, x: u32, y: u32) -> Option<&LitCorner<T>> {
        let Region { x0, y0, x1, y1 } = self.region;
        let inside = x >= x0 && y >= y0 && x < x1 && y < y1;
        inside.then(|| &self.corners[((y - y0) * (x1 - x0) + (x - x0)) as usize])
    }

    /// Light at a surface that is seen at a point of the film, between the corners and the pixels
    /// around that end on its piece.
    #[must_use]
    pub fn at(
        &self,
        [x, y]: [f32; 2],
        surface: &Surface,
        footprint: f32,
    ) -> Option<LightOnFilm<T>> {
        if x < 0.0 || y < 0.0 {
            return None;
        }
        let mut light = LightOnFilm {
            direct: WithSky::BLACK,
            indirect: WithSky::BLACK,
            is_edge: false,
            passed: T::default(),
        };
        let mut sum = 0.0;
        let (mut transmittance, mut radiance) = (T::Share::default(), Rgb::BLACK);
        for (corner, weight) in self.around([x, y]) {
            let Some(end) = corner.end.filter(|end| is_on(end, surface, footprint)) else {
                continue;
            };
            sum += weight;
            light.indirect += end.indirect * weight;
            if !T::IS_VACUUM {
                transmittance += corner.passed.transmittance() * weight;
                radiance += corner.passed.radiance() * weight;
            }
        }
        if sum == 0.0 {
            return None;
        }
        let share = 1.0 / sum;
        light.indirect = light.indirect * share;
        light.passed = T::of(transmittance * share, radiance * share);
        // Shadows are those in the middle of pixels.
        let mut sum = 0.0;
        for (corner, weight) in self.around([x - 0.5, y - 0.5]) {
            let Some(end) = corner.end.filter(|end| is_on(end, surface, footprint)) else {
                continue;
            };
            sum += weight;
            light.direct += end.direct * weight;
        }
        let own = self.corner(x as u32, y as u32).and_then(|c| c.end);
        let is_own_edge = own.is_some_and(|end| end.is_edge && is_on(&end, surface, footprint));
        light.is_edge = is_own_edge || sum == 0.0;
        if sum > 0.0 {
            light.direct = light.direct * (1.0 / sum);
        }
        Some(light)
    }

    /// The upper left corners of the pixels before and behind a place along both axes, with their
    /// weights there.
    fn around(&self, [x, y]: [f32; 2]) -> impl Iterator<Item = (&LitCorner<T>, f32)> {
        let [left, top] = [x, y].map(f32::floor);
        let [u, v] = [x - left, y - top];
        let around = [
            (0.0, 0.0, (1.0 - u) * (1.0 - v)),
            (1.0, 0.0, u * (1.0 - v)),
            (0.0, 1.0, (1.0 - u) * v),
            (1.0, 1.0, u * v),
        ];
        around.into_iter().filter_map(move |(right, down, weight)| {
            let [x, y] = [left + right, top + down];
            let corner = (x >= 0.0 && y >= 0.0).then(|| self.corner(x as u32, y as u32))?;
            // None is left out for lying on the border.
            Some((corner?, weight + 1e-3))
        })
    }
}

impl<T: PassedMedia> FilmLight<T> {
    /// What media do that are seen at a point of the film, before ends as far from `origin` as this
    /// one, between the corners around; `span` tells where the media are.
    #[must_use]
    pub fn media_at(
        &self,
        [x, y]: [f32; 2],
        origin: Vec3,
        t: f32,
        [near, far]: [f32; 2],
    ) -> Option<T> {
        /// Part of a way through media by which others may be longer or shorter.
        const MOST_DIFFERENCE: f32 = 0.1;
        if x < 0.0 || y < 0.0 {
            return None;
        }
        let (mut sum, mut transmittance, mut radiance) = (0.0, T::Share::default(), Rgb::BLACK);
        for (corner, weight) in self.around([x, y]) {
            let end = corner
                .end
                .map_or(f32::INFINITY, |end| end.position.distance(origin));
            if (end.min(far) - t.min(far)).abs() > MOST_DIFFERENCE * (far - near) {
                continue;
            }
            sum += weight;
            transmittance += corner.passed.transmittance() * weight;
            radiance += corner.passed.radiance() * weight;
        }
        let share = 1.0 / sum;
        (sum > 0.0).then(|| T::of(transmittance * share, radiance * share))
    }
}

/// Whether a surface is of the piece that a corner ends on.
#[inline]
fn is_on(end: &LitEnd, surface: &Surface, footprint: f32) -> bool {
    end.material == surface.material
        && end.normal.dot(surface.normal) > 0.98
        && (end.position - surface.position)
            .dot(surface.face_normal)
            .abs()
            < 0.5 * footprint
}
