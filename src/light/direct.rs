//! Direct light at a point, kept as a ratio estimator needs it: unshadowed light in closed form,
//! and the share of it that shadow rays found to arrive.

use super::visibility::Visibility;
use crate::math::{Rgb, Spectrum};
use std::ops::{AddAssign, MulAssign};

/// Direct light at a point: irradiance of a surface, or radiance in a medium, summed over the
/// sphere or its mean.
#[derive(Clone, Copy, Debug, Default)]
pub struct DirectLight {
    /// Light of delta lights that arrives: one ray tells all of each.
    pub delta: Rgb,
    /// Unshadowed light of the lights with an extent.
    pub unshadowed: Rgb,
    /// Share of that which arrives, by shadow rays. Sums over points near each other tell it
    /// better.
    pub ratio: ShadowRatio,
    /// Excess of an environment image.
    pub sky: LightOfSky,
    /// Lights that the rays reached.
    pub visibility: Visibility,
}

/// Light of the excess of an environment image: it does not change with what hides lamps and suns.
#[derive(Clone, Copy, Debug, Default)]
pub struct LightOfSky {
    /// Unshadowed.
    pub unshadowed: Rgb,
    /// Share of that which arrives, by shadow rays.
    pub ratio: ShadowRatio,
}

/// Whether two amounts of light differ so little that what is known at one point serves at the
/// other. Beside lights it does not: a ray that few points were to take would bring all the light.
#[must_use]
pub fn is_similar(a: f32, b: f32) -> bool {
    const MIN_RATIO: f32 = 0.9;
    a.min(b) >= MIN_RATIO * a.max(b)
}

/// Sums over shadow rays to lights with an extent. Rays are weighted so that unshadowed, those to
/// one light add up to what it sends times the rays that each light gets: else what hides one light
/// would count for another, too.
#[derive(Clone, Copy, Debug, Default)]
pub struct ShadowRatio {
    /// Light that the rays brought.
    pub shadowed: Rgb,
    /// Light that they would have brought with nothing between.
    pub unshadowed: Rgb,
    /// That times the square of the share of each ray that arrived, by the mean channel.
    pub squares: f32,
}

impl ShadowRatio {
    /// Notes a ray that would bring `light` with nothing between.
    pub(super) fn note<K: Spectrum>(&mut self, light: Rgb, transmittance: K) {
        let arriving = transmittance.filter(light);
        self.unshadowed += light;
        self.shadowed += arriving;
        let (arriving, all) = (arriving.mean(), light.mean());
        if all > 0.0 {
            self.squares += arriving * (arriving / all);
        }
    }

    /// Variance of the shares of single rays that arrive.
    #[must_use]
    pub fn variance(&self) -> f32 {
        let unshadowed = self.unshadowed.mean();
        let share = self.share();
        match unshadowed > 0.0 {
            true => (self.squares / unshadowed - share * share).max(0.0),
            false => 0.0,
        }
    }

    /// The share of the light of all rays that arrives, by its mean channel; 1 if there was none.
    #[must_use]
    #[inline]
    pub fn share(&self) -> f32 {
        let unshadowed = self.unshadowed.mean();
        if unshadowed > 0.0 {
            self.shadowed.mean() / unshadowed
        } else {
            1.0
        }
    }

    /// What lies so far on the way to what other rays brought: 0 is this, 1 the other.
    #[must_use]
    pub fn towards(&self, other: &Self, by: f32) -> Self {
        let [all, of_other] = [self.unshadowed.mean(), other.unshadowed.mean()];
        if all <= 0.0 || of_other <= 0.0 {
            return *self;
        }
        let (own, others) = (1.0 - by, by * (all / of_other));
        let mix = |a: Rgb, b: Rgb| a * own + b * others;
        Self {
            shadowed: mix(self.shadowed, other.shadowed),
            unshadowed: mix(self.unshadowed, other.unshadowed),
            squares: self.squares * own + other.squares * others,
        }
    }

    /// What rays brought, brought to the scale of `unshadowed` light; `None` if there was no ray.
    fn arriving(&self, unshadowed: Rgb) -> Option<Rgb> {
        let of_rays = self.unshadowed.mean();
        (of_rays > 0.0).then(|| self.shadowed * (unshadowed.mean() / of_rays))
    }

    /// The part of `unshadowed` light that arrives, by the sum of many rays; all of it if there was
    /// none.
    ///
    /// The share is that of the mean channel, by which rays choose among lights. What rays brought
    /// in each channel beyond that share is added: it colours a shadow, and is exactly 0 where rays
    /// agree, so that light without shadows has no noise whatever colours the lights have.
    #[must_use]
    pub fn of(&self, unshadowed: Rgb) -> Rgb {
        let all = self.unshadowed.mean();
        if all <= 0.0 {
            return unshadowed;
        }
        let share = self.share();
        let per_ray = unshadowed.mean() / all;
        Rgb(std::array::from_fn(|c| {
            let beyond = self.shadowed.0[c] - share * self.unshadowed.0[c];
            (share * unshadowed.0[c] + per_ray * beyond).max(0.0)
        }))
    }
}

