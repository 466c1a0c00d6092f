//! Where pages are kept: for good once they were decoded, or in a cache of bounded size.
//!
//! Either way a page that no ray touches is never read.

use super::decoder::{Decoder, PageStats};
use super::page::{self, PageLeaves, PageNodes};
use crate::run::{Resident, memory, size};
use crate::{Error, Result};
use lvox_formats::{MappedFile, Tree};
use quick_cache::sync::Cache;
use quick_cache::{DefaultHashBuilder, OptionsBuilder, Weighter};
use std::cell::OnceCell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::sync::{Arc, OnceLock};

/// A page while it is used.
#[derive(Debug)]
pub enum Page<'a> {
    /// That stays in memory.
    Resident(ResidentPage<'a>),
    /// That lives in a cache.
    Cached(CachedPage<'a>),
}

impl Page<'_> {
    /// Returns the nodes of the page.
    #[inline]
    #[must_use]
    pub fn nodes(&self) -> &PageNodes {
        match self {
            Self::Resident(page) => page.nodes,
            Self::Cached(page) => &page.nodes,
        }
    }

    /// Returns the leaves of the page. Leaves that cannot be read are given as none.
    #[inline]
    #[must_use]
    pub fn leaves(&self) -> &PageLeaves {
        match self {
            Self::Resident(page) => page.leaves(),
            Self::Cached(page) => page.leaves(),
        }
    }
}

/// A tree whose pages stay in memory once decoded; leaves are decoded when they are first asked
/// for.
#[derive(Debug)]
pub struct ResidentTree {
    decoder: Decoder,
    /// Boxed: a tree has far more pages than most frames need.
    pages: Vec<OnceLock<Box<ResidentEntry>>>,
}

/// A page that was decoded, and its leaves, which may have been, too.
type ResidentEntry = (PageNodes, OnceLock<PageLeaves>);

/// A page of a [`ResidentTree`].
#[derive(Clone, Copy, Debug)]
pub struct ResidentPage<'a> {
    decoder: &'a Decoder,
    id: u32,
    nodes: &'a PageNodes,
    leaves: &'a OnceLock<PageLeaves>,
}

impl<'a> ResidentPage<'a> {
    #[inline]
    fn leaves(&self) -> &'a PageLeaves {
        self.leaves.get_or_init(|| self.decoder.leaves(self.id))
    }
}

impl ResidentTree {
    #[inline]
    fn page(&self, id: u32) -> ResidentPage<'_> {
        let decode = || Box::new((self.decoder.nodes(id), OnceLock::new()));
        let (nodes, leaves) = &**self.pages[id as usize].get_or_init(decode);
        ResidentPage {
            decoder: &self.decoder,
            id,
            nodes,
            leaves,
        }
    }
}

/// A tree whose decoded pages live in a cache of bounded size. Nodes and leaves are kept apart:
/// most queries need no leaves, which take as much room as nodes.
#[derive(Debug)]
pub struct CachedTree {
    decoder: Decoder,
    cache: Cache<PartKey, Part, PartBytes>,
    /// The least and the most that the cache may hold, bytes.
    bounds: [u64; 2],
    /// Looks at the process's memory until freed memory may be given back again.
    kept_for: AtomicU32,
}

/// A page and which part of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum PartKey {
    Nodes(u32),
    Leaves(u32),
}

/// A part of a page.
#[derive(Clone, Debug)]
enum Part {
    Nodes(Arc<PageNodes>),
    Leaves(Arc<PageLeaves>),
}

/// A page of a [`CachedTree`], which stays while it is held.
#[derive(Debug)]
pub struct CachedPage<'a> {
    tree: &'a CachedTree,
    id: u32,
    nodes: Arc<PageNodes>,
    leaves: OnceCell<Arc<PageLeaves>>,
}

impl CachedPage<'_> {
    fn leaves(&self) -> &PageLeaves {
        self.leaves.get_or_init(|| self.tree.leaves(self.id))
    }
}

/// Weighs a part of a page by its bytes.
#[derive(Clone, Debug)]
struct PartBytes;

impl Weighter<PartKey, Part> for PartBytes {
    fn weight(&self, _: &PartKey, part: &Part) -> u64 {
        /// Of its entry, and of what the allocator keeps beside its lists.
        const BESIDE: u64 = 256;
        let bytes = match part {
            Part::Nodes(nodes) => nodes.bytes(),
            Part::Leaves(leaves) => leaves.bytes(),
        };
        bytes as u64 + BESIDE
    }
}

