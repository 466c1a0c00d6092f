//! What a point gets of the lights.

use super::sight::{Dimmed, Dimming, Sight};
use crate::math::Rgb;
use std::ops::AddAssign;

/// What direct light a point gets: irradiance of a surface, or mean radiance over the sphere in a medium.
#[derive(Clone, Copy, Debug, Default)]
pub struct Direct<D = Dimmed> {
    /// From lights without extent, of which one ray tells all.
    pub sharp: Rgb,
    /// What the lights with an extent would send with nothing between.
    pub open: Rgb,
    /// What came of that along shadow rays, added up. Sums of several points near each other tell it better.
    pub rays: Arrival,
    /// Which lights its rays reached.
    pub sight: Sight<D>,
}

/// What shadow rays to lights with an extent brought, added up. Rays are weighted so that with nothing between, those to one light
/// add up to what it sends times the rays that each light gets: else what hides one light would count for another, too.
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
    /// The share that arrives is that of the mean channel, by which rays choose among lights. What rays brought in each channel
    /// beyond that share is added: it colours a shadow, and is exactly 0 where rays agree, so that light without shadows
    /// has no noise whatever colours the lights have.
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
    /// The point's own estimate. Rays choose among lights by their mean channel, so a few of them cannot tell the share of each
    /// channel: their colour is what they brought.
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
