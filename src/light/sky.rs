//! The light of an environment image in two parts: what gathers meet, and an excess that they would
//! meet too seldom, which is a light with an extent.
//!
//! What is brighter than a few times the mean over all directions is the excess, so that nothing
//! counts twice.

use super::direct::DirectLight;
use super::shading_point::{Arrival, Receiver, ShadingPoint};
use super::shadows::Shadows;
use crate::math::distribution::GridDistribution;
use crate::math::{EnvironmentMap, Rgb, Spectrum, SphereMap};
use crate::scene::EnvironmentImage;
use glam::Vec3;
use std::f32::consts::TAU;
use std::f64::consts::PI as PI_F64;

/// The light of an environment image, and of environments of one colour with it.
#[derive(Debug)]
pub struct Sky {
    /// What gathers meet.
    pub map: EnvironmentMap,
    /// What is brighter than that.
    pub excess: Option<Excess>,
}

/// The excess of an environment image.
#[derive(Debug)]
pub struct Excess {
    parts: SkyParts,
    /// Of the parts, by the light that they send.
    distribution: GridDistribution,
    /// By part, what it sends over its chance.
    light: Vec<Rgb>,
    /// Irradiance of a surface that nothing hides it from, by its normal.
    irradiance: SphereMap,
}

/// A lat-long grid over the sphere.
#[derive(Clone, Debug)]
struct SkyParts {
    width: usize,
    height: usize,
    rotation_rad: f32,
    /// By column, sine and cosine of the angle in its middle.
    columns: Vec<[f32; 2]>,
    /// By row, cosines of the angles from +y to its upper end and behind it.
    rows: Vec<f32>,
}

impl SkyParts {
    /// Parts across: of a small image its radiance between texels is looked at, of a large one
    /// means.
    const ACROSS: [u32; 2] = [256, 1024];

    /// The parts that stand for an image, and the radiance of each, row by row.
    fn of(image: &EnvironmentImage) -> (Self, Vec<Rgb>) {
        let [least, most] = Self::ACROSS;
        let across = image.size()[0].clamp(least, most);
        let rotation_rad = image.rotation_rad();
        let (width, height) = (across as usize, across as usize / 2);
        let angle = |column: usize| TAU * (column as f32 + 0.5) / width as f32 - rotation_rad;
        let columns = (0..width).map(angle);
        let border = |row: usize| libm::cos(PI_F64 * row as f64 / height as f64) as f32;
        let parts = Self {
            width,
            height,
            rotation_rad,
            columns: columns.map(|a| [libm::sinf(a), libm::cosf(a)]).collect(),
            rows: (0..=height).map(border).collect(),
        };
        let radiance = match image.size()[0] < least {
            true => (0..width * height)
                .map(|i| image.light(parts.direction(i)))
                .collect(),
            false => image.reduced(most).texels,
        };
        (parts, radiance)
    }

    /// The unit direction of the middle of a part.
    fn direction(&self, part: usize) -> Vec3 {
        let row = part / self.width;
        let [sin, cos] = self.columns[part % self.width];
        Self::towards(sin, cos, 0.5 * (self.rows[row] + self.rows[row + 1]))
    }

    fn towards(sin: f32, cos: f32, up: f32) -> Vec3 {
        let side = (1.0 - up * up).max(0.0).sqrt();
        Vec3::new(sin * side, up, -cos * side).normalize()
    }

    /// A unit direction of a part, by where in it two numbers in [0,1) are.
    fn within(&self, part: usize, [across, down]: [f32; 2]) -> Vec3 {
        let (row, column) = (part / self.width, part % self.width);
        let angle = TAU * (column as f32 + across) / self.width as f32 - self.rotation_rad;
        let up = self.rows[row] + (self.rows[row + 1] - self.rows[row]) * down;
        Self::towards(libm::sinf(angle), libm::cosf(angle), up)
    }

    fn solid_angle(&self, part: usize) -> f64 {
        let row = part / self.width;
        let height = f64::from(self.rows[row]) - f64::from(self.rows[row + 1]);
        height * 2.0 * PI_F64 / self.width as f64
    }

