//! Reading a tree.

use super::{MAX_PAGE_BYTES, MAX_PAGE_RECORDS, columns, decode, lvoxels};
use crate::format::{Format, PointBlocks, expect_count};
use crate::frame::{Block, BlockKind, FileKind};
use crate::opened::{Opened, check_sizes};
use crate::record::{Below, Bounds, Lvoxel, Node, Surfel, SurfelLeaves, SurfelPage};
use crate::summary::{Sums, TreeSummary};
use crate::{FormatError, MappedFile, Result, TreeMeta, check};

/// What a page of surfels is called in errors.
pub const SURFEL_PAGE: &str = "surfel page";

/// The format of a tree file.
#[derive(Debug)]
pub enum TreeFormat {}

/// A tree file that was opened: an octree over surfels in pages, and lvoxels in pages.
pub type Tree<D> = Opened<D, TreeFormat>;

impl Format for TreeFormat {
    type Meta = TreeMeta;
    type Summary = TreeSummary;
    type Blocks = PointBlocks;
    const KIND: FileKind = FileKind::Tree;

    fn check_meta(meta: &TreeMeta) -> Result<()> {
        meta.cloud.validate()
    }

    fn arrange(blocks: Vec<Block>, summary: &TreeSummary) -> Result<PointBlocks> {
        let mut nodes = 0;
        let blocks = PointBlocks::new(blocks, &summary.sums, |i, block| {
            let most = MAX_PAGE_RECORDS as u32;
            if block.records > most || block.nodes > most {
                return Err(FormatError::invalid(
                    format!("records of block {i}"),
                    format!("at most {most}"),
                    format!("{} and {} nodes", block.records, block.nodes),
                ));
            }
            if block.kind == BlockKind::Surfels {
                nodes += u64::from(block.nodes);
            }
            check_sizes(block, i, MAX_PAGE_BYTES)
        })?;
        let pages = blocks.surfels.len() as u64;
        expect_count("surfel pages", pages, summary.surfel_pages)?;
        let lvoxel_pages = blocks.lvoxels.len() as u64;
        expect_count("lvoxel pages", lvoxel_pages, summary.lvoxel_pages)?;
        expect_count("nodes", nodes, summary.nodes)?;
        let last = pages.checked_sub(1);
        if summary.root_page.map(u64::from) != last || summary.bounds.is_some() != last.is_some() {
            return Err(FormatError::invalid(
                "root page",
                format!("the last one, {last:?}, and its bounds"),
                format!("{:?}", summary.root_page),
            ));
        }
        Ok(blocks)
    }

    fn check_summary(summary: &TreeSummary, meta: &TreeMeta) -> Result<()> {
        for sums in [&summary.sums, &summary.cloud_sums] {
            check::sums(sums, meta.cloud.volumes.len())?;
        }
        let bounds = summary.bounds.as_ref();
        bounds.map_or(Ok(()), |b| {
            check::bounds(b, &|| "bounds in the summary".into())
        })
    }

    /// Beyond the values of each page: each page but the root has one link to it, linking nodes and
    /// nodes above hold the boxes below them, and the summary has the sums of all points.
    fn verify<D: AsRef<[u8]>, E: From<FormatError>>(
        tree: &Tree<D>,
        mut after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        let summary = tree.summary();
        // Box that the linking node gives to each page; pages are read from the root down.
        let mut held: Vec<Option<Bounds>> = vec![None; tree.surfel_pages()];
        if let Some(last) = held.last_mut() {
            *last = summary.bounds;
        }
        let mut page_sums = vec![Sums::default(); tree.surfel_pages()];
        for i in (0..tree.surfel_pages()).rev() {
            let page = tree.surfel_page(i)?;
            tree.named(|| check_page(&page, i, &mut held))?;
            for surfel in &page.surfels {
                page_sums[i].add_surfel(surfel);
            }
            after_block()?;
        }
        // In the writer's order, which fixes the rounding.
        let mut sums = Sums::of_nothing(tree.meta().cloud.volumes.len());
        for page in &page_sums {
            sums.add(page);
        }
        for i in 0..tree.lvoxel_pages() {
            for lvoxel in tree.lvoxel_page(i)? {
                sums.add_lvoxel(&lvoxel);
            }
            after_block()?;
        }
        tree.named(|| {
            if sums != summary.sums {
                return Err(FormatError::invalid(
                    "summary",
                    format!("the sums of the points, {sums:?}"),
                    format!("{:?}", summary.sums),
                ));
            }
            Ok(())
        })?;
        Ok(())
    }
}

impl Tree<MappedFile> {
    /// Gives the memory of page `i` of surfels back to the system, which maps it again when it is
    /// next read.
    pub fn release_surfel_page(&self, i: usize) {
        if let Some(block) = self.surfel_blocks().get(i) {
            self.release(std::slice::from_ref(block));
        }
    }
}

impl<D: AsRef<[u8]>> Tree<D> {
    /// The page where traversal starts; `None` without surfels.
    pub fn root_page(&self) -> Option<u32> {
        self.summary().root_page
    }

    /// Pages of surfels, by id.
    pub fn surfel_blocks(&self) -> &[Block] {
        &self.table().surfels
    }

    /// Pages of lvoxels, by id.
    pub fn lvoxel_blocks(&self) -> &[Block] {
        &self.table().lvoxels
    }

