//! Camera rays through corners, and direct light where they end.

use super::{Corner, CornerPosition, Corners};
use crate::image::Region;
use crate::light::{DirectLight, ShadowRays, Unshadowed, is_similar};
use crate::math::Rgb;
use crate::shade::pixels::camera_media::CameraMedia;
use crate::shade::pixels::sample::Sample;
use crate::shade::pixels::shader::PixelShader;
use crate::shade::surfaces::WithSky;
use crate::trace::Surface;

/// Samples the corners of a region whose first and last corners are at even coordinates, row by
/// row.
///
/// Where camera rays may be two corners apart, corners between are where the even ones say, if
/// those are on one triangle.
///
/// What emissive triangles would send, with nothing between, changes little from one corner to the
/// next. It is found at every second corner of every second row; those between take the mean where
/// all beside them lie on one piece of surface.
pub(super) struct Sampler<'a, A: CameraMedia> {
    shader: &'a PixelShader<'a, A>,
    region: Region,
    /// Rings of corners around the region's own.
    rings: u32,
    /// Corners in a row.
    width: usize,
    /// The last row at an even coordinate that was sampled.
    even: Vec<EvenCorner<'a, A>>,
}

/// A corner at even coordinates.
struct EvenCorner<'a, A: CameraMedia> {
    sample: Sample<A::Passed>,
    /// `None` where no light is seen.
    unshadowed: Option<Unshadowed<'a>>,
}

impl<'a, A: CameraMedia> Sampler<'a, A> {
    /// Before the first row of the corners of a region and so many rings around them.
    pub fn new(shader: &'a PixelShader<'a, A>, region: Region, rings: u32) -> Self {
        Self {
            shader,
            region,
            rings,
            width: (region.width() + 1 + 2 * rings) as usize,
            even: Vec::new(),
        }
    }

    /// So many rows of corners, the last at an even coordinate.
    pub fn sample(mut self, rows: usize) -> Vec<Corner<A::Passed>> {
        let mut corners = Vec::with_capacity(self.width * rows);
        let mut push = |sample| {
            corners.push(Corner {
                sample,
                irradiance: WithSky::BLACK,
            });
        };
        for row in 0..rows {
            if row % 2 == 1 {
                let below = self.even_row(row + 1);
                let above = std::mem::replace(&mut self.even, below);
                for column in 0..self.width {
                    let [left, right] = [column / 2, column.div_ceil(2)];
                    let below = &self.even;
                    let around = [&above[left], &above[right], &below[left], &below[right]];
                    push(self.between(column, row, around));
                }
                continue;
            }
            if row == 0 {
                self.even = self.even_row(row);
            }
            for column in 0..self.width {
                let left = &self.even[column / 2];
                if column % 2 == 0 {
                    push(left.sample);
                } else {
                    push(self.between(column, row, [left, &self.even[column / 2 + 1]]));
                }
            }
        }
        corners
    }

    fn place(&self, column: usize, row: usize) -> CornerPosition {
        Corners::<A>::place(self.region, self.rings, column, row)
    }

    fn rays(&self, place: &CornerPosition) -> ShadowRays {
        place.rays(self.shader, 0, 1)
    }

    /// Every second corner of a row.
    fn even_row(&self, row: usize) -> Vec<EvenCorner<'a, A>> {
        let even = |column| {
            let place = self.place(column, row);
            let mut sample = self.shader.look(place.film[0], place.film[1]);
            let lights = self.shader.lights;
            let unshadowed = sample.lit_surface().map(|s| lights.unshadowed(s));
            if let (Some(surface), Some(unshadowed)) = (sample.surface, &unshadowed) {
                let rays = self.rays(&place);
                sample.direct = lights.irradiance_by(&surface, unshadowed, unshadowed.light, rays);
            }
            EvenCorner { sample, unshadowed }
        };
        (0..self.width).step_by(2).map(even).collect()
    }

    /// A corner between some of those.
    fn between<const N: usize>(
        &self,
        column: usize,
        row: usize,
        around: [&EvenCorner<'a, A>; N],
    ) -> Sample<A::Passed> {
        let place = self.place(column, row);
        let amid = if self.shader.counts.corner_spacing > 1 {
            Sample::amid(around.map(|even| &even.sample))
        } else {
            None
        };
        // Every second row asks lights itself at all corners: the rims of penumbrae are found by
        // few rays.
        if let Some(mut sample) = amid
            && row % 2 == 1
            && let Some(direct) = DirectLight::between(around.map(|even| &even.sample.direct))
        {
            sample.direct = direct;
            return sample;
        }
        let mut sample = amid.unwrap_or_else(|| self.shader.look(place.film[0], place.film[1]));
        if let Some(&surface) = sample.lit_surface() {
            let rays = self.rays(&place);
            let lights = self.shader.lights;
            sample.direct = match self.known(&surface, sample.t, around) {
                Some((unshadowed, light)) => {
                    lights.irradiance_by(&surface, unshadowed, light, rays)
                }
                None => {
                    let unshadowed = lights.unshadowed(&surface);
                    lights.irradiance_by(&surface, &unshadowed, unshadowed.light, rays)
                }
            };
        }
        sample
    }

    /// The unshadowed light of the first corner around a surface, and the mean of all, if all are
    /// on its piece and see much the same of it.
    fn known<'e, const N: usize>(
        &self,
        surface: &Surface,
        t: f32,
        around: [&'e EvenCorner<'a, A>; N],
    ) -> Option<(&'e Unshadowed<'a>, Rgb)> {
        let mut first = None;
        let mut sum = Rgb::BLACK;
        let [mut least, mut most] = [f32::INFINITY, 0.0_f32];
        for even in around {
            let (of, unshadowed) = (even.sample.surface.as_ref()?, even.unshadowed.as_ref()?);
            if !self.shader.is_lit_alike(surface, of, t) {
                return None;
            }
            sum += unshadowed.light;
            least = least.min(unshadowed.light.mean());
            most = most.max(unshadowed.light.mean());
            first = first.or(Some(unshadowed));
        }
        if !is_similar(least, most) {
            return None;
        }
        first.map(|unshadowed| (unshadowed, sum * (1.0 / N as f32)))
    }
}
