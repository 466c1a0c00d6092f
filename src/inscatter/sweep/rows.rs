//! What arrives at vertices between the rays of one direction, row by row of rays.
//!
//! All rays are whole steps apart, so that in a layer all vertices stand between them alike: four
//! by four rays and their weights are found once a layer, and four rows of rays are all that has to
//! be held.

use crate::Result;
use crate::inscatter::sparse::SparseLattice;
use crate::math::lanes::Lanes;
use crate::math::ray_lattice::RayLattice;
use crate::math::{Rgb, Spectrum};
use wide::f32x4;

/// Rays in a row from which a vertex takes its light.
pub const TAPS: usize = 4;

/// What arrives at a vertex from one direction: the medium's own light, and the share of light from
/// beyond.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Arriving<K = f32> {
    pub radiance: Rgb,
    pub transmittance: K,
}

/// The rows of rays of one direction, and the vertices that they serve.
pub struct RayRows<'a> {
    set: &'a SparseLattice,
    rays: &'a RayLattice,
    /// First vertex and number of vertices by axis of the rays: along them, in a row, across rows.
    first: [usize; 3],
    count: [usize; 3],
    /// By layer.
    taps: Vec<Taps>,
    /// Words of 64 vertices in a row.
    words: usize,
    /// By layer and row, a bit for each vertex that is in the set.
    vertices: Vec<u64>,
}

impl<'a> RayRows<'a> {
    /// Rays along a direction, between which the vertices of a set stand.
    pub fn new(set: &'a SparseLattice, rays: &'a RayLattice) -> Self {
        let [first, count] = extent(set, rays);
        let words = count[1].div_ceil(64);
        let mut vertices = vec![0; count[0] * count[2] * words];
        for v in set.vertices() {
            let [layer, x, y] = std::array::from_fn(|a| v[rays.axes[a]] - first[a]);
            vertices[(layer * count[2] + y) * words + x / 64] |= 1 << (x % 64);
        }
        Self {
            set,
            rays,
            first,
            count,
            taps: (0..count[0])
                .map(|l| Taps::new(rays, first[0] + l))
                .collect(),
            words,
            vertices,
        }
    }

    /// Bytes that those and [`Self::pass`] take, but for what arrives at the vertices.
    pub fn bytes<K: Spectrum>(set: &SparseLattice, rays: &RayLattice) -> u64 {
        let [_, [layers, columns, rows]] = extent(set, rays).map(|n| n.map(|n| n as u64));
        let [(_, across), _] = rays.extent(set.bounds());
        let of_vertices = layers * rows * columns.div_ceil(64) + columns / 64 + 1;
        let of_rays = across as u64 * layers.div_ceil(64);
        let held = TAPS as u64 * layers * (columns + TAPS as u64 - 1);
        size_of::<u64>() as u64 * (of_vertices + of_rays)
            + size_of::<K::Lanes>() as u64 * held
            + size_of::<Taps>() as u64 * layers
    }

