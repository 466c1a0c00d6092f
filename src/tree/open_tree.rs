//! A tree file that is open for use.

use super::decoder::PageStats;
use super::media::{self, Block, Media, MediaLayout};
use super::pages::SurfelStore;
use crate::run::{Job, Resident, hex, size};
use crate::{Error, Result};
use glam::DVec3;
use lvox_formats::record::Lvoxel;
use lvox_formats::{MappedFile, Scatter, Tree, TreeMeta};
use std::path::Path;

/// Most bytes of the tables that find lvoxels, where no memory limit allows more.
const MOST_OF_TABLES: u64 = 4 << 30;

/// A tree file that is open for use: surfels in either kind of store, lvoxels in memory.
#[derive(Debug)]
pub struct OpenTree {
    /// Pages of surfels and of the nodes over them.
    #[doc(hidden)]
    pub(crate) surfels: SurfelStore,
    /// Lvoxels of all volumes.
    #[doc(hidden)]
    pub(crate) media: Media,
    /// Light that they scatter, if it was made beforehand.
    #[doc(hidden)]
    pub scatter: Option<Scatter<MappedFile>>,
    memory_limit: Option<u64>,
}

/// Lvoxels that are in memory twice while a tree is opened, at most.
const MOST_READ_ONCE: u64 = 1 << 19;

/// Reads all lvoxels of a tree. Many, and those within a memory limit, are read page by page and
/// twice: no more than what is kept is ever in memory.
fn read_media(tree: &Tree<MappedFile>, path: &Path, memory_limit: Option<u64>) -> Result<Media> {
    let allow = |bytes: u64| {
        let what = format_args!("holding {} lvoxels", tree.summary().sums.lvoxels());
        size::within(what, bytes, memory_limit).map_err(|e| e.at(path.display()))
    };
    let least = size_of::<Block>() as u64;
    allow(tree.summary().sums.lvoxels().saturating_mul(least))?;
    let page = |i: usize| tree.lvoxel_page(i).map_err(|e| e.at(path));
    let pages = 0..tree.lvoxel_pages();
    let is_read_once = memory_limit.is_none() && tree.summary().sums.lvoxels() <= MOST_READ_ONCE;
    let once = is_read_once.then(|| pages.clone().map(page).collect::<Result<Vec<_>, _>>());
    let once = once.transpose()?;
    let each = |visit: &mut dyn FnMut(&Lvoxel)| -> Result<()> {
        match &once {
            Some(all) => all.iter().flatten().for_each(visit),
            None => {
                for i in pages.clone() {
                    page(i)?.iter().for_each(&mut *visit);
                }
            }
        }
        Ok(())
    };
    let mut layout = MediaLayout::new(&tree.meta().cloud.volumes);
    each(&mut |l| layout.note(l))?;
    allow(layout.bytes())?;
    let mut media = layout.allocate();
    each(&mut |l| media.place(l))?;
    Ok(media.with_dark())
}

/// What a tree makes frames hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TreeNeeds {
    /// Bytes with which it can be used, as [`OpenTree::least_bytes`].
    pub least_bytes: u64,
    /// Whether light inside media was made beforehand, on the voxels that all cameras share.
    pub has_scattered_light: bool,
}

impl OpenTree {
    /// Most segments of paths of direct light and one bounce.
    pub(crate) const SEGMENTS_OF_ONE_BOUNCE: u32 = 3;

    /// Opens a tree file, or the tree in a packed scene. With a memory limit that the decoded tree
    /// might pass, pages are cached within it.
    ///
    /// # Errors
    /// A file that is not a whole tree, or a limit too small for its media and a few pages.
    pub fn open(path: &Path, memory_limit: Option<u64>) -> Result<Self> {
        let tree = Tree::open_within(path)?;
        let volumes = &tree.meta().cloud.volumes;
        let table_bytes: u128 = volumes.iter().map(media::table_bytes).sum();
        let table_bytes = u64::try_from(table_bytes).unwrap_or(u64::MAX);
        let what = "finding the lvoxels of its volumes";
        size::within(what, table_bytes, memory_limit).map_err(|e| e.at(path.display()))?;
        let most = size::most_of_tables(tree.file_bytes()).min(MOST_OF_TABLES);
        if memory_limit.is_none() && table_bytes > most {
            return Err(Error::input(format!(
                "{}: {what} needs {}, without `memory_limit` the most is {}",
                path.display(),
                size::format(table_bytes),
                size::format(most)
            ))
            .hint(
                "a larger `memory_limit` allows it; `lvox verify` tells whether the file is whole",
            ));
        }
        let media = read_media(&tree, path, memory_limit)?;
        if memory_limit.is_some() {
            tree.release_all();
        }
        let surfels = SurfelStore::new(tree, path, media.bytes() as u64, memory_limit)?;
        Ok(Self {
            surfels,
            media,
            scatter: None,
            memory_limit,
        })
    }

