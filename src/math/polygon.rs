//! Closed forms of what a triangle of uniform radiance sends to a point.

use super::magnitude::to_unit;
use super::vec3x4::Vec3x4;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI};
use wide::f32x4;

/// Vector irradiance of a triangle seen from the origin, clipped at the horizon of the unit normal
/// `n`: the cosine integral over its solid angle, in units of its radiance (Lambert 1760; Baum et
/// al. 1989). Positive whichever way the triangle winds, at most pi.
#[must_use]
pub fn irradiance(corners: [Vec3; 3], n: Vec3) -> f32 {
    let corners = near_unit(corners);
    let heights = corners.map(|c| c.dot(n));
    if heights.iter().all(|h| *h <= 0.0) {
        return 0.0;
    }
    if heights.iter().all(|h| *h >= 0.0) {
        if is_small(corners) {
            return small_irradiance(corners, n);
        }
        let [a, b, c] = corners;
        return of_edges([a, b, c, Vec3::ZERO], [b, c, a, Vec3::ZERO], n);
    }
    let (poly, len) = above(corners, n);
    let ends = std::array::from_fn(|i| poly[(i + 1) % len.max(1)]);
    of_edges(poly, ends, n)
}

/// The same of a polygon above the horizon, by its edges; those whose ends are equal add nothing.
#[inline]
fn of_edges(from: [Vec3; 4], to: [Vec3; 4], n: Vec3) -> f32 {
    let (from, to) = (Vec3x4::new(from), Vec3x4::new(to));
    let cross = from.cross(&to);
    let sin = cross.length();
    let edge = angle(sin, from.dot(&to)) * (cross.dot(&Vec3x4::splat(n)) / sin);
    let [a, b, c, d] = sin
        .simd_gt(f32x4::ZERO)
        .select(edge, f32x4::ZERO)
        .to_array();
    0.5 * (a + b + c + d).abs()
}

/// A triangle seen from the origin, as another one of the same directions whose farthest coordinate
/// is near 1: fourth powers of lengths would leave the range of f32.
#[inline]
fn near_unit(corners: [Vec3; 3]) -> [Vec3; 3] {
    let [a, b, c] = corners.map(Vec3::abs);
    let scale = to_unit(a.max(b).max(c).max_element());
    corners.map(|c| c * scale)
}

/// Angles whose sines and cosines are as given but for a common positive factor, within 1e-6 of
/// them; sines are not negative. 0 where both are 0.
#[inline]
fn angle(sin: f32x4, cos: f32x4) -> f32x4 {
    // Arc tangent of at most 1, within 2e-8 (Abramowitz & Stegun 1964, 4.4.49).
    const TERMS: [f32; 8] = [
        0.002_866_225_7,
        -0.016_165_737,
        0.042_909_614,
        -0.075_289_64,
        0.106_562_64,
        -0.142_089,
        0.199_935_51,
        -0.333_331_45,
    ];
    let size = cos.abs();
    let is_steep = sin.simd_gt(size);
    let (less, most) = (sin.fast_min(size), sin.fast_max(size));
    let x = most.simd_gt(f32x4::ZERO).select(less / most, f32x4::ZERO);
    let x2 = x * x;
    let mut series = f32x4::ZERO;
    for term in TERMS {
        series = (series + f32x4::splat(term)) * x2;
    }
    let near = x + x * series;
    let acute = is_steep.select(f32x4::splat(FRAC_PI_2) - near, near);
    let angle = cos
        .simd_lt(f32x4::ZERO)
        .select(f32x4::splat(PI) - acute, acute);
    most.simd_gt(f32x4::ZERO).select(angle, f32x4::ZERO)
}

/// The same of the part of the triangle on the side of another plane through the origin, by its
/// normal `face`.
#[must_use]
pub fn irradiance_above(corners: [Vec3; 3], n: Vec3, face: Vec3) -> f32 {
    let below = corners.map(|c| c.dot(face) < 0.0);
    match below {
        [false, false, false] => irradiance(corners, n),
        [true, true, true] => 0.0,
        _ => {
            let (poly, len) = above(corners, face);
            (2..len)
                .map(|i| irradiance([poly[0], poly[i - 1], poly[i]], n))
                .sum()
        }
    }
}

