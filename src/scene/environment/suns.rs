//! Suns in an environment image: parts so small and bright that rays hardly find them, taken out of
//! the image as lights of their own.

use super::EnvironmentImage;
use crate::math::Rgb;
use glam::{DVec3, Vec3};
use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};

/// A sun that was in an environment image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageSun {
    /// Unit direction towards it, scene space.
    pub towards: Vec3,
    /// Irradiance of a plane that faces it.
    pub irradiance: [f32; 3],
    /// Half of the angle that it is seen under, radians.
    pub angular_radius_rad: f32,
}

/// Suns of one image, at most.
const MAX_SUNS: usize = 8;
/// A sun is so many times as bright as the ring around it.
const OVER_RING: f64 = 50.0;
/// Its texels are no further from its middle than this, radians.
const MAX_RADIUS: f64 = 1.5 * PI / 180.0;
/// Texels that are wider than this have no suns, radians.
const MAX_TEXEL: f64 = 2.0 * MAX_RADIUS;
/// The ring around it, radians; of an image of wide texels it is as many of these away.
const RING: [f64; 2] = [2.5 * PI / 180.0, 5.0 * PI / 180.0];
const RING_TEXELS: [f64; 2] = [0.9, 2.2];
/// It sends at least this share of what all of the image does.
const MIN_SHARE: f64 = 0.02;

/// Texels of a part of the image.
struct Part {
    texels: BTreeSet<usize>,
    ring: [f64; 3],
}

impl EnvironmentImage {
    /// The image with its suns taken out, and these: connected texels over 50 times as bright as
    /// the ring around them, and no more than 3 degrees across, send what they have beyond the mean
    /// of the ring from a disk of the same direction, irradiance and second moment. In their place
    /// is the mean of the ring.
    #[must_use]
    pub(in crate::scene) fn without_suns(self) -> (Self, Vec<ImageSun>) {
        let all = PI * f64::from(self.mean().mean());
        let (mut image, mut suns) = (self, Vec::new());
        while suns.len() < MAX_SUNS {
            let Some((sun, part)) = image.brightest_sun() else {
                break;
            };
            let sent = f64::from(Rgb(sun.irradiance).mean());
            if sent < MIN_SHARE * all || sent <= 0.0 {
                break;
            }
            let mut holes = image.holes.to_vec();
            holes.extend(part.texels.iter().map(|&texel| {
                let [r, g, b] = image.texels[texel];
                let filled = std::array::from_fn(|c| [r, g, b][c].min(part.ring[c] as f32));
                (texel as u32, filled)
            }));
            holes.sort_by_key(|hole| hole.0);
            image = image.with_holes(holes);
            suns.push(sun);
        }
        (image, suns)
    }

    /// The brightest texel and those like it around, if they are a sun.
    fn brightest_sun(&self) -> Option<(ImageSun, Part)> {
        if PI / f64::from(self.height) > MAX_TEXEL {
            return None;
        }
        let seed = self.brightest()?;
        let ring = self.ring_around(seed)?;
        let part = self.part_around(seed, ring)?;
        let (mut sent, mut flux, mut towards) = ([0.0_f64; 3], 0.0, DVec3::ZERO);
        let scale = self.scale.map(f64::from);
        let each = || part.texels.iter().map(|&texel| self.beyond(texel, &part));
        for (beyond, direction) in each() {
            (sent.iter_mut().zip(beyond).zip(scale)).for_each(|((s, b), scale)| *s += b * scale);
            let weight = beyond.iter().sum::<f64>();
            flux += weight;
            towards += direction * weight;
        }
        let towards = towards.try_normalize()?;
        // Of a disk the mean square of the distance from its middle is half of that of its rim.
        let mut moment = 0.0;
        for (&texel, (beyond, direction)) in part.texels.iter().zip(each()) {
            let away = libm::acos(direction.dot(towards).clamp(-1.0, 1.0));
            if away > MAX_RADIUS {
                return None;
            }
            let [across, down] = self.texel_edges(texel);
            // Between the middles of texels radiance falls to that of the next.
            let own = (across * across + down * down) / 6.0;
            moment += beyond.iter().sum::<f64>() * (away * away + own);
        }
        let sun = ImageSun {
            towards: towards.as_vec3().normalize(),
            irradiance: sent.map(|s| s as f32),
            angular_radius_rad: (2.0 * moment / flux).sqrt() as f32,
        };
        Some((sun, part))
    }

