//! The octree over surfels in Morton order, from the leaves up, and its cutting into pages.

use super::morton;
use crate::formats::{
    Below, Bounds, EncodedPage, FormatError, Node, Surfel, SurfelAggregate, SurfelPage, TreeLevel,
    node_bytes, surfel_bytes,
};
use crate::run::Cancel;
use crate::tree::{AggregateSums, is_even};
use crate::{Error, Result};
use rayon::prelude::*;
use std::cmp::Reverse;

/// A leaf holds at most this many surfels.
pub const MAX_LEAF_SURFELS: usize = 8;
/// Below this many surfels a subtree is built by one thread.
const SERIAL_SURFELS: usize = 8192;
/// Of a node that does not fit in one page with all below it, what takes this share of a page or
/// more is a page of its own.
const LARGE_SHARE: u32 = 4;
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
    Page {
        id: u32,
        /// Whether the nodes right below send about what it sends.
        is_even: bool,
    },
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
    pub fn cut(&mut self, mut pending: Pending) -> Result<Pending> {
        self.cut_node(&mut pending.node)?;
        Ok(pending)
    }

    fn cut_node(&mut self, node: &mut PendingNode) -> Result<()> {
        if matches!(node.below, PendingBelow::Page { .. }) {
            return Ok(());
        }
        let id = self.next_id();
        let encoded =
            EncodedPage::new(&node.page(), id, self.settings.overlap).map_err(too_large)?;
        // What readers decode may be a little larger than what was given.
        node.bounds = encoded.bounds();
        node.bytes = node_bytes(&node.aggregate) + LINK_BYTES;
        let is_even = match &node.below {
            PendingBelow::Nodes(parts) => {
                is_even(&node.aggregate, parts.iter().map(|part| &part.aggregate))
            }
            _ => false,
        };
        node.below = PendingBelow::Page { id, is_even };
        self.done.push(encoded);
        Ok(())
    }
}

/// A reader checked every surfel, so only sums can be out of range.
fn too_large(error: FormatError) -> Error {
    Error::input(format!("sums over surfels cannot be stored: {error}"))
        .hint("scale the scene to a size whose areas and lights are within 1e-30 to 1e30")
}

