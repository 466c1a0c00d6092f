//! Means of textures over triangles, as they are filtered: between the middles of four texels a
//! texture is bilinear, so that integrals over polygons are known in closed form.

use super::Texture;
use crate::math::sampling;
use glam::{DVec2, DVec3, Vec2, Vec3};

/// Texels up to which a triangle is gone through, however often it shows the texture.
const MANY_TEXELS: f64 = (1 << 24) as f64;
/// Times that a triangle shows a whole texture from which on its mean is that of the texture.
const MANY_TIMES: f64 = 64.0;
/// Texels by which places may be off.
const ROUNDING: f64 = 1e-9;
/// Texels from the origin within which floats tell where in a texture they are.
const FAR: f64 = 1e6;

impl Texture {
    /// Texels that a triangle of these texture coordinates covers.
    pub(crate) fn texels_within(&self, uvs: [DVec2; 3]) -> f64 {
        let [a, b, c] = uvs.map(|uv| uv * self.size());
        0.5 * (b - a).perp_dot(c - a).abs()
    }

    /// Linear RGB of a texel, by its number among all.
    fn color(&self, at: usize) -> DVec3 {
        Vec3::from(self.texel(at)).as_dvec3()
    }

    fn size(&self) -> DVec2 {
        DVec2::new(f64::from(self.width), f64::from(self.height))
    }

    /// Mean over a triangle of these texture coordinates of what [`Texture::sample`] has there.
    pub(crate) fn mean_within(&self, uvs: [DVec2; 3]) -> DVec3 {
        let size = self.size();
        // A point lies between the texels of whole numbers around it.
        let corners = uvs.map(|uv| uv * size - 0.5);
        let [a, b, c] = corners;
        let (low, high) = (a.min(b).min(c), a.max(b).max(c));
        let texels = self.texels_within(uvs);
        let extent = high - low;
        let is_flat = texels <= 1e-9 * extent.length_squared();
        if is_flat || low.abs().max(high.abs()).max_element() > FAR {
            return self.mean_of_points(uvs);
        }
        if texels > MANY_TEXELS && texels > MANY_TIMES * size.x * size.y {
            let all = self.texels();
            let count = all.len() as f64;
            return all.fold(DVec3::ZERO, |sum, t| sum + Vec3::from(t).as_dvec3()) / count;
        }
        let mut sum = Integral::default();
        let triangle = Polygon::of(&corners);
        for row in low.y.floor() as i64..=high.y.floor() as i64 {
            self.add_row(&mut sum, &triangle, row);
        }
        match sum.area > 0.0 {
            true => sum.light / sum.area,
            false => self.mean_of_points(uvs),
        }
    }

    /// Adds the part of a triangle between two rows of texels.
    fn add_row(&self, sum: &mut Integral, triangle: &Polygon, row: i64) {
        let (top, bottom) = (row as f64, row as f64 + 1.0);
        let band = triangle.cut(|p| p.y - top).cut(|p| bottom - p.y);
        if band.len < 3 {
            return;
        }
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        // Where the band is as wide at its top and at its bottom, if it reaches both.
        let mut ends = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for p in band.corners() {
            (low, high) = (low.min(p.x), high.max(p.x));
            for (end, y) in ends.iter_mut().zip([top, bottom]) {
                if (p.y - y).abs() < ROUNDING {
                    *end = [end[0].min(p.x), end[1].max(p.x)];
                }
            }
        }
        let first = (ends[0][0].max(ends[1][0]) - ROUNDING).ceil();
        let last = (ends[0][1].min(ends[1][1]) + ROUNDING).floor();
        let (left, right) = (low.floor() as i64, high.ceil() as i64);
        // Cells that are whole, if there are any.
        let whole = match first < last {
            true => first as i64..last as i64,
            false => right..right,
        };
        self.add_whole(sum, whole.clone(), row);
        for column in (left..whole.start).chain(whole.end..right) {
            let at = DVec2::new(column as f64, top);
            let cell = band.cut(|p| p.x - at.x).cut(|p| at.x + 1.0 - p.x);
            self.add_part(sum, &cell, [column, row], at);
        }
    }