    /// What a texel of a sun sends beyond what is put in its place, in the unit of texels times
    /// steradians, and the direction towards it.
    fn beyond(&self, texel: usize, part: &Part) -> ([f64; 3], DVec3) {
        let row = texel / self.width as usize;
        let solid_angle = self.solid_angle(row as u32);
        let beyond = std::array::from_fn(|c| {
            let value = self.texels[texel][c];
            f64::from(value - value.min(part.ring[c] as f32)) * solid_angle
        });
        (beyond, self.middle(texel))
    }

    /// The number of the texel whose channels add up to the most.
    fn brightest(&self) -> Option<usize> {
        let holes = self.holes();
        let is_hole = |i: usize| holes.binary_search_by_key(&(i as u32), |h| h.0).is_ok();
        let mut best: Option<(f32, usize)> = None;
        for i in 0..self.texels.len() {
            let sum = self.sum(i);
            if sum > best.map_or(0.0, |b| b.0) && (holes.is_empty() || !is_hole(i)) {
                best = Some((sum, i));
            }
        }
        best.map(|(_, i)| i)
    }

    fn sum(&self, texel: usize) -> f32 {
        let [r, g, b] = self.texels[texel];
        r * self.scale[0] + g * self.scale[1] + b * self.scale[2]
    }

    /// Direction towards the middle of a texel.
    fn middle(&self, texel: usize) -> DVec3 {
        let (width, height) = (self.width as usize, f64::from(self.height));
        let phi = TAU * ((texel % width) as f64 + 0.5) / f64::from(self.width);
        let phi = phi - f64::from(self.rotation_rad);
        let theta = PI * ((texel / width) as f64 + 0.5) / height;
        let sin = libm::sin(theta);
        DVec3::new(
            libm::sin(phi) * sin,
            libm::cos(theta),
            -libm::cos(phi) * sin,
        )
    }

    /// Angles that a texel is seen under, across and down.
    fn texel_edges(&self, texel: usize) -> [f64; 2] {
        let height = f64::from(self.height);
        let theta = PI * ((texel / self.width as usize) as f64 + 0.5) / height;
        [TAU / f64::from(self.width) * libm::sin(theta), PI / height]
    }

    /// Mean radiance of the ring around a texel, in the unit of texels; `None` if it has none.
    fn ring_around(&self, texel: usize) -> Option<[f64; 3]> {
        let down = PI / f64::from(self.height);
        let [inner, outer] = [0, 1].map(|i| RING[i].max(RING_TEXELS[i] * down));
        let middle = self.middle(texel);
        let (mut sum, mut all) = ([0.0; 3], 0.0);
        self.around(texel, outer, |near| {
            let cos = middle.dot(self.middle(near)).clamp(-1.0, 1.0);
            if (inner..=outer).contains(&libm::acos(cos)) {
                let solid_angle = self.solid_angle((near / self.width as usize) as u32);
                for (sum, value) in sum.iter_mut().zip(self.texels[near]) {
                    *sum += f64::from(value) * solid_angle;
                }
                all += solid_angle;
            }
        });
        (all > 0.0).then(|| sum.map(|s| s / all))
    }

    /// Gives the texels of the rows and columns that are up to an angle from one to `take`.
    fn around(&self, texel: usize, angle: f64, mut take: impl FnMut(usize)) {
        let (width, height) = (i64::from(self.width), i64::from(self.height));
        let (row, column) = (texel as i64 / width, texel as i64 % width);
        let rows = libm::ceil(angle / PI * height as f64) as i64;
        for near in (row - rows).max(0)..=(row + rows).min(height - 1) {
            let theta = PI * (near as f64 + 0.5) / height as f64;
            let columns = libm::ceil(angle / (TAU * libm::sin(theta)) * width as f64) as i64 + 1;
            let all = 2 * columns + 1 >= width;
            let columns = if all {
                0..=width - 1
            } else {
                column - columns..=column + columns
            };
            for column in columns {
                take((near * width + column.rem_euclid(width)) as usize);
            }
        }
    }

