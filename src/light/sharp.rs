//! Lights without extent: one ray tells all of each.

use super::direct::Direct;
use super::receiver::Receiver;
use super::shading_point::ShadingPoint;
use super::shadows::{OpticalDepth, Shadows};
use crate::math::Rgb;
use crate::scene::Light;
use crate::trace::short_of;
use glam::Vec3;

/// Light towards a point as nothing between would change it.
struct Beam {
    /// Unit direction to the light, and how far rays to it go.
    direction: Vec3,
    end: f32,
    /// What the light sends, and the part of that which the receiver responds to.
    sent: Rgb,
    response: f32,
}

impl Beam {
    /// That of a point, spot or parallel light; `None` for others, and at the light itself.
    fn of<S, R: Receiver>(light: &Light, at: &ShadingPoint<S, R>) -> Option<Self> {
        if let Light::Directional {
            direction,
            irradiance,
            ..
        } = *light
        {
            return Some(Self {
                direction: -direction,
                end: f32::INFINITY,
                sent: Rgb(irradiance),
                response: at.receiver.response(-direction),
            });
        }
        let (position, intensity) = light.lamp()?;
        let to_light = position - at.origin;
        let distance = to_light.length();
        let d = to_light / distance;
        let response = at.receiver.response(d) / (distance * distance) * light.falloff(-d);
        (distance > 0.0).then_some(Self {
            direction: d,
            end: short_of(position, distance),
            sent: Rgb(intensity),
            response,
        })
    }
}

/// Adds a point, spot or parallel light. Media before it are those of `depth`, or the scene's own.
pub fn add<S: Shadows, R: Receiver>(
    total: &mut Direct<S::Dimming>,
    light: &Light,
    index: usize,
    at: &ShadingPoint<S, R>,
    depth: Option<&dyn OpticalDepth>,
) {
    if let Some(beam) = Beam::of(light, at)
        && beam.response > 0.0
    {
        let through = at.through(beam.direction, beam.end, depth);
        total.sight.note_sharp(index, through);
        total.sharp += beam.sent * (beam.response * through);
    }
}
