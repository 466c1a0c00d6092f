//! A tree over many emissive triangles (Conty Estevez & Kulla 2018): what a group of them sends to
//! a point, how far that may be wrong, and how much it may be at most.
//!
//! Groups are small in space and in directions. Each keeps the moments of its light, so that from
//! afar it counts as one: the flux through its middle, and how light is spread around that.

use super::emitter::Emitter;
use super::receiver::Receiver;
use crate::math::Rgb;
use glam::{DVec3, Mat3, Vec3};

/// A group of sides of emissive triangles, or one.
#[derive(Clone, Copy, Debug)]
struct Node {
    /// Mean point, weighted by power.
    middle: Vec3,
    /// Of a sphere around the middle that holds all.
    radius: f32,
    /// Middle and half the size of a box that holds all.
    box_middle: Vec3,
    box_half: Vec3,
    /// Cone that holds all normals.
    axis: Vec3,
    cos: f32,
    sin: f32,
    /// Lowest point along the axis.
    lowest: f32,
    /// Sum of area times normal times radiance, by channel.
    flux: [Vec3; 3],
    /// Sum of area times radiance, and its mean channel.
    strength: Rgb,
    power: f32,
    /// Second moment of the normals, weighted by power.
    turned: Mat3,
    /// Share of the power that is of triangles which emit on both sides.
    both: f32,
    /// Mean squared distance from the middle, weighted by power.
    spread2: f32,
    /// First moment of the flux around the middle, mean over channels of its size: none where all
    /// emit alike.
    lopsided: f32,
    below: Below,
}

#[derive(Clone, Copy, Debug)]
enum Below {
    /// Of two groups, the first follows its parent; this is the second.
    Second(u32),
    /// One side of the emitter of this index.
    Emitter(u32),
}

/// What a group sends to a receiver with nothing between.
#[derive(Clone, Copy, Debug)]
pub struct Estimate {
    /// Irradiance, or integral of radiance over the sphere.
    pub light: Rgb,
    /// How much of its mean channel that may be wrong; infinite near a group.
    pub error: f32,
    /// Share of shadow rays: positive if any of the group's light can reach the receiver.
    pub importance: f32,
}

/// One side of an emissive triangle.
#[derive(Clone, Copy)]
struct Side {
    corners: [Vec3; 3],
    normal: Vec3,
    middle: Vec3,
    area: f32,
    radiance: Rgb,
    emitter: u32,
    is_pair: bool,
}

impl Side {
    fn power(&self) -> f32 {
        self.area * self.radiance.mean()
    }

    /// What groups are split by: place, then direction.
    fn key(&self, axis: usize) -> f32 {
        if axis < 3 {
            self.middle[axis]
        } else {
            self.normal[axis - 3]
        }
    }
}

/// The tree: groups in depth-first order, the whole first.
#[derive(Debug)]
pub struct Tree {
    nodes: Vec<Node>,
    units: Units,
}

/// What nodes count lengths and radiance in: powers of two about as large as the largest, which
/// change no digit and keep areas times radiance in the range of f32.
#[derive(Clone, Copy, Debug)]
struct Units {
    per_length: f32,
    radiance: f32,
    per_radiance: f32,
}

impl Units {
    fn of(emitters: &[Emitter]) -> Self {
        let corners = emitters.iter().flat_map(|e| e.corners);
        let length = corners.fold(0.0_f32, |m, c| m.max(c.abs().max_element()));
        let radiance = emitters
            .iter()
            .fold(0.0_f32, |m, e| m.max(e.radiance.max()));
        let exponent = |v: f32| libm::frexpf(v).1.clamp(-120, 120);
        let power = |exponent| libm::ldexpf(1.0, exponent);
        Self {
            per_length: power(-exponent(length)),
            radiance: power(exponent(radiance)),
            per_radiance: power(-exponent(radiance)),
        }
    }
}

impl Tree {
    /// The tree over the sides that emit; `None` if there are none of any power.
    pub fn new(emitters: &[Emitter]) -> Option<Self> {
        let units = Units::of(emitters);
        let mut sides = Vec::with_capacity(emitters.len());
        for (i, e) in emitters.iter().enumerate() {
            let corners = e.corners.map(|c| c * units.per_length);
            let [a, b, c] = corners;
            let front = Side {
                corners,
                normal: e.normal,
                middle: (a + b + c) * (1.0 / 3.0),
                area: e.area * units.per_length * units.per_length,
                radiance: e.radiance * units.per_radiance,
                emitter: i as u32,
                is_pair: e.both_sides,
            };
            if !(front.power() > 0.0 && front.power().is_finite()) {
                continue;
            }
            sides.push(front);
            if e.both_sides {
                sides.push(Side {
                    normal: -e.normal,
                    ..front
                });
            }
        }
        if sides.is_empty() {
            return None;
        }
        let mut tree = Self {
            nodes: Vec::with_capacity(2 * sides.len() - 1),
            units,
        };
        tree.add(&mut sides, 0);
        Some(tree)
    }

