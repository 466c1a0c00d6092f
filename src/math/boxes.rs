//! Which of many boxes a ray meets.

use super::{Aabb, Ray};
use glam::Vec3;
use smallvec::SmallVec;
use std::ops::Range;

/// Boxes along the axes, in a hierarchy if they are many.
#[derive(Clone, Debug, Default)]
pub struct Boxes {
    count: usize,
    /// Depth first; none if there are few boxes.
    nodes: Vec<Node>,
}

/// A box, or a group of them.
#[derive(Clone, Copy, Debug)]
struct Node {
    bounds: Aabb,
    holds: Holds,
}

#[derive(Clone, Copy, Debug)]
enum Holds {
    One(u32),
    /// Two nodes: the first follows this one, and the second has this index.
    Halves(u32),
}

/// Indices of boxes, from the first to the last.
#[derive(Debug)]
pub enum Indices {
    /// Of all.
    All(Range<usize>),
    /// Of some.
    Some(smallvec::IntoIter<[u32; 32]>),
}

impl Iterator for Indices {
    type Item = usize;

    #[inline]
    fn next(&mut self) -> Option<usize> {
        match self {
            Self::All(range) => range.next(),
            Self::Some(indices) => indices.next().map(|i| i as usize),
        }
    }
}

impl Boxes {
    /// Up to this many are not told apart: what is in each tells more.
    const MAX_FEW: usize = 16;

    /// Takes boxes, wider by what rounding of the ray and of what is in them may be.
    #[must_use]
    pub fn new(boxes: impl IntoIterator<Item = Aabb>) -> Self {
        let mut boxes: Vec<(Aabb, u32)> = boxes.into_iter().zip(0..).collect();
        let count = boxes.len();
        let mut nodes = Vec::new();
        if count > Self::MAX_FEW {
            for (b, _) in &mut boxes {
                let largest = b.min.abs().max(b.max.abs()).max_element();
                let margin = Vec3::splat(1e-5 * largest);
                (b.min, b.max) = (b.min - margin, b.max + margin);
            }
            nodes.reserve_exact(2 * count - 1);
            add(&mut nodes, &mut boxes);
        }
        Self { count, nodes }
    }

    /// The boxes that a ray may meet, and all if they are few.
    #[inline]
    #[must_use]
    pub fn along(&self, ray: &Ray) -> Indices {
        if self.nodes.is_empty() {
            return Indices::All(0..self.count);
        }
        self.found(|b| {
            let enter = b.enter(ray.origin, ray.direction);
            enter.is_some_and(|t| t * (1.0 - 1e-5) <= ray.t_max)
        })
    }

    /// The boxes that may touch another, and all if they are few.
    #[must_use]
    pub fn around(&self, other: &Aabb) -> Indices {
        if self.nodes.is_empty() {
            return Indices::All(0..self.count);
        }
        self.found(|b| b.min.cmple(other.max).all() && b.max.cmpge(other.min).all())
    }

    fn found(&self, is_met: impl Fn(&Aabb) -> bool) -> Indices {
        let mut found = SmallVec::<[u32; 32]>::new();
        let mut todo = SmallVec::<[u32; 32]>::new();
        todo.push(0);
        while let Some(i) = todo.pop() {
            let node = &self.nodes[i as usize];
            if is_met(&node.bounds) {
                match node.holds {
                    Holds::One(index) => found.push(index),
                    Holds::Halves(second) => todo.extend([second, i + 1]),
                }
            }
        }
        // Sums over them do not depend on the hierarchy.
        found.sort_unstable();
        Indices::Some(found.into_iter())
    }
}

/// Adds the node over some boxes, halved along the axis on which their middles are most apart.
fn add(nodes: &mut Vec<Node>, boxes: &mut [(Aabb, u32)]) {
    let index = nodes.len();
    let joined = |a: Aabb, b: &Aabb| a.with(b.min).with(b.max);
    let bounds = boxes.iter().fold(Aabb::EMPTY, |all, (b, _)| joined(all, b));
    nodes.push(Node {
        bounds,
        holds: Holds::One(boxes[0].1),
    });
    if boxes.len() == 1 {
        return;
    }
    let middle = |b: &Aabb| 0.5 * b.min + 0.5 * b.max;
    let middles = boxes
        .iter()
        .fold(Aabb::EMPTY, |all, (b, _)| all.with(middle(b)));
    let axis = (middles.max - middles.min).max_position();
    let half = boxes.len() / 2;
    boxes.select_nth_unstable_by(half, |(a, i), (b, j)| {
        middle(a)[axis].total_cmp(&middle(b)[axis]).then(i.cmp(j))
    });
    let (first, second) = boxes.split_at_mut(half);
    add(nodes, first);
    nodes[index].holds = Holds::Halves(nodes.len() as u32);
    add(nodes, second);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    fn boxes(count: u64, size: f32) -> Vec<Aabb> {
        (0..count)
            .map(|i| {
                let at = |k: u64| {
                    Vec3::from([0, 1, 2].map(|a| sampling::unit(sampling::hash(&[i, k, a]))))
                };
                Aabb::EMPTY.with(at(0)).with(at(0) + size * at(1))
            })
            .collect()
    }

    #[test]
    fn many_boxes_are_met_as_one_by_one() {
        for (count, size) in [(17, 0.3), (100, 0.1), (1000, 0.02), (500, 0.0)] {
            let all = boxes(count, size);
            let many = Boxes::new(all.iter().copied());
            let mut met = 0;
            for i in 0..500 {
                let origin = 1.5 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let aim = all[i as usize % all.len()];
                let direction = (0.5 * (aim.min + aim.max) - origin).normalize();
                let ray = Ray::new(origin, direction, 1.8);
                let found: Vec<usize> = many.along(&ray).collect();
                assert!(found.is_sorted());
                for (k, b) in all.iter().enumerate() {
                    let expected = b.enter(origin, direction).is_some_and(|t| t <= ray.t_max);
                    met += usize::from(expected);
                    assert!(!expected || found.contains(&k));
                }
                // None that is far from the ray.
                assert!(found.iter().all(|&k| {
                    let Aabb { min, max } = all[k];
                    let wide = Vec3::splat(1e-3);
                    let wider = Aabb {
                        min: min - wide,
                        max: max + wide,
                    };
                    wider.enter(origin, direction).is_some()
                }));
                let around: Vec<usize> = many.around(&all[i as usize % all.len()]).collect();
                assert!(around.contains(&(i as usize % all.len())));
            }
            assert!(met > 20 || size == 0.0, "{met}");
        }
    }

    #[test]
    fn few_boxes_are_all_given_and_many_at_one_place_are_found() {
        let ray = Ray::endless(Vec3::splat(9.0), Vec3::X);
        let few = Boxes::new(boxes(16, 0.1));
        assert!(few.along(&ray).eq(0..16));
        assert_eq!(Boxes::default().along(&ray).next(), None);
        let one = boxes(1, 0.5)[0];
        let same = Boxes::new(std::iter::repeat_n(one, 10_000));
        assert_eq!(same.along(&ray).count(), 0);
        let middle = 0.5 * (one.min + one.max);
        assert_eq!(same.along(&Ray::endless(middle, Vec3::Y)).count(), 10_000);
    }
}
