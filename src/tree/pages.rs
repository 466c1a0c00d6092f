//! Where pages are kept: for good once they were decoded, or in a cache of bounded size.
//!
//! Either way a page that no ray touches is never read.

use super::decoder::{Decoder, PageStats, WholePage};
use super::page::{self, PageLeaves, PageNodes};
use crate::run::size;
use crate::{Error, Result};
use lvox_formats::{MappedFile, Tree};
use quick_cache::sync::Cache;
use quick_cache::{DefaultHashBuilder, OptionsBuilder, Weighter};
use std::path::Path;
use std::sync::{Arc, OnceLock};

/// A page in use.
pub trait Page {
    /// Returns the nodes of the page.
    fn nodes(&self) -> &PageNodes;

    /// Returns the leaves of the page. Leaves that cannot be read are given as none.
    fn leaves(&self) -> &PageLeaves;
}

/// Gives pages to the kernels.
pub trait Pages: Sync {
    /// A page while it is used.
    type Page<'a>: Page
    where
        Self: 'a;

    /// Returns the page at which every query starts; `None` for a tree without surfels.
    fn root(&self) -> Option<u32>;

    /// Returns a page. One that cannot be read is given as empty; [`Pages::check`] then tells.
    fn page(&self, id: u32) -> Self::Page<'_>;

    /// Returns an error if any page could not be read so far.
    ///
    /// # Errors
    /// A page with a wrong checksum or content.
    fn check(&self) -> Result<()>;
}

/// A tree whose pages stay in memory once decoded; leaves are decoded when they are first asked
/// for.
#[derive(Debug)]
pub struct ResidentTree {
    decoder: Decoder,
    pages: Vec<ResidentEntry>,
}

/// A page that may have been decoded, and its leaves, too.
type ResidentEntry = (OnceLock<PageNodes>, OnceLock<PageLeaves>);

/// A page of a [`ResidentTree`].
#[derive(Clone, Copy, Debug)]
pub struct ResidentPage<'a> {
    decoder: &'a Decoder,
    id: u32,
    nodes: &'a PageNodes,
    leaves: &'a OnceLock<PageLeaves>,
}

impl Page for ResidentPage<'_> {
    #[inline]
    fn nodes(&self) -> &PageNodes {
        self.nodes
    }

    #[inline]
    fn leaves(&self) -> &PageLeaves {
        self.leaves.get_or_init(|| self.decoder.leaves(self.id))
    }
}

impl Pages for ResidentTree {
    type Page<'a> = ResidentPage<'a>;

    fn root(&self) -> Option<u32> {
        self.decoder.tree.root_page()
    }

    #[inline]
    fn page(&self, id: u32) -> ResidentPage<'_> {
        let (nodes, leaves) = &self.pages[id as usize];
        ResidentPage {
            decoder: &self.decoder,
            id,
            nodes: nodes.get_or_init(|| self.decoder.nodes(id)),
            leaves,
        }
    }

    fn check(&self) -> Result<()> {
        self.decoder.check()
    }
}

/// A tree whose decoded pages live in a cache of bounded size.
#[derive(Debug)]
pub struct CachedTree {
    decoder: Decoder,
    cache: Cache<u32, Arc<WholePage>, PageBytes>,
}

impl Page for Arc<WholePage> {
    fn nodes(&self) -> &PageNodes {
        &self.nodes
    }

    fn leaves(&self) -> &PageLeaves {
        &self.leaves
    }
}

/// Weighs a page by its bytes.
#[derive(Clone, Debug)]
struct PageBytes;

impl Weighter<u32, Arc<WholePage>> for PageBytes {
    fn weight(&self, _: &u32, page: &Arc<WholePage>) -> u64 {
        (page.nodes.bytes() + page.leaves.bytes()) as u64 + 64
    }
}

impl Pages for CachedTree {
    type Page<'a> = Arc<WholePage>;

    fn root(&self) -> Option<u32> {
        self.decoder.tree.root_page()
    }

    fn page(&self, id: u32) -> Arc<WholePage> {
        // The closure cannot fail; the cache's error type is ours to choose.
        self.cache
            .get_or_insert_with(&id, || {
                Ok::<_, std::convert::Infallible>(Arc::new(self.decoder.whole(id)))
            })
            .unwrap_or_else(|never| match never {})
    }

    fn check(&self) -> Result<()> {
        self.decoder.check()
    }
}

/// The pages of surfels, in either kind of store.
#[derive(Debug)]
pub enum SurfelStore {
    /// Pages that stay in memory once touched.
    Resident(ResidentTree),
    /// Pages within the limit on memory; what is needed again after it had to go is read again.
    Cached(CachedTree),
}

impl SurfelStore {
    /// Opens the pages of a tree file. With a memory limit that they might pass once decoded,
    /// beside `other_bytes` of other data, they are cached within it.
    ///
    /// # Errors
    /// A limit too small for a few pages.
    pub(super) fn new(
        tree: Tree<MappedFile>,
        path: &Path,
        other_bytes: u64,
        memory_limit: Option<u64>,
    ) -> Result<Self> {
        let most = || {
            let blocks = tree.surfel_blocks().iter().enumerate();
            blocks.map(|(i, b)| {
                let (clips, backs) = (tree.has_clips(i), tree.has_backs(i));
                page::most_bytes(u64::from(b.nodes), u64::from(b.records), clips, backs)
            })
        };
        let entry = size_of::<ResidentEntry>() as u64;
        let decoded = most().fold(other_bytes, |sum, bytes| {
            sum.saturating_add(bytes).saturating_add(entry)
        });
        let largest = most().max().unwrap_or(0);
        let count = tree.surfel_pages();
        let decoder = Decoder::new(tree, path);
        let Some(limit) = memory_limit.filter(|&limit| decoded > limit) else {
            let pages = (0..count).map(|_| Default::default()).collect();
            return Ok(Self::Resident(ResidentTree { decoder, pages }));
        };
        // A cache shard never keeps what is heavier than nearly all of it.
        let least = other_bytes.saturating_add(largest.saturating_mul(8));
        size::within("shading from it", least, memory_limit).map_err(|e| e.at(path.display()))?;
        let cache = page_cache(limit - other_bytes, largest, count)?;
        Ok(Self::Cached(CachedTree { decoder, cache }))
    }

    /// The tree file.
    pub(super) fn file(&self) -> &Tree<MappedFile> {
        match self {
            Self::Resident(t) => &t.decoder.tree,
            Self::Cached(t) => &t.decoder.tree,
        }
    }

    /// Counts of the pages used so far.
    pub(super) fn stats(&self) -> PageStats {
        match self {
            Self::Resident(t) => t.decoder.stats(),
            Self::Cached(t) => PageStats {
                hits: t.cache.hits(),
                misses: t.cache.misses(),
                ..t.decoder.stats()
            },
        }
    }
}

/// A cache of so many bytes for pages, the largest of which has `largest` bytes.
fn page_cache(
    budget: u64,
    largest: u64,
    pages: usize,
) -> Result<Cache<u32, Arc<WholePage>, PageBytes>> {
    let shards = (budget / largest.saturating_mul(2).max(1)).clamp(1, 16) as usize;
    let options = OptionsBuilder::new()
        .shards(shards)
        .estimated_items_capacity(pages.max(1))
        .weight_capacity(budget)
        .build()
        .map_err(|e| Error::failed(format!("cannot make a page cache of {budget} bytes: {e:?}")))?;
    Ok(Cache::with_options(
        options,
        PageBytes,
        DefaultHashBuilder::default(),
        Default::default(),
    ))
}
