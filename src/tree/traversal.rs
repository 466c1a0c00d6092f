//! The way of a query through the nodes of a tree, from the root down, page by page.

use super::page::{ChildKind, WideNode};
use super::pages::{Page, SurfelStore};
use std::ops::ControlFlow;

/// A node that is still to be visited, and what the query knows of it.
#[derive(Clone, Copy, Debug)]
pub struct OpenNode<T> {
    page: u32,
    node: u32,
    state: T,
}

/// The bit that tells an open leaf from an open node; pages have fewer of either.
const LEAF: u32 = 1 << 31;

/// The nodes that are still to be visited, the next last. Not by recursion: a tree may be as deep
/// as its file is long.
#[derive(Debug)]
pub struct OpenNodes<T>(Vec<OpenNode<T>>);

impl<T> Default for OpenNodes<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<T> OpenNodes<T> {
    /// Opens a child of a node; nothing happens for a leaf or an empty slot.
    #[inline(always)]
    pub fn open(&mut self, node: &Visited<'_>, child: usize, state: T) {
        let below = node.children.child[child];
        let (page, node) = match node.children.kind[child] {
            ChildKind::Inner => (node.page_id, below),
            ChildKind::Page | ChildKind::EvenPage => (below, 0),
            ChildKind::Leaf | ChildKind::None => return,
        };
        self.0.push(OpenNode { page, node, state });
    }

    /// Opens a child of a node that is a leaf, for queries that open leaves.
    #[inline(always)]
    pub fn open_leaf(&mut self, node: &Visited<'_>, child: usize, state: T) {
        self.0.push(OpenNode {
            page: node.page_id,
            node: LEAF | node.children.child[child],
            state,
        });
    }

    /// How many nodes are open.
    #[inline(always)]
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Turns the order around of the nodes that were opened since there were `count`: the first of
    /// them is visited first.
    #[inline(always)]
    pub fn reverse_from(&mut self, count: usize) {
        self.0[count..].reverse();
    }
}

/// A node of the tree while it is visited.
#[derive(Debug)]
pub struct Visited<'a> {
    /// The page that it is in.
    pub page: &'a Page<'a>,
    /// Its children.
    pub children: &'a WideNode,
    page_id: u32,
}

/// A query that looks at the children of nodes, and opens those below which there is more to see.
pub trait Query {
    /// What it knows of an open node, such as the distance at which a ray enters that.
    type State;

    /// Whether it opens leaves, too, so that they are visited in order among nodes.
    const OPENS_LEAVES: bool = false;

    /// Whether an open node need not be visited any more.
    #[inline(always)]
    fn skips(&self, _: &Self::State) -> bool {
        false
    }

    /// Looks at the children of a node, and opens some: the one opened last is visited first.
    fn visit(
        &mut self,
        node: &Visited<'_>,
        state: &Self::State,
        open: &mut OpenNodes<Self::State>,
    ) -> ControlFlow<()>;

    /// Looks at a leaf that was opened, a block of disks of a page.
    fn visit_leaf(&mut self, _: &Page<'_>, _block: u32) {}
}

/// Leads a query through a tree, from the root on, until it breaks or no node is open. `open` is
/// a buffer. Nodes that cannot be read are left out.
#[inline(always)]
pub fn traverse<Q: Query>(
    pages: &SurfelStore,
    query: &mut Q,
    first: Q::State,
    open: &mut OpenNodes<Q::State>,
) -> ControlFlow<()> {
    let Some(root) = pages.root() else {
        return ControlFlow::Continue(());
    };
    open.0.clear();
    open.0.push(OpenNode {
        page: root,
        node: 0,
        state: first,
    });
    let mut page_id = root;
    let mut page = pages.page(root);
    while let Some(next) = open.0.pop() {
        if query.skips(&next.state) {
            continue;
        }
        if next.page != page_id {
            page = pages.page(next.page);
            page_id = next.page;
        }
        if Q::OPENS_LEAVES && next.node & LEAF != 0 {
            query.visit_leaf(&page, next.node & !LEAF);
        } else if let Some(children) = page.nodes().nodes.get(next.node as usize) {
            let node = Visited {
                page: &page,
                children,
                page_id,
            };
            query.visit(&node, &next.state, open)?;
        }
    }
    ControlFlow::Continue(())
}
