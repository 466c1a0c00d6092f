//! Reading a tree.

use super::{MAX_PAGE_BYTES, MAX_PAGE_RECORDS, columns, decode, lvoxels};
use crate::bytes;
use crate::frame::{Block, BlockKind, FileKind, Frame};
use crate::record::{Below, Bounds, Lvoxel, Node, Surfel, SurfelLeaves, SurfelPage};
use crate::summary::{Sums, TreeSummary, VolumeSums};
use crate::{FormatError, MappedFile, Result, TreeMeta, check, codec};
use std::cell::RefCell;
use std::path::{Path, PathBuf};

/// A tree file, opened. Pages are decoded when asked for, by any number of threads.
#[derive(Debug)]
pub struct Tree<D> {
    data: D,
    path: Option<PathBuf>,
    surfel_blocks: Vec<Block>,
    lvoxel_blocks: Vec<Block>,
    meta: TreeMeta,
    summary: TreeSummary,
    content_hash: [u8; 16],
    version: u32,
}

impl Tree<MappedFile> {
    /// Maps and opens a file; all errors name it.
    ///
    /// # Errors
    /// As [`Tree::open`], and [`FormatError::Io`].
    pub fn open_path(path: &Path) -> Result<Self> {
        let mut tree = Self::open(MappedFile::open(path)?).map_err(|e| e.at(path))?;
        tree.path = Some(path.into());
        Ok(tree)
    }
}

impl<D: AsRef<[u8]>> Tree<D> {
    /// Reads header, metadata, summary and block table, and checks them; no page is touched.
    ///
    /// # Errors
    /// Any [`FormatError`] but `Io`, `Exists` and `InFile`.
    pub fn open(data: D) -> Result<Self> {
        let all = data.as_ref();
        let frame = Frame::read(all, FileKind::Tree)?;
        let meta: TreeMeta = codec::decode(&all[frame.meta.clone()], "metadata")?;
        meta.cloud.validate()?;
        let summary: TreeSummary = codec::decode(&all[frame.summary.clone()], "summary")?;
        for (i, block) in frame.blocks.iter().enumerate() {
            let most = MAX_PAGE_RECORDS as u32;
            if block.records > most || block.nodes > most {
                return Err(FormatError::invalid(
                    format!("records of block {i}"),
                    format!("at most {most}"),
                    format!("{} and {} nodes", block.records, block.nodes),
                ));
            }
            if block.raw_bytes as usize > MAX_PAGE_BYTES || block.stored_bytes > block.raw_bytes {
                return Err(FormatError::invalid(
                    format!("bytes of block {i}"),
                    format!("at most {MAX_PAGE_BYTES}, and no more stored than raw"),
                    format!("{} stored, {} raw", block.stored_bytes, block.raw_bytes),
                ));
            }
        }
        let (surfel_blocks, lvoxel_blocks): (Vec<_>, Vec<_>) = frame
            .blocks
            .into_iter()
            .partition(|b| b.kind == BlockKind::Surfels);
        let records = |blocks: &[Block]| blocks.iter().map(|b| u64::from(b.records)).sum::<u64>();
        let expect = |what: &str, expected: u64, found: u64| {
            if expected == found {
                Ok(())
            } else {
                Err(FormatError::invalid(
                    format!("{what} in the summary"),
                    expected.to_string(),
                    found,
                ))
            }
        };
        expect(
            "surfel pages",
            surfel_blocks.len() as u64,
            summary.surfel_pages,
        )?;
        expect(
            "lvoxel pages",
            lvoxel_blocks.len() as u64,
            summary.lvoxel_pages,
        )?;
        expect("surfels", records(&surfel_blocks), summary.sums.surfels)?;
        expect("lvoxels", records(&lvoxel_blocks), summary.sums.lvoxels())?;
        let nodes = surfel_blocks.iter().map(|b| u64::from(b.nodes)).sum();
        expect("nodes", nodes, summary.nodes)?;
        for sums in [&summary.sums, &summary.cloud_sums] {
            expect(
                "volumes",
                meta.cloud.volumes.len() as u64,
                sums.volumes.len() as u64,
            )?;
        }
        let last = (surfel_blocks.len() as u64).checked_sub(1);
        if summary.root_page.map(u64::from) != last || summary.bounds.is_some() != last.is_some() {
            return Err(FormatError::invalid(
                "root page",
                format!("the last one, {last:?}, and its bounds"),
                format!("{:?}", summary.root_page),
            ));
        }
        Ok(Self {
            path: None,
            surfel_blocks,
            lvoxel_blocks,
            meta,
            summary,
            content_hash: frame.content_hash,
            version: frame.version,
            data,
        })
    }

    /// Where the tree comes from.
    pub fn meta(&self) -> &TreeMeta {
        &self.meta
    }

    /// What was counted while it was written.
    pub fn summary(&self) -> &TreeSummary {
        &self.summary
    }

    /// Version of the format that the file was written in.
    pub fn version(&self) -> u32 {
        self.version
    }

    /// Identity of everything in the file.
    pub fn content_hash(&self) -> [u8; 16] {
        self.content_hash
    }

    /// Where traversal starts; `None` without surfels.
    pub fn root_page(&self) -> Option<u32> {
        self.summary.root_page
    }

    /// Pages of surfels, by id.
    pub fn surfel_blocks(&self) -> &[Block] {
        &self.surfel_blocks
    }

    /// Pages of lvoxels, by id.
    pub fn lvoxel_blocks(&self) -> &[Block] {
        &self.lvoxel_blocks
    }

