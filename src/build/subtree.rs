//! The octree over surfels in Morton order, from the leaves up, and its cutting into pages.

use super::aggregate::Sums;
use super::morton;
use crate::formats::{
    Below, Bounds, EncodedPage, FormatError, Level, Node, Surfel, SurfelAggregate, SurfelPage,
    node_bytes, surfel_bytes,
};
use crate::run::Cancel;
use crate::{Error, Result};
use rayon::prelude::*;
use std::cmp::Reverse;

/// A leaf holds at most this many surfels.
pub const LEAF: usize = 8;
/// Below this many surfels a subtree is built by one thread.
const ALONE: usize = 8192;
/// Bytes of a link, beside those of its node.
const LINK: u32 = 4;

/// What decides about pages.
#[derive(Clone, Copy, Debug)]
pub struct PageSettings {
    /// Most bytes of a page before compression.
    pub bytes: u32,
    /// That of the cloud.
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
    sums: Sums,
    /// Counts by steps below this node, the most steps first.
    steps: Vec<Level>,
    node: Part,
}

/// A node of such a part. There are many of them, so they do without the sums.
struct Part {
    aggregate: SurfelAggregate,
    bounds: Bounds,
    below: PartBelow,
    /// Bytes in a page, of the node and all that is below it in the same page.
    bytes: u32,
}

enum PartBelow {
    Nodes(Vec<Part>),
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
            node: self.cut_part(pending.node)?,
        })
    }

    fn cut_part(&mut self, part: Part) -> Result<Part> {
        if matches!(part.below, PartBelow::Page(_)) {
            return Ok(part);
        }
        let aggregate = part.aggregate;
        let id = self.next_id();
        let encoded =
            EncodedPage::new(&part.into_page(), id, self.settings.overlap).map_err(too_large)?;
        // What readers decode may be a little larger than what was given.
        let bounds = encoded.bounds();
        self.done.push(encoded);
        Ok(Part {
            bytes: node_bytes(&aggregate) + LINK,
            aggregate,
            bounds,
            below: PartBelow::Page(id),
        })
    }
}

/// A reader checked every surfel, so only sums can be out of range.
fn too_large(error: FormatError) -> Error {
    Error::input(format!("sums over surfels cannot be stored: {error}"))
        .hint("scale the scene to a size whose areas and lights are within 1e-30 to 1e30")
}

impl Pending {
    fn new(sums: Sums, steps: Vec<Level>, below: PartBelow, bytes_below: u32) -> Self {
        let aggregate = sums.aggregate();
        Self {
            node: Part {
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
    pub fn levels(self) -> Vec<Level> {
        self.steps.into_iter().rev().collect()
    }
}

/// Counts of a node over those of its children, which may be of different heights.
fn count_steps(children: &mut [Pending]) -> Vec<Level> {
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
    steps.push(Level {
        nodes: 1,
        ..Level::default()
    });
    steps
}

impl Part {
    fn shift_links(&mut self, by: u32) {
        match &mut self.below {
            PartBelow::Nodes(nodes) => nodes.iter_mut().for_each(|n| n.shift_links(by)),
            PartBelow::Surfels(_) => {}
            PartBelow::Page(id) => *id += by,
        }
    }

    /// Breadth first, as the format wants it.
    fn into_page(self) -> SurfelPage {
        let mut page = SurfelPage::default();
        let mut next = 1;
        let mut queue = std::collections::VecDeque::from([self]);
        while let Some(part) = queue.pop_front() {
            let below = match part.below {
                PartBelow::Nodes(nodes) => {
                    let first = next;
                    let count = nodes.len() as u8;
                    next += u32::from(count);
                    queue.extend(nodes);
                    Below::Nodes { first, count }
                }
                PartBelow::Surfels(surfels) => {
                    let first = page.surfels.len() as u32;
                    let count = surfels.len() as u8;
                    page.surfels.extend(surfels);
                    Below::Surfels { first, count }
                }
                PartBelow::Page(id) => Below::Page(id),
            };
            page.nodes.push(Node {
                bounds: part.bounds,
                below,
                aggregate: part.aggregate,
            });
        }
        page
    }
}

/// Builds the subtree of a cell of `level`; there must be at least one surfel.
///
/// The shape depends on the surfels alone: at most [`LEAF`] are a leaf; a cell with one child that
/// is not empty is that child; surfels of one last-level cell are divided by their order.
pub fn build(
    surfels: &Sorted<'_>,
    level: u32,
    pages: &mut Pages,
    cancel: &Cancel,
) -> Result<Pending> {
    let n = surfels.order.len();
    if n <= LEAF {
        return Ok(leaf(surfels));
    }
    let (level, children) = split(surfels, level);
    if n <= ALONE {
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
    let mut sums = Sums::NOTHING;
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
        bytes = bytes - child.bytes + node_bytes(&child.aggregate) + LINK;
        is_cut[i] = true;
    }
    let nodes = children
        .into_iter()
        .zip(is_cut)
        .map(|(child, cut)| {
            if cut {
                pages.cut_part(child.node)
            } else {
                Ok(child.node)
            }
        })
        .collect::<Result<_>>()?;
    Ok(Pending::new(sums, steps, PartBelow::Nodes(nodes), bytes))
}

fn leaf(surfels: &Sorted<'_>) -> Pending {
    let own: Box<[Surfel]> = surfels
        .order
        .iter()
        .map(|(_, i)| surfels.surfels[*i as usize])
        .collect();
    let count = Level {
        nodes: 1,
        leaves: 1,
        surfels: own.len() as u64,
        bytes: 0,
    };
    let bytes = own.iter().map(surfel_bytes).sum();
    Pending::new(Sums::of(&own), vec![count], PartBelow::Surfels(own), bytes)
}

/// The first level at which the surfels divide, and its cell's children that are not empty.
fn split<'a>(surfels: &Sorted<'a>, mut level: u32) -> (u32, Vec<Sorted<'a>>) {
    let part = |order| Sorted {
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
        let parts = eighths(n as u64).map(|r| part(&order[r.start as usize..r.end as usize]));
        return (level, parts.collect());
    }
    let mut rest = order;
    let mut children = Vec::with_capacity(8);
    while let Some((key, _)) = rest.first() {
        let child = morton::child(*key, level);
        let end = rest.partition_point(|(key, _)| morton::child(*key, level) <= child);
        let (own, others) = rest.split_at(end);
        children.push(part(own));
        rest = others;
    }
    (level, children)
}

/// How more than [`LEAF`] surfels of one last-level cell are divided: eight runs of nearly the same
/// length.
pub fn eighths(n: u64) -> impl Iterator<Item = std::ops::Range<u64>> {
    let at = move |k: u64| ((u128::from(n) * u128::from(k)) / 8) as u64;
    (0..8).map(move |k| at(k)..at(k + 1))
}
