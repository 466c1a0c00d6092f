//! Direct light at vertices, and between them: linear, or exponential as far as depth explains.

use super::sparse::SparseValues;
use super::vertices::extremes;
use crate::light::MediumLight;
use crate::math::exp::exp_neg;
use crate::math::{Rgb, Spectrum};
use wide::f32x8;

/// Spacings of 1 to 64 voxels.
pub const DIRECT_LEVELS: usize = 7;

/// Of those, spacings that vertices of thin media have whatever camera looks.
pub const NEAR_LEVELS: usize = 3;

/// Direct light at vertices, by log2 of the voxels between them.
pub type DirectLevels = [Option<SparseValues<Vertex>>; DIRECT_LEVELS];

/// Direct light at a vertex.
#[derive(Clone, Copy, Debug, Default)]
pub struct Vertex {
    pub light: MediumLight,
    /// Logarithms of the luminance of both parts.
    ln_share: f32,
    ln_rest: f32,
}

impl Vertex {
    pub fn new(light: MediumLight) -> Self {
        Self {
            light,
            ln_share: libm::logf(light.share.luminance()),
            ln_rest: libm::logf(light.rest.luminance()),
        }
    }
}

/// Direct light at a vertex as vectors, as points between vertices need it.
#[derive(Clone, Copy, Debug, Default)]
pub struct LightVectors {
    /// The channels of the share, its luminance, and those of the rest.
    pub light: f32x8,
    /// Logarithms of both luminances.
    pub ln: [f32; 2],
}

impl LightVectors {
    pub fn of(vertex: &Vertex) -> Self {
        let MediumLight { share, rest } = vertex.light;
        let ([r, g, b], [s, t, u]) = (share.0, rest.0);
        Self {
            light: f32x8::new([r, g, b, share.luminance(), s, t, u, rest.luminance()]),
            ln: [vertex.ln_share, vertex.ln_rest],
        }
    }

    pub fn share(light: f32x8) -> Rgb {
        let [r, g, b, ..] = light.to_array();
        Rgb([r, g, b])
    }

    pub fn rest(light: f32x8) -> Rgb {
        let [.., r, g, b, _] = light.to_array();
        Rgb([r, g, b])
    }

    /// Luminances of the share and of the rest.
    fn luminances(light: f32x8) -> [f32; 2] {
        let [_, _, _, share, _, _, _, rest] = light.to_array();
        [share, rest]
    }
}

/// Whether light differs by more between vertices of a thin brick than anything but a surface
/// explains.
pub fn has_edge(values: &[LightVectors; 8], weights: &[f32; 8]) -> bool {
    const SHADOW: f32 = 2.0;
    let (least, most) = extremes(values, weights, |v| v.light);
    let [least, most] = [least, most].map(LightVectors::luminances);
    (0..2).any(|part| most[part] > SHADOW * least[part])
}

/// How a value differs between the vertices around a point.
#[derive(Clone, Copy, Debug, Default)]
pub struct Spread {
    /// The largest over the smallest; 0 if there is no light at one of them: that a surface hides
    /// it is no matter of depth.
    pub ratio: f32,
    mean: f32,
}

impl Spread {
    /// Values that differ by less than this factor are as good as linear between vertices.
    const LINEAR: f32 = 1.2;

    /// Spreads of the luminances of both parts of the light, given the light between the vertices.
    pub fn of(values: &[LightVectors; 8], weights: &[f32; 8], light: f32x8) -> [Self; 2] {
        let (least, most) = extremes(values, weights, |v| v.light);
        let [least, most, mean] = [least, most, light].map(LightVectors::luminances);
        std::array::from_fn(|part| Self {
            ratio: if least[part] > 0.0 {
                most[part] / least[part]
            } else {
                0.0
            },
            mean: mean[part],
        })
    }

    /// The same, of light whose channels count by such weights.
    pub fn weighted<K: Spectrum>(
        values: &[LightVectors; 8],
        weights: &[f32; 8],
        light: f32x8,
        channels: K,
    ) -> [Self; 2] {
        let plain = Self::of(values, weights, light);
        if K::IS_GREY {
            return plain;
        }
        let (least, most) = extremes(values, weights, |v| v.light);
        let luminances = |light: f32x8| {
            let parts = [LightVectors::share(light), LightVectors::rest(light)];
            parts.map(|part| channels.luminance_of(part))
        };
        let (least, most) = (luminances(least), luminances(most));
        std::array::from_fn(|part| Self {
            ratio: if plain[part].ratio > 0.0 && least[part] > 0.0 {
                most[part] / least[part]
            } else {
                plain[part].ratio
            },
            ..plain[part]
        })
    }

