//! A group of emissive triangles: the moments of its light, and what it sends to a point by them.

use super::split::EmitterSide;
use crate::light::shading_point::Receiver;
use crate::math::Rgb;
use glam::{DVec3, Mat3, Vec3};

/// A group of sides of emissive triangles, or one.
#[derive(Clone, Copy, Debug)]
pub struct Node {
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
    /// What the group consists of.
    pub holds: Holds,
}

/// What a group consists of.
#[derive(Clone, Copy, Debug)]
pub enum Holds {
    /// Two groups: the first follows its parent, and the second has this index.
    Halves(u32),
    /// One side of the emitter of this index.
    Emitter(u32),
}

/// Unshadowed light that a group sends to a receiver.
#[derive(Clone, Copy, Debug)]
pub struct GroupLight {
    /// Irradiance, or integral of radiance over the sphere.
    pub light: Rgb,
    /// How much of its mean channel that may be wrong; infinite near a group.
    pub error: f32,
    /// Share of shadow rays: positive if any of the group's light can reach the receiver.
    pub importance: f32,
}

impl GroupLight {
    /// Light in closed form.
    pub fn exactly(light: Rgb) -> Self {
        Self {
            light,
            error: 0.0,
            importance: light.mean(),
        }
    }

    /// Light of which at most `error` is missing, or too much.
    fn within(light: Rgb, error: f32) -> Self {
        Self {
            light,
            error,
            importance: light.mean() + error,
        }
    }
}

impl Node {
    /// Adds up sides, one or more.
    pub fn over(sides: &[EmitterSide]) -> Self {
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
            holds: Holds::Emitter(sides[0].emitter),
        }
    }

    /// Light at a receiver, in the tree's units; `None` if nothing can arrive.
    pub fn light(&self, origin: Vec3, receiver: impl Receiver) -> Option<GroupLight> {
        // A group nearer than this many radii is never taken whole.
        const NEAR: f32 = 1.5;
        // All emit the same way, and the receiver is behind them.
        if self.cos == 1.0 && origin.dot(self.axis) <= self.lowest {
            return None;
        }
        let to_middle = self.middle - origin;
        let squared = to_middle.length_squared();
        let distance = squared.sqrt();
        let incidence = match receiver.normals() {
            None => Incidence::ANYWHERE,
            Some(normals) => self.incidence(origin, distance, normals)?,
        };
        if distance < NEAR * self.radius {
            // Within the group, all directions are possible.
            return Some(GroupLight {
                light: Rgb::BLACK,
                error: f32::INFINITY,
                importance: self.power / squared.max(0.25 * self.radius * self.radius),
            });
        }
        let inverse = 1.0 / distance;
        let way = Way {
            direction: to_middle * inverse,
            distance,
            inverse,
        };
        let facing = self.facing(&way)?;
        let sent = if incidence.is_whole && facing.is_whole {
            self.light_of_whole(&way, &incidence)
        } else {
            self.light_of_part(&way, &incidence, &facing)
        };
        if receiver.normals().is_some() {
            return Some(sent);
        }
        let angle = [facing.sin_sphere, facing.cos_sphere];
        let [response, off] = receiver.response_to_sphere(way.direction, angle);
        let error = sent.error * (response + off) + sent.light.mean() * off * MIXED;
        Some(GroupLight::within(sent.light * response, error))
    }

    // The parts of this are inlined: by themselves they cost scenes of many lights a fifth more
    // time.

    /// How the group stands above the horizons of both normals; `None` if it is below one.
    #[inline(always)]
    fn incidence(&self, origin: Vec3, distance: f32, normals: [Vec3; 2]) -> Option<Incidence> {
        let to_box = self.box_middle - origin;
        let height = |n: Vec3| (to_box.dot(n), self.box_half.dot(n.abs()));
        let mut is_whole = true;
        for (height, half) in normals.map(height) {
            if height + half <= 0.0 {
                return None;
            }
            is_whole &= height >= half;
        }
        let (middle, half) = height(normals[0]);
        Some(Incidence {
            cos: (self.middle - origin).dot(normals[0]) / distance,
            mean_cos: positive_part(middle, half) / distance,
            is_whole,
        })
    }

    /// How the group's normals are turned to a receiver; `None` if all are turned away: the angle
    /// between the cone's axis and the way to the receiver, against the cone's and that of the
    /// group's sphere.
    #[inline(always)]
    fn facing(&self, way: &Way) -> Option<Facing> {
        let sin_sphere = self.radius * way.inverse;
        let cos_sphere = (1.0 - sin_sphere * sin_sphere).max(0.0).sqrt();
        let cos_axis = -way.direction.dot(self.axis);
        let sin_axis = (1.0 - cos_axis * cos_axis).max(0.0).sqrt();
        // The cone widened by the sphere, which may be more than a half turn.
        let cos_wide = self.cos * cos_sphere - self.sin * sin_sphere;
        let sin_wide = self.sin * cos_sphere + self.cos * sin_sphere;
        let is_all_round = sin_wide < 0.0 || self.cos <= -cos_sphere;
        let max_cos = if is_all_round || cos_axis >= cos_wide {
            1.0
        } else {
            cos_axis * cos_wide + sin_axis * sin_wide
        };
        (max_cos > 0.0).then_some(Facing {
            max_cos,
            sin_sphere,
            cos_sphere,
            is_whole: !is_all_round
                && cos_wide > 0.0
                && cos_axis * cos_wide - sin_axis * sin_wide > 0.0,
        })
    }

    /// Flux per channel along the way to a receiver.
    #[inline(always)]
    fn flux_along(&self, way: &Way) -> [f32; 3] {
        self.flux.map(|f| -f.dot(way.direction))
    }

    /// Light of a group of which all faces a receiver, above its horizon: its flux, wrong by terms
    /// of first and second order around its middle.
    #[inline(always)]
    fn light_of_whole(&self, way: &Way, incidence: &Incidence) -> GroupLight {
        let per_area = way.inverse * way.inverse;
        let response = incidence.cos.max(0.0);
        let flux = self.flux_along(way);
        let light = Rgb(flux.map(|f| f.max(0.0) * response * per_area));
        let error = (FIRST_ORDER * self.lopsided
            + SECOND_ORDER * self.power * self.spread2 * way.inverse)
            * way.inverse
            * per_area;
        GroupLight::within(light, error)
    }

    /// Light of a group of which a part may face away from a receiver, or be below its horizon:
    /// cosines at the lights as if they were spread evenly around their mean, wrong by a share of
    /// the most that the group can send.
    #[inline(always)]
    fn light_of_part(&self, way: &Way, incidence: &Incidence, facing: &Facing) -> GroupLight {
        let per_area = way.inverse * way.inverse;
        let mean = Rgb(self.flux_along(way)).mean() / self.power;
        let d = way.direction;
        let variance = ((self.turned * d).dot(d) - mean * mean).max(0.0);
        let spread = positive_part(mean, (3.0 * variance).sqrt());
        // Of two sides one faces the receiver.
        let paired = 0.5 * (mean + (variance + mean * mean).sqrt());
        let cos = spread + (paired - spread) * self.both;
        let light = self.strength * (cos * incidence.mean_cos * per_area);
        // At most: the nearest point of the sphere, turned as well as can be.
        let nearest = way.distance - self.radius;
        let max_incidence = incidence.max_cos(facing.sin_sphere, facing.cos_sphere);
        let most = self.power * facing.max_cos * max_incidence / (nearest * nearest);
        GroupLight::within(light, most * MIXED)
    }
}

