//! Small lamps that are far out of focus: how much of a pixel's samples over the lens meet each, in
//! closed form.
//!
//! Rays through a lens miss a lamp that fills little of its circle of confusion, however bright
//! that is. Here points of the lamp are chosen, each of which a pixel sees through one point of the
//! lens, and rays only tell what stands between.

use super::confusion::Confusion;
use crate::light::{Lights, Shadows};
use crate::math::{Ray, Rgb, Spectrum, sampling};
use crate::scene::Lens;
use crate::trace::{short_of, unit_normal};
use crate::view::View;
use glam::Vec3;

/// Emissive triangles beside each other on the film.
#[derive(Debug)]
struct Lamp {
    /// Middle on the film, pixels from its top left, and half its extent with the circle of
    /// confusion.
    middle: [f32; 2],
    reach: [f32; 2],
    radiance: Rgb,
    /// Corners on the film, and the triangle.
    triangles: Vec<LampTriangle>,
    /// Area on the film up to each triangle, squared pixels.
    areas: Vec<f32>,
}

#[derive(Clone, Copy, Debug)]
struct LampTriangle {
    on_film: [[f32; 2]; 3],
    corner: Vec3,
    normal: Vec3,
}

/// The small lamps of a view that are out of focus.
#[derive(Debug, Default)]
pub struct Lamps {
    lamps: Vec<Lamp>,
    /// Their triangles in order.
    triangles: Vec<u32>,
    /// Numbers of the lamps that each square of the film may show.
    squares: Vec<Vec<u32>>,
    /// Squares in a row.
    width: u32,
}

impl Lamps {
    /// Pixels along the edge of a square of the film.
    const SQUARE: u32 = 16;
    /// Radius of the circle of confusion from which on they are out of focus, pixels.
    const LEAST_RADIUS: f32 = 2.0;
    /// Part of its circle of confusion that a lamp fills at most: more is met by samples.
    const MOST_SHARE: f32 = 0.3;
    /// Points of a lamp for each pixel.
    const POINTS: u32 = 8;

    /// Those of a camera with a lens that stands still; none of others.
    #[must_use]
    pub fn of(view: &View, confusion: &Confusion) -> Self {
        let mut lamps = Self::default();
        if view.camera.lens.is_none() || confusion.moves() {
            return lamps;
        }
        let scene = view.tracer.scene;
        let mut open: Option<(u32, Vec<u32>, Extent)> = None;
        for (t, &material) in (0..).zip(&scene.mesh.material[..]) {
            let of = &scene.materials[material as usize];
            if Rgb(of.emission).is_black() || of.emission_texture.is_some() || !of.is_seen {
                continue;
            }
            let corners = scene.mesh.corners(t as usize);
            let faces = (view.camera.origin() - corners[0]).dot(unit_normal(corners)) > 0.0;
            let extent = Extent::of(view, confusion, corners);
            let Some(extent) = extent.filter(|_| faces || of.emits_both_sides) else {
                continue;
            };
            match &mut open {
                Some((like, triangles, all))
                    if *like == material && all.with(&extent).is_small() =>
                {
                    triangles.push(t);
                    *all = all.with(&extent);
                }
                _ => {
                    if let Some(done) = open.take() {
                        lamps.add(view, done);
                    }
                    open = Some((material, vec![t], extent));
                }
            }
        }
        if let Some(done) = open {
            lamps.add(view, done);
        }
        lamps.triangles.sort_unstable();
        lamps.list([view.film.width, view.film.height]);
        lamps
    }

