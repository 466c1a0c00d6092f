//! What a point gets of the lights.

use super::sight::{Dimmed, Dimming, Sight};
use crate::math::Rgb;
use std::ops::AddAssign;

/// What direct light a point gets: irradiance of a surface, or mean radiance over the sphere in a
/// medium.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direct<D = Dimmed> {
    /// From lights without extent, of which one ray tells all.
    pub sharp: Rgb,
    /// What the lights with an extent would send with nothing between.
    pub open: Rgb,
    /// What came of that along shadow rays, added up. Sums of several points near each other tell
    /// it better.
    pub rays: Arrival,
    /// Which lights its rays reached.
    pub sight: Sight<D>,
}

/// Whether two amounts of light differ so little that what is known at one place is good at the
/// other: beside lamps it is not, and a ray that few were to take would bring all the light.
#[must_use]
pub fn is_alike(a: f32, b: f32) -> bool {
    const SAME: f32 = 0.9;
    a.min(b) >= SAME * a.max(b)
}

/// What shadow rays to lights with an extent brought, added up. Rays are weighted so that with
/// nothing between, those to one light add up to what it sends times the rays that each light gets:
/// else what hides one light would count for another, too.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrival {
    /// With what stands between.
    pub arriving: Rgb,
    /// As if nothing stood between.
    pub all: Rgb,
}

impl Arrival {
    /// The share of the light of all rays that arrives, by its mean channel; 1 if there was none.
    #[must_use]
    #[inline]
    pub fn share(&self) -> f32 {
        let all = self.all.mean();
        if all > 0.0 {
            self.arriving.mean() / all
        } else {
            1.0
        }
    }

    /// What arrives of `open`, by the sum of many rays; all of it if there was none.
    ///
    /// The share that arrives is that of the mean channel, by which rays choose among lights. What
    /// rays brought in each channel beyond that share is added: it colours a shadow, and is exactly
    /// 0 where rays agree, so that light without shadows has no noise whatever colours the lights
    /// have.
    #[must_use]
    pub fn of(&self, open: Rgb) -> Rgb {
        let all = self.all.mean();
        if all <= 0.0 {
            return open;
        }
        let share = self.share();
        let per_ray = open.mean() / all;
        Rgb(std::array::from_fn(|c| {
            let differs = self.arriving.0[c] - share * self.all.0[c];
            (share * open.0[c] + per_ray * differs).max(0.0)
        }))
    }
}

impl AddAssign for Arrival {
    fn add_assign(&mut self, other: Self) {
        self.arriving += other.arriving;
        self.all += other.all;
    }
}

impl<D: Dimming> Direct<D> {
    /// What a point between some others gets, if all of those get much the same and no shadow's
    /// edge is among them.
    #[must_use]
    pub fn amid<const N: usize>(around: [&Self; N]) -> Option<Self> {
        let mut mean = Self::default();
        let [mut least, mut most] = [f32::INFINITY, 0.0_f32];
        for direct in around {
            mean.sharp += direct.sharp;
            mean.open += direct.open;
            mean.rays += direct.rays;
            mean.sight += direct.sight;
            let light = direct.light().mean();
            least = least.min(light);
            most = most.max(light);
        }
        if mean.sight.has_edge() || mean.sight.has_penumbra() || !is_alike(least, most) {
            return None;
        }
        let share = 1.0 / N as f32;
        mean.sharp *= share;
        mean.open *= share;
        mean.rays.arriving *= share;
        mean.rays.all *= share;
        Some(mean)
    }

    /// The point's own estimate. Rays choose among lights by their mean channel, so a few of them
    /// cannot tell the share of each channel: their colour is what they brought.
    #[must_use]
    pub fn light(&self) -> Rgb {
        let all = self.rays.all.mean();
        if all > 0.0 {
            self.sharp + self.rays.arriving * (self.open.mean() / all)
        } else {
            self.sharp
        }
    }

    /// Notes a ray to a light with an extent that would bring `light` with nothing between.
    pub(super) fn note_ray(&mut self, index: usize, light: Rgb, through: f32) {
        self.rays.all += light;
        self.rays.arriving += light * through;
        self.sight.note_ray(index, through);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a point gets of one light with an extent, of which `share` of its ray comes through.
    fn lit(open: f32, share: f32) -> Direct {
        let mut direct = Direct {
            open: Rgb([open; 3]),
            ..Direct::default()
        };
        direct.note_ray(0, direct.open, share);
        direct
    }

    #[test]
    fn between_even_light_is_its_mean() {
        let mean = Direct::amid([&lit(1.0, 1.0), &lit(1.04, 1.0)]).unwrap();
        assert!((mean.light().mean() - 1.02).abs() < 1e-6);
        // It counts as one ray beside those of other points.
        assert!((mean.rays.all.mean() - 1.02).abs() < 1e-6);
        let dark = Direct::amid([&lit(1.0, 0.0), &lit(1.04, 0.0)]).unwrap();
        assert!(dark.light().is_black());
    }

    #[test]
    fn nothing_is_told_between_uneven_light() {
        for (name, other) in [
            ("shadow", lit(1.0, 0.0)),
            ("smoke", lit(1.0, 0.5)),
            ("beside a lamp", lit(1.3, 1.0)),
        ] {
            assert!(Direct::amid([&lit(1.0, 1.0), &other]).is_none(), "{name}");
        }
    }
}