impl Pending {
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
            PendingBelow::Page { id, .. } => *id += by,
        }
    }

    /// The node and what is below it, breadth first, as the format wants it.
    fn page(&self) -> SurfelPage {
        let mut nodes = vec![self];
        let (mut at, mut surfels) = (0, 0);
        while let Some(node) = nodes.get(at) {
            match &node.below {
                PendingBelow::Nodes(children) => nodes.extend(children),
                PendingBelow::Surfels(own) => surfels += own.len(),
                PendingBelow::Page { .. } => {}
            }
            at += 1;
        }
        let mut page = SurfelPage {
            nodes: Vec::with_capacity(nodes.len()),
            surfels: Vec::with_capacity(surfels),
        };
        let mut next = 1;
        for node in nodes {
            let below = match &node.below {
                PendingBelow::Nodes(children) => {
                    let (first, count) = (next, children.len() as u8);
                    next += u32::from(count);
                    Below::Nodes { first, count }
                }
                PendingBelow::Surfels(own) => {
                    let (first, count) = (page.surfels.len() as u32, own.len() as u8);
                    page.surfels.extend_from_slice(own);
                    Below::Surfels { first, count }
                }
                PendingBelow::Page { id, is_even: true } => Below::EvenPage(*id),
                PendingBelow::Page { id, is_even: false } => Below::Page(*id),
            };
            page.nodes.push(Node {
                bounds: node.bounds,
                below,
                aggregate: node.aggregate,
            });
        }
        page
    }

    /// A node over others, with the sums over these. If they do not fit in one page, cuts off all
    /// that are large, so that pages above are of nodes alone, which most patches need no more
    /// than; then the largest first until the rest fits.
    fn over(mut children: Vec<Self>, sums: &AggregateSums, pages: &mut Pages) -> Result<Self> {
        let aggregate = sums.aggregate();
        let own = node_bytes(&aggregate);
        let mut below: u32 = children.iter().map(|c| c.bytes).sum();
        if own + below > pages.settings.bytes {
            let mut by_size: Vec<usize> = (0..children.len()).collect();
            by_size.sort_by_key(|i| (Reverse(children[*i].bytes), *i));
            let mut is_cut = [false; 8];
            let large = pages.settings.bytes / LARGE_SHARE;
            for i in by_size {
                if own + below <= pages.settings.bytes && children[i].bytes < large {
                    break;
                }
                let child = &children[i];
                below = below - child.bytes + node_bytes(&child.aggregate) + LINK_BYTES;
                is_cut[i] = true;
            }
            for (child, _) in children.iter_mut().zip(is_cut).filter(|(_, cut)| *cut) {
                pages.cut_node(child)?;
            }
        }
        Ok(Self {
            aggregate,
            bounds: sums.bounds,
            below: PendingBelow::Nodes(children),
            bytes: own + below,
        })
    }

    /// A leaf, with the sums over its surfels.
    fn leaf(surfels: &[Surfel], sums: &AggregateSums) -> Self {
        let aggregate = sums.aggregate();
        let below: u32 = surfels.iter().map(surfel_bytes).sum();
        Self {
            bytes: node_bytes(&aggregate) + below,
            aggregate,
            bounds: sums.bounds,
            below: PendingBelow::Surfels(surfels.into()),
        }
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
    cancel.check()?;
    let order = surfels.order;
    if order.len() <= SERIAL_SURFELS {
        let own: Vec<Surfel> = order
            .iter()
            .map(|(_, i)| surfels.surfels[*i as usize])
            .collect();
        let mut serial = Serial {
            pages,
            levels: Vec::new(),
        };
        let mut sums = AggregateSums::NOTHING;
        let node = serial.node(&own, order, level, 0, &mut sums)?;
        let mut steps = serial.levels;
        steps.reverse();
        return Ok(Pending { sums, steps, node });
    }
    let (level, children) = split(order, level);
    let children: Vec<_> = children.collect();
    let built: Vec<Result<(Pending, Pages)>> = children
        .par_iter()
        .map(|order| {
            let mut own = Pages::new(0, pages.settings);
            let surfels = Sorted { order, ..*surfels };
            let pending = build(&surfels, level, &mut own, cancel)?;
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

/// A subtree that one thread builds.
struct Serial<'a> {
    pages: &'a mut Pages,
    /// Counts by steps below the root.
    levels: Vec<TreeLevel>,
}

impl Serial<'_> {
    /// The node of a cell, `depth` steps below the root, over surfels in their order; adds these to
    /// `sums`, which must be over nothing.
    fn node(
        &mut self,
        surfels: &[Surfel],
        order: &[(u64, u32)],
        level: u32,
        depth: usize,
        sums: &mut AggregateSums,
    ) -> Result<PendingNode> {
        if self.levels.len() == depth {
            self.levels.push(TreeLevel::default());
        }
        let counts = &mut self.levels[depth];
        counts.nodes += 1;
        if surfels.len() <= MAX_LEAF_SURFELS {
            counts.leaves += 1;
            counts.surfels += surfels.len() as u64;
            surfels.iter().for_each(|s| sums.add_surfel(s));
            return Ok(PendingNode::leaf(surfels, sums));
        }
        let (level, runs) = split(order, level);
        let mut children = Vec::with_capacity(8);
        let mut rest = surfels;
        for run in runs {
            let (own, others) = rest.split_at(run.len());
            rest = others;
            let mut below = AggregateSums::NOTHING;
            children.push(self.node(own, run, level, depth + 1, &mut below)?);
            sums.add(&below);
        }
        PendingNode::over(children, sums, self.pages)
    }
}

/// Makes a node of its children, and pages of what does not fit in one with it.
pub fn join(mut children: Vec<Pending>, pages: &mut Pages) -> Result<Pending> {
    let steps = count_steps(&mut children);
    let mut sums = AggregateSums::NOTHING;
    for child in &children {
        sums.add(&child.sums);
    }
    let children = children.into_iter().map(|child| child.node).collect();
    let node = PendingNode::over(children, &sums, pages)?;
    Ok(Pending { sums, steps, node })
}

/// The children of a cell at the first level at which surfels divide, as runs of their order, and
/// the level of these. There must be more than [`MAX_LEAF_SURFELS`].
fn split(order: &[(u64, u32)], mut level: u32) -> (u32, impl Iterator<Item = &[(u64, u32)]>) {
    let (first, last) = (order[0].0, order[order.len() - 1].0);
    while level < morton::LEVELS && morton::child(first, level) == morton::child(last, level) {
        level += 1;
    }
    let is_one_spot = level == morton::LEVELS;
    let mut spots = eighths(order.len() as u64);
    let mut rest = order;
    let runs = std::iter::from_fn(move || {
        let end = if is_one_spot {
            let spot = spots.next()?;
            (spot.end - spot.start) as usize
        } else {
            let child = morton::child(rest.first()?.0, level);
            rest.partition_point(|(key, _)| morton::child(*key, level) <= child)
        };
        let (own, others) = rest.split_at(end);
        rest = others;
        Some(own)
    });
    ((level + 1).min(morton::LEVELS), runs)
}

/// How more than [`MAX_LEAF_SURFELS`] surfels of one last-level cell are divided: eight runs of
/// nearly the same length.
pub fn eighths(n: u64) -> impl Iterator<Item = std::ops::Range<u64>> {
    let at = move |k: u64| ((u128::from(n) * u128::from(k)) / 8) as u64;
    (0..8).map(move |k| at(k)..at(k + 1))
}