    fn count(&self) -> usize {
        self.width * self.height
    }
}

impl Sky {
    /// What is brighter than so many times the mean is excess.
    const EXCESS_OVER_MEAN: f32 = 4.0;
    /// An excess of less than this share of all light is left to gathers.
    const MIN_EXCESS: f64 = 0.005;
    /// Edges along the map that gathers meet: a few for each of their rays.
    const RADIANCE_EDGE: usize = 32;
    /// The same for irradiance by normal, of gathers and of the excess.
    const IRRADIANCE_EDGE: usize = 32;
    const EXCESS_EDGE: usize = 64;

    /// The light of an image and, with it, of an environment of one colour.
    #[must_use]
    pub fn new(image: &EnvironmentImage, even: Rgb) -> Self {
        let (parts, mut radiance) = SkyParts::of(image);
        radiance.iter_mut().for_each(|r| *r += even);
        let weight = |(i, light): (usize, &Rgb)| f64::from(light.mean()) * parts.solid_angle(i);
        let all: f64 = radiance.iter().enumerate().map(weight).sum();
        let most = Self::EXCESS_OVER_MEAN * (all / (4.0 * PI_F64)) as f32;
        let beyond = |light: Rgb| light * (1.0 - most / light.mean()).max(0.0);
        let excess: Vec<Rgb> = radiance
            .iter()
            .map(|light| {
                if light.mean() > most {
                    beyond(*light)
                } else {
                    Rgb::BLACK
                }
            })
            .collect();
        let beyond: f64 = excess.iter().enumerate().map(weight).sum();
        let excess = match beyond > Self::MIN_EXCESS * all {
            true => {
                for (light, excess) in radiance.iter_mut().zip(&excess) {
                    *light = Rgb(std::array::from_fn(|c| light.0[c] - excess.0[c]));
                }
                Excess::new(parts.clone(), &excess)
            }
            false => None,
        };
        let each = radiance.iter().enumerate();
        let each = each.map(|(i, light)| (parts.direction(i), *light, parts.solid_angle(i)));
        let map = EnvironmentMap {
            radiance: SphereMap::of_parts(Self::RADIANCE_EDGE, each),
            irradiance: irradiance(&parts, &radiance, Self::IRRADIANCE_EDGE),
        };
        Self { map, excess }
    }
}

impl Excess {
    fn new(parts: SkyParts, radiance: &[Rgb]) -> Option<Self> {
        let weights: Vec<f64> = (0..parts.count())
            .map(|i| f64::from(radiance[i].mean()) * parts.solid_angle(i))
            .collect();
        let sum: f64 = weights.iter().sum();
        let over_chance = |light: &Rgb| match light.mean() {
            mean if mean > 0.0 => *light * (sum as f32 / mean),
            _ => Rgb::BLACK,
        };
        Some(Self {
            distribution: GridDistribution::new(parts.width, weights.into_iter())?,
            light: radiance.iter().map(over_chance).collect(),
            irradiance: irradiance(&parts, radiance, Sky::EXCESS_EDGE),
            parts,
        })
    }

    /// The direction that two numbers in [0,1) choose, and the radiance from there over its chance.
    fn choose(&self, u: [f32; 2]) -> (Vec3, Rgb) {
        let chosen = self.distribution.choose(u);
        let size = [self.parts.width, self.parts.height].map(|n| n as f32);
        let at = [
            chosen.place[0] * size[0] - (chosen.cell % self.parts.width) as f32,
            chosen.place[1] * size[1] - (chosen.cell / self.parts.width) as f32,
        ];
        let within = at.map(|c| c.clamp(0.0, 1.0));
        (
            self.parts.within(chosen.cell, within),
            self.light[chosen.cell],
        )
    }

