//! Phase functions: how the light that a medium scatters is spread over directions.
//!
//! A lobe is that of Henyey & Greenstein (1941). All that is known of a phase function beside its
//! values are its moments, so that others can be tables of those.

use super::sampling::{sin_cos_turns, tangents};
use glam::Vec3;
use std::f32::consts::PI;

/// Directions of the sphere that a unit of solid angle is, per steradian.
const INVERSE_SPHERE: f32 = 1.0 / (4.0 * PI);

/// The phase function of a medium: one or two lobes, rotationally symmetric about the direction in
/// which light travels. Cosines are between the directions of travel before and after: 1 is
/// straight on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PhaseFunction {
    /// Mean cosine of each lobe.
    g: [f32; 2],
    /// Weight of the first; the second has the rest.
    mix: f32,
}

impl Default for PhaseFunction {
    fn default() -> Self {
        Self::ISOTROPIC
    }
}

impl PhaseFunction {
    /// Scatters alike in all directions.
    pub const ISOTROPIC: Self = Self {
        g: [0.0; 2],
        mix: 1.0,
    };

    /// The largest size of a lobe's mean cosine.
    pub const MAX_G: f32 = 0.99;

    /// One lobe of mean cosine `g`, from -[`Self::MAX_G`] (back) to [`Self::MAX_G`] (forward); 0 is
    /// isotropic.
    #[must_use]
    pub const fn henyey_greenstein(g: f32) -> Self {
        Self {
            g: [g, 0.0],
            mix: 1.0,
        }
    }

    /// Two lobes, of which the first has the weight `mix`, from 0 to 1.
    #[must_use]
    pub fn two_lobes(g: [f32; 2], mix: f32) -> Self {
        // What is the same has one form.
        if g[0] == g[1] || mix == 1.0 {
            Self::henyey_greenstein(g[0])
        } else if mix == 0.0 {
            Self::henyey_greenstein(g[1])
        } else {
            Self { g, mix }
        }
    }

    /// Whether mean cosines and weight are in range.
    #[must_use]
    pub fn is_valid(self) -> bool {
        let is_cosine = |g: f32| g.abs() <= Self::MAX_G;
        self.g.into_iter().all(is_cosine) && (0.0..=1.0).contains(&self.mix)
    }

    /// Whether it scatters alike in all directions.
    #[must_use]
    #[inline]
    pub fn is_isotropic(self) -> bool {
        self.g == [0.0; 2]
    }

    /// Mean cosines of both lobes.
    #[must_use]
    pub fn lobes(self) -> [f32; 2] {
        self.g
    }

    /// Weight of the first lobe; 1 if there is no other.
    #[must_use]
    pub fn mix(self) -> f32 {
        self.mix
    }

    /// Share of the scattered light that goes into a unit of solid angle at a cosine, per
    /// steradian.
    #[must_use]
    #[inline]
    pub fn value(self, cos: f32) -> f32 {
        INVERSE_SPHERE * self.over_isotropic(cos)
    }

    /// The same, over that of an isotropic medium: a mean over the sphere of 1.
    #[must_use]
    #[inline]
    pub fn over_isotropic(self, cos: f32) -> f32 {
        let first = lobe(self.g[0], cos);
        if self.mix == 1.0 {
            return first;
        }
        self.mix * first + (1.0 - self.mix) * lobe(self.g[1], cos)
    }

    /// Moment b_l: the mean of the Legendre polynomial P_l of the cosine.
    #[must_use]
    pub fn moment(self, l: i32) -> f32 {
        self.mix * self.g[0].powi(l) + (1.0 - self.mix) * self.g[1].powi(l)
    }

    /// A direction of travel after scattering, for one before it and two numbers in [0,1): its
    /// density is [`Self::value`].
    #[must_use]
    pub fn sample(self, travel: Vec3, [u, v]: [f32; 2]) -> Vec3 {
        let cos = self.cosine(u);
        let sine = (1.0 - cos * cos).max(0.0).sqrt();
        let (sin_phi, cos_phi) = sin_cos_turns(v);
        let (x, y) = tangents(travel);
        (x * (sine * cos_phi) + y * (sine * sin_phi) + travel * cos).normalize()
    }

