//! Light of a few emissive triangles, each by its closed form.

use super::direct::Direct;
use super::emitters::Emitters;
use super::receiver::Receiver;
use super::shading_point::ShadingPoint;
use super::shadows::Shadows;
use crate::math::Rgb;
use glam::Vec3;
use smallvec::SmallVec;

/// An emitter that rays of a point may go to.
#[derive(Clone, Copy, Debug)]
struct Chosen {
    index: u32,
    running_power: f32,
    /// Closed form of the receiver's response to it, per unit radiance.
    response: f32,
}

/// Those that send light to a point, and the shares of its rays that they get.
#[derive(Clone, Debug, Default)]
pub struct Chances {
    /// What all send with nothing between.
    pub light: Rgb,
    chosen: SmallVec<[Chosen; 16]>,
}

impl Chances {
    /// Asks all emitters of a scene that has few.
    pub fn new(emitters: &Emitters, origin: Vec3, receiver: impl Receiver) -> Self {
        let mut chances = Self::default();
        let mut sum = 0.0;
        for (index, emitter) in emitters.facing(origin) {
            let response = receiver.of_triangle(emitter.corners.map(|c| c - origin));
            let light = emitter.radiance * response;
            let power = light.mean();
            if power > 0.0 {
                chances.light += light;
                sum += power;
                chances.chosen.push(Chosen {
                    index,
                    running_power: sum,
                    response,
                });
            }
        }
        chances
    }

    /// Adds what rays bring. They share the emitters out by what each would send; each ray counts
    /// by what its point would send.
    pub fn add<S: Shadows, R: Receiver>(
        &self,
        total: &mut Direct<S::Dimming>,
        emitters: &Emitters,
        at: &ShadingPoint<S, R>,
    ) {
        let rays = at.rays;
        let chosen = &self.chosen;
        let Some(last) = chosen.last() else {
            return;
        };
        let sum = last.running_power;
        for i in 0..rays.count() {
            let [u, v] = rays.point(i, 63);
            let target = u * sum;
            let k = chosen
                .iter()
                .position(|c| target < c.running_power)
                .unwrap_or(chosen.len() - 1);
            let below = if k == 0 {
                0.0
            } else {
                chosen[k - 1].running_power
            };
            let within = ((target - below) / (chosen[k].running_power - below)).clamp(0.0, 1.0);
            let index = chosen[k].index;
            let emitter = emitters.get(index);
            // What this point sends over what its emitter was expected to: near 1.
            if let Some((w, through)) = at.ray_to(emitter, [within, v], chosen[k].response) {
                let light = emitter.radiance * (w * sum / emitter.radiance.mean());
                // Emitters of one surface are told apart no further than sharing a bit with
                // another.
                total.note_ray(index as usize, light, through);
            }
        }
    }
}
