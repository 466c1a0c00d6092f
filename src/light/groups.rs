//! Lights that are no triangles, in groups, for a scene that has many: from afar one of a group
//! stands for all of it (lightcuts, Walter et al. 2005).
//!
//! A group is split as long as what it may send differs by more than a share of what all send. What
//! hides a part of a group is not looked at: groups that are small as a point sees them are hidden
//! together.

use super::delta_lights::SegmentFromLight;
use super::shading_point::Receiver;
use crate::math::sampling::{hash, unit};
use crate::math::{Aabb, Rgb};
use crate::scene::Light;
use glam::Vec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::f32::consts::PI;

/// How exactly the light of many lights is known.
#[derive(Clone, Copy, Debug)]
pub struct Exactness {
    /// Share of all light by which one group may be wrong.
    pub tolerance: f32,
    /// Groups at a point, at most.
    pub groups: usize,
}

impl Exactness {
    /// For points that pictures show.
    pub const SHADING: Self = Self {
        tolerance: 0.004,
        groups: 512,
    };
    /// For points of which pictures show means of many.
    pub const BAKING: Self = Self {
        tolerance: 0.03,
        groups: 64,
    };
}

/// Which lights are asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// Directional lights.
    Directional,
    /// Point and spot lights.
    PointSources,
    /// Both.
    All,
}

impl Which {
    /// Whether a light is among them.
    pub fn counts(self, light: &Light) -> bool {
        match self {
            Self::All => true,
            Self::PointSources => light.point_source().is_some(),
            Self::Directional => light.point_source().is_none(),
        }
    }
}

/// The lights of a scene that has many.
#[derive(Debug)]
pub struct LightGroups {
    point_sources: Vec<Node>,
    directional: Vec<Node>,
}

/// A light, or a group of them. Groups stand depth first.
#[derive(Clone, Debug)]
struct Node {
    /// One of the lights, with the light of all.
    light: Light,
    /// Index of that one.
    index: usize,
    /// Around positions; around directions of directional lights.
    bounds: Aabb,
    /// Mean channel of what all send.
    power: f32,
    /// Axis of a cone around those of spots, and the half angle of all that they light; pi if any
    /// is a point.
    axis: Vec3,
    lit_rad: f32,
    /// The largest angular radius of directional lights, radians.
    wide_rad: f32,
    /// The second half; the first follows this node. `None` of one light.
    second: Option<u32>,
}

/// A light that is to be put into groups.
#[derive(Clone, Copy)]
struct Member<'a> {
    light: &'a Light,
    index: usize,
    /// Position, or direction.
    at: Vec3,
    sent: Rgb,
}

/// What a group sends to a point: about so much, wrong by at most so much.
#[derive(Clone, Copy, Debug)]
struct Sent {
    light: f32,
    error: f32,
}

/// A group of a cut.
struct Group {
    sent: Sent,
    node: u32,
}

impl PartialEq for Group {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Group {}

impl PartialOrd for Group {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Group {
    fn cmp(&self, other: &Self) -> Ordering {
        let by_error = self.sent.error.total_cmp(&other.sent.error);
        by_error.then(other.node.cmp(&self.node))
    }
}

impl LightGroups {
    /// Up to this many lights are all looked at.
    const MAX_FEW: usize = 64;

    /// Groups the lights of a scene that has many; `None` for few.
    pub fn new(lights: &[Light]) -> Option<Self> {
        let (mut points, mut directions) = (Vec::new(), Vec::new());
        for (index, light) in lights.iter().enumerate() {
            let (into, at, sent) = match *light {
                Light::Environment { .. } => continue,
                Light::Directional {
                    direction,
                    irradiance,
                    ..
                } => (&mut directions, direction, Rgb(irradiance)),
                Light::Point {
                    position,
                    intensity,
                }
                | Light::Spot {
                    position,
                    intensity,
                    ..
                } => (&mut points, position, Rgb(intensity)),
            };
            into.push(Member {
                light,
                index,
                at,
                sent,
            });
        }
        if points.len() + directions.len() <= Self::MAX_FEW {
            return None;
        }
        let groups = |mut members: Vec<Member>| {
            members.retain(|m| m.sent.mean() > 0.0);
            let mut nodes = Vec::with_capacity(2 * members.len());
            if !members.is_empty() {
                add(&mut nodes, &mut members);
            }
            nodes
        };
        Some(Self {
            point_sources: groups(points),
            directional: groups(directions),
        })
    }

