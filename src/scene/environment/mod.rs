//! Environment images: the radiance that comes from every direction in which no surface is.
//!
//! - here: the image, and what comes from a direction
//! - `suns`: the small bright parts of an image, as lights of their own

mod suns;

pub use suns::ImageSun;

use crate::column::Column;
use crate::math::Rgb;
use crate::{Error, Result};
use glam::Vec3;
use std::f32::consts::{PI, TAU};
use std::sync::Arc;
use std::{f64, fmt};

/// A lat-long image of the radiance from all directions, in the orientation of OpenEXR and UsdLux:
/// the first row is around +y, the middle of the image is +z, and +x a quarter of its width before
/// that. Radiance is bilinear between the middles of texels, and that of the first and last row up
/// to the poles.
///
/// Suns that were taken out of it still stand in what is seen of it, but no longer in the light
/// that it sends.
#[derive(Clone)]
pub struct EnvironmentImage {
    width: u32,
    height: u32,
    /// Row by row from the top.
    texels: Arc<Column<[f32; 3]>>,
    /// Factor on them.
    scale: [f32; 3],
    /// By how much the image is turned about +y, right-handed.
    rotation_rad: f32,
    /// What is in the place of suns, by the number of the texel, in the unit of texels.
    holes: Arc<[(u32, [f32; 3])]>,
}

impl fmt::Debug for EnvironmentImage {
    /// Without its texels, which may be millions.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("EnvironmentImage")
            .field("width", &self.width)
            .field("height", &self.height)
            .field("scale", &self.scale)
            .field("rotation_rad", &self.rotation_rad)
            .field("holes", &self.holes.len())
            .finish_non_exhaustive()
    }
}

impl EnvironmentImage {
    /// Texels in a row, at most.
    pub(super) const MAX_WIDTH: u32 = 65_536;
    /// Radiance beyond this is taken for a mistake.
    const MAX_RADIANCE: f32 = 1e30;

    /// An image of linear RGB, row by row from the top.
    ///
    /// # Errors
    /// An image that is not twice as wide as it is high, or whose texels are not numbers of at
    /// least
    /// 0.
    pub fn new(width: u32, height: u32, texels: Vec<[f32; 3]>) -> Result<Self> {
        Self::of(width, height, texels.into())
    }

    pub(super) fn of(width: u32, height: u32, texels: Column<[f32; 3]>) -> Result<Self> {
        Self::check_size(width, height)?;
        let count = width as usize * height as usize;
        if texels.len() != count {
            return Err(Error::input(format!(
                "expected {width} x {height} texels, found {}",
                texels.len()
            )));
        }
        let is_right = |texel: &[f32; 3]| {
            let mut values = texel.iter();
            values.all(|v| (0.0..=Self::MAX_RADIANCE).contains(v))
        };
        if let Some(i) = texels.iter().position(|t| !is_right(t)) {
            return Err(Error::input(format!(
                "expected radiance from 0 to {:e}, found {:?} in column {} of row {}, \
                 counted from 0",
                Self::MAX_RADIANCE,
                texels[i],
                i as u32 % width,
                i as u32 / width
            )));
        }
        Ok(Self {
            width,
            height,
            texels: Arc::new(texels),
            scale: [1.0; 3],
            rotation_rad: 0.0,
            holes: [].into(),
        })
    }

    /// Refuses sizes that no lat-long image has.
    pub(super) fn check_size(width: u32, height: u32) -> Result<()> {
        if height == 0 || u64::from(width) != 2 * u64::from(height) || width > Self::MAX_WIDTH {
            return Err(Error::input(format!(
                "expected a lat-long image, twice as wide as high and at most {} across, found \
                 {width} x {height}",
                Self::MAX_WIDTH
            )));
        }
        Ok(())
    }

    /// The same image with its radiance times a factor, for each channel.
    #[must_use]
    pub fn scaled(mut self, scale: [f32; 3]) -> Self {
        self.scale = scale;
        self
    }

    /// The same image, turned about +y by an angle, right-handed: from +z towards +x.
    #[must_use]
    pub fn rotated(mut self, rotation_rad: f32) -> Self {
        self.rotation_rad = rotation_rad;
        self
    }

    /// The same image with other light in some of its texels, in their order.
    pub(super) fn with_holes(mut self, holes: Vec<(u32, [f32; 3])>) -> Self {
        self.holes = holes.into();
        self
    }