    fn add(&mut self, sides: &mut [Side], depth: u32) {
        let index = self.nodes.len();
        self.nodes.push(Node::over(sides));
        if sides.len() > 1 {
            let at = split(sides, depth);
            let (first, second) = sides.split_at_mut(at);
            self.add(first, depth + 1);
            self.nodes[index].below = Below::Second(self.nodes.len() as u32);
            self.add(second, depth + 1);
        }
    }

    /// The emitter that a group consists of, if it is but one.
    pub fn emitter(&self, node: u32) -> Option<u32> {
        match self.nodes[node as usize].below {
            Below::Emitter(e) => Some(e),
            Below::Second(_) => None,
        }
    }

    /// The two halves of a group.
    pub fn halves(&self, node: u32) -> Option<[u32; 2]> {
        match self.nodes[node as usize].below {
            Below::Emitter(_) => None,
            Below::Second(second) => Some([node + 1, second]),
        }
    }

    /// What a group sends to a receiver; `None` if nothing can arrive.
    pub fn estimate(&self, node: u32, origin: Vec3, receiver: impl Receiver) -> Option<Estimate> {
        let Units {
            per_length,
            radiance,
            ..
        } = self.units;
        let what = self.nodes[node as usize].estimate(origin * per_length, receiver)?;
        Some(Estimate {
            light: what.light * radiance,
            error: what.error * radiance,
            importance: what.importance * radiance,
        })
    }
}

impl Node {
    fn over(sides: &[Side]) -> Self {
        let power: f64 = sides.iter().map(|s| f64::from(s.power())).sum();
        let mut middle = DVec3::ZERO;
        let mut axis = Vec3::ZERO;
        let mut flux = [Vec3::ZERO; 3];
        let (mut strength, mut turned, mut both) = (Rgb::BLACK, Mat3::ZERO, 0.0);
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for s in sides {
            let share = f64::from(s.power()) / power;
            middle += s.middle.as_dvec3() * share;
            axis += s.normal * share as f32;
            strength += s.radiance * s.area;
            both += if s.is_pair { share } else { 0.0 };
            turned += outer(s.normal * share as f32, s.normal);
            for (f, radiance) in flux.iter_mut().zip(s.radiance.0) {
                *f += s.normal * (s.area * radiance);
            }
            for c in s.corners {
                (min, max) = (min.min(c), max.max(c));
            }
        }
        let middle = middle.as_vec3();
        let axis = axis.normalize_or(sides[0].normal);
        let (mut radius, mut lowest, mut cos) = (0.0_f32, f32::INFINITY, 1.0_f32);
        let (mut spread2, mut moments) = (0.0_f64, [Mat3::ZERO; 3]);
        for s in sides {
            cos = cos.min(s.normal.dot(axis));
            // Mean square over a triangle: that of its middle, and a twelfth of those of its
            // corners around that.
            let mut square = (s.middle - middle).length_squared();
            for c in s.corners {
                radius = radius.max((c - middle).length());
                lowest = lowest.min(c.dot(axis));
                square += (c - s.middle).length_squared() * (1.0 / 12.0);
            }
            spread2 += f64::from(s.power()) / power * f64::from(square);
            let offset = s.middle - middle;
            for (m, radiance) in moments.iter_mut().zip(s.radiance.0) {
                let flux = s.normal * (s.area * radiance);
                *m += outer(flux, offset);
            }
        }
        // Wider by the rounding of the dot product.
        let cos = if sides.len() == 1 { 1.0 } else { cos - 1e-5 }.max(-1.0);
        let size = |m: &Mat3| {
            let columns = m.x_axis.length_squared() + m.y_axis.length_squared();
            (columns + m.z_axis.length_squared()).sqrt()
        };
        Self {
            middle,
            radius,
            box_middle: (min + max) * 0.5,
            box_half: (max - min) * 0.5,
            axis,
            cos,
            sin: (1.0 - cos * cos).max(0.0).sqrt(),
            lowest,
            flux,
            strength,
            power: power as f32,
            turned,
            both: both as f32,
            spread2: spread2 as f32,
            lopsided: moments.iter().map(size).sum::<f32>() * (1.0 / 3.0),
            below: Below::Emitter(sides[0].emitter),
        }
    }

