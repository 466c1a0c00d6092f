//! The rays of one direction of a sweep.

use super::{MediaBox, Scope};
use crate::Result;
use crate::gather::{Medium, Pages};
use crate::math::Rgb;
use crate::math::dda::leave_box;
use crate::math::exp::exp_neg_and_rest;
use crate::math::segment::Segment;
use crate::math::sheared::Sheared;
use crate::shade::media::sparse::SparseLattice;
use crate::trace::offset;
use glam::Vec3;

/// Rays in a row from which a vertex takes its light.
const TAPS: usize = 4;

/// What arrives at a vertex from one direction: the medium's own light, and the share of light from beyond.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arriving {
    pub radiance: Rgb,
    pub transmittance: f32,
}

/// Parallel rays through a volume, between which vertices interpolate.
pub struct Rays<'a, P, M> {
    scope: &'a Scope<'a, P, M>,
    set: &'a SparseLattice,
    /// Unit direction against the light.
    direction: Vec3,
    rays: Sheared,
    media: &'a MediaBox,
}

impl<'a, P: Pages, M: Medium> Rays<'a, P, M> {
    /// Those along a unit `direction` of scene space, against the light, for vertices `step` voxels apart.
    pub fn new(
        scope: &'a Scope<'a, P, M>,
        set: &'a SparseLattice,
        step: usize,
        direction: Vec3,
        media: &'a MediaBox,
    ) -> Self {
        Self {
            scope,
            set,
            direction,
            rays: Self::along(scope, step, direction),
            media,
        }
    }

    fn along(scope: &Scope<P, M>, step: usize, direction: Vec3) -> Sheared {
        let d = scope.volume.index_from_scene.transform_vector3(direction);
        Sheared::new(d, step as f32)
    }

    /// Bytes that passing those along a direction takes, but for what arrives at the vertices.
    pub fn bytes(scope: &Scope<P, M>, set: &SparseLattice, step: usize, direction: Vec3) -> u64 {
        let rays = Self::along(scope, step, direction);
        let [(_, nu), (_, nw)] = rays.extent(set.bounds());
        let layers = set.count()[rays.axes[0]];
        let words = (nu as u64)
            .saturating_mul(nw as u64)
            .saturating_mul(layers.div_ceil(64) as u64);
        let shares = (layers * size_of::<Shares>()) as u64;
        words
            .saturating_mul(size_of::<u64>() as u64)
            .saturating_add(shares)
    }

    /// Passes all rays that any vertex needs, and returns what arrives at the vertices.
    ///
    /// # Errors
    /// If cancelled.
    pub fn pass(&self) -> Result<Vec<Arriving>> {
        let [(u0, nu), (w0, nw)] = self.rays.extent(self.set.bounds());
        let words = self.layers().div_ceil(64);
        let shares: Vec<Shares> = (0..self.layers())
            .map(|l| Shares::new(&self.rays, l))
            .collect();
        // By ray, a bit for each layer in which a vertex needs it.
        let mut needed = vec![0_u64; nu * nw * words];
        for v in self.set.vertices() {
            let [layer, x, y] = self.rays.axes.map(|a| v[a]);
            let [column, row] = shares[layer].first_ray([x, y]);
            for row in row..row + TAPS as i32 {
                for column in column..column + TAPS as i32 {
                    let ray = (row - w0) as usize * nu + (column - u0) as usize;
                    needed[ray * words + layer / 64] |= 1 << (layer % 64);
                }
            }
        }
        let mut at_vertices = vec![Arriving::default(); self.set.len()];
        let mut stops = Vec::new();
        for (i, needed) in needed.chunks_exact(words).enumerate() {
            self.scope.job.cancel.check()?;
            stops.clear();
            for (word, &bits) in needed.iter().enumerate() {
                let mut bits = bits;
                while bits != 0 {
                    stops.push(word * 64 + bits.trailing_zeros() as usize);
                    bits &= bits - 1;
                }
            }
            if !stops.is_empty() {
                if self.rays.upwards {
                    stops.reverse();
                }
                let ray = [(i % nu) as i32 + u0, (i / nu) as i32 + w0];
                self.pass_one(ray.map(|c| c as f32), &stops, |layer, light| {
                    self.leave(ray, layer, &shares[layer], light, &mut at_vertices);
                });
            }
        }
        // Beside an edge a cubic swings below it.
        for light in &mut at_vertices {
            light.radiance = Rgb(light.radiance.0.map(|c| c.max(0.0)));
            light.transmittance = light.transmittance.clamp(0.0, 1.0);
        }
        Ok(at_vertices)
    }