    /// What arrives at the vertices. `pass(ray, layers, arrive)` passes a ray and tells `arrive`
    /// what it brings to each of some layers, which are in the order of travel.
    ///
    /// # Errors
    /// That of `pass`.
    pub fn pass<K: Spectrum>(
        &self,
        mut pass: impl FnMut([i32; 2], &[usize], &mut dyn FnMut(usize, Arriving<K>)) -> Result<()>,
    ) -> Result<Vec<Arriving<K>>> {
        let mut at_vertices = vec![Arriving::default(); self.set.len()];
        if at_vertices.is_empty() {
            return Ok(at_vertices);
        }
        let [(u0, nu), (w0, nw)] = self.rays.extent(self.set.bounds());
        let width = self.count[1] + TAPS - 1;
        // Of the last rows, what their rays bring to each layer, from the first that a vertex there
        // needs.
        let mut held = vec![K::Lanes::default(); TAPS * self.count[0] * width];
        let place = |row: i32, layer: usize| {
            (row.rem_euclid(TAPS as i32) as usize * self.count[0] + layer) * width
        };
        // By ray, a bit for each layer in which a vertex needs it.
        let words = self.count[0].div_ceil(64);
        let mut needed = vec![0_u64; nu * words];
        let mut in_layer = vec![0_u64; width.div_ceil(64)];
        let mut stops = Vec::new();
        for row in w0..w0 + nw as i32 {
            needed.fill(0);
            for layer in 0..self.count[0] {
                if !self.needed_rays(layer, row, &mut in_layer) {
                    continue;
                }
                let first = (self.first_ray(layer) - u0) as usize;
                for x in ones(&in_layer) {
                    needed[(first + x) * words + layer / 64] |= 1 << (layer % 64);
                }
            }
            for (column, needed) in needed.chunks_exact(words).enumerate() {
                stops.clear();
                stops.extend(ones(needed).map(|layer| self.first[0] + layer));
                if stops.is_empty() {
                    continue;
                }
                if self.rays.upwards {
                    stops.reverse();
                }
                let column = u0 + column as i32;
                pass([column, row], &stops, &mut |layer, light| {
                    let layer = layer - self.first[0];
                    let x = (column - self.first_ray(layer)) as usize;
                    held[place(row, layer) + x] = light.lanes();
                })?;
            }
            for layer in 0..self.count[0] {
                let taps = &self.taps[layer];
                let Some(y) = self.row_of_vertices(row + taps.first[1]) else {
                    continue;
                };
                let held: [&[K::Lanes]; TAPS] = std::array::from_fn(|i| {
                    &held[place(row - (TAPS - 1 - i) as i32, layer)..][..width]
                });
                let mut v = [0; 3];
                v[self.rays.axes[0]] = self.first[0] + layer;
                v[self.rays.axes[2]] = self.first[2] + y;
                for x in ones(self.vertices_of(layer, y)) {
                    v[self.rays.axes[1]] = self.first[1] + x;
                    if let Some(i) = self.set.index(v) {
                        at_vertices[i] = taps.between(held.map(|row| &row[x..x + TAPS]));
                    }
                }
            }
        }
        Ok(at_vertices)
    }

    /// Notes which rays of a row vertices of a layer need, from the first ray that one there may
    /// need; returns whether any.
    fn needed_rays(&self, layer: usize, row: i32, needed: &mut [u64]) -> bool {
        let mut any = 0;
        needed.fill(0);
        for i in 0..TAPS as i32 {
            let Some(y) = self.row_of_vertices(row + self.taps[layer].first[1] + i) else {
                continue;
            };
            for (needed, vertices) in needed.iter_mut().zip(self.vertices_of(layer, y)) {
                *needed |= vertices;
                any |= vertices;
            }
        }
        if any != 0 {
            let mut before = 0;
            for word in needed {
                let bits = u128::from(*word) << 64 | u128::from(before);
                before = *word;
                *word = (0..TAPS).fold(0, |sum, i| sum | (bits << i >> 64) as u64);
            }
        }
        any != 0
    }

    /// The first ray of a row that a vertex of a layer may need.
    #[inline]
    fn first_ray(&self, layer: usize) -> i32 {
        self.first[1] as i32 - self.taps[layer].first[0] - (TAPS as i32 - 1)
    }

    /// A row of vertices, counted from the first.
    #[inline]
    fn row_of_vertices(&self, row: i32) -> Option<usize> {
        let y = usize::try_from(row - self.first[2] as i32).ok()?;
        (y < self.count[2]).then_some(y)
    }

    /// A bit for each vertex of a row that is in the set.
    #[inline]
    fn vertices_of(&self, layer: usize, y: usize) -> &[u64] {
        &self.vertices[(layer * self.count[2] + y) * self.words..][..self.words]
    }
}

/// First vertex of a set and number of vertices up to the last, by axis of the rays.
fn extent(set: &SparseLattice, rays: &RayLattice) -> [[usize; 3]; 2] {
    let [first, last] = set.bounds().map(|v| rays.axes.map(|a| v[a]));
    let count = std::array::from_fn(|a| (last[a] + 1).saturating_sub(first[a]));
    [first, count]
}