    fn estimate(&self, origin: Vec3, receiver: impl Receiver) -> Option<Estimate> {
        // A group nearer than this many radii is never taken whole.
        const NEAR: f32 = 1.5;
        // All emit the same way, and the receiver is behind them.
        if self.cos == 1.0 && origin.dot(self.axis) <= self.lowest {
            return None;
        }
        let to_middle = self.middle - origin;
        let squared = to_middle.length_squared();
        let distance = squared.sqrt();
        let mut is_whole = true;
        // Cosine at the receiver, and its mean over the part of the box that is above the horizon.
        let (mut slope, mut above) = (1.0, 1.0);
        let normals = receiver.normals();
        if let Some([normal, face_normal]) = normals {
            let to_box = self.box_middle - origin;
            for n in [normal, face_normal] {
                let (height, half) = (to_box.dot(n), self.box_half.dot(n.abs()));
                if height + half <= 0.0 {
                    return None;
                }
                is_whole &= height >= half;
            }
            slope = to_middle.dot(normal) / distance;
            let (height, half) = (to_box.dot(normal), self.box_half.dot(normal.abs()));
            above = positive_part(height, half) / distance;
        }
        let is_near = distance < NEAR * self.radius;
        let reach2 = squared.max(0.25 * self.radius * self.radius);
        if is_near {
            // Within the group, all directions are possible.
            return Some(Estimate {
                light: Rgb::BLACK,
                error: f32::INFINITY,
                importance: self.power / reach2,
            });
        }
        let inverse = 1.0 / distance;
        let d = to_middle * inverse;
        // Angle between the cone's axis and the way to the receiver, against the cone's and that of
        // the group's sphere.
        let (sin_u, cos_u) = {
            let sin = self.radius * inverse;
            (sin, (1.0 - sin * sin).max(0.0).sqrt())
        };
        let cos_a = -d.dot(self.axis);
        let sin_a = (1.0 - cos_a * cos_a).max(0.0).sqrt();
        // Cosine and sine of the cone widened by the sphere, which may be more than a half turn.
        let cos_w = self.cos * cos_u - self.sin * sin_u;
        let sin_w = self.sin * cos_u + self.cos * sin_u;
        let is_all_round = sin_w < 0.0 || self.cos <= -cos_u;
        let facing = if is_all_round || cos_a >= cos_w {
            1.0
        } else {
            cos_a * cos_w + sin_a * sin_w
        };
        if facing <= 0.0 {
            return None;
        }
        is_whole &= !is_all_round && cos_w > 0.0 && cos_a * cos_w - sin_a * sin_w > 0.0;
        let per_area = inverse * inverse;
        let sent = self.flux.map(|f| -f.dot(d));
        if is_whole {
            let response = if normals.is_none() {
                1.0
            } else {
                slope.max(0.0)
            };
            let light = Rgb(sent.map(|s| s.max(0.0) * response * per_area));
            // Terms of first and second order around the middle.
            let error = (FIRST_ORDER * self.lopsided
                + SECOND_ORDER * self.power * self.spread2 * inverse)
                * inverse
                * per_area;
            return Some(Estimate {
                light,
                error,
                importance: light.mean() + error,
            });
        }
        // Cosines at the lights, as if they were spread evenly around their mean.
        let mean = Rgb(sent).mean() / self.power;
        let variance = ((self.turned * d).dot(d) - mean * mean).max(0.0);
        let spread = positive_part(mean, (3.0 * variance).sqrt());
        // Of two sides one faces the receiver.
        let paired = 0.5 * (mean + (variance + mean * mean).sqrt());
        let turned = spread + (paired - spread) * self.both;
        let light = self.strength * (turned * above * per_area);
        // At most: the nearest point of the sphere, turned as well as can be.
        let nearest = distance - self.radius;
        let raised = if normals.is_none() || slope >= cos_u {
            1.0
        } else {
            slope * cos_u + (1.0 - slope * slope).max(0.0).sqrt() * sin_u
        };
        let most = self.power * facing * raised.max(0.0) / (nearest * nearest);
        Some(Estimate {
            light,
            error: most * MIXED,
            importance: light.mean() + most * MIXED,
        })
    }
}