    /// Adds unshadowed light, and what rays find of it. Where pictures show means of many points
    /// the rays alone tell it, which has no bias.
    pub fn trace(
        &self,
        total: &mut DirectLight,
        at: &ShadingPoint<impl Shadows, impl Receiver>,
        by_rays_alone: bool,
    ) {
        /// Among the sequences of rays, and among the lights that are seen.
        const SET: u32 = 61;
        let rays = at.rays;
        let mut sent = Rgb::BLACK;
        for i in 0..rays.count() {
            let (direction, light) = self.choose(rays.point(i, SET));
            let response = at.receiver.response(direction);
            if response > 0.0 {
                let light = light * response;
                sent += light;
                let media = at.shadows.before_emitters();
                let transmittance = at.transmittance(direction, f32::INFINITY, media);
                // In media what is sent is what rays bring.
                let arrives = transmittance.mean_of(light) / rays.count() as f32;
                at.receiver.note(direction, arrives, Arrival::Delta);
                total.sky.ratio.note(light, transmittance);
                total
                    .visibility
                    .note_ray(SET as usize, transmittance.mean());
            }
        }
        total.sky.unshadowed += match at.receiver.normals() {
            Some([normal, _]) if !by_rays_alone => self.irradiance.get(normal),
            // Rays to a medium differ by its phase function alone.
            _ => sent * (1.0 / rays.count().max(1) as f32),
        };
    }
}