    /// Light between vertices, if it falls exponentially, over what it is by linear interpolation:
    /// at most 1. Absorption over `depth`, the optical depth between two vertices, explains a fall
    /// down to a limit; a larger difference between vertices is the edge of a shadow or of another
    /// medium, which the factor leaves alone. `mean_ln` is the logarithm of light that falls
    /// exponentially.
    pub fn fall(self, depth: f32, mean_ln: impl Fn() -> f32) -> f32 {
        if self.ratio <= Self::LINEAR {
            return 1.0;
        }
        // 1 / cosh(depth / 2): that of two vertices, half way between them.
        let root = exp_neg(0.5 * depth);
        let most = 2.0 * root / (1.0 + root * root);
        (libm::expf(mean_ln()) / self.mean).max(most).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inscatter::vertices::blend;
    use crate::math::sampling;
    use glam::Vec3;

    /// Light at the corners of a cube of this edge, some of it from point lights, and their weights
    /// for a point of it.
    fn around(
        edge: f32,
        point: [f32; 3],
        light: impl Fn(Vec3) -> f32,
    ) -> ([LightVectors; 8], [f32; 8]) {
        let corner = |i: usize| std::array::from_fn(|a| (i >> a & 1) as f32);
        let values = std::array::from_fn(|i| {
            let light = Rgb::splat(light(edge * Vec3::from(corner(i))));
            LightVectors::of(&Vertex::new(MediumLight {
                share: light,
                rest: light * 3.0,
            }))
        });
        let weights = std::array::from_fn(|i| {
            let along = (0..3).map(|a| 1.0 - (corner(i)[a] - point[a]).abs());
            along.product()
        });
        (values, weights)
    }

    fn found((values, weights): &([LightVectors; 8], [f32; 8]), depth: f32) -> f32 {
        let light = blend(values, weights, |v| v.light);
        let spread = Spread::of(values, weights, light);
        let [share, rest] = [0, 1].map(|part| {
            spread[part].mean * spread[part].fall(depth, || blend(values, weights, |v| v.ln[part]))
        });
        assert!((rest / share - 3.0).abs() < 1e-5);
        share
    }

    #[test]
    fn light_that_falls_exponentially_is_found_between_vertices() {
        let depth = 1.0;
        for direction in [Vec3::X, Vec3::ONE.normalize(), Vec3::new(0.6, 0.8, 0.0)] {
            let light = |p: Vec3| (-p.dot(direction)).exp();
            for i in 0..100 {
                let [x, y] = sampling::r2(i, [0.5; 2]);
                let point = [x, y, (0.37 * i as f32).fract()];
                let values = around(depth, point, light);
                let expected = light(depth * Vec3::from(point));
                let got = found(&values, depth);
                assert!((got / expected - 1.0).abs() < 0.01, "{got} {expected}");
            }
            // A straight line would be up to an eighth above it.
            let (values, weights) = around(depth, [0.5; 3], light);
            let linear = LightVectors::share(blend(&values, &weights, |v| v.light)).0[0];
            assert!(linear > 1.1 * light(Vec3::splat(0.5)));
        }
    }

    #[test]
    fn the_edge_of_a_shadow_in_a_thin_medium_stays_where_it_is() {
        for dark in [0.0, 1e-3, 0.1] {
            let values = around(0.1, [0.5; 3], |p| if p.x > 0.0 { 1.0 } else { dark });
            let (got, linear) = (found(&values, 0.1), 0.5 * (1.0 + dark));
            assert!(got <= linear && got > 0.998 * linear, "{got} {linear}");
        }
    }

    #[test]
    fn parts_are_blended_and_compared_like_each_number_by_itself() {
        let number = |i: usize, c: u64| sampling::unit(sampling::hash(&[i as u64, c]));
        let lit = |i: usize| MediumLight {
            share: Rgb([0, 1, 2].map(|c| number(i, c))),
            // No light at some of them.
            rest: Rgb([3, 4, 5].map(|c| (number(i, c) - 0.2).max(0.0))),
        };
        for set in 0..20 {
            let light: [MediumLight; 8] = std::array::from_fn(|i| lit(8 * set + i));
            let values = light.map(|l| LightVectors::of(&Vertex::new(l)));
            let mut weights: [f32; 8] = std::array::from_fn(|i| number(8 * set + i, 6));
            weights[set % 8] = 0.0;
            let mut sum = MediumLight::default();
            let (mut least, mut most) = ([f32::INFINITY; 2], [0.0_f32; 2]);
            let mut mean = [0.0; 2];
            for (light, &weight) in light.iter().zip(&weights).filter(|(_, w)| **w > 0.0) {
                sum += *light * weight;
                for (part, rgb) in [light.share, light.rest].into_iter().enumerate() {
                    least[part] = least[part].min(rgb.luminance());
                    most[part] = most[part].max(rgb.luminance());
                    mean[part] += rgb.luminance() * weight;
                }
            }
            let found = blend(&values, &weights, |v| v.light);
            assert_eq!(LightVectors::share(found), sum.share);
            assert_eq!(LightVectors::rest(found), sum.rest);
            for (part, spread) in Spread::of(&values, &weights, found).iter().enumerate() {
                let ratio = most[part] / least[part];
                assert_eq!(spread.ratio, if least[part] > 0.0 { ratio } else { 0.0 });
                assert_eq!(spread.mean, mean[part]);
            }
            let differs = (0..2).any(|part| most[part] > 2.0 * least[part]);
            assert_eq!(has_edge(&values, &weights), differs);
        }
    }
}
