//! Where pages come from: decoded when a ray first needs them and kept, or kept in a cache of
//! bounded size.
//!
//! Either way a page that no ray touches is never read.

use super::media::{self, Block, Media, MediaLayout};
use super::page::{self, PageLeaves, PageNodes};
use crate::run::{hex, size};
use crate::{Error, Result};
use glam::DVec3;
use lvox_formats::record::{Below, Lvoxel, Node, SurfelLeaves};
use lvox_formats::{FormatError, MappedFile, Scatter, Tree};
use quick_cache::sync::Cache;
use quick_cache::{DefaultHashBuilder, OptionsBuilder, Weighter};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// A page in use.
pub trait Page {
    /// Its nodes.
    fn nodes(&self) -> &PageNodes;

    /// Its leaves. Leaves that cannot be read are given as none.
    fn leaves(&self) -> &PageLeaves;
}

/// Gives pages to the kernels.
pub trait Pages: Sync {
    /// A page while it is used.
    type Page<'a>: Page
    where
        Self: 'a;

    /// The page at which every ray starts; `None` for a tree without surfels.
    fn root(&self) -> Option<u32>;

    /// A page. A page that cannot be read is given as empty; [`Pages::check`] then tells.
    fn page(&self, id: u32) -> Self::Page<'_>;

    /// An error if any page could not be read so far.
    ///
    /// # Errors
    /// A page with a wrong checksum or content.
    fn check(&self) -> Result<()>;
}

/// How much of a tree was used.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PageStats {
    /// Pages in the file.
    pub pages: u64,
    /// Pages of which the nodes were decoded, each time counted.
    pub decoded: u64,
    /// Those of which the disks were decoded, too.
    pub decoded_leaves: u64,
    /// Bytes of the file read for them.
    pub bytes_read: u64,
    /// Requests that the cache could answer; 0 where pages are kept for good.
    pub hits: u64,
    /// Requests that it could not.
    pub misses: u64,
}

/// What a thread decoded last, before it was laid out for rays: memory that is new to a process is
/// a quarter of what decoding costs.
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
struct Decoder {
    tree: Tree<MappedFile>,
    path: PathBuf,
    decoded: AtomicU64,
    decoded_leaves: AtomicU64,
    bytes_read: AtomicU64,
    failed: AtomicU64,
    failure: Mutex<Option<Error>>,
    links: Links,
}