    /// Texels across, and rows.
    #[must_use]
    pub fn size(&self) -> [u32; 2] {
        [self.width, self.height]
    }

    /// Factor on the texels.
    #[must_use]
    pub fn scale(&self) -> [f32; 3] {
        self.scale
    }

    /// By how much the image is turned about +y, radians.
    #[must_use]
    pub fn rotation_rad(&self) -> f32 {
        self.rotation_rad
    }

    /// The texels as the image has them, row by row from the top.
    #[must_use]
    pub fn texels(&self) -> &[[f32; 3]] {
        &self.texels
    }

    /// What is in the place of suns, by the number of the texel, in the unit of texels.
    #[must_use]
    pub fn holes(&self) -> &[(u32, [f32; 3])] {
        &self.holes
    }

    /// Bytes of memory that the texels take, but for those that lie in a packed file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        match self.texels.is_mapped() {
            true => 0,
            false => size_of_val(&self.texels[..]) as u64,
        }
    }

    /// Refuses factors and angles out of range.
    pub(super) fn check(&self) -> Result<()> {
        let is_right = |v: &f32| (0.0..=Self::MAX_RADIANCE).contains(v);
        if !self.scale.iter().all(is_right) {
            return Err(Error::input(format!(
                "the environment image: the factor {:?} is not in 0 to {:e}",
                self.scale,
                Self::MAX_RADIANCE
            )));
        }
        if !self.rotation_rad.is_finite() {
            return Err(Error::input(format!(
                "the environment image is turned by {}",
                self.rotation_rad
            )));
        }
        Ok(())
    }

    /// Radiance of a texel as it is seen.
    #[must_use]
    pub fn seen_texel(&self, texel: usize) -> Rgb {
        Rgb(self.texels[texel]) * Rgb(self.scale)
    }

    /// Radiance of a texel without the suns that were taken out.
    #[must_use]
    pub fn lit_texel(&self, texel: usize) -> Rgb {
        let number = texel as u32;
        if let (Some(first), Some(last)) = (self.holes.first(), self.holes.last())
            && (first.0..=last.0).contains(&number)
            && let Ok(i) = self.holes.binary_search_by_key(&number, |hole| hole.0)
        {
            return Rgb(self.holes[i].1) * Rgb(self.scale);
        }
        self.seen_texel(texel)
    }

    /// Radiance that is seen in a unit direction of scene space.
    #[must_use]
    pub fn seen(&self, direction: Vec3) -> Rgb {
        self.bilinear(direction, |texel| self.seen_texel(texel))
    }

    /// Radiance that comes from a unit direction of scene space, without suns that were taken out.
    #[must_use]
    pub fn light(&self, direction: Vec3) -> Rgb {
        self.bilinear(direction, |texel| self.lit_texel(texel))
    }

    /// Radiance that is seen around a unit direction of scene space within an angle: a mean over
    /// all texels there, if they are many.
    #[must_use]
    pub fn seen_within(&self, direction: Vec3, angle: f32) -> Rgb {
        let texel = PI / self.height as f32;
        let steps = (angle / texel).ceil();
        // As rows are, even where the columns meet.
        if steps.is_nan() || steps <= 1.0 {
            return self.seen(direction);
        }
        let [u, v] = self.place(direction);
        let sin = libm::sinf(PI * v).max(1e-3);
        let [high, wide] = [angle / PI, (angle / (TAU * sin)).min(1.0)];
        let across = (wide * self.width as f32).ceil().max(1.0);
        let mut sum = Rgb::BLACK;
        for down in 0..steps as u32 {
            let v = v + high * ((down as f32 + 0.5) / steps - 0.5);
            for column in 0..across as u32 {
                let u = u + wide * ((column as f32 + 0.5) / across - 0.5);
                let place = [u - u.floor(), v.clamp(0.0, 1.0)];
                let texel = |i: usize| self.seen_texel(i);
                sum += bilinear([self.width, self.height], place, texel);
            }
        }
        sum * (1.0 / (steps * across))
    }

    fn bilinear(&self, direction: Vec3, texel: impl Fn(usize) -> Rgb) -> Rgb {
        bilinear([self.width, self.height], self.place(direction), texel)
    }

    /// Where a unit direction of scene space is in the image, from 0 to 1 across and down.
    #[must_use]
    pub fn place(&self, direction: Vec3) -> [f32; 2] {
        let turns = libm::atan2f(direction.x, -direction.z) + self.rotation_rad;
        let u = turns / TAU;
        let v = libm::acosf(direction.y.clamp(-1.0, 1.0)) / PI;
        [(u - u.floor()).min(1.0), v]
    }

    /// The unit direction of scene space at a place in the image, from 0 to 1 across and down.
    #[must_use]
    pub fn direction(&self, [u, v]: [f32; 2]) -> Vec3 {
        let phi = TAU * u - self.rotation_rad;
        let theta = PI * v;
        let (sin, cos) = (libm::sinf(theta), libm::cosf(theta));
        Vec3::new(libm::sinf(phi) * sin, cos, -libm::cosf(phi) * sin).normalize()
    }

    /// Solid angle of each texel of a row.
    #[must_use]
    pub fn solid_angle(&self, row: u32) -> f64 {
        solid_angle([self.width, self.height], row)
    }

    /// The image without suns on at most `width` texels across: means over solid angles. Its texels
    /// are row by row from the top.
    #[must_use]
    pub fn reduced(&self, width: u32) -> ReducedImage {
        let width = self.width.min(width);
        let height = width.div_ceil(2);
        let count = width as usize * height as usize;
        if width == self.width {
            let texels = (0..count).map(|i| self.lit_texel(i)).collect();
            return ReducedImage {
                width,
                height,
                texels,
            };
        }
        let mut sums = vec![[0.0_f64; 4]; count];
        let cell = |at: u32, from: u32, to: u32| u64::from(at) * u64::from(to) / u64::from(from);
        for row in 0..self.height {
            let solid_angle = self.solid_angle(row);
            let first = cell(row, self.height, height) as usize * width as usize;
            for column in 0..self.width {
                let texel = row as usize * self.width as usize + column as usize;
                let sum = &mut sums[first + cell(column, self.width, width) as usize];
                let light = self.lit_texel(texel);
                for (sum, light) in sum.iter_mut().zip(light.0.into_iter().chain([1.0])) {
                    *sum += f64::from(light) * solid_angle;
                }
            }
        }
        let mean = |[r, g, b, all]: [f64; 4]| Rgb([r, g, b].map(|sum| (sum / all) as f32));
        ReducedImage {
            width,
            height,
            texels: sums.into_iter().map(mean).collect(),
        }
    }

    /// Mean radiance over the sphere, without suns that were taken out.
    #[must_use]
    pub fn mean(&self) -> Rgb {
        let mut sum = [0.0_f64; 3];
        for row in 0..self.height {
            let first = row as usize * self.width as usize;
            let mut of_row = [0.0_f64; 3];
            for texel in first..first + self.width as usize {
                let light = self.lit_texel(texel).0;
                (of_row.iter_mut().zip(light)).for_each(|(s, v)| *s += f64::from(v));
            }
            let solid_angle = self.solid_angle(row);
            (sum.iter_mut().zip(of_row)).for_each(|(s, v)| *s += v * solid_angle);
        }
        Rgb(sum.map(|v| (v / (4.0 * f64::consts::PI)) as f32))
    }

    /// The radiance of all texels, if it is the same everywhere.
    pub(super) fn only_radiance(&self) -> Option<[f32; 3]> {
        let first = self.texels.first()?;
        let is_same = self.texels.iter().all(|t| t == first);
        is_same.then(|| self.seen_texel(0).0)
    }
}

