//! Light by direction on an octahedral map, and what comes from where nothing is.

use super::Rgb;
use glam::{Vec2, Vec3};

/// A function of direction, linear between points of a sphere that is unfolded onto a square as an
/// octahedron (Cigolle et al. 2014), each of whose faces is cut into equal triangles.
#[derive(Clone, Debug)]
pub struct SphereMap {
    /// Edges of triangles along the square.
    edges: usize,
    /// Row by row; points on the border of the square are there twice, at the corners four times.
    points: Vec<Rgb>,
}

/// The place of a unit direction on the square from 0 to 1.
fn unfold(d: Vec3) -> Vec2 {
    let p = d / (d.x.abs() + d.y.abs() + d.z.abs());
    let flat = if p.z >= 0.0 {
        Vec2::new(p.x, p.y)
    } else {
        Vec2::new(
            (1.0 - p.y.abs()).copysign(p.x),
            (1.0 - p.x.abs()).copysign(p.y),
        )
    };
    (flat * 0.5 + 0.5).clamp(Vec2::ZERO, Vec2::ONE)
}

/// The unit direction at a place of the square.
fn fold(place: Vec2) -> Vec3 {
    let p = place * 2.0 - 1.0;
    let z = 1.0 - p.x.abs() - p.y.abs();
    let d = if z >= 0.0 {
        Vec3::new(p.x, p.y, z)
    } else {
        Vec3::new(
            (1.0 - p.y.abs()).copysign(p.x),
            (1.0 - p.x.abs()).copysign(p.y),
            z,
        )
    };
    d.normalize()
}

impl SphereMap {
    /// The map of a function of direction, with so many edges of triangles along the square: an
    /// even number.
    #[must_use]
    pub fn from_fn(edges: usize, of: impl Fn(Vec3) -> Rgb) -> Self {
        let at = |i: usize| i as f32 / edges as f32;
        let along = edges + 1;
        let point = |i: usize| of(fold(Vec2::new(at(i % along), at(i / along))));
        let points = (0..along * along).map(point).collect();
        Self { edges, points }
    }

    /// The map of what parts of the sphere send, each with its direction, radiance and solid angle:
    /// of the same integral over the sphere, smoothed over about two edges.
    #[must_use]
    pub fn of_parts(edges: usize, parts: impl Iterator<Item = (Vec3, Rgb, f64)>) -> Self {
        let along = edges + 1;
        let mut sums = vec![[0.0_f64; 4]; along * along];
        for (direction, radiance, solid_angle) in parts {
            for (point, weight) in around(edges, direction) {
                let weight = f64::from(weight) * solid_angle;
                let light = radiance.0.into_iter().chain([1.0]);
                (sums[point].iter_mut().zip(light)).for_each(|(s, v)| *s += f64::from(v) * weight);
            }
        }
        let mean = |i: usize| {
            let (x, y) = (i % along, i / along);
            let mut sum = [0.0; 4];
            let mut add = |x: usize, y: usize| {
                let other = sums[y * along + x];
                (sum.iter_mut().zip(other)).for_each(|(s, v)| *s += v);
            };
            let ends = [0, edges];
            add(x, y);
            match (ends.contains(&x), ends.contains(&y)) {
                (true, true) => {
                    add(edges - x, y);
                    add(x, edges - y);
                    add(edges - x, edges - y);
                }
                (true, false) if 2 * y != edges => add(x, edges - y),
                (false, true) if 2 * x != edges => add(edges - x, y),
                _ => {}
            }
            let [r, g, b, all] = sum;
            match all > 0.0 {
                true => Rgb([r, g, b].map(|sum| (sum / all) as f32)),
                false => Rgb::BLACK,
            }
        };
        let points = (0..along * along).map(mean).collect();
        Self { edges, points }
    }

    /// The value in a unit direction.
    #[must_use]
    pub fn get(&self, direction: Vec3) -> Rgb {
        let around = around(self.edges, direction);
        around.into_iter().fold(Rgb::BLACK, |sum, (point, weight)| {
            sum + self.points[point] * weight
        })
    }
}