impl CachedTree {
    /// A part of a page, decoded if it is not there.
    fn part(&self, key: PartKey) -> Part {
        let decode = || {
            Ok::<_, std::convert::Infallible>(match key {
                PartKey::Nodes(id) => Part::Nodes(Arc::new(self.decoder.nodes(id))),
                PartKey::Leaves(id) => Part::Leaves(Arc::new(self.decoder.leaves(id))),
            })
        };
        // The closure cannot fail; the cache's error type is ours to choose.
        let part = self.cache.get_or_insert_with(&key, decode);
        part.unwrap_or_else(|never| match never {})
    }

    fn page(&self, id: u32) -> CachedPage<'_> {
        CachedPage {
            tree: self,
            id,
            nodes: match self.part(PartKey::Nodes(id)) {
                Part::Nodes(nodes) => nodes,
                Part::Leaves(_) => Arc::default(),
            },
            leaves: OnceCell::new(),
        }
    }

    fn leaves(&self, id: u32) -> Arc<PageLeaves> {
        match self.part(PartKey::Leaves(id)) {
            Part::Leaves(leaves) => leaves,
            Part::Nodes(_) => Arc::default(),
        }
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
    /// Returns the page at which every query starts; `None` for a tree without surfels.
    pub fn root(&self) -> Option<u32> {
        self.file().root_page()
    }

    /// Returns a page. One that cannot be read is given as empty; [`Self::check`] then tells.
    #[inline]
    pub fn page(&self, id: u32) -> Page<'_> {
        match self {
            Self::Resident(tree) => Page::Resident(tree.page(id)),
            Self::Cached(tree) => Page::Cached(tree.page(id)),
        }
    }

    /// Whether a page may have to be decoded again when it is next asked for, so that it pays to
    /// ask in an order in which those near each other follow one another.
    pub fn are_cached(&self) -> bool {
        matches!(self, Self::Cached(_))
    }

    /// Returns an error if any page could not be read so far.
    ///
    /// # Errors
    /// A page with a wrong checksum or content.
    pub fn check(&self) -> Result<()> {
        self.decoder().check()
    }

    /// Opens the pages of a tree file. With a memory limit that they might pass once decoded,
    /// beside `other_bytes` of other data, they are cached within it, and the pages of the file are
    /// given back as soon as they are decoded.
    ///
    /// # Errors
    /// A limit too small for a few pages.
    pub(super) fn new(
        tree: Tree<MappedFile>,
        path: &Path,
        other_bytes: u64,
        memory_limit: Option<u64>,
    ) -> Result<Self> {
        let count = tree.surfel_pages();
        let resident = |decoder| {
            let pages = (0..count).map(|_| Default::default()).collect();
            Ok(Self::Resident(ResidentTree { decoder, pages }))
        };
        // Of a large tree it takes long to say how large its pages are.
        let Some(limit) = memory_limit else {
            return resident(Decoder::new(tree, path, false));
        };
        let most = || most_bytes_of_pages(&tree);
        let entry = (size_of::<ResidentEntry>() + size_of::<OnceLock<Box<ResidentEntry>>>()) as u64;
        let decoded = most().fold(other_bytes, |sum, bytes| {
            sum.saturating_add(bytes).saturating_add(entry)
        });
        let largest = most().max().unwrap_or(0);
        let least = Self::least_bytes(&tree);
        let decoder = Decoder::new(tree, path, true);
        if decoded <= limit {
            return resident(decoder);
        }
        let needed = other_bytes.saturating_add(least);
        size::within("shading from it", needed, memory_limit).map_err(|e| e.at(path.display()))?;
        let most = limit - other_bytes;
        Ok(Self::Cached(CachedTree {
            decoder,
            cache: page_cache(most, largest, count)?,
            // With less, the parts of a cache could not keep a page each.
            bounds: [least.max(most / LEAST_SHARE).min(most), most],
            kept_for: AtomicU32::new(0),
        }))
    }

    /// Bytes of memory with which the pages of a tree can be used.
    pub(super) fn least_bytes(tree: &Tree<MappedFile>) -> u64 {
        // A cache shard never keeps what is heavier than nearly all of it.
        most_bytes_of_pages(tree)
            .max()
            .unwrap_or(0)
            .saturating_mul(8)
    }

    /// The tree file and its path, to open it anew.
    pub(super) fn into_file(self) -> (Tree<MappedFile>, PathBuf) {
        match self {
            Self::Resident(t) => t.decoder.into_file(),
            Self::Cached(t) => t.decoder.into_file(),
        }
    }

    /// Has the cache take no more than a limit leaves beside all else that the process has in
    /// memory now, and that the stage at work holds for now. Its size changes no result.
    pub(super) fn fit(&self, now: Resident, limit: u64, held_for_now: u64) {
        // Pages that are read anew would only come back where memory is of another kind.
        if now.all() > limit && now.mapped > limit / MAPPED_SHARE {
            self.file().release_all();
        }
        let Self::Cached(t) = self else {
            return;
        };
        let [least, most] = t.bounds;
        // Files that are mapped are the system's to take back, and may pass the limit by a tenth.
        let over = now
            .anonymous
            .max(now.kept(limit).saturating_sub(limit / 10));
        let others = over.saturating_sub(t.cache.weight()).max(held_for_now);
        // Between two looks the rest may grow.
        let room = (limit - limit / ROOM_SHARE).saturating_sub(others);
        let capacity = room.clamp(least, most);
        if capacity.abs_diff(t.cache.capacity()) > most / 64 {
            t.cache.set_capacity(capacity);
        }
        let kept_for = t.kept_for.load(Relaxed);
        if kept_for > 0 {
            t.kept_for.store(kept_for - 1, Relaxed);
        } else if over > limit - limit / (2 * ROOM_SHARE) {
            // It locks all that allocates, and has little to give back soon after.
            t.kept_for.store(LOOKS_BETWEEN, Relaxed);
            memory::give_back_freed();
        }
    }

    /// The tree file.
    pub(super) fn file(&self) -> &Tree<MappedFile> {
        &self.decoder().tree
    }

    fn decoder(&self) -> &Decoder {
        match self {
            Self::Resident(t) => &t.decoder,
            Self::Cached(t) => &t.decoder,
        }
    }

    /// Counts of the pages used so far.
    pub(super) fn stats(&self) -> PageStats {
        let decoded = self.decoder().stats();
        match self {
            Self::Resident(_) => decoded,
            Self::Cached(t) => {
                PageStats {
                    hits: t.cache.hits(),
                    // The cache counts those twice that it was told what to hold for.
                    misses: decoded.decoded + decoded.decoded_leaves,
                    ..decoded
                }
            }
        }
    }
}