    /// Adds whole cells of a row: of each a quarter of the four texels around it.
    fn add_whole(&self, sum: &mut Integral, columns: std::ops::Range<i64>, row: i64) {
        if columns.is_empty() {
            return;
        }
        for y in [row, row + 1] {
            let texel = |column: i64| self.color(self.place([column, y]));
            let ends = texel(columns.start) + texel(columns.end);
            let between = (columns.start + 1..columns.end).map(texel);
            sum.light += 0.25 * ends + 0.5 * between.sum::<DVec3>();
        }
        sum.area += (columns.end - columns.start) as f64;
    }

    /// Adds a part of a cell, whose first texel is at `at`.
    fn add_part(&self, sum: &mut Integral, part: &Polygon, [column, row]: [i64; 2], at: DVec2) {
        // Integrals of 1, x, y and x y within the cell.
        let [area, x, y, xy] = part.moments(at);
        if area <= 0.0 {
            return;
        }
        let texel = |i: i64, j: i64| self.color(self.place([column + i, row + j]));
        sum.light += texel(0, 0) * (area - x - y + xy)
            + texel(1, 0) * (x - xy)
            + texel(0, 1) * (y - xy)
            + texel(1, 1) * xy;
        sum.area += area;
    }

    /// The mean of many points, where a triangle is a line in a texture, or too far away.
    fn mean_of_points(&self, uvs: [DVec2; 3]) -> DVec3 {
        const POINTS: u64 = 1024;
        let [a, b, c] = uvs;
        let point = |i: u64| {
            let w = sampling::triangle(sampling::r2(i, [0.5; 2])).map(f64::from);
            let uv: Vec2 = (a * w[0] + b * w[1] + c * w[2]).as_vec2();
            Vec3::from(self.sample(uv)).as_dvec3()
        };
        (0..POINTS).map(point).sum::<DVec3>() / POINTS as f64
    }
}

/// An integral over an area.
#[derive(Default)]
struct Integral {
    light: DVec3,
    area: f64,
}

/// A convex polygon: a triangle cut by four lines.
#[derive(Clone, Copy)]
struct Polygon {
    corners: [DVec2; 8],
    len: usize,
}

impl Polygon {
    fn of(corners: &[DVec2]) -> Self {
        let mut out = Self {
            corners: [DVec2::ZERO; 8],
            len: 0,
        };
        corners.iter().for_each(|c| out.push(*c));
        out
    }

    fn push(&mut self, p: DVec2) {
        if self.len < self.corners.len() {
            self.corners[self.len] = p;
            self.len += 1;
        }
    }

    fn corners(&self) -> &[DVec2] {
        &self.corners[..self.len]
    }

    /// The part where `height`, which is linear, is not negative.
    fn cut(&self, height: impl Fn(DVec2) -> f64) -> Self {
        let mut out = Self::of(&[]);
        for (i, &a) in self.corners().iter().enumerate() {
            let b = self.corners[(i + 1) % self.len];
            let (ha, hb) = (height(a), height(b));
            if ha >= 0.0 {
                out.push(a);
            }
            if (ha > 0.0 && hb < 0.0) || (ha < 0.0 && hb > 0.0) {
                out.push(a + (b - a) * (ha / (ha - hb)));
            }
        }
        out
    }

