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
    /// Variances of the rays of each corner, added up, as if each ray brought all or nothing.
    within: f32,
    /// Those variances as they are.
    found_within: f32,
    slope: Slope,
}

/// How the shares of 4 x 4 corners lie about a plane.
#[derive(Debug, Default)]
struct Slope {
    sum: f32,
    squares: f32,
    /// Times the place of the corner, along rows and along columns.
    moments: [f32; 2],
}

impl Slope {
    /// Squares of the places of all corners along an axis, added up.
    const SQUARES_OF_PLACES: f32 = 20.0;
    const CORNERS: f32 = 16.0;

    fn add(&mut self, row: usize, column: usize, share: f32) {
        self.sum += share;
        self.squares += share * share;
        for (moment, place) in self.moments.iter_mut().zip([row, column]) {
            *moment += share * (place as f32 - 1.5);
        }
    }

    /// Whether all corners lie so near a plane, which is no level one, that they have no noise.
    fn is_smooth(&self) -> bool {
        /// Of the variance, what is off the plane.
        const MOST_OFF: f32 = 0.05;
        /// Variance of shares that are alike whatever rays told them.
        const LEVEL: f32 = 1e-6;
        let mean = self.sum / Self::CORNERS;
        let variance = self.squares / Self::CORNERS - mean * mean;
        let [x, y] = self.moments;
        let on_plane = (x * x + y * y) / (Self::SQUARES_OF_PLACES * Self::CORNERS);
        variance > LEVEL && variance - on_plane < MOST_OFF * variance
    }
}

/// What rays near a pixel tell.
#[derive(Clone, Copy)]
struct Told {
    arrived: ShadowRatio,
    /// Whether that is of the pixel's own corners, whose rays agree: more of them would blur it.
    is_own: bool,
}

impl NearbyRays {
    /// Adds a corner of a row and a column, 0 to 3.
    pub fn add(&mut self, row: usize, column: usize, direct: &DirectLight) {
        self.lamps.add(row, column, direct.ratio);
        self.sky.add(row, column, direct.sky.ratio);
        self.visibility += direct.visibility;
        self.corners += 1.0;
    }

    /// What they say, and where a penumbra is wide the `squares` around the pixel, to lamps and
    /// suns and to the sky.
    pub fn lit(&self, squares: impl FnOnce() -> Option<[Option<Squares>; 2]>) -> LightAtPixel {
        if !self.visibility.has_penumbra() {
            let even =
                |rays: &RaysToLights| rays.smooth(self.corners).unwrap_or_else(|| rays.all());
            return LightAtPixel::Arrived {
                lamps: even(&self.lamps),
                sky: even(&self.sky),
            };
        }
        let [Some(lamps), Some(sky)] = [&self.lamps, &self.sky].map(|rays| rays.lit(self.corners))
        else {
            return LightAtPixel::Edge;
        };
        let [of_lamps, of_sky] = squares().unwrap_or_default();
        let wide = |told: Told, squares: Option<Squares>| {
            let squares = squares.filter(|_| !told.is_own);
            let wide = squares.and_then(|s| s.wide(told.arrived));
            wide.unwrap_or(told.arrived)
        };
        LightAtPixel::Arrived {
            lamps: wide(lamps, of_lamps),
            sky: wide(sky, of_sky),
        }
    }
}

/// The shadow rays of 8 x 8 corners around a pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Squares {
    /// Of four squares of 4 x 4 corners: upper left, upper right, lower left, lower right.
    pub sums: [ShadowRatio; 4],
    /// Deviation of the share of each, about, where there is no edge.
    pub noise: f32,
}

impl Squares {
    /// By how much two halves may differ, over the share that arrives: what rises as a square from
    /// the foot of a penumbra is off by a hundredth then.
    const MAX_RISE: f32 = 0.35;
    /// The same of all light, for the bend at the end of a penumbra.
    const MAX_DIFFERENCE: f32 = 0.1;
    /// By how much, times the deviation of single rays, the mean may differ from that of the 4 x 4
    /// corners in the middle: about one and a half times the noise of those where an edge is
    /// straight.
    const MAX_BEND: f32 = 0.06;
    /// The same over the noise of a square.
    const MAX_NOISE: f32 = 2.0;