    /// Adds a lamp, unless samples meet it well.
    fn add(&mut self, view: &View, (material, triangles, extent): (u32, Vec<u32>, Extent)) {
        let scene = view.tracer.scene;
        let pose = view.camera.pose();
        let of = |t: &u32| {
            let corners = scene.mesh.corners(*t as usize);
            let seen = corners.map(|c| pose.on_film(&view.film, c).map_or([0.0; 2], |s| s.0));
            LampTriangle {
                on_film: seen,
                corner: corners[0],
                normal: unit_normal(corners),
            }
        };
        let parts: Vec<LampTriangle> = triangles.iter().map(of).collect();
        let mut sum = 0.0;
        let mut areas = Vec::with_capacity(parts.len());
        for part in &parts {
            let [a, b, c] = part.on_film;
            sum += 0.5 * ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])).abs();
            areas.push(sum);
        }
        let circle = std::f32::consts::PI * extent.radius[0] * extent.radius[0];
        let is_right = extent.is_small() && sum > 0.0 && sum <= Self::MOST_SHARE * circle;
        if !is_right {
            return;
        }
        let Extent { low, high, radius } = extent;
        self.lamps.push(Lamp {
            middle: [0, 1].map(|a| 0.5 * (low[a] + high[a])),
            reach: [0, 1].map(|a| 0.5 * (high[a] - low[a]) + radius[1] + 1.0),
            radiance: Rgb(scene.materials[material as usize].emission),
            triangles: parts,
            areas,
        });
        self.triangles.extend(triangles);
    }

    /// Lists which squares of a film may show which lamps.
    fn list(&mut self, film: [u32; 2]) {
        if self.lamps.is_empty() {
            return;
        }
        let [width, height] = film.map(|n| n.div_ceil(Self::SQUARE));
        self.width = width;
        self.squares = vec![Vec::new(); width as usize * height as usize];
        for (i, lamp) in (0..).zip(&self.lamps) {
            let range = |a: usize, count: u32| {
                let edge = Self::SQUARE as f32;
                let low = ((lamp.middle[a] - lamp.reach[a]) / edge).floor().max(0.0) as u32;
                let high = ((lamp.middle[a] + lamp.reach[a]) / edge).floor().max(-1.0) + 1.0;
                low..(high as u32).min(count)
            };
            for row in range(1, height) {
                for column in range(0, width) {
                    self.squares[(row * width + column) as usize].push(i);
                }
            }
        }
    }

    /// Triangles whose light is told here and not by rays that meet them, in order.
    #[must_use]
    pub fn triangles(&self) -> &[u32] {
        &self.triangles
    }

    /// The lamps that a pixel may show.
    fn before(&self, x: u32, y: u32) -> impl Iterator<Item = (u32, &Lamp)> {
        let square = y / Self::SQUARE * self.width + x / Self::SQUARE;
        let listed = self.squares.get(square as usize).map_or(&[][..], |l| l);
        let at = [x as f32 + 0.5, y as f32 + 0.5];
        let lamps = listed.iter().map(|&i| (i, &self.lamps[i as usize]));
        lamps.filter(move |(_, lamp)| {
            [0, 1]
                .into_iter()
                .all(|a| (at[a] - lamp.middle[a]).abs() <= lamp.reach[a])
        })
    }

    /// Whether a pixel may show any.
    #[must_use]
    pub fn may_be_in(&self, x: u32, y: u32) -> bool {
        self.before(x, y).next().is_some()
    }

    /// Mean radiance over a pixel and the lens of all of them, through what is before them.
    #[must_use]
    pub fn seen<S: Shadows>(&self, view: &View, lights: &Lights<S>, x: u32, y: u32) -> Rgb {
        let mut seen = Rgb::BLACK;
        let Some(lens) = view.camera.lens else {
            return seen;
        };
        for (number, lamp) in self.before(x, y) {
            let key = [view.seed, 13, x.into(), y.into(), number.into()];
            let seed = sampling::hash(&key) as u32;
            let points = 0..Self::POINTS;
            let weights = points.map(|i| lamp.weight(view, lights, lens, [x, y], i, seed));
            let sum = weights.fold(S::Share::default(), |sum, weight| sum + weight);
            seen += sum
                .each(|sum| sum / Self::POINTS as f32)
                .filter(lamp.radiance);
        }
        seen
    }
}

