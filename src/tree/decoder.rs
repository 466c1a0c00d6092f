//! Decodes the pages of a tree file, and counts what was decoded.

use super::page::{PageLeaves, PageNodes};
use crate::{Error, Result};
use lvox_formats::record::{Node, SurfelLeaves};
use lvox_formats::{FormatError, MappedFile, Tree};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

/// Counts of the pages of a tree that were used.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PageStats {
    /// Pages in the file.
    pub pages: u64,
    /// Pages of which the nodes were decoded, each time counted.
    pub decoded: u64,
    /// Pages of which the disks were decoded, too.
    pub decoded_leaves: u64,
    /// Bytes of the file read for them.
    pub bytes_read: u64,
    /// Bytes of memory that they took once decoded.
    pub bytes_decoded: u64,
    /// Requests that the cache could answer; 0 where pages are kept for good.
    pub hits: u64,
    /// Requests that it could not.
    pub misses: u64,
}

/// The last page that a thread decoded, before it was laid out for rays: memory that is new to a
/// process is a quarter of what decoding costs.
#[derive(Default)]
struct Scratch {
    nodes: Vec<Node>,
    leaves: SurfelLeaves,
}

thread_local! {
    static SCRATCH: RefCell<Scratch> = RefCell::default();
}

/// An open tree file that pages are decoded from.
#[derive(Debug)]
pub(super) struct Decoder {
    pub tree: Tree<MappedFile>,
    path: PathBuf,
    decoded: AtomicU64,
    decoded_leaves: AtomicU64,
    bytes_read: AtomicU64,
    bytes_decoded: AtomicU64,
    failed: AtomicU64,
    failure: Mutex<Option<Error>>,
    links: Links,
    /// Whether pages of the file are given back once they are decoded.
    gives_back: bool,
}

/// The page that links to each page, as far as pages were decoded. A tree in which two do has more
/// paths to a page than a walk can ever end.
#[derive(Debug)]
struct Links(Vec<AtomicU32>);

impl Links {
    const NONE: u32 = u32::MAX;

    fn new(pages: usize) -> Self {
        Self((0..pages).map(|_| AtomicU32::new(Self::NONE)).collect())
    }

    /// Notes the links of a page, each time that it is decoded; an error for a second link to the
    /// same page.
    fn note(&self, id: u32, nodes: &[Node]) -> std::result::Result<(), FormatError> {
        let mut links: Vec<u32> = (nodes.iter()).filter_map(|n| n.below.page()).collect();
        links.sort_unstable();
        let twice = |link: u32, other: u32| FormatError::Invalid {
            what: format!("links to page {link}"),
            expected: "one".into(),
            found: format!("one in page {other} and another in page {id}"),
        };
        if let Some(pair) = links.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(twice(pair[0], id));
        }
        for link in links {
            let Some(linker) = self.0.get(link as usize) else {
                continue;
            };
            let order = Ordering::Relaxed;
            match linker.compare_exchange(Self::NONE, id, order, order) {
                Err(other) if other != id => return Err(twice(link, other)),
                _ => {}
            }
        }
        Ok(())
    }
}

impl Decoder {
    pub fn new(tree: Tree<MappedFile>, path: &Path, gives_back: bool) -> Self {
        Self {
            gives_back,
            links: Links::new(tree.surfel_pages()),
            tree,
            path: path.to_owned(),
            decoded: AtomicU64::new(0),
            decoded_leaves: AtomicU64::new(0),
            bytes_read: AtomicU64::new(0),
            bytes_decoded: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            failure: Mutex::new(None),
        }
    }

    /// The tree file and its path.
    pub fn into_file(self) -> (Tree<MappedFile>, PathBuf) {
        (self.tree, self.path)
    }

    /// Gives the memory of a page of the file back, if pages are.
    fn give_back(&self, id: u32) {
        if self.gives_back {
            self.tree.release_surfel_page(id as usize);
        }
    }

    fn count(&self, id: u32) {
        self.decoded.fetch_add(1, Ordering::Relaxed);
        if let Some(block) = self.tree.surfel_blocks().get(id as usize) {
            self.bytes_read
                .fetch_add(u64::from(block.stored_bytes), Ordering::Relaxed);
        }
    }

    fn count_decoded(&self, bytes: usize) {
        self.bytes_decoded
            .fetch_add(bytes as u64, Ordering::Relaxed);
    }

    pub fn nodes(&self, id: u32) -> PageNodes {
        self.count(id);
        SCRATCH.with_borrow_mut(|Scratch { nodes, .. }| {
            let decoded = self.tree.surfel_nodes(id as usize, nodes);
            match decoded.and_then(|()| self.links.note(id, nodes)) {
                Ok(()) => {
                    self.give_back(id);
                    let page = PageNodes::new(nodes);
                    self.count_decoded(page.bytes());
                    page
                }
                Err(e) => self.fail(e),
            }
        })
    }

    pub fn leaves(&self, id: u32) -> PageLeaves {
        self.decoded_leaves.fetch_add(1, Ordering::Relaxed);
        SCRATCH.with_borrow_mut(|Scratch { leaves, .. }| {
            match self.tree.surfel_leaves(id as usize, leaves) {
                Ok(()) => {
                    self.give_back(id);
                    let page = PageLeaves::new(&leaves.counts, &leaves.surfels);
                    self.count_decoded(page.bytes());
                    page
                }
                Err(e) => self.fail(e),
            }
        })
    }

    /// Notes the first error, and returns something empty.
    fn fail<T: Default>(&self, e: FormatError) -> T {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.get_or_insert_with(|| Error::from(e.at(&self.path)));
        self.failed.store(1, Ordering::Relaxed);
        T::default()
    }

    pub fn check(&self) -> Result<()> {
        if self.failed.load(Ordering::Relaxed) == 0 {
            return Ok(());
        }
        match self
            .failure
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
        {
            Some(e) => Err(e),
            None => Err(Error::input(format!(
                "{}: a page could not be read",
                self.path.display()
            ))),
        }
    }

    pub fn stats(&self) -> PageStats {
        PageStats {
            pages: self.tree.surfel_pages() as u64,
            decoded: self.decoded.load(Ordering::Relaxed),
            decoded_leaves: self.decoded_leaves.load(Ordering::Relaxed),
            bytes_read: self.bytes_read.load(Ordering::Relaxed),
            bytes_decoded: self.bytes_decoded.load(Ordering::Relaxed),
            ..PageStats::default()
        }
    }
}