    /// What arrived along all of them, if the penumbra is as wide as that beside what `narrow`
    /// tells. Where it bends, that is between the two: what is furthest off of noise alone must not
    /// be taken as it is.
    fn wide(&self, narrow: ShadowRatio) -> Option<ShadowRatio> {
        let all = sum(&self.sums);
        let share = all.share();
        let deviation = variance(all).max(0.0).sqrt();
        // No more than 64 rays anywhere have.
        let noise = self.noise.min(deviation / 8.0);
        let most = Self::MAX_DIFFERENCE.min(Self::MAX_RISE * share) + noise;
        let [a, b, c, d] = self.sums;
        let differ = |one: [ShadowRatio; 2], other: [ShadowRatio; 2]| {
            (sum(&one).share() - sum(&other).share()).abs() > most
        };
        if differ([a, b], [c, d]) || differ([a, c], [b, d]) {
            return None;
        }
        let bend = (share - narrow.share()).abs();
        let most = (Self::MAX_BEND * deviation).max(Self::MAX_NOISE * noise);
        match bend <= most {
            true => Some(all),
            false if bend < 2.0 * most => Some(narrow.towards(&all, 2.0 - bend / most)),
            false => None,
        }
    }
}

fn sum(ratios: &[ShadowRatio]) -> ShadowRatio {
    let mut sum = ShadowRatio::default();
    ratios.iter().for_each(|r| sum += *r);
    sum
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
    /// Variance within corners over that of rays which bring all or nothing, up to which the rays
    /// of a corner agree to two hundredths: what dims them is a medium, and the light has a narrow
    /// extent. Those to a wide one agree less, and four corners have more noise than 16.
    const MAX_AGREEING: f32 = 0.002;
    /// The least of the latter that tells this.
    const LEAST_DIMMED: f32 = 0.01;

    fn add(&mut self, row: usize, column: usize, ratio: ShadowRatio) {
        self.quarters[row / 2 * 2 + column / 2] += ratio;
        self.within += variance(ratio);
        self.found_within += ratio.variance();
        self.slope.add(row, column, ratio.share());
        if (1..3).contains(&row) && (1..3).contains(&column) {
            self.own += ratio;
        }
    }

    fn all(&self) -> ShadowRatio {
        sum(&self.quarters)
    }

    /// What arrived at the pixel's own corners, if all 16 tell that it has no noise: more of them
    /// would blur it.
    fn smooth(&self, corners: f32) -> Option<ShadowRatio> {
        (corners == Slope::CORNERS && self.slope.is_smooth()).then_some(self.own)
    }

    /// What arrived along them, if that tells the light of the pixel.
    fn lit(&self, corners: f32) -> Option<Told> {
        let of_own = Told {
            arrived: self.own,
            is_own: true,
        };
        if self.smooth(corners).is_some() {
            return Some(of_own);
        }
        if self.within > Self::LEAST_DIMMED * corners
            && self.found_within < Self::MAX_AGREEING * self.within
        {
            // An edge within the pixel is for samples of its own.
            return (self.own.variance() <= Self::FAINT_VARIANCE).then_some(of_own);
        }
        let all = self.all();
        let of_all = variance(all);
        if of_all > Self::FAINT_VARIANCE
            && self.within < Self::MIN_VARIANCE_WITHIN * of_all * corners
        {
            return match self.own.share() {
                0.0 | 1.0 => Some(of_own),
                _ => None,
            };
        }
        let differ = |a: ShadowRatio, b: ShadowRatio| {
            (a.share() - b.share()).abs() > Self::MAX_HALF_DIFFERENCE
        };
        let is_narrow =
            differ(self.half(0, 1), self.half(2, 3)) || differ(self.half(0, 2), self.half(1, 3));
        let told = Told {
            arrived: all,
            is_own: false,
        };
        (!is_narrow).then_some(told)
    }

    /// Two quarters.
    fn half(&self, a: usize, b: usize) -> ShadowRatio {
        sum(&[self.quarters[a], self.quarters[b]])
    }
}