impl AddAssign for ShadowRatio {
    fn add_assign(&mut self, other: Self) {
        self.shadowed += other.shadowed;
        self.unshadowed += other.unshadowed;
        self.squares += other.squares;
    }
}

impl MulAssign<f32> for ShadowRatio {
    fn mul_assign(&mut self, scale: f32) {
        self.shadowed *= scale;
        self.unshadowed *= scale;
        self.squares *= scale;
    }
}

impl DirectLight {
    /// Direct light at a point between others: the mean of theirs, if all have about as much and no
    /// shadow's edge is among them.
    #[must_use]
    pub fn between<const N: usize>(others: [&Self; N]) -> Option<Self> {
        let mut mean = Self::default();
        let [mut least, mut most] = [f32::INFINITY, 0.0_f32];
        for direct in others {
            mean.delta += direct.delta;
            mean.unshadowed += direct.unshadowed;
            mean.ratio += direct.ratio;
            mean.sky.unshadowed += direct.sky.unshadowed;
            mean.sky.ratio += direct.sky.ratio;
            mean.visibility += direct.visibility;
            let light = direct.light().mean();
            least = least.min(light);
            most = most.max(light);
        }
        let visibility = mean.visibility;
        if visibility.has_edge() || visibility.has_penumbra() || !is_similar(least, most) {
            return None;
        }
        let share = 1.0 / N as f32;
        mean.delta *= share;
        mean.unshadowed *= share;
        mean.ratio *= share;
        mean.sky.unshadowed *= share;
        mean.sky.ratio *= share;
        Some(mean)
    }

    /// All direct light, by the sums of rays of points near each other: to lamps and suns, and to
    /// the excess of an environment image. The second number is what comes from that.
    #[must_use]
    pub fn arriving(&self, lamps: &ShadowRatio, sky: &ShadowRatio) -> [Rgb; 2] {
        let light = self.delta + lamps.of(self.unshadowed);
        if self.sky.unshadowed.is_black() {
            return [light, Rgb::BLACK];
        }
        let from_sky = sky.of(self.sky.unshadowed);
        [light + from_sky, from_sky]
    }

    /// All direct light, by this point's rays alone. Rays choose among lights by their mean
    /// channel, so a few of them cannot tell the share of each channel: their colour is what they
    /// brought.
    #[must_use]
    pub fn light(&self) -> Rgb {
        let lamps = self.ratio.arriving(self.unshadowed);
        let sky = self.sky.ratio.arriving(self.sky.unshadowed);
        match (lamps, sky) {
            (Some(lamps), None) => self.delta + lamps,
            (None, Some(sky)) => self.delta + sky,
            (Some(lamps), Some(sky)) => self.delta + lamps + sky,
            (None, None) => self.delta,
        }
    }

    /// Notes a ray to a light with an extent that would bring `light` with nothing between.
    pub(super) fn note_ray<K: Spectrum>(&mut self, index: usize, light: Rgb, transmittance: K) {
        self.ratio.note(light, transmittance);
        self.visibility.note_ray(index, transmittance.mean());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Direct light of one light with an extent, of which `share` of its ray comes through.
    fn lit(unshadowed: f32, share: f32) -> DirectLight {
        let mut direct = DirectLight {
            unshadowed: Rgb([unshadowed; 3]),
            ..DirectLight::default()
        };
        direct.note_ray(0, direct.unshadowed, share);
        direct
    }

    #[test]
    fn between_even_light_is_its_mean() {
        let mean = DirectLight::between([&lit(1.0, 1.0), &lit(1.04, 1.0)]).unwrap();
        assert!((mean.light().mean() - 1.02).abs() < 1e-6);
        // It counts as one ray beside those of other points.
        assert!((mean.ratio.unshadowed.mean() - 1.02).abs() < 1e-6);
        let dark = DirectLight::between([&lit(1.0, 0.0), &lit(1.04, 0.0)]).unwrap();
        assert!(dark.light().is_black());
    }

    #[test]
    fn nothing_is_told_between_uneven_light() {
        for (name, other) in [
            ("shadow", lit(1.0, 0.0)),
            ("smoke", lit(1.0, 0.5)),
            ("beside a light", lit(1.3, 1.0)),
        ] {
            assert!(
                DirectLight::between([&lit(1.0, 1.0), &other]).is_none(),
                "{name}"
            );
        }
    }
}