/// Which page links to each, as far as pages were decoded. A tree in which two do has more paths to
/// a page than a walk can ever end.
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
        let mut links: Vec<u32> = (nodes.iter())
            .filter_map(|n| match n.below {
                Below::Page(link) => Some(link),
                _ => None,
            })
            .collect();
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
    fn count(&self, id: u32) {
        self.decoded.fetch_add(1, Ordering::Relaxed);
        if let Some(block) = self.tree.surfel_blocks().get(id as usize) {
            self.bytes_read
                .fetch_add(u64::from(block.stored_bytes), Ordering::Relaxed);
        }
    }

    fn nodes(&self, id: u32) -> PageNodes {
        self.count(id);
        SCRATCH.with_borrow_mut(|Scratch { nodes, .. }| {
            let decoded = self.tree.surfel_nodes(id as usize, nodes);
            match decoded.and_then(|()| self.links.note(id, nodes)) {
                Ok(()) => PageNodes::new(nodes),
                Err(e) => self.fail(e),
            }
        })
    }

    fn leaves(&self, id: u32) -> PageLeaves {
        self.decoded_leaves.fetch_add(1, Ordering::Relaxed);
        SCRATCH.with_borrow_mut(|Scratch { leaves, .. }| {
            match self.tree.surfel_leaves(id as usize, leaves) {
                Ok(()) => PageLeaves::new(&leaves.counts, &leaves.surfels),
                Err(e) => self.fail(e),
            }
        })
    }

    fn whole(&self, id: u32) -> WholePage {
        self.count(id);
        self.decoded_leaves.fetch_add(1, Ordering::Relaxed);
        let page = self.tree.surfel_page(id as usize).and_then(|page| {
            self.links.note(id, &page.nodes)?;
            let counts: Vec<u8> = page
                .nodes
                .iter()
                .filter_map(|n| n.below.surfels())
                .collect();
            Ok(WholePage {
                nodes: PageNodes::new(&page.nodes),
                leaves: PageLeaves::new(&counts, &page.surfels),
            })
        });
        page.unwrap_or_else(|e| self.fail(e))
    }

    /// Notes the first error, and gives something empty.
    fn fail<T: Default>(&self, e: FormatError) -> T {
        let mut failure = self.failure.lock().unwrap_or_else(PoisonError::into_inner);
        failure.get_or_insert_with(|| Error::from(e.at(&self.path)));
        self.failed.store(1, Ordering::Relaxed);
        T::default()
    }

    fn check(&self) -> Result<()> {
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

    fn stats(&self) -> PageStats {
        PageStats {
            pages: self.tree.surfel_pages() as u64,
            decoded: self.decoded.load(Ordering::Relaxed),
            decoded_leaves: self.decoded_leaves.load(Ordering::Relaxed),
            bytes_read: self.bytes_read.load(Ordering::Relaxed),
            ..PageStats::default()
        }
    }
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

/// A page with its leaves, so that what it weighs never changes.
#[derive(Debug, Default)]
pub struct WholePage {
    nodes: PageNodes,
    leaves: PageLeaves,
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

/// An open tree, ready to gather from: surfels in either kind of store, lvoxels in memory.
#[derive(Debug)]
pub struct OpenTree {
    /// Pages of surfels and of the nodes over them.
    pub surfels: SurfelStore,
    /// Lvoxels of all volumes.
    pub media: Media,
    /// Light that they scatter, if it was made beforehand.
    pub scatter: Option<Scatter<MappedFile>>,
}

/// Reads all lvoxels of a tree, page by page and twice: no more than what is kept is ever in memory.
fn read_media(tree: &Tree<MappedFile>, path: &Path, memory_limit: Option<u64>) -> Result<Media> {
    let allow = |bytes: u64| {
        let what = format_args!("holding {} lvoxels", tree.summary().sums.lvoxels());
        size::within(what, bytes, memory_limit).map_err(|e| e.at(path.display()))
    };
    let least = size_of::<Block>() as u64;
    allow(tree.summary().sums.lvoxels().saturating_mul(least))?;
    let each = |visit: &mut dyn FnMut(&Lvoxel)| -> Result<()> {
        for i in 0..tree.lvoxel_pages() {
            let page = tree.lvoxel_page(i).map_err(|e| e.at(path))?;
            page.iter().for_each(&mut *visit);
        }
        Ok(())
    };
    let mut layout = MediaLayout::new(&tree.meta().cloud.volumes);
    each(&mut |l| layout.note(l))?;
    allow(layout.bytes())?;
    let mut media = layout.allocate();
    each(&mut |l| media.place(l))?;
    Ok(media)
}

/// Where the pages of surfels are kept.
#[derive(Debug)]
pub enum SurfelStore {
    /// Everything that was touched.
    Resident(ResidentTree),
    /// What fits the limit on memory; what is needed again after it had to go is read again.
    Cached(CachedTree),
}

/// What the tables that find lvoxels may take where no memory limit is given: volumes of 8192^3
/// voxels in all.
const MOST_TABLE_BYTES: u64 = 4 << 30;

impl OpenTree {
    /// Opens a tree file. With a memory limit that the decoded tree might pass, pages are cached
    /// within it.
    ///
    /// # Errors
    /// A file that is not a whole tree, or a limit too small for its media and a few pages.
    pub fn open(path: &Path, memory_limit: Option<u64>) -> Result<Self> {
        let tree = Tree::open_path(path)?;
        let volumes = &tree.meta().cloud.volumes;
        let table_bytes: u128 = volumes.iter().map(media::table_bytes).sum();
        let table_bytes = u64::try_from(table_bytes).unwrap_or(u64::MAX);
        let what = "finding the lvoxels of its volumes";
        size::within(what, table_bytes, memory_limit).map_err(|e| e.at(path.display()))?;
        if memory_limit.is_none() && table_bytes > MOST_TABLE_BYTES {
            return Err(Error::input(format!(
                "{}: {what} needs {}, without `memory_limit` the most is {}",
                path.display(),
                size::format(table_bytes),
                size::format(MOST_TABLE_BYTES)
            ))
            .hint(
                "a larger `memory_limit` allows it; `lvox verify` tells whether the file is whole",
            ));
        }
        let media = read_media(&tree, path, memory_limit)?;
        let most = || {
            let blocks = tree.surfel_blocks().iter().enumerate();
            blocks.map(|(i, b)| {
                let (clips, backs) = (tree.has_clips(i), tree.has_backs(i));
                page::most_bytes(u64::from(b.nodes), u64::from(b.records), clips, backs)
            })
        };
        let entry = size_of::<ResidentEntry>() as u64;
        let decoded = most().fold(media.bytes() as u64, |sum, bytes| {
            sum.saturating_add(bytes).saturating_add(entry)
        });
        let largest = most().max().unwrap_or(0);
        let page_count = tree.surfel_pages();
        let decoder = Decoder {
            tree,
            path: path.to_owned(),
            decoded: AtomicU64::new(0),
            decoded_leaves: AtomicU64::new(0),
            bytes_read: AtomicU64::new(0),
            failed: AtomicU64::new(0),
            failure: Mutex::new(None),
            links: Links::new(page_count),
        };
        let surfels = match memory_limit.filter(|&limit| decoded > limit) {
            None => {
                let pages = (0..page_count).map(|_| Default::default()).collect();
                SurfelStore::Resident(ResidentTree { decoder, pages })
            }
            Some(limit) => {
                // A cache shard never keeps what is heavier than nearly all of it.
                let least = (media.bytes() as u64).saturating_add(largest.saturating_mul(8));
                size::within("shading from it", least, memory_limit)
                    .map_err(|e| e.at(path.display()))?;
                let budget = limit - media.bytes() as u64;
                let shards = (budget / largest.saturating_mul(2).max(1)).clamp(1, 16) as usize;
                let options = OptionsBuilder::new()
                    .shards(shards)
                    .estimated_items_capacity(page_count.max(1))
                    .weight_capacity(budget)
                    .build()
                    .map_err(|e| {
                        Error::failed(format!("cannot make a page cache of {budget} bytes: {e:?}"))
                    })?;
                let cache = Cache::with_options(
                    options,
                    PageBytes,
                    DefaultHashBuilder::default(),
                    Default::default(),
                );
                SurfelStore::Cached(CachedTree { decoder, cache })
            }
        };
        Ok(Self {
            surfels,
            media,
            scatter: None,
        })
    }

    /// With light that media scatter, from a file that was made from this tree.
    ///
    /// # Errors
    /// A file that is no whole file of scattered light, or that of another tree.
    pub fn with_scatter(self, path: &Path) -> Result<Self> {
        let scatter = Scatter::open_path(path)?;
        let (expected, found) = (self.tree().content_hash(), scatter.meta().tree_hash);
        if expected != found {
            return Err(Error::input(format!(
                "{}: expected light gathered from the tree {}, found that of {}",
                path.display(),
                hex(&expected),
                hex(&found)
            ))
            .hint("make it again from this tree: lvox scatter"));
        }
        Ok(Self {
            scatter: Some(scatter),
            ..self
        })
    }

    /// What the file says of itself.
    #[must_use]
    pub fn tree(&self) -> &Tree<MappedFile> {
        match &self.surfels {
            SurfelStore::Resident(t) => &t.decoder.tree,
            SurfelStore::Cached(t) => &t.decoder.tree,
        }
    }

    /// The place of the origin of the tree's scene space in the world: what is added to a position of
    /// scene space makes one of the world.
    #[must_use]
    pub fn world_from_scene(&self) -> DVec3 {
        self.tree().meta().cloud.world_from_scene.into()
    }

    /// Mean area that a surfel stands for, scene units squared; 0 without surfels.
    #[must_use]
    pub fn area_per_surfel(&self) -> f32 {
        let sums = &self.tree().summary().sums;
        (sums.area / sums.surfels.max(1) as f64) as f32
    }

    /// How much of the tree was used so far.
    #[must_use]
    pub fn stats(&self) -> PageStats {
        match &self.surfels {
            SurfelStore::Resident(t) => t.decoder.stats(),
            SurfelStore::Cached(t) => PageStats {
                hits: t.cache.hits(),
                misses: t.cache.misses(),
                ..t.decoder.stats()
            },
        }
    }
}