/// Bytes that each page of a tree takes at most once it is decoded.
fn most_bytes_of_pages(tree: &Tree<MappedFile>) -> impl Iterator<Item = u64> {
    let blocks = tree.surfel_blocks().iter().enumerate();
    blocks.map(|(i, b)| {
        let (clips, backs) = (tree.has_clips(i), tree.has_backs(i));
        page::most_bytes(u64::from(b.nodes), u64::from(b.records), clips, backs)
    })
}

/// The share of a memory limit that caches leave free for what grows between two looks at the
/// process's memory.
const ROOM_SHARE: u64 = 16;
/// The share of what a cache may have that it keeps at least.
const LEAST_SHARE: u64 = 8;
/// The share of a memory limit up to which files that are mapped stay so.
const MAPPED_SHARE: u64 = 64;
/// Looks at the process's memory, a hundredth of a second each, between which freed memory is given
/// back.
const LOOKS_BETWEEN: u32 = 8;

/// A cache of so many bytes for pages, the largest of which has `largest` bytes.
fn page_cache(budget: u64, largest: u64, pages: usize) -> Result<Cache<PartKey, Part, PartBytes>> {
    /// Of the cache, for what was asked for again: in the rest pages stay for a short time, which
    /// is all that most need.
    const HOT_SHARE: f64 = 0.5;
    let shards = (budget / largest.saturating_mul(32).max(1)).clamp(1, 16) as usize;
    let options = OptionsBuilder::new()
        .hot_allocation(HOT_SHARE)
        .shards(shards)
        .estimated_items_capacity(pages.max(1))
        .weight_capacity(budget)
        .build()
        .map_err(|e| Error::failed(format!("cannot make a page cache of {budget} bytes: {e:?}")))?;
    Ok(Cache::with_options(
        options,
        PartBytes,
        DefaultHashBuilder::default(),
        Default::default(),
    ))
}