    /// The cosine below which a share `u` of one lobe scatters; which lobe is chosen by `u` as
    /// well.
    fn cosine(self, u: f32) -> f32 {
        if u < self.mix {
            cosine(self.g[0], u / self.mix)
        } else {
            cosine(self.g[1], (u - self.mix) / (1.0 - self.mix))
        }
    }
}

/// A phase function that is not isotropic as a ray sees it: by where light comes from.
#[derive(Clone, Copy, Debug)]
pub struct SeenPhase {
    phase: PhaseFunction,
    /// Unit direction of the ray, against the light that it carries.
    direction: Vec3,
}

impl SeenPhase {
    /// As a ray of a unit direction sees it; `None` of an isotropic one, which looks alike from
    /// everywhere.
    #[must_use]
    #[inline]
    pub fn of(phase: PhaseFunction, direction: Vec3) -> Option<Self> {
        (!phase.is_isotropic()).then_some(Self { phase, direction })
    }

    /// Share of the light from a unit direction that is scattered along the ray, over that of an
    /// isotropic medium.
    #[must_use]
    #[inline]
    pub fn response(self, to_light: Vec3) -> f32 {
        self.phase.over_isotropic(self.direction.dot(to_light))
    }

    /// The same from the middle of a sphere that is seen in a unit direction under an angle of this
    /// sine and cosine, and by how much more or less that may be from elsewhere on it.
    #[must_use]
    pub fn response_to_sphere(self, to_middle: Vec3, [sin, cos]: [f32; 2]) -> [f32; 2] {
        let middle = self.direction.dot(to_middle).clamp(-1.0, 1.0);
        let across = (1.0 - middle * middle).sqrt();
        let ends = [
            if middle >= cos {
                1.0
            } else {
                middle * cos + across * sin
            },
            if middle <= -cos {
                -1.0
            } else {
                middle * cos - across * sin
            },
        ];
        let response = self.phase.over_isotropic(middle);
        let off = ends.map(|end| (self.phase.over_isotropic(end) - response).abs());
        [response, off[0].max(off[1])]
    }

    /// Unit direction of the ray.
    #[must_use]
    pub fn direction(self) -> Vec3 {
        self.direction
    }

    /// A unit direction in which to look for light, for two numbers in [0,1): directions have the
    /// density of the phase function, so that light has to be weighed no more.
    #[must_use]
    pub fn sample(self, u: [f32; 2]) -> Vec3 {
        self.phase.sample(self.direction, u)
    }
}

/// A lobe of Henyey & Greenstein over an isotropic one.
#[inline]
fn lobe(g: f32, cos: f32) -> f32 {
    // 1 + g^2 - 2 g cos, without the cancellation near the peak.
    let base = (1.0 - g) * (1.0 - g) + 2.0 * g * (1.0 - cos);
    (1.0 - g * g) / (base * base.sqrt())
}

