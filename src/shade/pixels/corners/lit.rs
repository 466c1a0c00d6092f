//! Corners with all their light, for samples that end elsewhere than those of pinholes.

use super::penumbra::LightAtPixel;
use super::{Corner, Corners};
use crate::light::Visibility;
use crate::math::{Rgb, Spectrum};
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::shade::pixels::pixel::Pixel;
use crate::shade::pixels::pixel_sum::PixelSum;
use crate::shade::pixels::sample::Sample;
use crate::shade::surfaces::WithSky;
use glam::Vec3;
use std::f32::consts::FRAC_1_PI;

/// A corner of pixels with all its light.
#[derive(Clone, Copy, Debug)]
pub struct LitCorner<T> {
    /// Where its ray ends: position, normal and material; `None` for the background.
    pub end: Option<LitEnd>,
    /// Media before that.
    pub passed: T,
    /// Radiance towards the camera, media included.
    pub radiance: Rgb,
    /// Radius in pixels over which the camera spreads it.
    pub radius: f32,
}

/// The surface that a corner shows, and its light.
#[derive(Clone, Copy, Debug)]
pub struct LitEnd {
    /// Where it is, scene space.
    pub position: Vec3,
    /// Unit normal for shading, on the side that is seen.
    pub normal: Vec3,
    /// Index of its material.
    pub material: u32,
    /// Direct irradiance in the middle of the pixel that it is the upper left corner of.
    pub direct: WithSky,
    /// Indirect irradiance.
    pub indirect: WithSky,
    /// Whether the edge of a shadow is in that pixel.
    pub is_edge: bool,
}

impl<A: CameraMedia> Corners<'_, A> {
    /// The ray through the upper left corner of pixel (x, y) of the region, and where it ends.
    pub fn sample(&self, x: u32, y: u32) -> &Sample<A::Passed> {
        &self.corners[self.first_around(x, y) + self.width + 1].sample
    }

    /// The upper left corner of pixel (x, y) of the region, which is spread over a radius.
    pub fn lit_corner(&self, x: u32, y: u32, radius: f32) -> LitCorner<A::Passed> {
        let first = self.first_around(x, y);
        let at = |column: usize, row: usize| &self.corners[first + row * self.width + column];
        let own = [at(1, 1), at(2, 1), at(1, 2), at(2, 2)];
        let Corner { sample, irradiance } = own[0];
        let Some(surface) = &sample.surface else {
            let radiance = self.shader.background(sample.direction);
            return LitCorner {
                end: None,
                passed: sample.passed,
                radiance: sample.passed.transmittance().filter(radiance) + sample.passed.radiance(),
                radius,
            };
        };
        let mut visibility = Visibility::default();
        own.iter()
            .for_each(|c| visibility += c.sample.direct.visibility);
        let lit = self.lit(first, own[0], at);
        let arriving = |corner: &Corner<A::Passed>| {
            let direct = &corner.sample.direct;
            WithSky::from(match &lit {
                LightAtPixel::Arrived { lamps, sky } => direct.arriving(lamps, sky),
                LightAtPixel::Edge => direct.arriving(&direct.ratio, &direct.sky.ratio),
            })
        };
        let direct = arriving(own[0]);
        let (mut over_pixel, mut count) = (WithSky::BLACK, 0.0);
        for corner in own
            .into_iter()
            .filter(|c| self.shader.same_end(sample, &c.sample))
        {
            over_pixel += arriving(corner);
            count += 1.0;
        }
        let emission = surface.emission(
            self.shader.view.tracer.scene,
            sample.triangle,
            -sample.direction,
        );
        let light = surface.albedo * ((direct.all + irradiance.all) * FRAC_1_PI) + emission;
        LitCorner {
            end: Some(LitEnd {
                position: surface.position,
                normal: surface.normal,
                material: surface.material,
                direct: over_pixel * (1.0 / f32::max(count, 1.0)),
                indirect: *irradiance,
                is_edge: matches!(lit, LightAtPixel::Edge) || visibility.has_edge(),
            }),
            passed: sample.passed,
            radiance: sample.passed.transmittance().filter(light) + sample.passed.radiance(),
            radius,
        }
    }

    /// Pixel (x, y) of the region as a pinhole shows it, if its corners tell it, or if it is
    /// `sharp`.
    pub fn shade_if_known(&self, x: u32, y: u32, sharp: bool) -> Option<Pixel> {
        let first = self.first_around(x, y);
        if sharp {
            return Some(self.shade_between(x, y, first));
        }
        let at = |column: usize, row: usize| &self.corners[first + row * self.width + column];
        let own = [at(1, 1), at(2, 1), at(1, 2), at(2, 2)];
        if !self.shader.end_alike(own.iter().map(|c| &c.sample))
            || self.shader.borders.is_border(x, y)
        {
            return None;
        }
        self.mean_of_corners(PixelSum::of(x, y), first, own, at)
    }
}
