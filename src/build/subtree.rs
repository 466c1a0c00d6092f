//! The octree over surfels in Morton order, from the leaves up, and its cutting into pages.

use super::aggregate::AggregateSums;
use super::morton;
use crate::formats::{
    Below, Bounds, EncodedPage, FormatError, Node, Surfel, SurfelAggregate, SurfelPage, TreeLevel,
    node_bytes, surfel_bytes,
};
use crate::run::Cancel;
use crate::{Error, Result};
use rayon::prelude::*;
use std::cmp::Reverse;

/// A leaf holds at most this many surfels.
pub const MAX_LEAF_SURFELS: usize = 8;
/// Below this many surfels a subtree is built by one thread.
const SERIAL_SURFELS: usize = 8192;
/// Bytes of a link, beside those of its node.
const LINK_BYTES: u32 = 4;

/// Settings of pages.
#[derive(Clone, Copy, Debug)]
pub struct PageSettings {
    /// Most bytes of a page before compression.
    pub bytes: u32,
    /// Disk overlap of the cloud.
    pub overlap: f32,
}

/// Surfels and their order: keys with indices, sorted.
pub struct Sorted<'a> {
    pub surfels: &'a [Surfel],
    pub order: &'a [(u64, u32)],
}

/// A part of the tree that is not written yet: small enough for one page.
pub struct Pending {
    /// Over all that is below, in pages or not.
    sums: AggregateSums,
    /// Counts by steps below this node, the most steps first.
    steps: Vec<TreeLevel>,
    node: PendingNode,
}

/// A node that is not written yet. There are many of them, so they do without the sums.
struct PendingNode {
    aggregate: SurfelAggregate,
    bounds: Bounds,
    below: PendingBelow,
    /// Bytes in a page, of the node and all that is below it in the same page.
    bytes: u32,
}

enum PendingBelow {
    Nodes(Vec<PendingNode>),
    Surfels(Box<[Surfel]>),
    Page(u32),
}

/// Pages that are done but not in the file yet. Ids count from `first`.
pub struct Pages {
    pub first: u32,
    pub done: Vec<EncodedPage>,
    settings: PageSettings,
}

impl Pages {
    pub fn new(first: u32, settings: PageSettings) -> Self {
        Self {
            first,
            done: Vec::new(),
            settings,
        }
    }

    fn next_id(&self) -> u32 {
        self.first + self.done.len() as u32
    }

    /// Appends the pages of a subtree that was built apart, whose ids count from 0.
    pub fn append(&mut self, other: Pages, pending: &mut Pending) {
        pending.node.shift_links(self.next_id());
        self.done.extend(other.done);
    }

    /// Encodes a page and puts a link in its place.
    pub fn cut(&mut self, pending: Pending) -> Result<Pending> {
        Ok(Pending {
            sums: pending.sums,
            steps: pending.steps,
            node: self.cut_node(pending.node)?,
        })
    }

    fn cut_node(&mut self, node: PendingNode) -> Result<PendingNode> {
        if matches!(node.below, PendingBelow::Page(_)) {
            return Ok(node);
        }
        let aggregate = node.aggregate;
        let id = self.next_id();
        let encoded =
            EncodedPage::new(&node.into_page(), id, self.settings.overlap).map_err(too_large)?;
        // What readers decode may be a little larger than what was given.
        let bounds = encoded.bounds();
        self.done.push(encoded);
        Ok(PendingNode {
            bytes: node_bytes(&aggregate) + LINK_BYTES,
            aggregate,
            bounds,
            below: PendingBelow::Page(id),
        })
    }
}

/// A reader checked every surfel, so only sums can be out of range.
fn too_large(error: FormatError) -> Error {
    Error::input(format!("sums over surfels cannot be stored: {error}"))
        .hint("scale the scene to a size whose areas and lights are within 1e-30 to 1e30")
}

impl Pending {
    fn new(
        sums: AggregateSums,
        steps: Vec<TreeLevel>,
        below: PendingBelow,
        bytes_below: u32,
    ) -> Self {
        let aggregate = sums.aggregate();
        Self {
            node: PendingNode {
                bytes: node_bytes(&aggregate) + bytes_below,
                aggregate,
                bounds: sums.bounds,
                below,
            },
            steps,
            sums,
        }
    }

    /// Counts of nodes by steps below this one.
    pub fn levels(self) -> Vec<TreeLevel> {
        self.steps.into_iter().rev().collect()
    }
}

/// Counts of a node over those of its children, which may be of different heights.
fn count_steps(children: &mut [Pending]) -> Vec<TreeLevel> {
    let highest = children.iter_mut().max_by_key(|c| c.steps.len());
    let mut steps = highest.map_or_else(Vec::new, |c| std::mem::take(&mut c.steps));
    for child in children {
        let first = steps.len() - child.steps.len();
        for (a, b) in steps[first..].iter_mut().zip(&child.steps) {
            a.nodes += b.nodes;
            a.leaves += b.leaves;
            a.surfels += b.surfels;
        }
    }
    steps.push(TreeLevel {
        nodes: 1,
        ..TreeLevel::default()
    });
    steps
}

impl PendingNode {
    fn shift_links(&mut self, by: u32) {
        match &mut self.below {
            PendingBelow::Nodes(nodes) => nodes.iter_mut().for_each(|n| n.shift_links(by)),
            PendingBelow::Surfels(_) => {}
            PendingBelow::Page(id) => *id += by,
        }
    }