    /// Leaves what a ray brings to a layer at the vertices around it there, each of which takes its share from rays on all
    /// sides.
    #[inline]
    fn leave(
        &self,
        ray: [i32; 2],
        layer: usize,
        shares: &Shares,
        light: Arriving,
        at_vertices: &mut [Arriving],
    ) {
        let [_, u, w] = self.rays.axes;
        let count = self.set.count();
        let mut v = [layer; 3];
        for (y, share_y) in shares.around(1, ray[1], count[w]) {
            v[w] = y;
            for (x, share_x) in shares.around(0, ray[0], count[u]) {
                v[u] = x;
                if let Some(i) = self.set.index(v) {
                    let weight = share_x * share_y;
                    at_vertices[i].radiance += light.radiance * weight;
                    at_vertices[i].transmittance += light.transmittance * weight;
                }
            }
        }
    }

    /// Layers of vertices.
    fn layers(&self) -> usize {
        self.set.count()[self.rays.axes[0]]
    }

    /// Passes one ray, and tells what it brings to some layers, in the order of travel.
    fn pass_one(&self, at: [f32; 2], stops: &[usize], mut arrive: impl FnMut(usize, Arriving)) {
        // The whole ray is the same whatever part of it is needed.
        let first = if self.rays.upwards {
            self.layers() - 1
        } else {
            0
        };
        let first_point = self.scope.to_scene(self.rays.point(at, first));
        // From the box of this volume on, however far others reach: stops far from the origin would lose their digits.
        let beyond = leave_box(first_point, self.direction, self.media.own);
        let origin = first_point + self.direction * beyond;
        let stop_at = |i: usize| {
            let stop = stops.get(i);
            stop.map_or(f32::INFINITY, |&layer| {
                beyond + layer.abs_diff(first) as f32 * self.rays.between
            })
        };
        // A layer further than any stop: whether a surface in a layer is met must not depend on which stop is the last.
        let end = stop_at(stops.len() - 1) + self.rays.between;
        let mut cuts = if self.media.has_walls {
            self.walls(origin, end)
        } else {
            Vec::new()
        };
        cuts.reverse();

        let mut light = self.light_of_other_media(origin);
        let mut next = 0;
        let mut add = |mut s: Segment| {
            let mut next_at = stop_at(next);
            while next < stops.len() {
                let cut = cuts.last().is_some_and(|&c| c <= next_at);
                let t = if cut { cuts[cuts.len() - 1] } else { next_at };
                if t >= s.far {
                    break;
                }
                let share = ((t - s.near) / (s.far - s.near)).max(0.0);
                if cut {
                    if share > 0.0 {
                        s.tau *= 1.0 - share;
                        s.near = t;
                    }
                    cuts.pop();
                    light = Arriving::NONE_YET;
                } else {
                    // Of a copy: what the ray goes on with must not depend on where it is asked.
                    let mut here = light;
                    if share > 0.0 {
                        here.pass(s.tau * share, s.source);
                    }
                    arrive(stops[next], here);
                    next += 1;
                    next_at = stop_at(next);
                }
            }
            light.pass(s.tau, s.source);
            next < stops.len()
        };
        self.scope
            .gatherer
            .media
            .walk(origin, -self.direction, f32::INFINITY, &mut add);
        // What is left of the ray is empty.
        add(Segment {
            near: f32::INFINITY,
            far: f32::INFINITY,
            tau: 0.0,
            source: Rgb::BLACK,
        });
    }