/// Irradiance by normal, with nothing in between, of parts of the sky.
fn irradiance(parts: &SkyParts, radiance: &[Rgb], edge: usize) -> SphereMap {
    /// Cells along each axis of the cube around all directions.
    const CELLS: usize = 24;
    let cell = |d: Vec3| {
        let [x, y, z] = [d.x, d.y, d.z].map(|c| ((0.5 * c + 0.5) * CELLS as f32) as usize);
        (x.min(CELLS - 1) * CELLS + y.min(CELLS - 1)) * CELLS + z.min(CELLS - 1)
    };
    // By cell, light, and directions by how much comes from there.
    let mut sums = vec![([0.0_f64; 3], [0.0_f64; 3]); CELLS * CELLS * CELLS];
    for (i, light) in radiance.iter().enumerate() {
        if light.is_black() {
            continue;
        }
        let (d, solid_angle) = (parts.direction(i), parts.solid_angle(i));
        let (sum, towards) = &mut sums[cell(d)];
        (sum.iter_mut().zip(light.0)).for_each(|(s, v)| *s += f64::from(v) * solid_angle);
        let weight = f64::from(light.mean()) * solid_angle;
        (towards.iter_mut().zip(d.to_array())).for_each(|(s, v)| *s += f64::from(v) * weight);
    }
    let sent = sums.into_iter().filter_map(|(light, towards)| {
        let all = light.iter().sum::<f64>() / 3.0;
        // Not of unit length: the mean over the directions of a cell.
        let [x, y, z] = towards.map(|v| (v / all) as f32);
        (all > 0.0).then(|| (Vec3::new(x, y, z), Rgb(light.map(|v| v as f32))))
    });
    let sent: Vec<(Vec3, Rgb)> = sent.collect();
    SphereMap::from_fn(edge, |normal| {
        let mut sum = Rgb::BLACK;
        for (towards, light) in &sent {
            sum += *light * normal.dot(*towards).max(0.0);
        }
        sum
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use std::f32::consts::PI;

    fn image(width: u32, of: impl Fn(Vec3) -> f32) -> EnvironmentImage {
        let height = width / 2;
        let count = (width * height) as usize;
        let blank = EnvironmentImage::new(width, height, vec![[0.0; 3]; count]).unwrap();
        let texel = |i: u32| {
            let place = [i % width, i / width].map(|c| c as f32 + 0.5);
            let d = blank.direction([place[0] / width as f32, place[1] / height as f32]);
            [1.0, 0.5, 2.0].map(|c| c * of(d))
        };
        let texels = (0..width * height).map(texel).collect();
        EnvironmentImage::new(width, height, texels).unwrap()
    }

    fn normals() -> impl Iterator<Item = Vec3> {
        (0..200).map(|i| sampling::sphere(sampling::r2(i, [0.2; 2])))
    }

    /// Of light in spherical harmonics of order 0, 1 and 2 irradiance has pi, 2 pi / 3 and pi / 4
    /// times as much (Ramamoorthi & Hanrahan 2001).
    #[test]
    fn irradiance_is_that_of_spherical_harmonics() {
        let (a, b) = (
            Vec3::new(0.3, 0.5, -0.8).normalize(),
            Vec3::new(0.7, 0.1, 0.4).normalize(),
        );
        let second = |d: Vec3| 1.5 * b.dot(d) * b.dot(d) - 0.5;
        let image = image(512, |d| 2.0 + a.dot(d) + 0.8 * second(d));
        let sky = Sky::new(&image, Rgb::splat(0.5));
        assert!(sky.excess.is_none());
        for n in normals() {
            let first = 2.0 * PI / 3.0 * a.dot(n);
            let expected = 2.0 * PI + first + 0.8 * PI / 4.0 * second(n);
            let [red, green, _] = sky.map.irradiance.get(n).0;
            assert!(
                (red / (expected + 0.5 * PI) - 1.0).abs() < 4e-3,
                "{n} {red} {expected}"
            );
            assert!((green / (0.5 * (expected + PI)) - 1.0).abs() < 4e-3);
            let radiance = sky.map.radiance.get(n).0[0];
            let expected = 2.5 + a.dot(n) + 0.8 * second(n);
            assert!((radiance - expected).abs() < 0.06, "{radiance} {expected}");
        }
    }

    /// What a wall hides of a softbox must not be met beside that.
    #[test]
    fn edges_of_a_softbox_are_narrow() {
        let towards = Vec3::new(0.2, 0.6, 0.5).normalize();
        let off = |d: Vec3| libm::acosf(d.dot(towards)).to_degrees() - 62.0;
        let value = |d: Vec3| if off(d) < 0.0 { 1.0 } else { 0.0 };
        let sky = Sky::new(&image(256, value), Rgb::BLACK);
        assert!(sky.excess.is_none());
        let all = (0..40_000).map(|i| sampling::sphere(sampling::r2(i, [0.2; 2])));
        let (mut sum, mut count) = (0.0, 0.0);
        for d in all.filter(|d| off(*d).abs() < 16.0) {
            sum += (sky.map.radiance.get(d).0[0] - value(d)).abs();
            count += 1.0;
        }
        // A straight slope over so many degrees is off by a quarter of it in the mean over them.
        let width = 4.0 * 32.0 * sum / count;
        assert!(width < 14.0, "{width}");
    }

    #[test]
    fn the_parts_of_an_image_add_up_to_it() {
        let towards = Vec3::new(0.2, 0.6, 0.5).normalize();
        let of = |d: Vec3| if d.dot(towards) > 0.99 { 300.0 } else { 1.0 };
        for turn in [0.0, 1.0] {
            let image = image(256, of).rotated(turn);
            let sky = Sky::new(&image, Rgb::BLACK);
            let excess = sky.excess.as_ref().unwrap();
            let mean = image.mean();
            let n = 1 << 14;
            let mut low = Rgb::BLACK;
            for i in 0..n {
                low += sky
                    .map
                    .radiance
                    .get(sampling::sphere(sampling::sobol2(i, 0, 1)));
            }
            // Directions that are chosen send the excess, and its irradiance.
            let normal = Vec3::new(0.1, 0.9, -0.2).normalize();
            let (mut all, mut irradiance) = (Rgb::BLACK, Rgb::BLACK);
            for i in 0..n {
                let (d, light) = excess.choose(sampling::sobol2(i, 0, 2));
                all += light * (1.0 / n as f32);
                irradiance += light * (normal.dot(d).max(0.0) / n as f32);
                let seen = image.light(d).0[0];
                assert!(seen > 1.0, "{d} {seen}");
            }
            let expected = excess.irradiance.get(normal);
            let sum = low * (1.0 / n as f32) + all * (1.0 / (4.0 * PI));
            for c in 0..3 {
                assert!(
                    (sum.0[c] / mean.0[c] - 1.0).abs() < 3e-3,
                    "{sum:?} {mean:?}"
                );
                assert!((irradiance.0[c] / expected.0[c] - 1.0).abs() < 5e-3);
            }
        }
    }
}
