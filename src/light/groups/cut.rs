//! The groups that stand for all lights of a scene at a point.

use super::Exactness;
use super::node::{Node, Sent};
use crate::scene::Light;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

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

/// The nodes that stand for all: those that may be most wrong are split until none may be by more
/// than is allowed, or there are as many as are allowed. In the order of nodes.
pub fn cut(
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