    /// The connected texels around one that are so much brighter than a ring; `None` if they are
    /// too many for a sun.
    fn part_around(&self, seed: usize, ring: [f64; 3]) -> Option<Part> {
        let scaled = |i: usize| ring[i] * f64::from(self.scale[i]);
        let least = OVER_RING * (scaled(0) + scaled(1) + scaled(2));
        let middle = self.middle(seed);
        let nearest = libm::cos(2.0 * MAX_RADIUS);
        let (width, height) = (self.width as i64, self.height as i64);
        let mut texels = BTreeSet::new();
        let mut open = vec![seed];
        while let Some(texel) = open.pop() {
            if f64::from(self.sum(texel)) <= least || !texels.insert(texel) {
                continue;
            }
            if middle.dot(self.middle(texel)) < nearest {
                return None;
            }
            let (row, column) = (texel as i64 / width, texel as i64 % width);
            for row in (row - 1).max(0)..=(row + 1).min(height - 1) {
                for column in column - 1..=column + 1 {
                    open.push((row * width + column.rem_euclid(width)) as usize);
                }
            }
        }
        (!texels.is_empty()).then_some(Part { texels, ring })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grey sky of so many texels across with a disk of a radius in degrees, so many times as
    /// bright, around a direction.
    fn sky(width: u32, towards: Vec3, radius_deg: f64, times: f32) -> EnvironmentImage {
        let height = width / 2;
        let dark = vec![[1.0, 2.0, 3.0]; (width * height) as usize];
        let image = EnvironmentImage::new(width, height, dark).unwrap();
        let lit = |i: usize| {
            let cos = image.middle(i).dot(towards.as_dvec3().normalize());
            let is_lit = libm::acos(cos.clamp(-1.0, 1.0)).to_degrees() <= radius_deg;
            [1.0, 2.0, 3.0].map(|v| if is_lit { v * times } else { v })
        };
        let texels = (0..(width * height) as usize).map(lit).collect();
        EnvironmentImage::new(width, height, texels).unwrap()
    }

    #[test]
    fn suns_leave_with_their_flux_direction_and_radius() {
        for (towards, width) in [
            (Vec3::new(0.4, 0.7, 0.2), 2048),
            (Vec3::new(0.01, 0.1, -1.0), 2048),
            (Vec3::new(0.02, 1.0, 0.01), 1024),
        ] {
            let towards = towards.normalize();
            let image = sky(width, towards, 1.2, 1e4)
                .rotated(0.5)
                .scaled([2.0, 1.0, 1.0]);
            let before = image.mean();
            let (rest, suns) = image.without_suns();
            assert_eq!(suns.len(), 1);
            let sun = suns[0];
            let place = rest.place(sun.towards);
            let back = sky(8, Vec3::Y, 0.0, 1.0).direction(place);
            assert!(back.dot(towards) > 0.999_99, "{back} {towards}");
            let radius = f64::from(sun.angular_radius_rad).to_degrees();
            assert!((radius - 1.2).abs() < 0.12, "{radius}");
            let solid_angle = TAU * (1.0 - libm::cos(1.2_f64.to_radians()));
            let expected = 2.0 * (1e4 - 1.0) * solid_angle;
            let sent = f64::from(sun.irradiance[0]);
            assert!((sent / expected - 1.0).abs() < 0.06, "{sent} {expected}");
            // All light is still there.
            let after = rest.mean();
            for c in 0..3 {
                let of_sun = f64::from(sun.irradiance[c]) / (4.0 * PI);
                let sum = f64::from(after.0[c]) + of_sun;
                assert!((sum / f64::from(before.0[c]) - 1.0).abs() < 1e-6);
            }
            assert_eq!(rest.light(sun.towards).0, [2.0, 2.0, 3.0]);
            assert!(rest.seen(sun.towards).0[0] > 1e4);
        }
    }

    #[test]
    fn lamps_glows_and_stars_are_no_suns() {
        // Four degrees across, 40 times as bright, and of hardly any flux.
        for (radius, times) in [(2.1, 1e4), (1.0, 40.0), (0.3, 60.0)] {
            let image = sky(1024, Vec3::new(0.3, 0.5, 0.7), radius, times);
            assert!(image.without_suns().1.is_empty(), "{radius} {times}");
        }
    }

    #[test]
    fn a_texel_before_black_is_a_sun() {
        let mut texels = vec![[0.0; 3]; 128 * 64];
        texels[15 * 128 + 9] = [10.0, 20.0, 30.0];
        let image = EnvironmentImage::new(128, 64, texels).unwrap();
        let (middle, solid_angle) = (image.middle(15 * 128 + 9), image.solid_angle(15));
        let (rest, suns) = image.without_suns();
        assert_eq!(suns.len(), 1);
        assert!(suns[0].towards.as_dvec3().distance(middle) < 1e-6);
        let sent = f64::from(suns[0].irradiance[2]);
        assert!((sent / (30.0 * solid_angle) - 1.0).abs() < 1e-6);
        assert_eq!(rest.mean(), Rgb::BLACK);
    }
}