impl Lamp {
    /// What point `i` of the lamp adds to a pixel, for a radiance of 1.
    fn weight<S: Shadows>(
        &self,
        view: &View,
        lights: &Lights<S>,
        lens: Lens,
        [x, y]: [u32; 2],
        i: u32,
        seed: u32,
    ) -> S::Share {
        let [u, v, a, b] = sampling::sobol4(i, 0, seed);
        let all = self.areas.last().copied().unwrap_or(0.0);
        let target = a * all;
        let chosen = (self.areas.partition_point(|area| *area <= target)).min(self.areas.len() - 1);
        let below = chosen.checked_sub(1).map_or(0.0, |i| self.areas[i]);
        let own = (self.areas[chosen] - below).max(f32::MIN_POSITIVE);
        let part = &self.triangles[chosen];
        let w = sampling::triangle([((target - below) / own).clamp(0.0, 0.999_999), b]);
        let [p, q, r] = part.on_film;
        let at = [0, 1].map(|k| p[k] * w[0] + q[k] * w[1] + r[k] * w[2]);
        let middle = view.camera.origin();
        let toward = view.camera.direction(&view.film, at[0], at[1]);
        let distance = (part.corner - middle).dot(part.normal) / toward.dot(part.normal);
        if !(distance > 0.0 && distance.is_finite()) {
            return S::Share::default();
        }
        let point = middle + toward * distance;
        let depth = (point - middle).dot(view.camera.axis());
        // Pixels on the film for a unit of the lens.
        let scale = (1.0 / lens.focus_distance - 1.0 / depth) / view.pixel_angle;
        let on_lens = [
            (at[0] - x as f32 - u) / scale,
            -(at[1] - y as f32 - v) / scale,
        ]
        .map(|c| -c);
        let squared = on_lens[0] * on_lens[0] + on_lens[1] * on_lens[1];
        if squared > lens.aperture * lens.aperture {
            return S::Share::default();
        }
        let place = view.camera.scene_from_camera;
        let from = place.transform_point3(Vec3::new(on_lens[0], on_lens[1], 0.0));
        let way = point - from;
        let length = way.length();
        let direction = way / length;
        let through =
            lights.seen_transmittance(&Ray::new(from, direction, short_of(point, length)));
        let radius = lens.aperture * scale;
        through.each(|through| through * all / (std::f32::consts::PI * radius * radius))
    }
}

/// What triangles cover of the film.
#[derive(Clone, Copy, Debug)]
struct Extent {
    low: [f32; 2],
    high: [f32; 2],
    /// The least and the largest radius of their circles of confusion.
    radius: [f32; 2],
}

impl Extent {
    /// Of a triangle, if all of it is ahead.
    fn of(view: &View, confusion: &Confusion, corners: [Vec3; 3]) -> Option<Self> {
        let mut extent = Self {
            low: [f32::INFINITY; 2],
            high: [f32::NEG_INFINITY; 2],
            radius: [f32::INFINITY, 0.0],
        };
        let pose = view.camera.pose();
        for corner in corners {
            let (at, _) = pose.on_film(&view.film, corner)?;
            let radius = confusion.radius(corner);
            let own = Self {
                low: at,
                high: at,
                radius: [radius; 2],
            };
            extent = extent.with(&own);
        }
        Some(extent)
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            low: [0, 1].map(|a| self.low[a].min(other.low[a])),
            high: [0, 1].map(|a| self.high[a].max(other.high[a])),
            radius: [
                self.radius[0].min(other.radius[0]),
                self.radius[1].max(other.radius[1]),
            ],
        }
    }

    /// Whether they are out of focus alike, and no wider than that spreads them.
    fn is_small(&self) -> bool {
        let [least, most] = self.radius;
        let wide = (0..2)
            .map(|a| self.high[a] - self.low[a])
            .fold(0.0, f32::max);
        least >= Lamps::LEAST_RADIUS && most <= 2.0 * least && wide <= 2.0 * least
    }
}