/// Solid angle of each texel of a row of a lat-long image.
fn solid_angle([width, height]: [u32; 2], row: u32) -> f64 {
    let border = |row: u32| libm::cos(f64::consts::PI * f64::from(row) / f64::from(height));
    (border(row) - border(row + 1)) * f64::consts::TAU / f64::from(width)
}

/// Bilinear between the texels of a lat-long image, at a place from 0 to 1 across and down.
pub(crate) fn bilinear(
    [width, height]: [u32; 2],
    [u, v]: [f32; 2],
    texel: impl Fn(usize) -> Rgb,
) -> Rgb {
    let (x, y) = (u * width as f32 - 0.5, v * height as f32 - 0.5);
    let (left, top) = (x.floor(), y.floor());
    let (fx, fy) = (x - left, y - top);
    let column = |c: f32| (c as i64).rem_euclid(width.into()) as usize;
    let row = |r: f32| r.clamp(0.0, (height - 1) as f32) as usize * width as usize;
    let columns = [(column(left), 1.0 - fx), (column(left + 1.0), fx)];
    let rows = [(row(top), 1.0 - fy), (row(top + 1.0), fy)];
    let mut sum = Rgb::BLACK;
    for (row, down) in rows {
        for (column, across) in columns {
            sum += texel(row + column) * (down * across);
        }
    }
    sum
}