    /// Lights that stand for all that are asked for at a point, each with the index of one of
    /// those that it stands for.
    pub fn at_point(
        &self,
        which: Which,
        origin: Vec3,
        receiver: impl Receiver,
        exactness: Exactness,
    ) -> impl Iterator<Item = (usize, &Light)> {
        let of = |nodes, asked: bool| match asked {
            true => cut(nodes, exactness, |node| node.sent_to(origin, receiver)),
            false => Vec::new(),
        };
        let points = of(&self.point_sources, which != Which::Directional);
        let directional = of(&self.directional, which != Which::PointSources);
        points.into_iter().chain(directional)
    }

    /// Point and spot lights that stand for all along a segment in a medium.
    pub fn along(
        &self,
        ends: [Vec3; 2],
        exactness: Exactness,
    ) -> impl Iterator<Item = (usize, &Light)> {
        cut(&self.point_sources, exactness, |node| node.sent_along(ends)).into_iter()
    }

    /// The point or spot light that is nearest to a segment, if one is nearer than `distance`.
    pub fn nearest(&self, ends: [Vec3; 2], distance: f32) -> Option<SegmentFromLight> {
        let nodes = &self.point_sources;
        let box_of_segment = Aabb::EMPTY.with(ends[0]).with(ends[1]);
        let mut best: Option<(f32, usize, SegmentFromLight)> = None;
        let mut todo = Vec::with_capacity(64);
        todo.extend((!nodes.is_empty()).then_some(0));
        while let Some(i) = todo.pop() {
            let node: &Node = &nodes[i as usize];
            let limit = best.as_ref().map_or(distance, |(d, ..)| *d);
            // Less than rounding could take from it.
            if 0.999 * range(&node.bounds, &box_of_segment)[0] > limit {
                continue;
            }
            if let Some(second) = node.second {
                todo.extend([second, i + 1]);
            } else if let Some((position, _)) = node.light.point_source() {
                let segment = SegmentFromLight::new(position, ends);
                let d = segment.distance();
                let is_nearer = best
                    .as_ref()
                    .is_none_or(|(least, index, _)| (d, node.index) < (*least, *index));
                if d < distance && is_nearer {
                    best = Some((d, node.index, segment));
                }
            }
        }
        best.map(|(.., segment)| segment)
    }
}

/// Adds the node over some lights, halved along the axis on which they are most apart.
fn add(nodes: &mut Vec<Node>, members: &mut [Member]) {
    let index = nodes.len();
    let bounds = members.iter().fold(Aabb::EMPTY, |b, m| b.with(m.at));
    let first = &members[0];
    let (axis, lit_rad) = match *first.light {
        Light::Spot {
            direction,
            cos_outer,
            ..
        } => (direction, libm::acosf(cos_outer.clamp(-1.0, 1.0))),
        _ => (Vec3::Z, PI),
    };
    let wide_rad = match *first.light {
        Light::Directional {
            angular_radius_rad, ..
        } => angular_radius_rad,
        _ => 0.0,
    };
    nodes.push(Node {
        light: first.light.clone(),
        index: first.index,
        bounds,
        power: first.sent.mean(),
        axis,
        lit_rad,
        wide_rad,
        second: None,
    });
    if members.len() == 1 {
        return;
    }
    let across = (bounds.max - bounds.min).max_position();
    let half = members.len() / 2;
    members.select_nth_unstable_by(half, |a, b| {
        let by_place = a.at[across].total_cmp(&b.at[across]);
        by_place.then(a.index.cmp(&b.index))
    });
    let (lower, upper) = members.split_at_mut(half);
    add(nodes, lower);
    let second = nodes.len();
    add(nodes, upper);
    let halves = [&nodes[index + 1], &nodes[second]];
    let power = halves[0].power + halves[1].power;
    // By its share, so that groups of few bright lights and many dim ones are like both.
    let chosen = unit(hash(&[index as u64, members.len() as u64])) * power < halves[0].power;
    let chosen = halves[usize::from(!chosen)];
    let sent = halves.map(|h| Rgb(sent(&h.light)));
    let (axis, lit_rad) = cone_around(halves);
    nodes[index] = Node {
        light: sending(&chosen.light, sent[0] + sent[1]),
        index: chosen.index,
        bounds,
        power,
        axis,
        lit_rad,
        wide_rad: halves[0].wide_rad.max(halves[1].wide_rad),
        second: Some(second as u32),
    };
}

/// A cone that holds those of two groups.
fn cone_around([a, b]: [&Node; 2]) -> (Vec3, f32) {
    let between = libm::acosf(a.axis.dot(b.axis).clamp(-1.0, 1.0));
    let (wide, narrow) = if a.lit_rad >= b.lit_rad {
        (a, b)
    } else {
        (b, a)
    };
    if between + narrow.lit_rad <= wide.lit_rad {
        return (wide.axis, wide.lit_rad);
    }
    // Wider by the rounding of the angles.
    let half = 0.5 * (between + wide.lit_rad + narrow.lit_rad) + 1e-3;
    let turn = half - wide.lit_rad;
    let aside = (narrow.axis - wide.axis * narrow.axis.dot(wide.axis)).normalize_or_zero();
    if half >= PI || aside == Vec3::ZERO {
        return (wide.axis, PI);
    }
    let axis = wide.axis * libm::cosf(turn) + aside * libm::sinf(turn);
    (axis.normalize(), half)
}

/// Intensity or irradiance of a light.
fn sent(light: &Light) -> [f32; 3] {
    match *light {
        Light::Point { intensity, .. } | Light::Spot { intensity, .. } => intensity,
        Light::Directional { irradiance, .. } => irradiance,
        Light::Environment { radiance } => radiance,
    }
}

/// The same light with another intensity or irradiance.
fn sending(light: &Light, sum: Rgb) -> Light {
    let mut light = light.clone();
    match &mut light {
        Light::Point { intensity, .. } | Light::Spot { intensity, .. } => *intensity = sum.0,
        Light::Directional { irradiance, .. } => *irradiance = sum.0,
        Light::Environment { radiance } => *radiance = sum.0,
    }
    light
}

/// The nodes that stand for all: those that may be most wrong are split until none may be by more
/// than is allowed, or there are as many as are allowed. In the order of nodes.
fn cut(
    nodes: &[Node],
    exactness: Exactness,
    sent: impl Fn(&Node) -> Option<Sent>,
) -> Vec<(usize, &Light)> {
    let group = |node: u32| {
        let sent = sent(&nodes[node as usize])?;
        Some(Group { sent, node })
    };
    let mut open = BinaryHeap::with_capacity(exactness.groups + 1);
    open.extend((!nodes.is_empty()).then(|| group(0)).flatten());
    let mut total: f32 = open.iter().map(|g| g.sent.light).sum();
    while open.len() < exactness.groups
        && let Some(worst) = open.peek()
        && worst.sent.error > exactness.tolerance * total
        && let Some(second) = nodes[worst.node as usize].second
        && let Some(worst) = open.pop()
    {
        total -= worst.sent.light;
        for half in [worst.node + 1, second].into_iter().filter_map(group) {
            total += half.sent.light;
            open.push(half);
        }
    }
    let mut chosen: Vec<u32> = open.into_iter().map(|g| g.node).collect();
    chosen.sort_unstable();
    let light = |node: u32| {
        let node = &nodes[node as usize];
        (node.index, &node.light)
    };
    chosen.into_iter().map(light).collect()
}

/// The least and the largest distance between points of two boxes.
fn range(a: &Aabb, b: &Aabb) -> [f32; 2] {
    let apart = (a.min - b.max).max(b.min - a.max).max(Vec3::ZERO);
    let far = (a.max - b.min).abs().max((b.max - a.min).abs());
    [apart.length(), far.length()]
}

impl Node {
    /// What the group sends to a point; `None` if nothing can arrive.
    fn sent_to(&self, origin: Vec3, receiver: impl Receiver) -> Option<Sent> {
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
    fn sent_along(&self, ends: [Vec3; 2]) -> Option<Sent> {
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

/// The least and the largest height of a box above a plane through a point.
fn heights(bounds: &Aabb, origin: Vec3, normal: Vec3) -> [f32; 2] {
    let middle = 0.5 * (bounds.min + bounds.max) - origin;
    let half = (0.5 * (bounds.max - bounds.min)).dot(normal.abs());
    let height = middle.dot(normal);
    [height - half, height + half]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::shading_point::{MediumReceiver, SurfaceReceiver};
    use crate::math::sampling::sphere;

    fn number(i: u64, k: u64) -> f32 {
        unit(hash(&[i, k]))
    }

    fn vector(i: u64, k: u64) -> Vec3 {
        Vec3::from([0, 1, 2].map(|a| 2.0 * number(i, 3 * k + a) - 1.0))
    }

    fn lights(count: u64, kinds: &[u64]) -> Vec<Light> {
        let light = |i: u64| {
            let intensity = [0.1, 0.5, 1.0].map(|c| c * number(i, 90) * number(i, 91));
            let direction = sphere([number(i, 92), number(i, 93)]);
            match kinds[i as usize % kinds.len()] {
                0 => Light::Point {
                    position: vector(i, 1),
                    intensity,
                },
                1 => Light::Spot {
                    position: vector(i, 1),
                    direction,
                    intensity,
                    cos_inner: 0.8,
                    cos_outer: 0.3,
                },
                _ => Light::Directional {
                    direction,
                    irradiance: intensity,
                    angular_radius_rad: 0.0,
                },
            }
        };
        (0..count).map(light).collect()
    }

    /// Unshadowed light by the plain sum over lights.
    fn light<'a>(
        lights: impl Iterator<Item = &'a Light>,
        origin: Vec3,
        receiver: impl Receiver,
    ) -> f64 {
        let of = |light: &Light| match light.point_source() {
            Some((position, intensity)) => {
                let to_light = position - origin;
                let d = to_light.normalize();
                let falloff = light.falloff(-d) * receiver.response(d);
                f64::from(Rgb(intensity).mean() * falloff / to_light.length_squared())
            }
            None => match light {
                Light::Directional {
                    direction,
                    irradiance,
                    ..
                } => f64::from(Rgb(*irradiance).mean() * receiver.response(-*direction)),
                _ => 0.0,
            },
        };
        lights.map(of).sum()
    }

    #[test]
    fn groups_send_what_all_their_lights_send() {
        for (kinds, most) in [
            (&[0][..], 0.03),
            (&[2], 0.03),
            (&[0, 2], 0.03),
            (&[1], 0.15),
        ] {
            let lights = lights(4000, kinds);
            let groups = LightGroups::new(&lights).unwrap();
            let mut squares = [0.0; 2];
            for i in 0..100 {
                let origin = vector(i, 50) * 2.0;
                let normal = sphere([number(i, 7), number(i, 8)]);
                let surface = SurfaceReceiver {
                    normal,
                    face_normal: normal,
                };
                let asked = |receiver| {
                    let found = groups.at_point(Which::All, origin, receiver, Exactness::SHADING);
                    found.collect::<Vec<_>>()
                };
                let found = asked(surface);
                assert!(found.len() <= 2 * Exactness::SHADING.groups);
                let exact = light(lights.iter(), origin, surface);
                let got = light(found.iter().map(|f| f.1), origin, surface);
                let of_all = light(lights.iter(), origin, MediumReceiver);
                squares[0] += ((got - exact) / of_all).powi(2);
                let found = groups.at_point(Which::All, origin, MediumReceiver, Exactness::SHADING);
                let got = light(found.map(|f| f.1), origin, MediumReceiver);
                squares[1] += (got / of_all - 1.0).powi(2);
            }
            let errors = squares.map(|s| (s / 100.0).sqrt());
            assert!(errors.iter().all(|&e| e < most), "{kinds:?}: {errors:?}");
        }
    }

    #[test]
    fn a_light_near_by_is_asked_by_itself() {
        let lights = lights(4000, &[0]);
        let groups = LightGroups::new(&lights).unwrap();
        for (i, light) in lights.iter().enumerate().take(50) {
            let (position, intensity) = light.point_source().unwrap();
            let origin = position + Vec3::new(1e-4, 0.0, 0.0);
            let mut found = groups.at_point(Which::All, origin, MediumReceiver, Exactness::BAKING);
            assert!(found.any(|f| f.0 == i && f.1.point_source().unwrap().1 == intensity));
        }
    }

    #[test]
    fn lights_at_one_place_are_one_group_and_black_ones_none() {
        let mut all = vec![lights(1, &[0])[0].clone(); 5000];
        let groups = LightGroups::new(&all).unwrap();
        let found: Vec<_> = groups
            .at_point(
                Which::All,
                Vec3::splat(3.0),
                MediumReceiver,
                Exactness::SHADING,
            )
            .collect();
        assert_eq!(found.len(), 1);
        let sum = found[0].1.point_source().unwrap().1[0];
        let one = all[0].point_source().unwrap().1[0];
        assert!((sum / one / 5000.0 - 1.0).abs() < 1e-3);
        for light in &mut all {
            *light = sending(light, Rgb::BLACK);
        }
        let groups = LightGroups::new(&all).unwrap();
        let mut found = groups.at_point(Which::All, Vec3::ZERO, MediumReceiver, Exactness::SHADING);
        assert!(found.next().is_none());
        assert!(LightGroups::new(&all[..LightGroups::MAX_FEW]).is_none());
    }

    #[test]
    fn the_nearest_light_is_that_of_a_scan() {
        let lights = lights(3000, &[0, 1, 2]);
        let groups = LightGroups::new(&lights).unwrap();
        let mut found = 0;
        for i in 0..300 {
            let ends = [vector(i, 60), vector(i, 60) + 0.3 * vector(i, 61)];
            let distance = 0.1 * number(i, 9);
            let of = |l: &Light| Some(SegmentFromLight::new(l.point_source()?.0, ends));
            let scan = lights
                .iter()
                .filter_map(of)
                .filter(|s| s.distance() < distance);
            let scan = scan.min_by(|a, b| a.distance().total_cmp(&b.distance()));
            let nearest = groups.nearest(ends, distance);
            found += usize::from(nearest.is_some());
            assert_eq!(
                nearest.map(|s| (s.distance(), s.median())),
                scan.map(|s| (s.distance(), s.median()))
            );
        }
        assert!(found > 50 && found < 300, "{found}");
    }
}