/// Where bits are 1.
fn ones(words: &[u64]) -> impl Iterator<Item = usize> {
    words.iter().enumerate().flat_map(|(i, &word)| {
        let mut bits = word;
        std::iter::from_fn(move || {
            (bits != 0).then(|| {
                let at = i * 64 + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                at
            })
        })
    })
}

/// Which rays serve a vertex of one layer, and by which weights: the same for all vertices there.
///
/// Light between them is a cubic through four rays in a row (Keys 1981): it is brightest a little
/// way into a medium that is lit from outside, and straight lines would cut off that crest.
#[derive(Debug)]
pub struct Taps {
    /// Along both axes across, the first vertex that a ray serves, counted from the ray.
    first: [i32; 2],
    /// Weights of the rays that serve a vertex, from the first.
    weights: [[f32x4; TAPS]; 2],
}

impl Taps {
    /// Those of a layer.
    pub fn new(rays: &RayLattice, layer: usize) -> Self {
        let at = rays.across([0.0; 2], layer as f32);
        let first = at.map(|c| c.floor() as i32 - 1);
        let weight = |d: f32| {
            if d < 1.0 {
                (1.5 * d - 2.5) * d * d + 1.0
            } else if d < 2.0 {
                ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
            } else {
                0.0
            }
        };
        let weights = std::array::from_fn(|a| {
            std::array::from_fn(|i| {
                let vertex = first[a] + (TAPS - 1 - i) as i32;
                f32x4::splat(weight((vertex as f32 - at[a]).abs()))
            })
        });
        Self { first, weights }
    }

    /// Along both axes across, the first ray that serves a vertex.
    #[inline]
    pub fn first_rays(&self, vertex: [i32; 2]) -> [i32; 2] {
        std::array::from_fn(|a| vertex[a] - self.first[a] - (TAPS as i32 - 1))
    }

    /// What arrives at a vertex, given what the rays of each row bring that serve it.
    #[inline]
    pub fn between<K: Spectrum>(&self, rows: [&[K::Lanes]; TAPS]) -> Arriving<K> {
        let [along, across] = &self.weights;
        let mut sum = K::Lanes::default();
        for (row, across) in rows.iter().zip(across) {
            let mut of_row = K::Lanes::default();
            for (light, along) in row.iter().zip(along) {
                of_row += *light * *along;
            }
            sum += of_row * *across;
        }
        // Beside an edge a cubic swings below it.
        let (radiance, transmittance) = sum.parts();
        Arriving {
            radiance: Rgb(radiance.0.map(|c| c.max(0.0))),
            transmittance: transmittance.each(|t| t.clamp(0.0, 1.0)),
        }
    }
}