/// The part of a triangle on the side of a plane through the origin, by its normal: corners, and
/// how many.
fn above(corners: [Vec3; 3], n: Vec3) -> ([Vec3; 4], usize) {
    let mut poly = [Vec3::ZERO; 4];
    let mut len = 0;
    for i in 0..3 {
        let (a, b) = (corners[i], corners[(i + 1) % 3]);
        let (ha, hb) = (a.dot(n), b.dot(n));
        if ha >= 0.0 {
            poly[len] = a;
            len += 1;
        }
        if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
            poly[len] = a + (b - a) * (ha / (ha - hb));
            len += 1;
        }
    }
    (poly, len)
}

/// Whether a triangle is so small, seen from the origin, that the sum over its edges would lose its
/// digits: terms as large as its edges cancel down to its area.
fn is_small([a, b, c]: [Vec3; 3]) -> bool {
    const SIZE2: f32 = 0.01;
    let longest2 = (b - a)
        .length_squared()
        .max((c - b).length_squared())
        .max((a - c).length_squared());
    longest2 < SIZE2 * a.length_squared()
}

/// The cosine integral over a triangle that is small and above the horizon, by seven points that
/// are exact to degree 5 (Radon 1948).
fn small_irradiance([a, b, c]: [Vec3; 3], n: Vec3) -> f32 {
    const NEAR: [f32; 2] = [0.101_286_51, 0.125_939_18];
    const FAR: [f32; 2] = [0.470_142_06, 0.132_394_15];
    // In units of the distance, by which terms of any triangle are near 1.
    let scale = 1.0 / a.length();
    let [a, b, c] = [a, b, c].map(|p| p * scale);
    let cross = (b - a).cross(c - a);
    let at = |p: Vec3| {
        let r2 = p.length_squared();
        p.dot(n) * p.dot(cross).abs() / (r2 * r2)
    };
    let mut sum = 0.225 * at((a + b + c) * (1.0 / 3.0));
    for [u, weight] in [NEAR, FAR] {
        let v = 1.0 - 2.0 * u;
        let points = at(a * v + (b + c) * u) + at(b * v + (a + c) * u) + at(c * v + (a + b) * u);
        sum += weight * points;
    }
    0.5 * sum
}

/// Solid angle of a triangle seen from the origin (Van Oosterom & Strackee 1983), steradians, not
/// negative.
#[must_use]
pub fn solid_angle(corners: [Vec3; 3]) -> f32 {
    let [a, b, c] = near_unit(corners);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    // The same as a . (b x c), but small triangles keep their digits.
    let numerator = a.dot((b - a).cross(c - a));
    let denominator = la * lb * lc + a.dot(b) * lc + a.dot(c) * lb + b.dot(c) * la;
    2.0 * angle(f32x4::splat(numerator.abs()), f32x4::splat(denominator)).to_array()[0]
}

/// Uniform direction of the solid angle of a triangle seen from the origin, for two numbers in
/// [0,1) (Arvo 1995): a part of the triangle that grows with the first, and a point of the arc that
/// cuts it off. `None` for a triangle seen edge-on.
#[must_use]
pub fn sample_solid_angle(corners: [Vec3; 3], [u, v]: [f32; 2]) -> Option<Vec3> {
    let [a, b, c] = near_unit(corners).map(Vec3::normalize_or_zero);
    // Normals of the edges' planes, and angles between them at the corners.
    let normals = Vec3x4::new([a, b, c, Vec3::ZERO]).cross(&Vec3x4::new([b, c, a, Vec3::ZERO]));
    let lengths = normals.length();
    let [ab, bc, ca, _] = lengths.to_array();
    if !(ab > 0.0 && bc > 0.0 && ca > 0.0) {
        return None;
    }
    let normals = normals.over(lengths);
    let before = normals.map(|[ab, bc, ca, none]| [-ca, -ab, -bc, none]);
    let (sines, cosines) = (normals.cross(&before).length(), normals.dot(&before));
    let [alpha, beta, gamma, _] = angle(sines, cosines).to_array();
    let (sin_alpha, cos_alpha) = (sines.to_array()[0], cosines.to_array()[0]);
    // The part's angles add up to its area and a half turn, which turns the signs of sine and
    // cosine.
    let (sin, cos) = libm::sincosf(u * (alpha + beta + gamma - PI));
    let (sin_phi, cos_phi) = (
        cos * sin_alpha - sin * cos_alpha,
        -cos * cos_alpha - sin * sin_alpha,
    );
    let k1 = cos_phi + cos_alpha;
    let k2 = sin_phi - sin_alpha * a.dot(b);
    let cos_arc = (k2 + (k2 * cos_phi - k1 * sin_phi) * cos_alpha)
        / ((k2 * sin_phi + k1 * cos_phi) * sin_alpha);
    if !cos_arc.is_finite() {
        return None;
    }
    let cut = along(a, c, cos_arc.clamp(-1.0, 1.0));
    Some(along(b, cut, 1.0 - v * (1.0 - cut.dot(b))))
}