    /// Breadth first, as the format wants it.
    fn into_page(self) -> SurfelPage {
        let mut page = SurfelPage::default();
        let mut next = 1;
        let mut queue = std::collections::VecDeque::from([self]);
        while let Some(node) = queue.pop_front() {
            let below = match node.below {
                PendingBelow::Nodes(nodes) => {
                    let first = next;
                    let count = nodes.len() as u8;
                    next += u32::from(count);
                    queue.extend(nodes);
                    Below::Nodes { first, count }
                }
                PendingBelow::Surfels(surfels) => {
                    let first = page.surfels.len() as u32;
                    let count = surfels.len() as u8;
                    page.surfels.extend(surfels);
                    Below::Surfels { first, count }
                }
                PendingBelow::Page(id) => Below::Page(id),
            };
            page.nodes.push(Node {
                bounds: node.bounds,
                below,
                aggregate: node.aggregate,
            });
        }
        page
    }
}

/// Builds the subtree of a cell of `level`; there must be at least one surfel.
///
/// The shape depends on the surfels alone: at most [`MAX_LEAF_SURFELS`] are a leaf; a cell with one
/// child that is not empty is that child; surfels of one last-level cell are divided by their
/// order.
pub fn build(
    surfels: &Sorted<'_>,
    level: u32,
    pages: &mut Pages,
    cancel: &Cancel,
) -> Result<Pending> {
    let n = surfels.order.len();
    if n <= MAX_LEAF_SURFELS {
        return Ok(leaf(surfels));
    }
    let (level, children) = split(surfels, level);
    if n <= SERIAL_SURFELS {
        let children = children
            .iter()
            .map(|c| build(c, (level + 1).min(morton::LEVELS), pages, cancel))
            .collect::<Result<_>>()?;
        return join(children, pages);
    }
    cancel.check()?;
    let built: Vec<Result<(Pending, Pages)>> = children
        .par_iter()
        .map(|c| {
            let mut own = Pages::new(0, pages.settings);
            let pending = build(c, (level + 1).min(morton::LEVELS), &mut own, cancel)?;
            Ok((pending, own))
        })
        .collect();
    let mut children = Vec::with_capacity(built.len());
    for result in built {
        let (mut pending, own) = result?;
        pages.append(own, &mut pending);
        children.push(pending);
    }
    join(children, pages)
}

/// Makes a node of its children and cuts off pages until the rest fits in one: the largest first,
/// so that pages are few and full.
pub fn join(mut children: Vec<Pending>, pages: &mut Pages) -> Result<Pending> {
    let steps = count_steps(&mut children);
    let mut sums = AggregateSums::NOTHING;
    for child in &children {
        sums.add(&child.sums);
    }
    let own = node_bytes(&sums.aggregate());
    let mut bytes: u32 = children.iter().map(|c| c.node.bytes).sum();
    let mut by_size: Vec<usize> = (0..children.len()).collect();
    by_size.sort_by_key(|i| (Reverse(children[*i].node.bytes), *i));
    let mut is_cut = [false; 8];
    for i in by_size {
        if own + bytes <= pages.settings.bytes {
            break;
        }
        let child = &children[i].node;
        bytes = bytes - child.bytes + node_bytes(&child.aggregate) + LINK_BYTES;
        is_cut[i] = true;
    }
    let nodes = children
        .into_iter()
        .zip(is_cut)
        .map(|(child, cut)| {
            if cut {
                pages.cut_node(child.node)
            } else {
                Ok(child.node)
            }
        })
        .collect::<Result<_>>()?;
    Ok(Pending::new(sums, steps, PendingBelow::Nodes(nodes), bytes))
}

fn leaf(surfels: &Sorted<'_>) -> Pending {
    let own: Box<[Surfel]> = surfels
        .order
        .iter()
        .map(|(_, i)| surfels.surfels[*i as usize])
        .collect();
    let count = TreeLevel {
        nodes: 1,
        leaves: 1,
        surfels: own.len() as u64,
        bytes: 0,
    };
    let bytes = own.iter().map(surfel_bytes).sum();
    Pending::new(
        AggregateSums::of(&own),
        vec![count],
        PendingBelow::Surfels(own),
        bytes,
    )
}

/// The first level at which the surfels divide, and its cell's children that are not empty.
fn split<'a>(surfels: &Sorted<'a>, mut level: u32) -> (u32, Vec<Sorted<'a>>) {
    let sorted = |order| Sorted {
        surfels: surfels.surfels,
        order,
    };
    let order = surfels.order;
    let (first, last) = (order[0].0, order[order.len() - 1].0);
    while level < morton::LEVELS && morton::child(first, level) == morton::child(last, level) {
        level += 1;
    }
    if level == morton::LEVELS {
        let n = order.len();
        let runs = eighths(n as u64).map(|r| sorted(&order[r.start as usize..r.end as usize]));
        return (level, runs.collect());
    }
    let mut rest = order;
    let mut children = Vec::with_capacity(8);
    while let Some((key, _)) = rest.first() {
        let child = morton::child(*key, level);
        let end = rest.partition_point(|(key, _)| morton::child(*key, level) <= child);
        let (own, others) = rest.split_at(end);
        children.push(sorted(own));
        rest = others;
    }
    (level, children)
}

/// How more than [`MAX_LEAF_SURFELS`] surfels of one last-level cell are divided: eight runs of
/// nearly the same length.
pub fn eighths(n: u64) -> impl Iterator<Item = std::ops::Range<u64>> {
    let at = move |k: u64| ((u128::from(n) * u128::from(k)) / 8) as u64;
    (0..8).map(move |k| at(k)..at(k + 1))
}