/// The corners of the triangle that a direction is in, and their weights.
fn around(edges: usize, direction: Vec3) -> [(usize, f32); 3] {
    let place = unfold(direction) * edges as f32;
    let (x, y) = (place.x.min(edges as f32), place.y.min(edges as f32));
    let (left, top) = ((x as usize).min(edges - 1), (y as usize).min(edges - 1));
    let (fx, fy) = (x - left as f32, y - top as f32);
    // Faces of the octahedron meet along the diagonals of four quarters.
    let is_mirrored = (2 * left < edges) != (2 * top < edges);
    let across = if is_mirrored { 1.0 - fx } else { fx };
    let point = |right: bool, below: bool| {
        (top + usize::from(below)) * (edges + 1) + left + usize::from(right != is_mirrored)
    };
    if across + fy < 1.0 {
        [
            (point(false, false), 1.0 - across - fy),
            (point(true, false), across),
            (point(false, true), fy),
        ]
    } else {
        [
            (point(true, true), across + fy - 1.0),
            (point(false, true), 1.0 - across),
            (point(true, false), 1.0 - fy),
        ]
    }
}

/// What comes from where nothing is: the same from everywhere, or as a map says.
#[derive(Clone, Copy, Debug)]
pub struct Environment<'a> {
    even: Rgb,
    map: Option<&'a EnvironmentMap>,
}

/// Radiance by direction, and what it is for surfaces that see all of it.
#[derive(Clone, Debug)]
pub struct EnvironmentMap {
    /// Radiance.
    pub radiance: SphereMap,
    /// Irradiance of a surface that nothing hides anything from, by its normal.
    pub irradiance: SphereMap,
}

impl<'a> Environment<'a> {
    /// The same from everywhere.
    #[must_use]
    pub const fn even(radiance: Rgb) -> Self {
        Self {
            even: radiance,
            map: None,
        }
    }

    /// By a map.
    #[must_use]
    pub const fn mapped(map: &'a EnvironmentMap) -> Self {
        Self {
            even: Rgb::BLACK,
            map: Some(map),
        }
    }

    /// Whether nothing comes from anywhere.
    #[must_use]
    pub fn is_black(&self) -> bool {
        self.map.is_none() && self.even.is_black()
    }

    /// The map, if it differs by direction.
    #[must_use]
    pub fn map(&self) -> Option<&'a EnvironmentMap> {
        self.map
    }

    /// Radiance from a unit direction.
    #[must_use]
    #[inline]
    pub fn radiance(&self, direction: Vec3) -> Rgb {
        match self.map {
            None => self.even,
            Some(map) => map.radiance.get(direction),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    fn directions(count: u64) -> impl Iterator<Item = Vec3> {
        (0..count).map(|i| sampling::sphere(sampling::r2(i, [0.4; 2])))
    }

    #[test]
    fn the_square_is_the_sphere() {
        for d in directions(1000) {
            assert!(fold(unfold(d)).distance(d) < 1e-5, "{d}");
        }
        // Smooth over all edges.
        let map = SphereMap::from_fn(64, |d| Rgb([d.x, d.y, d.z]));
        for d in directions(5000) {
            let Rgb(found) = map.get(d);
            assert!(Vec3::from(found).distance(d) < 2e-3, "{d} {found:?}");
        }
    }

    #[test]
    fn parts_keep_their_integral() {
        let light = |d: Vec3| Rgb([1.0, 1.0 + d.z, f32::from(u8::from(d.dot(Vec3::X) > 0.9))]);
        let count = 1_u32 << 16;
        let solid_angle = 4.0 * std::f64::consts::PI / f64::from(count);
        let parts = directions(count.into()).map(|d| (d, light(d), solid_angle));
        let map = SphereMap::of_parts(16, parts);
        let mean = |of: &dyn Fn(Vec3) -> Rgb| {
            let sum = directions(count.into()).fold(Rgb::BLACK, |sum, d| sum + of(d));
            sum * (1.0 / count as f32)
        };
        let (found, expected) = (mean(&|d| map.get(d)), mean(&light));
        for c in 0..3 {
            assert!(
                (found.0[c] / expected.0[c] - 1.0).abs() < 1e-3,
                "{found:?} {expected:?}"
            );
        }
        assert!(directions(100).all(|d| (map.get(d).0[0] - 1.0).abs() < 1e-6));
    }
}
