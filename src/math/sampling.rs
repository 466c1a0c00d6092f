//! Hashes, low-discrepancy points and the maps that carry them to disks, hemispheres, spheres and
//! triangles.
//!
//! Everything is a pure function of its arguments, so that any pixel can be computed anywhere.

use glam::Vec3;
use std::f32::consts::TAU;

/// Mixes a 64-bit key into 64 well-spread bits (the finaliser of SplitMix64).
#[must_use]
#[inline]
pub fn mix(mut x: u64) -> u64 {
    x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Hash of several values, order-dependent.
#[must_use]
#[inline]
pub fn hash(values: &[u64]) -> u64 {
    values
        .iter()
        .fold(0x51_7c_c1_b7_27_22_0a_95, |h, &v| mix(h ^ v))
}

/// [`hash`] of a key, another for each seed. Seed 0 gives the plain hash.
#[must_use]
#[inline]
pub fn seeded(seed: u64, key: &[u64]) -> u64 {
    match seed {
        0 => hash(key),
        _ => hash(&[hash(key), seed]),
    }
}

/// A float in [0,1) from the upper 24 bits of a hash.
#[must_use]
#[inline]
pub fn unit(bits: u64) -> f32 {
    (bits >> 40) as f32 * (1.0 / (1 << 24) as f32)
}

/// Two independent floats in [0,1) from one hash.
#[must_use]
#[inline]
pub fn unit2(bits: u64) -> [f32; 2] {
    [unit(bits), unit(bits << 24)]
}

/// Point `i` of the R2 sequence (Roberts 2018), shifted by `offset`: two numbers in [0,1).
#[must_use]
#[inline]
pub fn r2(i: u64, offset: [f32; 2]) -> [f32; 2] {
    // Fixed-point arithmetic keeps every index exact.
    const A: u64 = 13_925_035_116_211_876_495; // 2^64 / 1.3247179572...
    const B: u64 = 10_511_698_010_929_265_436; // 2^64 / 1.3247179572...^2
    let shift = |o: f32| (f64::from(o) * 1.844_674_407_370_955_2e19) as u64;
    [
        unit(i.wrapping_mul(A).wrapping_add(shift(offset[0]))),
        unit(i.wrapping_mul(B).wrapping_add(shift(offset[1]))),
    ]
}

/// Point `i` of an Owen-scrambled Sobol sequence in two dimensions; `set` picks an independent pair
/// of dimensions.
#[must_use]
#[inline]
pub fn sobol2(i: u32, set: u32, seed: u32) -> [f32; 2] {
    let [a, b, _, _] = sobol_burley::sample_4d(
        i & 0xffff,
        set % 64,
        seed ^ (i >> 16).wrapping_mul(0x9e37_79b9),
    );
    [a, b]
}

/// Point `i` of an Owen-scrambled Sobol sequence in four dimensions; `set` picks independent ones.
#[must_use]
pub fn sobol4(i: u32, set: u32, seed: u32) -> [f32; 4] {
    sobol_burley::sample_4d(i & 0xffff, set % 64, seed)
}

/// Sine and cosine of 2 pi u, the same on every machine.
#[must_use]
#[inline]
pub fn sin_cos_turns(u: f32) -> (f32, f32) {
    (libm::sinf(TAU * u), libm::cosf(TAU * u))
}

/// Uniform point of the unit disk, concentric map (Shirley & Chiu 1997).
#[must_use]
pub fn disk(u: [f32; 2]) -> [f32; 2] {
    let (x, y) = (2.0 * u[0] - 1.0, 2.0 * u[1] - 1.0);
    if x == 0.0 && y == 0.0 {
        return [0.0; 2];
    }
    let (r, turns) = if x.abs() > y.abs() {
        (x, 0.125 * (y / x))
    } else {
        (y, 0.25 - 0.125 * (x / y))
    };
    let (sin, cos) = sin_cos_turns(turns);
    [r * cos, r * sin]
}

/// Direction of the hemisphere around +z with density cos / pi.
#[must_use]
pub fn cosine_hemisphere(u: [f32; 2]) -> Vec3 {
    let [x, y] = disk(u);
    Vec3::new(x, y, (1.0 - x * x - y * y).max(0.0).sqrt())
}

/// Uniform direction of the sphere.
#[must_use]
pub fn sphere(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u[0];
    let r = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = sin_cos_turns(u[1]);
    Vec3::new(r * cos, r * sin, z)
}

/// The two numbers in [0,1] that [`sphere`] makes a unit direction of.
#[must_use]
pub fn square_from_sphere(d: Vec3) -> [f32; 2] {
    let turns = libm::atan2f(d.y, d.x) * (1.0 / TAU);
    let turns = if turns < 0.0 { turns + 1.0 } else { turns };
    [0.5 * (1.0 - d.z), turns]
}

/// Uniform barycentric coordinates of a triangle by folding (Heitz 2019): keeps low-discrepancy
/// sets well spread.
#[must_use]
pub fn triangle(u: [f32; 2]) -> [f32; 3] {
    let (mut a, mut b) = (0.5 * u[0], 0.5 * u[1]);
    let offset = b - a;
    if offset > 0.0 {
        b += offset;
    } else {
        a -= offset;
    }
    [a, b, (1.0 - a - b).max(0.0)]
}

/// Two unit tangents that make a right-handed frame with the unit vector `n`.
#[must_use]
#[inline]
pub fn tangents(n: Vec3) -> (Vec3, Vec3) {
    let sign = 1.0_f32.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_have_the_right_moments() {
        let n = 4096;
        let (mut cos, mut z2, mut bary) = (0.0, 0.0, [0.0; 3]);
        for i in 0..n {
            let u = sobol2(i, 0, 7);
            cos += f64::from(cosine_hemisphere(u).z);
            z2 += f64::from(sphere(u).z.powi(2));
            let b = triangle(u);
            bary = std::array::from_fn(|k| bary[k] + f64::from(b[k]));
        }
        let n = f64::from(n);
        assert!((cos / n - 2.0 / 3.0).abs() < 1e-3);
        assert!((z2 / n - 1.0 / 3.0).abs() < 1e-3);
        assert!(
            bary.iter().all(|b| (b / n - 1.0 / 3.0).abs() < 1e-3),
            "{bary:?}"
        );
    }

    #[test]
    fn directions_go_back_to_their_numbers() {
        for i in 0..100 {
            let u = r2(i, [0.25; 2]);
            let back = square_from_sphere(sphere(u));
            assert!(
                (0..2).all(|a| (u[a] - back[a]).abs() < 1e-4),
                "{u:?} {back:?}"
            );
        }
    }

    #[test]
    fn seeds_give_other_hashes_and_zero_the_plain_one() {
        let key = [3, 5, 7];
        assert_eq!(seeded(0, &key), hash(&key));
        let found = [0, 1, 2, u64::MAX].map(|seed| seeded(seed, &key));
        for (i, a) in found.iter().enumerate() {
            assert!(!found[..i].contains(a));
        }
    }

    #[test]
    fn tangents_are_orthonormal() {
        for i in 0..100 {
            let n = sphere(r2(i, [0.0; 2]));
            let (t, b) = tangents(n);
            assert!(t.dot(n).abs() < 1e-6 && b.dot(n).abs() < 1e-6 && t.dot(b).abs() < 1e-6);
            assert!((t.cross(b) - n).length() < 1e-5);
        }
    }
}