    /// Integrals of 1, x, y and x y, both from `at`.
    fn moments(&self, at: DVec2) -> [f64; 4] {
        let mut sums = [0.0; 4];
        let Some((first, rest)) = self.corners().split_first() else {
            return sums;
        };
        let a = *first - at;
        for pair in rest.windows(2) {
            let (b, c) = (pair[0] - at, pair[1] - at);
            let area = 0.5 * (b - a).perp_dot(c - a).abs();
            // Middles of sides are exact up to squares.
            for p in [a + b, b + c, c + a].map(|p| 0.5 * p) {
                let part = area / 3.0;
                let of = [part, part * p.x, part * p.y, part * p.x * p.y];
                sums = std::array::from_fn(|i| sums[i] + of[i]);
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Wrap;

    fn noise(width: u32, height: u32) -> Texture {
        let number = |i: u64, k: u64| sampling::unit(sampling::hash(&[i, k]));
        let texel = |i: u64| [number(i, 0).powi(3), number(i, 1), 0.25];
        let count = u64::from(width * height);
        Texture::new(width, height, (0..count).map(texel).collect())
    }

    /// Beside the mean of many points; triangles smaller than a texel, as large as the texture, and
    /// beyond its borders.
    #[test]
    fn means_are_those_of_points() {
        let number = |i: u64, k: u64| f64::from(sampling::unit(sampling::hash(&[9, i, k])));
        for wrap in [Wrap::Repeat, Wrap::Clamp, Wrap::Mirror] {
            let mut texture = noise(12, 7);
            texture.wrap = [wrap, Wrap::Mirror];
            for i in 0..60 {
                let size = [0.03, 0.4, 2.5][i as usize % 3];
                let middle = 3.0 * DVec2::new(number(i, 0), number(i, 1)) - 1.0;
                let uvs: [DVec2; 3] = std::array::from_fn(|k| {
                    let k = 2 * k as u64;
                    middle + size * (DVec2::new(number(i, 2 + k), number(i, 3 + k)) - 0.5)
                });
                let [a, b, c] = uvs;
                let mut expected = DVec3::ZERO;
                const POINTS: u64 = 20_000;
                for j in 0..POINTS {
                    let w = sampling::triangle(sampling::r2(j, [0.5; 2])).map(f64::from);
                    let uv = (a * w[0] + b * w[1] + c * w[2]).as_vec2();
                    expected += Vec3::from(texture.sample(uv)).as_dvec3() / POINTS as f64;
                }
                let found = texture.mean_within(uvs);
                let off = (found - expected).abs().max_element();
                assert!(off < 1e-3, "{wrap:?} {i}: {found} {expected}");
                assert!((found.z - 0.25).abs() < 1e-12, "{found}");
            }
        }
    }

    #[test]
    fn two_halves_of_a_texture_are_all_of_it() {
        let texture = noise(33, 20);
        let corners = [DVec2::ZERO, DVec2::X, DVec2::ONE, DVec2::Y];
        let half = |k: usize| texture.mean_within([corners[0], corners[k], corners[k + 1]]);
        let texels = texture.texels();
        let sum = texels.fold(DVec3::ZERO, |sum, t| sum + Vec3::from(t).as_dvec3());
        let off = 0.5 * (half(1) + half(2)) - sum / (33.0 * 20.0);
        assert!(off.abs().max_element() < 1e-12, "{off}");
        assert_eq!(
            texture.texels_within([corners[0], corners[1], corners[2]]),
            330.0
        );
    }

    #[test]
    fn points_and_lines_of_a_texture_have_a_mean() {
        let texture = noise(8, 8);
        let point = DVec2::new(0.3, 0.7);
        let expected = Vec3::from(texture.sample(point.as_vec2())).as_dvec3();
        let off = texture.mean_within([point; 3]) - expected;
        assert!(off.abs().max_element() < 1e-6, "{off}");
        let line = texture.mean_within([point, point + 0.5 * DVec2::X, point + DVec2::X]);
        assert!((line.z - 0.25).abs() < 1e-6 && line.x > 0.0, "{line}");
        let far = texture.mean_within([point, point + 1e9 * DVec2::X, point + 1e9 * DVec2::Y]);
        assert!(far.is_finite());
        let often = texture.mean_within([point, point + 9e4 * DVec2::X, point + 9e4 * DVec2::Y]);
        assert!((often.z - 0.25).abs() < 1e-9);
    }
}
