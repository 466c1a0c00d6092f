//! Lights that are no triangles, in groups, for a scene that has many: from afar one of a group
//! stands for all of it (lightcuts, Walter et al. 2005).
//!
//! A group is split as long as what it may send differs by more than a share of what all send. What
//! hides a part of a group is not looked at: groups that are small as a point sees them are hidden
//! together.
//!
//! - `node`: a group, and what it sends to a point or to a segment in a medium.
//! - `halves`: lights put into groups.
//! - `cut`: the groups that stand for all lights.

mod cut;
mod halves;
mod node;

use super::delta_lights::SegmentFromLight;
use super::shading_point::Receiver;
use crate::math::{Aabb, Rgb};
use crate::scene::Light;
use cut::cut;
use glam::Vec3;
use halves::Member;
use node::{Node, range};

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
    /// None of them, but emitters alone.
    Emitters,
}

impl Which {
    /// Whether a light is among them.
    pub fn counts(self, light: &Light) -> bool {
        match self {
            Self::All => true,
            Self::Emitters => false,
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
                halves::add(&mut nodes, &mut members);
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
        let asks = |kind| which == Which::All || which == kind;
        let points = of(&self.point_sources, asks(Which::PointSources));
        let directional = of(&self.directional, asks(Which::Directional));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::shading_point::{MediumReceiver, SurfaceReceiver};
    use crate::math::sampling::{hash, sphere, unit};

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
            *light = halves::sending(light, Rgb::BLACK);
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