    /// Bytes of memory with which the tree can be used: its lvoxels, and a few pages of surfels.
    #[must_use]
    pub fn least_bytes(&self) -> u64 {
        self.media.bytes() as u64 + SurfelStore::least_bytes(self.tree())
    }

    /// What frames hold more of than of other trees.
    #[must_use]
    pub fn needs(&self) -> TreeNeeds {
        TreeNeeds {
            least_bytes: self.least_bytes(),
            has_scattered_light: self.scatter.is_some(),
        }
    }

    /// The same of a tree within a memory limit; one without needs no bytes.
    pub(crate) fn needs_within_limit(&self) -> TreeNeeds {
        TreeNeeds {
            least_bytes: self.memory_limit.map_or(0, |_| self.least_bytes()),
            ..self.needs()
        }
    }

    /// The same tree, of which no page was used yet, where its memory limit holds so many bytes of
    /// other data, too.
    ///
    /// # Errors
    /// A limit too small for those and a few pages.
    pub fn beside(self, other_bytes: u64) -> Result<Self> {
        if self.memory_limit.is_none() {
            return Ok(self);
        }
        let (tree, path) = self.surfels.into_file();
        let others = other_bytes.saturating_add(self.media.bytes() as u64);
        Ok(Self {
            surfels: SurfelStore::new(tree, &path, others, self.memory_limit)?,
            ..self
        })
    }

    /// What hears from a stage what memory the process has, and has caches take no more than the
    /// memory limit leaves beside all else. Where the limit is not for this process alone, what
    /// that has says nothing.
    pub(crate) fn fitter<'a>(&'a self, job: &'a Job) -> impl Fn(Resident) + Sync + 'a {
        let limit = self.memory_limit.filter(|_| job.process_bytes > 0);
        move |now| {
            if let Some(limit) = limit {
                self.surfels.fit(now, limit, job.held.bytes_for_now());
            }
        }
    }

    /// Adds light that media scatter, from a file that was made from this tree.
    ///
    /// # Errors
    /// A file that is no whole file of scattered light, or that of another tree.
    pub fn with_scatter(self, path: &Path) -> Result<Self> {
        let scatter = Scatter::open_within(path)?;
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

    /// The tree file itself: its description, and its pages as they are stored.
    #[must_use]
    pub fn tree(&self) -> &Tree<MappedFile> {
        self.surfels.file()
    }

    /// The place of the origin of the tree's scene space in the world: what is added to a position
    /// of scene space makes one of the world.
    #[must_use]
    pub fn world_from_scene(&self) -> DVec3 {
        self.tree().meta().cloud.world_from_scene.into()
    }

    /// Most segments of the paths of light, from camera to light, that a frame shaded from the tree
    /// counts; 0 for no limit. Three, direct light and one bounce, unless its light has bounced
    /// beforehand.
    #[must_use]
    pub fn segments(&self) -> u32 {
        Self::segments_of(self.tree().meta())
    }

    /// The same of a tree that says this of itself.
    pub(crate) fn segments_of(meta: &TreeMeta) -> u32 {
        match meta.bounces() {
            None => Self::SEGMENTS_OF_ONE_BOUNCE,
            Some(bounces) => bounces.parse().map_or(0, |n: u32| n.saturating_add(2)),
        }
    }

    /// Mean area that a surfel stands for, scene units squared; 0 without surfels.
    #[must_use]
    pub fn area_per_surfel(&self) -> f32 {
        let sums = &self.tree().summary().sums;
        (sums.area / sums.surfels.max(1) as f64) as f32
    }

    /// Returns counts of the pages used so far.
    #[must_use]
    pub fn stats(&self) -> PageStats {
        self.surfels.stats()
    }
}