impl<K: Spectrum> Arriving<K> {
    /// The same in lanes.
    #[inline]
    pub fn lanes(self) -> K::Lanes {
        K::Lanes::new(self.radiance, self.transmittance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use glam::Vec3;

    /// What a ray brings to a layer, by its number.
    fn brought([u, w]: [i32; 2], layer: usize) -> Arriving {
        let channel = |c: u64| {
            let hash = sampling::hash(&[u as u64, w as u64, layer as u64, c]);
            sampling::unit(hash)
        };
        Arriving {
            radiance: Rgb([0, 1, 2].map(channel)),
            transmittance: channel(3),
        }
    }

    /// The same as [`RayRows::pass`], vertex by vertex.
    fn plain(set: &SparseLattice, rays: &RayLattice) -> Vec<Arriving> {
        let keys = |d: f64| match d.abs() {
            d if d < 1.0 => 1.5 * d.powi(3) - 2.5 * d.powi(2) + 1.0,
            d if d < 2.0 => -0.5 * d.powi(3) + 2.5 * d.powi(2) - 4.0 * d + 2.0,
            _ => 0.0,
        };
        let at = |v: [usize; 3]| {
            let (_, across) = rays.place(v.map(|c| c as f32));
            let layer = v[rays.axes[0]];
            let mut sums = [0.0; 4];
            let near = across.map(|c| c.round() as i32 - 3..c.round() as i32 + 4);
            for w in near[1].clone() {
                for u in near[0].clone() {
                    let weight = keys(f64::from(u as f32 - across[0]))
                        * keys(f64::from(w as f32 - across[1]));
                    let light = brought([u, w], layer);
                    let [r, g, b] = light.radiance.0;
                    for (sum, c) in sums.iter_mut().zip([r, g, b, light.transmittance]) {
                        *sum += weight * f64::from(c);
                    }
                }
            }
            let [r, g, b, transmittance] = sums.map(|sum| sum as f32);
            Arriving {
                radiance: Rgb([r, g, b].map(|c| c.max(0.0))),
                transmittance: transmittance.clamp(0.0, 1.0),
            }
        };
        set.vertices().map(at).collect()
    }

    fn set(count: [usize; 3], is_chosen: impl Fn([usize; 3]) -> bool) -> SparseLattice {
        SparseLattice::new(count, |choose| {
            for i in 0..count.iter().product() {
                let v = crate::math::unflatten(i, count);
                if is_chosen(v) {
                    choose(v);
                }
            }
        })
    }

    fn passed(set: &SparseLattice, rays: &RayLattice) -> (Vec<Arriving>, usize) {
        let mut asked = 0;
        let found = RayRows::new(set, rays).pass(|ray, layers, arrive| {
            asked += layers.len();
            let in_order = |l: &[usize]| (l[0] > l[1]) == rays.upwards && l[0] != l[1];
            assert!(layers.windows(2).all(in_order), "{layers:?}");
            layers.iter().for_each(|&l| arrive(l, brought(ray, l)));
            Ok(())
        });
        (found.unwrap(), asked)
    }

    const DIRECTIONS: [Vec3; 5] = [
        Vec3::new(0.9, 0.3, -0.2),
        Vec3::new(0.5, -2.0, 0.7),
        Vec3::new(-0.1, 0.4, -3.0),
        Vec3::new(1.0, 1.0, -1.0),
        Vec3::new(0.0, 0.0, 1.0),
    ];

    #[test]
    fn rows_serve_vertices_like_sixteen_rays_each() {
        for direction in DIRECTIONS {
            let rays = RayLattice::new(direction, 1.0);
            for (count, every) in [([9, 7, 8], 1), ([5, 70, 6], 3), ([70, 5, 67], 11)] {
                let set = set(count, |v| {
                    (v[0] * 5 + v[1] * 3 + v[2]).is_multiple_of(every) && v[0] > 1
                });
                let (found, asked) = passed(&set, &rays);
                assert!(asked <= 16 * set.len());
                for (found, plain) in found.iter().zip(plain(&set, &rays)) {
                    let off = (0..3)
                        .map(|c| (found.radiance.0[c] - plain.radiance.0[c]).abs())
                        .fold((found.transmittance - plain.transmittance).abs(), f32::max);
                    // The place of a vertex among rays is rounded.
                    assert!(off < 3e-5, "{direction} {found:?} {plain:?}");
                }
            }
        }
    }

    #[test]
    fn a_vertex_has_the_same_light_whichever_others_there_are() {
        let count = [9, 11, 10];
        let all = set(count, |_| true);
        let few = set(count, |v| v[0] > 2 && (v[0] + v[1] * v[2]) % 7 == 3);
        for direction in DIRECTIONS {
            let rays = RayLattice::new(direction, 1.0);
            let (of_all, of_few) = (passed(&all, &rays).0, passed(&few, &rays).0);
            for (v, light) in few.vertices().zip(of_few) {
                assert_eq!(all.index(v).map(|i| of_all[i]), Some(light));
            }
        }
    }

    #[test]
    fn nothing_is_passed_for_no_vertices() {
        let rays = RayLattice::new(Vec3::X, 1.0);
        assert_eq!(passed(&set([4; 3], |_| false), &rays), (Vec::new(), 0));
    }
}
