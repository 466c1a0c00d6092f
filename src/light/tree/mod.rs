//! A tree over many emissive triangles (Conty Estevez & Kulla 2018): what a group of them sends to
//! a point, how far that may be wrong, and how much it may be at most.
//!
//! Groups are small in space and in directions. Each keeps the moments of its light, so that from
//! afar it counts as one: the flux through its middle, and how light is spread around that.

mod cut;
mod node;
mod split;
#[cfg(test)]
mod tests;

use super::emitter::Emitter;
use super::shading_point::Receiver;
pub use cut::LightCut;
use glam::Vec3;
use node::{GroupLight, Holds, Node};
use split::{EmitterSide, split};

/// A tree over emissive triangles: groups in depth-first order, the whole first.
#[derive(Debug)]
pub struct LightTree {
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

impl LightTree {
    /// Builds the tree over the sides that emit; `None` if there are none of any power.
    pub fn new(emitters: &[Emitter]) -> Option<Self> {
        let units = Units::of(emitters);
        let mut sides = Vec::with_capacity(emitters.len());
        for (i, e) in emitters.iter().enumerate() {
            let corners = e.corners.map(|c| c * units.per_length);
            let [a, b, c] = corners;
            let front = EmitterSide {
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
                sides.push(EmitterSide {
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

    fn add(&mut self, sides: &mut [EmitterSide], depth: u32) {
        let index = self.nodes.len();
        self.nodes.push(Node::over(sides));
        if sides.len() > 1 {
            let at = split(sides, depth);
            let (first, second) = sides.split_at_mut(at);
            self.add(first, depth + 1);
            self.nodes[index].holds = Holds::Halves(self.nodes.len() as u32);
            self.add(second, depth + 1);
        }
    }

    /// The emitter that a group consists of, if it is but one.
    pub fn emitter(&self, node: u32) -> Option<u32> {
        match self.nodes[node as usize].holds {
            Holds::Emitter(e) => Some(e),
            Holds::Halves(_) => None,
        }
    }

    /// The two halves of a group.
    pub fn halves(&self, node: u32) -> Option<[u32; 2]> {
        match self.nodes[node as usize].holds {
            Holds::Emitter(_) => None,
            Holds::Halves(second) => Some([node + 1, second]),
        }
    }

    /// Light of a group at a receiver; `None` if nothing can arrive.
    pub fn light(&self, node: u32, origin: Vec3, receiver: impl Receiver) -> Option<GroupLight> {
        let Units {
            per_length,
            radiance,
            ..
        } = self.units;
        let sent = self.nodes[node as usize].light(origin * per_length, receiver)?;
        Some(GroupLight {
            light: sent.light * radiance,
            error: sent.error * radiance,
            importance: sent.importance * radiance,
        })
    }
}