/// The unit vector in the plane of `from` and `to` whose cosine to `from` is given, on the side of
/// `to`.
fn along(from: Vec3, to: Vec3, cos: f32) -> Vec3 {
    let across = (to - from * to.dot(from)).normalize_or_zero();
    (from * cos + across * (1.0 - cos * cos).max(0.0).sqrt()).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::r2;

    #[test]
    fn angles_are_those_of_the_arc_tangent() {
        for i in 0..=2000_u16 {
            let turn = PI * f32::from(i) / 2000.0;
            for scale in [1e-15, 1.0, 1e15] {
                let (sin, cos) = (scale * turn.sin().max(0.0), scale * turn.cos());
                let expected = f64::from(sin).atan2(f64::from(cos));
                let [got, ..] = angle(f32x4::splat(sin), f32x4::splat(cos)).to_array();
                let got = f64::from(got);
                assert!(
                    (got - expected).abs() <= 1e-6 * expected,
                    "{sin} {cos}: {got}"
                );
            }
        }
    }

    #[test]
    fn triangles_of_any_scale_are_seen_alike() {
        for i in 0..200 {
            let [p, q, r, n] = [0.1, 0.3, 0.6, 0.8]
                .map(|start| crate::math::sampling::sphere(r2(i, [start, 1.7 * start])));
            let face = (n + 0.8 * crate::math::sampling::sphere(r2(i, [0.7; 2]))).normalize();
            let small = [p, p + 0.01 * q, p + 0.02 * r];
            for corners in [[p * 2.0, q, r * 1.5], small] {
                let seen = |exponent: i32| {
                    let scale = libm::ldexpf(1.0, exponent);
                    let corners = corners.map(|c| c * scale);
                    (
                        irradiance(corners, n),
                        irradiance_above(corners, n, face),
                        solid_angle(corners),
                        sample_solid_angle(corners, [0.3, 0.6]),
                    )
                };
                for exponent in [-80, -50, -33, 33, 50, 62] {
                    assert_eq!(seen(exponent), seen(0), "{i}: {exponent}");
                }
            }
        }
    }

    #[test]
    fn an_octant_has_an_eighth_of_the_sphere_and_a_quarter_of_the_hemisphere() {
        let octant = [Vec3::X, Vec3::Y, Vec3::Z];
        assert!((solid_angle(octant) - PI / 2.0).abs() < 1e-6);
        assert!((irradiance(octant, Vec3::Z) - PI / 4.0).abs() < 1e-6);
        assert_eq!(irradiance(octant, -Vec3::Z), 0.0);
    }

    #[test]
    fn a_second_plane_takes_away_what_is_below_it() {
        let mut cut = 0;
        for i in 0..60 {
            let [p, q, r, n] = [0.1, 0.3, 0.6, 0.8]
                .map(|start| crate::math::sampling::sphere(r2(i, [start, 1.7 * start])));
            let face = (n + 0.8 * crate::math::sampling::sphere(r2(i, [0.7; 2]))).normalize();
            let corners = [p * 2.0, q, r * 1.5];
            let size = solid_angle(corners);
            if !(0.05..5.0).contains(&size) {
                continue;
            }
            let count = 20_000;
            let (mut whole, mut above) = (0.0_f64, 0.0_f64);
            for k in 0..count {
                let d = sample_solid_angle(corners, r2(k, [0.5; 2])).unwrap();
                let cos = f64::from(d.dot(n).max(0.0) * size) / count as f64;
                whole += cos;
                above += if d.dot(face) > 0.0 { cos } else { 0.0 };
            }
            cut += u32::from(above < 0.9 * whole);
            let got = f64::from(irradiance_above(corners, n, face));
            assert!((got - above).abs() < 0.01, "{i}: {got} {above}");
        }
        assert!(cut > 5);
    }

    #[test]
    fn parallel_unit_squares_have_the_tabled_form_factor() {
        // Point below a corner of a rectangle a x b at height c: Nusselt's analogue in closed form.
        let (a, b, c) = (0.7_f32, 1.3_f32, 0.9_f32);
        let (x, y) = (a / c, b / c);
        let part = |p: f32, q: f32| p / (1.0 + p * p).sqrt() * (q / (1.0 + p * p).sqrt()).atan();
        let expected = 0.5 * (part(x, y) + part(y, x));
        let p = |u: f32, v: f32| Vec3::new(u * a, v * b, c);
        let got = irradiance([p(0.0, 0.0), p(1.0, 0.0), p(1.0, 1.0)], Vec3::Z)
            + irradiance([p(0.0, 0.0), p(1.0, 1.0), p(0.0, 1.0)], Vec3::Z);
        assert!((got - expected).abs() < 1e-6, "{got} {expected}");
    }

    #[test]
    fn small_triangles_are_integrated_like_large_ones() {
        let n = Vec3::new(0.6, 0.0, 0.8);
        let at = |x: f32, y: f32| Vec3::new(0.3 + x, 0.2 + y, 1.0 + 0.5 * x);
        // Just large enough for the closed form, and its four quarters, which are not.
        let [a, b, c] = [at(0.0, 0.0), at(0.115, 0.0), at(0.0, 0.125)];
        let [p, q, r] = [0.5 * (a + b), 0.5 * (b + c), 0.5 * (a + c)];
        assert!(!is_small([a, b, c]) && is_small([p, q, r]));
        let parts = [[a, p, r], [p, b, q], [r, q, c], [p, q, r]];
        let sum: f32 = parts.iter().map(|t| irradiance(*t, n)).sum();
        assert!((sum / irradiance([a, b, c], n) - 1.0).abs() < 2e-6);
    }

    #[test]
    fn a_triangle_across_the_horizon_counts_above_it_only() {
        let corners = [
            Vec3::new(1.0, -1.0, -1.0),
            Vec3::new(1.0, 1.0, -1.0),
            Vec3::new(1.0, 0.0, 1.0),
        ];
        let above = irradiance(corners, Vec3::Z);
        assert!(above > 0.0 && above < irradiance(corners, Vec3::X));
    }

    #[test]
    fn directions_to_a_triangle_hit_it_and_are_uniform() {
        let corners = [
            Vec3::new(1.0, -0.8, 0.3),
            Vec3::new(-0.4, 1.2, 0.5),
            Vec3::new(-0.9, -0.7, 0.9),
        ];
        let n = Vec3::new(0.2, -0.1, 1.0).normalize();
        let whole = solid_angle(corners);
        let count = 20_000;
        let mut sum = 0.0;
        for i in 0..count {
            let d = sample_solid_angle(corners, r2(i, [0.2, 0.7])).unwrap();
            for e in 0..3 {
                let inward = corners[e].cross(corners[(e + 1) % 3]);
                let side = inward.dot(d) * inward.dot(corners[(e + 2) % 3]);
                assert!(side > -1e-5, "{d}");
            }
            sum += d.dot(n).max(0.0);
        }
        // The mean cosine over its directions is its irradiance.
        let found = sum / count as f32 * whole;
        assert!(
            (found / irradiance(corners, n) - 1.0).abs() < 1e-3,
            "{found}"
        );
        assert_eq!(
            sample_solid_angle([Vec3::X, Vec3::Y, Vec3::X], [0.5, 0.5]),
            None
        );
    }
}
