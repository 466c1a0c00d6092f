//! The groups of a light tree that stand for all lights at one point (adaptive tree splitting,
//! Conty Estevez & Kulla 2018).

use super::emitters::Emitters;
use super::receiver::Receiver;
use super::tree::{Estimate, Tree};
use crate::math::Rgb;
use glam::Vec3;

/// A group, or one light by its closed form.
#[derive(Clone, Copy, Debug)]
struct Part {
    node: u32,
    what: Estimate,
}

/// Groups that together are all lights that can reach a receiver, none in two, in the order of the
/// tree.
#[derive(Debug)]
pub struct Cut<'a, R> {
    tree: &'a Tree,
    origin: Vec3,
    receiver: R,
    parts: Vec<Part>,
    importance: f32,
}

/// A light that a ray is to go to.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// Index of the emitter.
    pub emitter: u32,
    /// What is left of the number it was chosen by, in [0,1).
    pub within: f32,
    /// Chance of choosing it.
    pub chance: f32,
}

/// Groups after which only those near by are split.
const MOST_VISITS: usize = 1024;

/// Parts for which there is room from the start.
const ROOM: usize = 64;

impl<'a, R: Receiver> Cut<'a, R> {
    /// Splits groups until none may be wrong by more than `tolerance` times what all lights send.
    /// After about a thousand groups, only those near by are split.
    pub fn new(
        tree: &'a Tree,
        emitters: &Emitters,
        origin: Vec3,
        receiver: R,
        tolerance: f32,
    ) -> Self {
        let part = |node| {
            let what = tree.estimate(node, origin, receiver)?;
            Some(Part { node, what })
        };
        let mut parts: Vec<Part> = part(0).into_iter().collect();
        let mut next = Vec::with_capacity(ROOM);
        let mut visits = 0;
        // All that are too wrong are split at once; what all send is known better each time.
        loop {
            let total: f32 = parts.iter().map(|p| p.what.light.mean()).sum();
            let limit = if visits < MOST_VISITS {
                tolerance * total
            } else {
                f32::MAX
            };
            let before = visits;
            for p in parts.drain(..) {
                if p.what.error <= limit {
                    next.push(p);
                } else if let Some(halves) = tree.halves(p.node) {
                    visits += 2;
                    next.extend(halves.into_iter().filter_map(part));
                } else if let Some(index) = tree.emitter(p.node) {
                    visits += 1;
                    let e = emitters.get(index);
                    let light = e.radiance * receiver.of_triangle(e.corners.map(|c| c - origin));
                    if light.mean() > 0.0 {
                        let what = Estimate {
                            light,
                            error: 0.0,
                            importance: light.mean(),
                        };
                        next.push(Part { what, ..p });
                    }
                }
            }
            std::mem::swap(&mut parts, &mut next);
            if visits == before {
                break;
            }
        }
        let importance = parts.iter().map(|p| p.what.importance).sum();
        Self {
            tree,
            origin,
            receiver,
            parts,
            importance,
        }
    }

    /// What all lights send with nothing between.
    pub fn light(&self) -> Rgb {
        self.parts
            .iter()
            .fold(Rgb::BLACK, |sum, p| sum + p.what.light)
    }

    /// Chooses a light for a number in [0,1): numbers near each other choose lights near each
    /// other. `None` if it leads to a group of which nothing can reach the receiver after all.
    pub fn choose(&self, u: f32) -> Option<Choice> {
        let target = u * self.importance;
        let mut below = 0.0;
        let mut found = None;
        for p in self.parts.iter().filter(|p| p.what.importance > 0.0) {
            found = Some((p, below));
            if target < below + p.what.importance {
                break;
            }
            below += p.what.importance;
        }
        let (part, below) = found?;
        let mut within = ((target - below) / part.what.importance).clamp(0.0, 1.0);
        let mut chance = part.what.importance / self.importance;
        let mut node = part.node;
        while let Some(halves) = self.tree.halves(node) {
            let first = self.first_share(halves)?;
            let is_first = within < first;
            let (part, start) = if is_first {
                (first, 0.0)
            } else {
                (1.0 - first, first)
            };
            within = ((within - start) / part).clamp(0.0, 1.0);
            chance *= part;
            node = halves[usize::from(!is_first)];
        }
        let emitter = self.tree.emitter(node)?;
        Some(Choice {
            emitter,
            within,
            chance,
        })
    }

    /// Chance of the first of two halves; `None` if neither can reach the receiver.
    fn first_share(&self, halves: [u32; 2]) -> Option<f32> {
        let [a, b] = halves.map(|h| {
            self.tree
                .estimate(h, self.origin, self.receiver)
                .map_or(0.0, |e| e.importance)
        });
        let sum = a + b;
        (sum > 0.0).then(|| a / sum)
    }
}

#[cfg(test)]
impl<R: Receiver> Cut<'_, R> {
    /// How many groups stand for all.
    pub fn len(&self) -> usize {
        self.parts.len()
    }

    /// Chance of each emitter, and of none: where the halves of a group tell that nothing of it can
    /// reach the receiver.
    pub fn chances(&self, emitters: usize) -> (Vec<f32>, f32) {
        let (mut chances, mut none) = (vec![0.0; emitters], 0.0);
        let mut open: Vec<(u32, f32)> = self
            .parts
            .iter()
            .map(|p| (p.node, p.what.importance / self.importance))
            .collect();
        while let Some((node, chance)) = open.pop() {
            if let Some(emitter) = self.tree.emitter(node) {
                chances[emitter as usize] += chance;
            } else if let Some(halves) = self.tree.halves(node)
                && let Some(first) = self.first_share(halves)
            {
                open.push((halves[0], chance * first));
                open.push((halves[1], chance * (1.0 - first)));
            } else {
                none += chance;
            }
        }
        (chances, none)
    }
}
