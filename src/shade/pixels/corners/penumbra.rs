//! What the corners around a pixel say of lights with an extent.

use crate::light::{DirectLight, ShadowRatio, Visibility};

/// Whether the light at a pixel is that of its corners.
pub(super) enum LightAtPixel {
    /// What arrived from lights with an extent along the shadow rays near the pixel.
    Arrived {
        /// From lamps and suns.
        lamps: ShadowRatio,
        /// From the excess of an environment image.
        sky: ShadowRatio,
    },
    /// A shadow whose edge is too narrow for the corners.
    Edge,
}

/// The shadow rays of those of the 16 corners around a pixel that lie on its piece of surface.
#[derive(Debug, Default)]
pub(super) struct NearbyRays {
    /// To lamps and suns, and to the excess of an environment image.
    lamps: RaysToLights,
    sky: RaysToLights,
    visibility: Visibility,
    corners: f32,
}

/// Those rays to some of the lights.
#[derive(Debug, Default)]
struct RaysToLights {
    /// Upper left, upper right, lower left, lower right.
    quarters: [ShadowRatio; 4],
    /// Of the pixel's own four corners.
    own: ShadowRatio,
    /// Variances of the rays of each corner, added up.
    within: f32,
}

impl NearbyRays {
    /// Adds a corner of a row and a column, 0 to 3.
    pub fn add(&mut self, row: usize, column: usize, direct: &DirectLight) {
        self.lamps.add(row, column, direct.ratio);
        self.sky.add(row, column, direct.sky.ratio);
        self.visibility += direct.visibility;
        self.corners += 1.0;
    }

    /// What they say.
    pub fn lit(&self) -> LightAtPixel {
        let has_penumbra = self.visibility.has_penumbra();
        let lit = |rays: &RaysToLights| match has_penumbra {
            true => rays.lit(self.corners),
            false => Some(rays.all()),
        };
        match (lit(&self.lamps), lit(&self.sky)) {
            (Some(lamps), Some(sky)) => LightAtPixel::Arrived { lamps, sky },
            _ => LightAtPixel::Edge,
        }
    }
}

impl RaysToLights {
    /// Share of an area light by which two halves may differ.
    const MAX_HALF_DIFFERENCE: f32 = 0.4;
    /// Part of the variance of all rays that is found within corners, at least: with four rays each
    /// it is three quarters in wide penumbrae, and nothing where each corner is in full light or
    /// none, as at the shadow of a thin bar, both sides of which look alike.
    const MIN_VARIANCE_WITHIN: f32 = 0.45;
    /// Variance of all of them up to which it does not matter: one in 20 is hidden, or arrives.
    const FAINT_VARIANCE: f32 = 0.05;

    fn add(&mut self, row: usize, column: usize, ratio: ShadowRatio) {
        self.quarters[row / 2 * 2 + column / 2] += ratio;
        self.within += variance(ratio);
        if (1..3).contains(&row) && (1..3).contains(&column) {
            self.own += ratio;
        }
    }

    fn all(&self) -> ShadowRatio {
        let mut all = self.half(0, 1);
        all += self.half(2, 3);
        all
    }

    /// What arrived along them, if that tells the light of the pixel.
    fn lit(&self, corners: f32) -> Option<ShadowRatio> {
        let all = self.all();
        let of_all = variance(all);
        if of_all > Self::FAINT_VARIANCE
            && self.within < Self::MIN_VARIANCE_WITHIN * of_all * corners
        {
            return match self.own.share() {
                0.0 | 1.0 => Some(self.own),
                _ => None,
            };
        }
        let differ = |a: ShadowRatio, b: ShadowRatio| {
            (a.share() - b.share()).abs() > Self::MAX_HALF_DIFFERENCE
        };
        let is_narrow =
            differ(self.half(0, 1), self.half(2, 3)) || differ(self.half(0, 2), self.half(1, 3));
        (!is_narrow).then_some(all)
    }

    /// Two quarters.
    fn half(&self, a: usize, b: usize) -> ShadowRatio {
        let mut sum = self.quarters[a];
        sum += self.quarters[b];
        sum
    }
}

/// Variance of what arrives along single rays, of which each brings all or nothing.
fn variance(rays: ShadowRatio) -> f32 {
    let share = rays.share();
    share * (1.0 - share)
}