/// How wrong a group is that faces the receiver in part, or is above its horizon in part, over the
/// most that it can send.
const MIXED: f32 = 0.3;

/// Mean of the positive part of what is spread evenly by up to `half` around `middle`.
fn positive_part(middle: f32, half: f32) -> f32 {
    if middle >= half {
        middle
    } else if middle <= -half {
        0.0
    } else {
        (middle + half) * (middle + half) / (4.0 * half)
    }
}

fn outer(a: Vec3, b: Vec3) -> Mat3 {
    Mat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Bounds of the derivatives of `cos cos / r^2`, relative to it: of the first, and half of the
/// second's.
const FIRST_ORDER: f32 = 2.0;
const SECOND_ORDER: f32 = 1.5;

/// Orders a group of two or more so that it falls into two halves, and tells where: by the least
/// sum of power times squared diagonal times solid angle of what the halves light.
fn split(sides: &mut [Side], depth: u32) -> usize {
    /// Deeper than this, halves by number.
    const DEEP: u32 = 60;
    let half = sides.len() / 2;
    if depth >= DEEP {
        return half;
    }
    let mut best: Option<(f32, usize, f32, f32, usize)> = None;
    let extent = {
        let mut whole = Bin::default();
        for s in sides.iter() {
            whole.add(s);
        }
        whole.max - whole.min
    };
    for axis in 0..6 {
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for s in sides.iter() {
            (low, high) = (low.min(s.key(axis)), high.max(s.key(axis)));
        }
        let scale = BINS as f32 / (high - low);
        if !scale.is_finite() {
            continue;
        }
        let mut bins = [Bin::default(); BINS];
        for s in sides.iter() {
            bins[bin(s.key(axis), low, scale)].add(s);
        }
        // Thin boxes are cut across.
        let thin = if axis < 3 && extent[axis] > 0.0 {
            extent.max_element() / extent[axis]
        } else {
            1.0
        };
        let mut above = [Bin::default(); BINS];
        for b in (0..BINS - 1).rev() {
            above[b] = above[b + 1];
            above[b].join(&bins[b + 1]);
        }
        let mut below = Bin::default();
        for b in 0..BINS - 1 {
            below.join(&bins[b]);
            if below.count == 0 || above[b].count == 0 {
                continue;
            }
            let cost = thin * (below.cost() + above[b].cost());
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, low, scale, b));
            }
        }
    }
    let Some((_, axis, low, scale, last)) = best else {
        return half;
    };
    // Stable, so that equal scenes have equal trees.
    sides.sort_by_key(|s| bin(s.key(axis), low, scale) > last);
    sides.partition_point(|s| bin(s.key(axis), low, scale) <= last)
}

const BINS: usize = 12;

fn bin(key: f32, low: f32, scale: f32) -> usize {
    (((key - low) * scale) as usize).min(BINS - 1)
}

/// Sides that fall together when a split is sought.
#[derive(Clone, Copy)]
struct Bin {
    min: Vec3,
    max: Vec3,
    /// Sum of normals by power.
    normals: Vec3,
    power: f32,
    count: u32,
}

impl Default for Bin {
    fn default() -> Self {
        Self {
            min: Vec3::INFINITY,
            max: Vec3::NEG_INFINITY,
            normals: Vec3::ZERO,
            power: 0.0,
            count: 0,
        }
    }
}

impl Bin {
    fn add(&mut self, side: &Side) {
        for c in side.corners {
            (self.min, self.max) = (self.min.min(c), self.max.max(c));
        }
        self.normals += side.normal * side.power();
        self.power += side.power();
        self.count += 1;
    }

    fn join(&mut self, other: &Self) {
        (self.min, self.max) = (self.min.min(other.min), self.max.max(other.max));
        self.normals += other.normals;
        self.power += other.power;
        self.count += other.count;
    }

    /// Power times squared diagonal times what is lit, over 2 pi: a hemisphere, wider by a cap that
    /// has the mean of these normals.
    fn cost(&self) -> f32 {
        let cos_cap = (2.0 * self.normals.length() / self.power - 1.0).clamp(-1.0, 1.0);
        let sin_cap = (1.0 - cos_cap * cos_cap).sqrt();
        let lit = if cos_cap > 0.0 { 1.0 + sin_cap } else { 2.0 };
        self.power * (self.max - self.min).length_squared() * lit
    }
}