    /// Whether any surfel of page `i` is clipped.
    pub fn has_clips(&self, i: usize) -> bool {
        let block = self.surfel_blocks.get(i);
        block.is_some_and(|b| b.columns >> columns::CLIP_COUNT & 1 == 1)
    }

    /// Whether backs of any node of page `i` send light.
    pub fn has_backs(&self, i: usize) -> bool {
        let block = self.surfel_blocks.get(i);
        block.is_some_and(|b| b.columns >> columns::BACK_AXES & 1 == 1)
    }

    /// Number of pages of surfels.
    pub fn surfel_pages(&self) -> usize {
        self.surfel_blocks.len()
    }

    /// Number of pages of lvoxels.
    pub fn lvoxel_pages(&self) -> usize {
        self.lvoxel_blocks.len()
    }

    /// Decodes page `i` of surfels. A page that is returned is safe to walk: all ranges are inside
    /// it, parents come before children, and links go to pages of a smaller id.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn surfel_page(&self, i: usize) -> Result<SurfelPage> {
        self.page(&self.surfel_blocks, i, "surfel page", |raw, block| {
            let overlap = self.meta.cloud.disk_overlap;
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
        self.page(&self.surfel_blocks, i, "surfel page", |raw, block| {
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
        self.page(&self.surfel_blocks, i, "surfel page", |raw, block| {
            let overlap = self.meta.cloud.disk_overlap;
            decode::surfel_leaves(raw, block, i as u32, overlap, leaves)
        })
    }

    /// Decodes page `i` of lvoxels.
    ///
    /// # Errors
    /// As [`Self::surfel_page`].
    pub fn lvoxel_page(&self, i: usize) -> Result<Vec<Lvoxel>> {
        self.page(&self.lvoxel_blocks, i, "lvoxel page", |raw, block| {
            let lvoxels = lvoxels::decode(raw, block)?;
            for (k, v) in lvoxels.iter().enumerate() {
                check::lvoxel(v, &self.meta.cloud.volumes, &|| format!("lvoxel {k}"))?;
            }
            Ok(lvoxels)
        })
    }

    /// Reads everything: checksums, the range of every value, that each page but the root has one
    /// link to it, that linking nodes and nodes above hold the boxes below them, and the sums of
    /// the summary.
    ///
    /// # Errors
    /// The first damage found.
    pub fn verify(&self) -> Result<()> {
        self.verify_with(|| Ok(()))
    }

    /// As [`Self::verify`], and calls `read` after each block.
    ///
    /// # Errors
    /// The first damage found, or what `read` returns, which ends the check.
    pub fn verify_with<E: From<FormatError>>(
        &self,
        mut read: impl FnMut() -> std::result::Result<(), E>,
    ) -> std::result::Result<(), E> {
        let mut sums = Sums {
            volumes: vec![VolumeSums::default(); self.meta.cloud.volumes.len()],
            ..Sums::default()
        };
        // Box that the linking node gives to each page; pages are read from the root down.
        let mut held: Vec<Option<Bounds>> = vec![None; self.surfel_pages()];
        if let Some(last) = held.last_mut() {
            *last = self.summary.bounds;
        }
        let mut page_sums = vec![Sums::default(); self.surfel_pages()];
        for i in (0..self.surfel_pages()).rev() {
            let page = self.surfel_page(i)?;
            self.named(|| check_page(&page, i, &mut held))?;
            for surfel in &page.surfels {
                page_sums[i].add_surfel(surfel);
            }
            read()?;
        }
        // In the writer's order, which fixes the rounding.
        for page in &page_sums {
            sums.add(page);
        }
        for i in 0..self.lvoxel_pages() {
            for lvoxel in self.lvoxel_page(i)? {
                sums.add_lvoxel(&lvoxel);
            }
            read()?;
        }
        self.named(|| {
            if sums != self.summary.sums {
                return Err(FormatError::invalid(
                    "summary",
                    format!("the sums of the points, {sums:?}"),
                    format!("{:?}", self.summary.sums),
                ));
            }
            Ok(())
        })?;
        Ok(())
    }

    fn named<T>(&self, run: impl FnOnce() -> Result<T>) -> Result<T> {
        run().map_err(|e| match &self.path {
            Some(path) => e.at(path),
            None => e,
        })
    }

    fn page<T>(
        &self,
        blocks: &[Block],
        i: usize,
        name: &str,
        decode: impl FnOnce(&[u8], &Block) -> Result<T>,
    ) -> Result<T> {
        thread_local! {
            static RAW: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
        }
        self.named(|| {
            let block = blocks
                .get(i)
                .ok_or_else(|| FormatError::invalid(name, format!("below {}", blocks.len()), i))?;
            let start = block.offset as usize;
            let stored = &self.data.as_ref()[start..start + block.stored_bytes as usize];
            bytes::check(stored, block.checksum, || format!("{name} {i}"))?;
            let decoded = if block.stored_bytes == block.raw_bytes {
                decode(stored, block)
            } else {
                RAW.with_borrow_mut(|raw| {
                    raw.resize(block.raw_bytes as usize, 0);
                    bytes::decompress(stored, raw, name)?;
                    decode(raw, block)
                })
            };
            decoded.map_err(|e| match e {
                FormatError::Invalid {
                    what,
                    expected,
                    found,
                } => FormatError::Invalid {
                    what: format!("{name} {i}: {what}"),
                    expected,
                    found,
                },
                other => other,
            })
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
            Below::Page(link) => {
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