/// The way from a receiver to the middle of a group.
struct Way {
    /// Unit direction.
    direction: Vec3,
    /// Length, and one over it.
    distance: f32,
    inverse: f32,
}

/// Cosines to a receiver's normal under which light of a group arrives.
struct Incidence {
    /// That of the middle of the group.
    cos: f32,
    /// Mean over the part of the group's box that is above the horizon.
    mean_cos: f32,
    /// Whether all of the box is above the horizon.
    is_whole: bool,
}

impl Incidence {
    /// At a receiver without a normal.
    const ANYWHERE: Self = Self {
        cos: 1.0,
        mean_cos: 1.0,
        is_whole: true,
    };

    /// The largest cosine of a sphere that is seen under an angle.
    fn max_cos(&self, sin_sphere: f32, cos_sphere: f32) -> f32 {
        if self.cos >= cos_sphere {
            1.0
        } else {
            let cos = self.cos * cos_sphere;
            (cos + (1.0 - self.cos * self.cos).max(0.0).sqrt() * sin_sphere).max(0.0)
        }
    }
}

/// How normals of a group are turned to a receiver.
struct Facing {
    /// The largest cosine between a normal and the way to the receiver.
    max_cos: f32,
    /// Of the angle under which the group's sphere is seen.
    sin_sphere: f32,
    cos_sphere: f32,
    /// Whether all of the group faces the receiver.
    is_whole: bool,
}

/// How wrong a group is that faces the receiver in part, is above its horizon in part, or is seen
/// under unlike angles to a phase function, over the most that it can be.
const MIXED: f32 = 0.3;

/// Bounds of the derivatives of `cos cos / r^2`, relative to it: of the first, and half of the
/// second's.
const FIRST_ORDER: f32 = 2.0;
const SECOND_ORDER: f32 = 1.5;

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