/// The cosine below which a share `u` of a lobe scatters.
fn cosine(g: f32, u: f32) -> f32 {
    // The usual form of it, without the cancellation near g = 0.
    let x = 2.0 * u - 1.0;
    let (g2, x2, base) = (g * g, x * x, 1.0 + g * x);
    let cos = x * (1.0 + g2) + 0.5 * g * (x2 + 3.0) + 0.5 * g * g2 * (x2 - 1.0);
    (cos / (base * base)).clamp(-1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::sobol2;

    const PHASES: [PhaseFunction; 7] = [
        PhaseFunction::ISOTROPIC,
        PhaseFunction::henyey_greenstein(1e-4),
        PhaseFunction::henyey_greenstein(0.6),
        PhaseFunction::henyey_greenstein(-0.75),
        PhaseFunction::henyey_greenstein(0.95),
        PhaseFunction {
            g: [0.9, -0.2],
            mix: 0.7,
        },
        PhaseFunction {
            g: [-0.5, 0.3],
            mix: 0.1,
        },
    ];

    /// Legendre polynomials P_0 to P_8.
    fn legendre(x: f64) -> [f64; 9] {
        let mut p = [1.0; 9];
        p[1] = x;
        for l in 2..9 {
            let n = l as f64;
            p[l] = ((2.0 * n - 1.0) * x * p[l - 1] - (n - 1.0) * p[l - 2]) / n;
        }
        p
    }

    #[test]
    fn moments_are_those_of_the_values() {
        for phase in PHASES {
            let mut found = [0.0; 9];
            // Points that crowd where lobes are high: the angle is uniform in its square root.
            let n = 400_000;
            let mut last = 0.0_f64;
            for i in 1..=n {
                let t = f64::from(i) / f64::from(n);
                let angle = std::f64::consts::PI * t * t;
                let middle = 0.5 * (angle + last);
                let width = last.cos() - angle.cos();
                let value = f64::from(phase.over_isotropic(middle.cos() as f32));
                for (sum, p) in found.iter_mut().zip(legendre(middle.cos())) {
                    *sum += 0.5 * width * value * p;
                }
                last = angle;
            }
            for (l, found) in (0..).zip(found) {
                let expected = f64::from(phase.moment(l));
                assert!(
                    (found - expected).abs() < 2e-4,
                    "{phase:?} {l}: {found} {expected}"
                );
            }
        }
        let one = PhaseFunction::henyey_greenstein(0.85);
        assert!((0..9).all(|l| one.moment(l) == 0.85_f32.powi(l)));
    }

    #[test]
    fn isotropic_is_exactly_one_and_signs_mirror() {
        for i in 0..=200 {
            let cos = i as f32 * 0.01 - 1.0;
            assert_eq!(PhaseFunction::ISOTROPIC.over_isotropic(cos), 1.0);
            let [there, back] = [0.7, -0.7].map(PhaseFunction::henyey_greenstein);
            let (a, b) = (there.value(cos), back.value(-cos));
            assert!((a - b).abs() <= 1e-5 * a, "{cos}: {a} {b}");
        }
        assert!(PhaseFunction::two_lobes([0.3, 0.3], 0.4) == PhaseFunction::henyey_greenstein(0.3));
        assert!(PhaseFunction::two_lobes([0.3, 0.0], 0.0).is_isotropic());
        assert!(!PhaseFunction::henyey_greenstein(f32::NAN).is_valid());
    }

    /// The share of a lobe below a cosine.
    fn below(g: f64, cos: f64) -> f64 {
        if g.abs() < 1e-3 {
            return 0.5 * (1.0 + cos);
        }
        let root = (1.0 + g * g - 2.0 * g * cos).sqrt();
        (1.0 - g * g) / (2.0 * g) * (1.0 / root - 1.0 / (1.0 + g))
    }

    #[test]
    fn samples_pass_a_chi_squared_test() {
        let travel = Vec3::new(0.48, -0.6, 0.64);
        let (x, _) = tangents(travel);
        for phase in PHASES {
            // Cells of equal chance by the cosine, and of equal angle around.
            const CELLS: usize = 20;
            let cumulative = |cos: f64| {
                let [a, b] = phase.g.map(|g| below(f64::from(g), cos));
                let mix = f64::from(phase.mix);
                mix * a + (1.0 - mix) * b
            };
            let n = 100_000_u64;
            let mut counts = [[0.0_f64; CELLS]; 4];
            for i in 0..n {
                // Independent numbers: well-spread ones would be too good for the test.
                let u = crate::math::sampling::unit2(crate::math::sampling::hash(&[i, 5]));
                let d = phase.sample(travel, u);
                assert!((d.length() - 1.0).abs() < 1e-5);
                let share = cumulative(f64::from(d.dot(travel).clamp(-1.0, 1.0)));
                let around =
                    usize::from(d.dot(x) > 0.0) + 2 * usize::from(d.dot(travel.cross(x)) > 0.0);
                counts[around][((share * CELLS as f64) as usize).min(CELLS - 1)] += 1.0;
            }
            let expected = n as f64 / (4 * CELLS) as f64;
            let chi2: f64 = (counts.as_flattened().iter())
                .map(|c| (c - expected).powi(2) / expected)
                .sum();
            // 79 degrees of freedom: a thousandth of such sums are beyond 122.
            assert!(chi2 < 122.0, "{phase:?}: {chi2}");
        }
    }

    #[test]
    fn the_mean_of_samples_is_the_first_moment() {
        for phase in PHASES {
            let n = 4096;
            let cosines = (0..n).map(|i| phase.sample(Vec3::Z, sobol2(i, 0, 3)).z);
            let mean = cosines.map(f64::from).sum::<f64>() / f64::from(n);
            assert!(
                (mean - f64::from(phase.moment(1))).abs() < 2e-3,
                "{phase:?}"
            );
        }
    }
}