/// Variance of what arrives along single rays, of which each brings all or nothing.
fn variance(rays: ShadowRatio) -> f32 {
    let share = rays.share();
    share * (1.0 - share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Rgb;

    /// Of 64 rays.
    fn arrived(share: f32) -> ShadowRatio {
        ShadowRatio {
            shadowed: Rgb([64.0 * share; 3]),
            unshadowed: Rgb([64.0; 3]),
            squares: 64.0 * share,
        }
    }

    fn wide_with_noise(noise: f32, squares: [f32; 4], narrow: f32) -> Option<f32> {
        let squares = Squares {
            sums: squares.map(arrived),
            noise,
        };
        squares.wide(arrived(narrow)).map(|all| all.share())
    }

    fn wide(squares: [f32; 4], narrow: f32) -> Option<f32> {
        wide_with_noise(0.0, squares, narrow)
    }

    #[test]
    fn what_is_within_noise_is_no_bend() {
        let bent = |noise| wide_with_noise(noise, [0.5; 4], 0.58);
        assert_eq!(bent(0.018), None);
        let between = bent(0.03).unwrap();
        assert!((0.52..0.53).contains(&between), "{between}");
        assert_eq!(bent(0.05), Some(0.5));
        let steep = |noise| wide_with_noise(noise, [0.4375, 0.5625, 0.4375, 0.5625], 0.5);
        assert_eq!(steep(0.01), None);
        assert_eq!(steep(0.05), Some(0.5));
        // 64 rays have no more noise than this.
        assert_eq!(wide_with_noise(1.0, [0.5; 4], 0.8), None);
    }

    #[test]
    fn wide_penumbrae_are_told_by_more_corners() {
        assert_eq!(wide([0.5, 0.5625, 0.5625, 0.625], 0.54), Some(0.5625));
        assert_eq!(wide([0.25, 0.3125, 0.25, 0.3125], 0.28), Some(0.28125));
        assert_eq!(wide([1.0; 4], 1.0), Some(1.0));
        assert_eq!(wide([0.0; 4], 0.0), Some(0.0));
    }

    /// A smooth shadow of smoke before a narrow light, and the same shares of rays that bring all
    /// or nothing.
    #[test]
    fn rays_that_a_medium_dims_are_not_blurred() {
        let lit = |is_dimmed: bool| {
            let mut rays = RaysToLights::default();
            for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
                // On no plane.
                let share = [0.0, 0.5, 0.25, 0.75][column];
                rays.add(
                    row,
                    column,
                    ShadowRatio {
                        shadowed: Rgb([4.0 * share; 3]),
                        unshadowed: Rgb([4.0; 3]),
                        squares: 4.0 * if is_dimmed { share * share } else { share },
                    },
                );
            }
            rays.lit(16.0)
        };
        let dimmed = lit(true).unwrap();
        assert!(dimmed.is_own);
        assert_eq!(dimmed.arrived.unshadowed.0[0], 16.0);
        assert!(!lit(false).is_some_and(|told| told.is_own));
    }

    #[test]
    fn shares_on_a_slope_have_no_noise_and_others_may() {
        let slope = |share: fn(usize, usize) -> f32| {
            let mut slope = Slope::default();
            for (row, column) in (0..4).flat_map(|row| (0..4).map(move |column| (row, column))) {
                slope.add(row, column, share(row, column));
            }
            slope.is_smooth()
        };
        assert!(slope(|row, column| 0.1
            + 0.02 * row as f32
            + 0.05 * column as f32));
        assert!(slope(|row, _| 0.04
            + 0.01 * (row * row) as f32 / 9.0
            + 0.01 * row as f32));
        assert!(!slope(|_, _| 0.7));
        assert!(!slope(|_, column| if column < 2 { 0.0 } else { 1.0 }));
        assert!(!slope(
            |row, column| [0.5, 0.75, 0.25, 1.0][(row * 3 + column * 2) % 4]
        ));
    }

    #[test]
    fn narrow_ones_are_not() {
        // Steep, at the foot of a penumbra, and bent.
        assert_eq!(wide([0.3, 0.7, 0.3, 0.7], 0.5), None);
        assert_eq!(wide([0.01, 0.05, 0.01, 0.05], 0.03), None);
        assert_eq!(wide([0.5; 4], 0.6), None);
        assert_eq!(wide([0.05; 4], 0.0), None);
    }
}
