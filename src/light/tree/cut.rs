//! The groups of a light tree that stand for all emitters at one point (adaptive tree splitting,
//! Conty Estevez & Kulla 2018).

use super::LightTree;
use super::node::GroupLight;
use crate::light::emitter::Emitter;
use crate::light::shading_point::Receiver;
use crate::math::Rgb;
use glam::Vec3;

/// A node of the tree, or one emitter by its closed form.
#[derive(Clone, Copy, Debug)]
struct Group {
    node: u32,
    sends: GroupLight,
}

/// Groups that together are all emitters that can reach a receiver, none in two, in the order of
/// the tree.
#[derive(Debug)]
pub struct LightCut<'a, R> {
    tree: &'a LightTree,
    origin: Vec3,
    receiver: R,
    groups: Vec<Group>,
    importance: f32,
}

/// An emitter that a ray is to go to.
#[derive(Clone, Copy, Debug)]
pub struct ChosenEmitter {
    /// Index of the emitter.
    pub emitter: u32,
    /// What is left of the number it was chosen by, in [0,1].
    pub within: f32,
    /// Chance of choosing it.
    pub chance: f32,
}

/// Nodes looked at after which only groups near by are split.
const MAX_VISITS: usize = 1024;

/// Groups for which there is room from the start.
const ROOM: usize = 64;

impl<'a, R: Receiver> LightCut<'a, R> {
    /// Splits groups until none may be wrong by more than `tolerance` times what all emitters send.
    /// After about a thousand nodes, only groups near by are split.
    pub fn new(
        tree: &'a LightTree,
        emitters: &[Emitter],
        origin: Vec3,
        receiver: R,
        tolerance: f32,
    ) -> Self {
        let group = |node| {
            let sends = tree.light(node, origin, receiver)?;
            Some(Group { node, sends })
        };
        let mut groups: Vec<Group> = group(0).into_iter().collect();
        let mut next = Vec::with_capacity(ROOM);
        let mut visits = 0;
        // All that are too wrong are split at once; what all send is known better each time.
        loop {
            let total: f32 = groups.iter().map(|g| g.sends.light.mean()).sum();
            let limit = if visits < MAX_VISITS {
                tolerance * total
            } else {
                f32::MAX
            };
            let before = visits;
            for g in groups.drain(..) {
                if g.sends.error <= limit {
                    next.push(g);
                } else if let Some(halves) = tree.halves(g.node) {
                    visits += 2;
                    next.extend(halves.into_iter().filter_map(group));
                } else if let Some(index) = tree.emitter(g.node) {
                    visits += 1;
                    let e = &emitters[index as usize];
                    let corners = e.corners.map(|c| c - origin);
                    let light = e.radiance * receiver.response_to_triangle(corners);
                    if light.mean() > 0.0 {
                        let sends = GroupLight::exactly(light);
                        next.push(Group { sends, ..g });
                    }
                }
            }
            std::mem::swap(&mut groups, &mut next);
            if visits == before {
                break;
            }
        }
        let importance = groups.iter().map(|g| g.sends.importance).sum();
        Self {
            tree,
            origin,
            receiver,
            groups,
            importance,
        }
    }

    /// Unshadowed light of all emitters.
    pub fn light(&self) -> Rgb {
        self.groups
            .iter()
            .fold(Rgb::BLACK, |sum, g| sum + g.sends.light)
    }

    /// Chooses an emitter for a number in [0,1): numbers near each other choose emitters near each
    /// other. `None` if it leads to a group of which nothing can reach the receiver after all.
    pub fn choose(&self, u: f32) -> Option<ChosenEmitter> {
        let target = u * self.importance;
        let mut below = 0.0;
        let mut found = None;
        for g in self.groups.iter().filter(|g| g.sends.importance > 0.0) {
            found = Some((g, below));
            if target < below + g.sends.importance {
                break;
            }
            below += g.sends.importance;
        }
        let (group, below) = found?;
        let mut within = ((target - below) / group.sends.importance).clamp(0.0, 1.0);
        let mut chance = group.sends.importance / self.importance;
        let mut node = group.node;
        while let Some(halves) = self.tree.halves(node) {
            let first = self.chance_of_first(halves)?;
            let is_first = within < first;
            let (share, start) = if is_first {
                (first, 0.0)
            } else {
                (1.0 - first, first)
            };
            within = ((within - start) / share).clamp(0.0, 1.0);
            chance *= share;
            node = halves[usize::from(!is_first)];
        }
        let emitter = self.tree.emitter(node)?;
        Some(ChosenEmitter {
            emitter,
            within,
            chance,
        })
    }

    /// Chance of the first of two halves; `None` if neither can reach the receiver.
    fn chance_of_first(&self, halves: [u32; 2]) -> Option<f32> {
        let [a, b] = halves.map(|h| {
            self.tree
                .light(h, self.origin, self.receiver)
                .map_or(0.0, |l| l.importance)
        });
        let sum = a + b;
        (sum > 0.0).then(|| a / sum)
    }
}

#[cfg(test)]
impl<R: Receiver> LightCut<'_, R> {
    /// How many groups stand for all.
    pub fn len(&self) -> usize {
        self.groups.len()
    }

    /// Chance of each emitter, and of none: where the halves of a group tell that nothing of it can
    /// reach the receiver.
    pub fn chances(&self, emitters: usize) -> (Vec<f32>, f32) {
        let (mut chances, mut none) = (vec![0.0; emitters], 0.0);
        let mut open: Vec<(u32, f32)> = self
            .groups
            .iter()
            .map(|g| (g.node, g.sends.importance / self.importance))
            .collect();
        while let Some((node, chance)) = open.pop() {
            if let Some(emitter) = self.tree.emitter(node) {
                chances[emitter as usize] += chance;
            } else if let Some(halves) = self.tree.halves(node)
                && let Some(first) = self.chance_of_first(halves)
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
