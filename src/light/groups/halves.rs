//! Lights put into groups: halves of halves, along the axis on which lights are most apart.

use super::node::Node;
use crate::math::sampling::{hash, unit};
use crate::math::{Aabb, Rgb};
use crate::scene::Light;
use glam::Vec3;
use std::f32::consts::PI;

/// A light that is to be put into groups.
#[derive(Clone, Copy)]
pub struct Member<'a> {
    pub light: &'a Light,
    pub index: usize,
    /// Position, or direction.
    pub at: Vec3,
    pub sent: Rgb,
}

/// Adds the node over some lights, halved along the axis on which they are most apart.
pub fn add(nodes: &mut Vec<Node>, members: &mut [Member]) {
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
pub fn sending(light: &Light, sum: Rgb) -> Light {
    let mut light = light.clone();
    match &mut light {
        Light::Point { intensity, .. } | Light::Spot { intensity, .. } => *intensity = sum.0,
        Light::Directional { irradiance, .. } => *irradiance = sum.0,
        Light::Environment { radiance } => *radiance = sum.0,
    }
    light
}