    /// What a ray brings with it from media around this volume, to where it enters its box.
    fn light_of_other_media(&self, origin: Vec3) -> Arriving {
        let mut light = Arriving::NONE_YET;
        if self.media.bounds == self.media.own {
            return light;
        }
        let mut way = leave_box(origin, self.direction, self.media.bounds);
        if self.media.has_walls
            && let Some(hit) = self.scope.view.tracer.closest(origin, self.direction, way)
        {
            way = hit.t;
        }
        // Against the light, so that what is near is as exact as it is far from all ends of the others.
        let mut add = |s: Segment| {
            light.pass_behind(s.tau, s.source);
            true
        };
        let media = &self.scope.gatherer.media;
        media.walk(origin, self.direction, way, &mut add);
        light
    }

    /// Distances at which a ray passes surfaces.
    fn walls(&self, origin: Vec3, end: f32) -> Vec<f32> {
        let tracer = self.scope.view.tracer;
        let mut walls = Vec::new();
        let mut t = 0.0;
        loop {
            let from = origin - self.direction * t;
            let Some(hit) = tracer.closest(from, -self.direction, end - t) else {
                break;
            };
            walls.push(t + hit.t);
            // Rays may meet walls at a slant.
            t += hit.t + 4.0 * offset(origin).max(offset(from));
        }
        walls
    }
}

/// The vertices of one layer around a ray there, and their shares of it: the same for all rays, which are whole steps apart.
///
/// They are those of a cubic through four rays in a row (Keys 1981): light is brightest a little way into a medium that is
/// lit from outside, and straight lines would cut off that crest.
#[derive(Debug)]
struct Shares {
    /// Along both axes across, the first of them, counted from the ray.
    first: [i32; 2],
    shares: [[f32; TAPS]; 2],
}

impl Shares {
    fn new(rays: &Sheared, layer: usize) -> Self {
        let at = rays.across([0.0; 2], layer as f32);
        let first = at.map(|c| c.floor() as i32 - 1);
        let share = |d: f32| {
            if d < 1.0 {
                (1.5 * d - 2.5) * d * d + 1.0
            } else if d < 2.0 {
                ((-0.5 * d + 2.5) * d - 4.0) * d + 2.0
            } else {
                0.0
            }
        };
        let shares = std::array::from_fn(|a| {
            std::array::from_fn(|i| share(((first[a] + i as i32) as f32 - at[a]).abs()))
        });
        Self { first, shares }
    }

    /// The first ray along both axes that one of these vertices takes light from.
    fn first_ray(&self, vertex: [usize; 2]) -> [i32; 2] {
        std::array::from_fn(|a| vertex[a] as i32 - self.first[a] - (TAPS as i32 - 1))
    }

    /// Those along an axis that are among `count` vertices.
    #[inline]
    fn around(&self, axis: usize, ray: i32, count: usize) -> impl Iterator<Item = (usize, f32)> {
        let first = ray + self.first[axis];
        let shares = self.shares[axis];
        (0..TAPS).filter_map(move |i| {
            let at = usize::try_from(first + i as i32).ok()?;
            (at < count).then_some((at, shares[i]))
        })
    }
}

impl Arriving {
    /// Of a ray that has passed nothing.
    const NONE_YET: Self = Self {
        radiance: Rgb::BLACK,
        transmittance: 1.0,
    };

    /// Adds a medium that the light passed before all that it has passed.
    #[inline]
    fn pass_behind(&mut self, tau: f32, source: Rgb) {
        let (through, taken) = exp_neg_and_rest(tau);
        self.radiance += source * (self.transmittance * taken);
        self.transmittance *= through;
    }

    /// Passes a medium on the way towards the vertex.
    #[inline]
    fn pass(&mut self, tau: f32, source: Rgb) {
        let (through, taken) = exp_neg_and_rest(tau);
        self.radiance = self.radiance * through + source * taken;
        self.transmittance *= through;
    }
}