/// Means of the radiance of an environment image.
#[derive(Clone, Debug)]
pub struct ReducedImage {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Row by row from the top.
    pub texels: Vec<Rgb>,
}

impl ReducedImage {
    /// Solid angle of each texel of a row.
    #[must_use]
    pub fn solid_angle(&self, row: u32) -> f64 {
        solid_angle([self.width, self.height], row)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    /// An image whose texels tell where they are.
    fn places(width: u32) -> EnvironmentImage {
        let height = width / 2;
        let texel = |i: u32| [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5, 1.0];
        let texels = (0..width * height).map(texel).collect();
        EnvironmentImage::new(width, height, texels).unwrap()
    }

    #[test]
    fn directions_are_those_of_openexr() {
        let image = places(64);
        for (direction, [x, y]) in [
            (Vec3::Y, [None, Some(0.5)]),
            (-Vec3::Y, [None, Some(31.5)]),
            (Vec3::Z, [Some(32.0), Some(16.0)]),
            (Vec3::X, [Some(16.0), Some(16.0)]),
            (-Vec3::X, [Some(48.0), Some(16.0)]),
        ] {
            let Rgb([u, v, one]) = image.seen(direction);
            assert!((one - 1.0).abs() < 1e-6);
            for (got, expected) in [(u, x), (v, y)] {
                assert!(
                    expected.is_none_or(|e| (got - e).abs() < 1e-4),
                    "{direction} {got}"
                );
            }
        }
        // Between the last column and the first.
        let [u, _, _] = image.seen(-Vec3::Z).0;
        assert!((u - 32.0).abs() < 1e-3, "{u}");
    }

    #[test]
    fn places_and_directions_are_each_others_inverse_and_turn_together() {
        for turn in [0.0_f32, 0.4, -7.0] {
            let image = places(64).rotated(turn);
            for i in 0..200 {
                let d = sampling::sphere(sampling::r2(i, [0.3; 2]));
                let back = image.direction(image.place(d));
                assert!(d.distance(back) < 1e-5, "{d} {back}");
                // Right-handed about +y.
                let (sin, cos) = (libm::sinf(turn), libm::cosf(turn));
                let turned = Vec3::new(cos * d.x + sin * d.z, d.y, cos * d.z - sin * d.x);
                let (got, expected) = (image.seen(turned), places(64).seen(d));
                let is_near_seam = (expected.0[0] - 32.0).abs() > 31.0;
                assert!(is_near_seam || (got.0[0] - expected.0[0]).abs() < 0.01);
            }
        }
    }

    #[test]
    fn a_quarter_turn_moves_columns_by_a_quarter() {
        let image = places(64).rotated(std::f32::consts::FRAC_PI_2);
        let at = |d: Vec3| image.seen(d).0[0];
        assert!((at(Vec3::X) - 32.0).abs() < 1e-3 && (at(-Vec3::Z) - 16.0).abs() < 1e-3);
    }

    #[test]
    fn smaller_images_have_the_same_mean() {
        let image = places(96).scaled([0.5, 2.0, 1.0]);
        let reduced = image.reduced(20);
        assert_eq!((reduced.width, reduced.height), (20, 10));
        let all: f64 = (0..48).map(|row| image.solid_angle(row) * 96.0).sum();
        assert!((all - 4.0 * f64::consts::PI).abs() < 1e-12);
        let mean = image.mean().0;
        assert!(
            (mean[0] - 24.0).abs() < 1e-3 && (mean[1] - 48.0).abs() < 1e-3,
            "{mean:?}"
        );
    }

    #[test]
    fn what_is_no_environment_is_refused() {
        let said = |width, height, texels| {
            let made = EnvironmentImage::new(width, height, texels);
            made.map(drop).unwrap_err().to_string()
        };
        assert!(said(3, 2, vec![[1.0; 3]; 6]).contains("found 3 x 2"));
        assert!(said(0, 0, Vec::new()).contains("found 0 x 0"));
        assert!(said(4, 2, vec![[1.0; 3]; 7]).contains("found 7"));
        for bad in [f32::NAN, -0.5, f32::INFINITY] {
            let mut texels = vec![[1.0; 3]; 8];
            texels[6][1] = bad;
            let said = said(4, 2, texels);
            assert!(said.contains("column 2 of row 1"), "{said}");
        }
    }
}