    /// Whether any surfel of page `i` is clipped.
    pub fn has_clips(&self, i: usize) -> bool {
        let block = self.surfel_blocks().get(i);
        block.is_some_and(|b| b.columns >> columns::CLIP_COUNT & 1 == 1)
    }

    /// Whether backs of any node of page `i` send light.
    pub fn has_backs(&self, i: usize) -> bool {
        let block = self.surfel_blocks().get(i);
        block.is_some_and(|b| b.columns >> columns::BACK_AXES & 1 == 1)
    }

    /// Number of pages of surfels.
    pub fn surfel_pages(&self) -> usize {
        self.surfel_blocks().len()
    }

    /// Number of pages of lvoxels.
    pub fn lvoxel_pages(&self) -> usize {
        self.lvoxel_blocks().len()
    }

    /// Decodes page `i` of surfels. A page that is returned is safe to walk: all ranges are inside
    /// it, parents come before children, and links go to pages of a smaller id.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn surfel_page(&self, i: usize) -> Result<SurfelPage> {
        self.unpacked(self.surfel_blocks(), i, SURFEL_PAGE, |raw, block| {
            let overlap = self.meta().cloud.disk_overlap;
            decode::surfel_page(raw, block, i as u32, overlap)
        })
    }

    /// Decodes the nodes of page `i` of surfels alone, in place of what `nodes` holds, whose memory
    /// is used again: what [`Self::surfel_page`] gives, as safe to walk, in less time. Damage to
    /// surfels goes unseen.
    ///
    /// # Errors
    /// As [`Self::surfel_page`]; `nodes` then holds nothing of use.
    pub fn surfel_nodes(&self, i: usize, nodes: &mut Vec<Node>) -> Result<()> {
        self.unpacked(self.surfel_blocks(), i, SURFEL_PAGE, |raw, block| {
            decode::surfel_nodes(raw, block, i as u32, nodes)
        })
    }

    /// Decodes the surfels of page `i` alone, in place of what `leaves` holds, whose memory is used
    /// again: what [`Self::surfel_page`] gives, in less time. Damage to what nodes say of the
    /// surfels below them goes unseen.
    ///
    /// # Errors
    /// As [`Self::surfel_page`]; `leaves` then holds nothing of use.
    pub fn surfel_leaves(&self, i: usize, leaves: &mut SurfelLeaves) -> Result<()> {
        self.unpacked(self.surfel_blocks(), i, SURFEL_PAGE, |raw, block| {
            let overlap = self.meta().cloud.disk_overlap;
            decode::surfel_leaves(raw, block, i as u32, overlap, leaves)
        })
    }

    /// Decodes page `i` of lvoxels.
    ///
    /// # Errors
    /// As [`Self::surfel_page`].
    pub fn lvoxel_page(&self, i: usize) -> Result<Vec<Lvoxel>> {
        self.unpacked(self.lvoxel_blocks(), i, "lvoxel page", |raw, block| {
            let lvoxels = lvoxels::decode(raw, block)?;
            for (k, v) in lvoxels.iter().enumerate() {
                check::lvoxel(v, &self.meta().cloud.volumes, &|| format!("lvoxel {k}"))?;
            }
            Ok(lvoxels)
        })
    }
}

fn holds(outer: &Bounds, inner: &Bounds) -> bool {
    (0..3).all(|k| outer.min[k] <= inner.min[k] && outer.max[k] >= inner.max[k])
}

/// With room for another machine's rounding.
fn holds_disk(outer: &Bounds, surfel: &Surfel) -> bool {
    let disk = Bounds::of_surfel(surfel);
    (0..3).all(|k| {
        let room = surfel.radius * 0.01 + surfel.position[k].abs() * 1e-6;
        outer.min[k] <= disk.min[k] + room && outer.max[k] >= disk.max[k] - room
    })
}

fn check_page(page: &SurfelPage, i: usize, held: &mut [Option<Bounds>]) -> Result<()> {
    let wrong = |what: &str, expected: &str, found: String| {
        Err(FormatError::invalid(
            format!("surfel page {i}: {what}"),
            expected,
            found,
        ))
    };
    let root = &page.nodes[0].bounds;
    match &held[i] {
        None => return wrong("links to it", "one", "none".into()),
        Some(outer) if !holds(outer, root) => {
            return wrong(
                "box of its root",
                &format!("inside {outer:?}"),
                format!("{root:?}"),
            );
        }
        Some(_) => {}
    }
    for (n, node) in page.nodes.iter().enumerate() {
        let inside = match node.below {
            Below::Nodes { first, count } => (first..first + u32::from(count))
                .all(|c| holds(&node.bounds, &page.nodes[c as usize].bounds)),
            Below::Surfels { first, count } => (first..first + u32::from(count))
                .all(|s| holds_disk(&node.bounds, &page.surfels[s as usize])),
            Below::Page(link) | Below::EvenPage(link) => {
                let slot = &mut held[link as usize];
                if slot.is_some() {
                    return wrong(&format!("links to page {link}"), "one", "another".into());
                }
                *slot = Some(node.bounds);
                true
            }
        };
        if !inside {
            return wrong(
                &format!("box of node {n}"),
                "to hold all below it",
                format!("{:?}", node.bounds),
            );
        }
    }
    Ok(())
}
