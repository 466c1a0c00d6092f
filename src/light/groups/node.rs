//! A group of lights, and what it sends.

use crate::light::delta_lights::SegmentFromLight;
use crate::light::shading_point::Receiver;
use crate::math::Aabb;
use crate::scene::Light;
use glam::Vec3;
use std::f32::consts::PI;

/// A light, or a group of them. Groups stand depth first.
#[derive(Clone, Debug)]
pub struct Node {
    /// One of the lights, with the light of all.
    pub light: Light,
    /// Index of that one.
    pub index: usize,
    /// Around positions; around directions of directional lights.
    pub bounds: Aabb,
    /// Mean channel of what all send.
    pub power: f32,
    /// Axis of a cone around those of spots, and the half angle of all that they light; pi if any
    /// is a point.
    pub axis: Vec3,
    pub lit_rad: f32,
    /// The largest angular radius of directional lights, radians.
    pub wide_rad: f32,
    /// The second half; the first follows this node. `None` of one light.
    pub second: Option<u32>,
}

/// What a group sends to a point: about so much, wrong by at most so much.
#[derive(Clone, Copy, Debug)]
pub struct Sent {
    pub light: f32,
    pub error: f32,
}

impl Node {
    /// What the group sends to a point; `None` if nothing can arrive.
    pub fn sent_to(&self, origin: Vec3, receiver: impl Receiver) -> Option<Sent> {
        let Some((position, _)) = self.light.point_source() else {
            return self.sent_from_afar(receiver);
        };
        let at = Aabb::EMPTY.with(origin);
        let [near, far] = range(&self.bounds, &at);
        let [least, most] = match receiver.normals() {
            None => [1.0, 1.0],
            Some(normals) => {
                let heights = normals.map(|n| heights(&self.bounds, origin, n));
                if heights.iter().any(|[_, upper]| *upper <= 0.0) {
                    return None;
                }
                let is_whole = heights.iter().all(|[lower, _]| *lower >= 0.0);
                let [lower, upper] = heights[0];
                let least = if is_whole { lower / far } else { 0.0 };
                [least, (upper / near).min(1.0)]
            }
        };
        if !self.may_light(origin, near) {
            return None;
        }
        let to_light = position - origin;
        let d = to_light.normalize_or_zero();
        let response = receiver.response(d) * self.light.falloff(-d);
        let light = self.power * response / to_light.length_squared();
        Some(self.sent(light, [least / (far * far), most / (near * near)]))
    }

    /// What a group of directional lights sends.
    fn sent_from_afar(&self, receiver: impl Receiver) -> Option<Sent> {
        let Light::Directional { direction, .. } = self.light else {
            return None;
        };
        let [least, most] = match receiver.normals() {
            None => [1.0, 1.0],
            Some([n, face]) => {
                // Suns with an extent reach below the horizon of their middle.
                let angle = self.wide_rad;
                let to_light = |n: Vec3| {
                    let [lower, upper] = heights(&self.bounds, Vec3::ZERO, -n);
                    [lower - angle, upper + angle]
                };
                let ([lower, upper], of_face) = (to_light(n), to_light(face));
                if upper <= 0.0 || of_face[1] <= 0.0 {
                    return None;
                }
                let is_whole = of_face[0] >= 0.0;
                [if is_whole { lower.max(0.0) } else { 0.0 }, upper.min(1.0)]
            }
        };
        // What hides lights differs by their directions.
        let spread = (self.bounds.max - self.bounds.min).length();
        let light = self.power * receiver.response(-direction);
        Some(self.sent(light, [least, most.max(least) + spread]))
    }

    /// What the group sends to a segment in a medium.
    pub fn sent_along(&self, ends: [Vec3; 2]) -> Option<Sent> {
        let (position, _) = self.light.point_source()?;
        let segment = SegmentFromLight::new(position, ends);
        let mean = segment.mean_inverse_square();
        if self.second.is_none() {
            return mean.is_finite().then_some(Sent {
                light: self.power * mean,
                error: 0.0,
            });
        }
        let at = Aabb::EMPTY.with(ends[0]).with(ends[1]);
        let [near, far] = range(&self.bounds, &at);
        let light = if mean.is_finite() {
            self.power * mean
        } else {
            0.0
        };
        Some(self.sent(light, [1.0 / (far * far), 1.0 / (near * near)]))
    }

    fn sent(&self, light: f32, [least, most]: [f32; 2]) -> Sent {
        let is_one = self.second.is_none();
        // Of spots some may not light the point.
        let least = if self.lit_rad < PI { 0.0 } else { least };
        let error = self.power * (most - least);
        Sent {
            light: if light.is_finite() { light } else { 0.0 },
            error: match is_one {
                true => 0.0,
                false if error.is_nan() => f32::INFINITY,
                false => error,
            },
        }
    }

    /// Whether a point may be in the light of any spot of the group; `near` is how far it is from
    /// the box.
    fn may_light(&self, point: Vec3, near: f32) -> bool {
        if self.lit_rad >= PI {
            return true;
        }
        let radius = 0.5 * (self.bounds.max - self.bounds.min).length();
        let away = point - 0.5 * (self.bounds.min + self.bounds.max);
        let distance = away.length();
        if near <= 0.0 || distance <= radius {
            return true;
        }
        let angle = libm::acosf((away.dot(self.axis) / distance).clamp(-1.0, 1.0));
        angle <= self.lit_rad + libm::asinf((radius / distance).min(1.0)) + 1e-3
    }
}

/// The least and the largest distance between points of two boxes.
pub fn range(a: &Aabb, b: &Aabb) -> [f32; 2] {
    let apart = (a.min - b.max).max(b.min - a.max).max(Vec3::ZERO);
    let far = (a.max - b.min).abs().max((b.max - a.min).abs());
    [apart.length(), far.length()]
}

/// The least and the largest height of a box above a plane through a point.
fn heights(bounds: &Aabb, origin: Vec3, normal: Vec3) -> [f32; 2] {
    let middle = 0.5 * (bounds.min + bounds.max) - origin;
    let half = (0.5 * (bounds.max - bounds.min)).dot(normal.abs());
    let height = middle.dot(normal);
    [height - half, height + half]
}
