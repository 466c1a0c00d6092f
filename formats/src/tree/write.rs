//! Writing a tree: pages from the leaves up.

use super::encode::EncodedPage;
use super::relight;
use super::stats::{self, ColumnStats, Errors};
use super::{EncodedLvoxels, TreeFormat};
use crate::frame::BlockKind;
use crate::output::{BlockContent, BlockWriter};
use crate::record::Bounds;
use crate::summary::{Sums, TreeLevel, TreeSummary};
use crate::{FormatError, Overwrite, Result, TreeMeta};
use std::path::Path;

/// Writes a tree file page by page. Memory is that of one page and of 40 bytes per page written.
///
/// The file gets its name in [`Self::finish`]; dropped before that, the writer leaves nothing
/// behind.
pub struct TreeWriter {
    file: BlockWriter<TreeFormat>,
    surfel_pages: u32,
    lvoxel_pages: u32,
    nodes: u64,
    sums: Sums,
    last_bounds: Bounds,
    surfel_columns: ColumnStats,
    lvoxel_columns: ColumnStats,
    surfel_stored: u64,
    lvoxel_stored: u64,
    errors: Errors,
}

impl TreeWriter {
    /// Opens a temporary file beside `path`.
    ///
    /// # Errors
    /// [`FormatError::Exists`] if the file may not be replaced, [`FormatError::Folder`] if the
    /// folder cannot be written, [`FormatError::Invalid`] for metadata that no reader would accept.
    pub fn create(path: &Path, meta: TreeMeta, overwrite: Overwrite) -> Result<Self> {
        let sums = Sums::of_nothing(meta.cloud.volumes.len());
        Ok(Self {
            file: BlockWriter::create(path, meta, overwrite)?,
            surfel_pages: 0,
            lvoxel_pages: 0,
            nodes: 0,
            sums,
            last_bounds: Bounds::EMPTY,
            surfel_columns: stats::surfel_columns(),
            lvoxel_columns: stats::lvoxel_columns(),
            surfel_stored: 0,
            lvoxel_stored: 0,
            errors: Errors::default(),
        })
    }

    /// Takes over what the summary of a tree says of all but light, of whose pages the pages of
    /// this one are, by [`EncodedPage::relit`].
    pub fn relight(&mut self, source: &TreeSummary) {
        let is_kept = |column| !relight::is_light(column);
        (self.surfel_columns).keep_left_out(&source.left_out, is_kept);
        self.errors.add_list(&source.errors);
    }

    /// Pages of surfels so far: the id of the next one.
    #[must_use]
    pub fn surfel_pages(&self) -> u32 {
        self.surfel_pages
    }

    /// Counts and sums so far, of the values as a reader will decode them.
    #[must_use]
    pub fn sums(&self) -> &Sums {
        &self.sums
    }

    /// Appends an encoded page of nodes and surfels, and returns its id.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for links that go back beyond the first page, and
    /// [`FormatError::Io`].
    pub fn push_surfel_page(&mut self, page: &EncodedPage) -> Result<u32> {
        let id = self.surfel_pages;
        if page.furthest_link > id || id == u32::MAX {
            return Err(FormatError::invalid(
                format!("links of page {id}"),
                "at most as many pages back as there are",
                page.furthest_link,
            )
            .at(self.file.path()));
        }
        self.file.push(&BlockContent {
            kind: BlockKind::Surfels,
            stored: &page.bytes,
            raw_bytes: page.raw_bytes,
            records: page.records,
            nodes: page.nodes,
            columns: page.mask,
            checksum: page.checksum,
        })?;
        self.surfel_pages += 1;
        self.nodes += u64::from(page.nodes);
        self.sums.add(&page.sums);
        self.surfel_columns.add(&page.columns);
        self.surfel_stored += page.bytes.len() as u64;
        self.errors.add(&page.errors);
        self.last_bounds = page.bounds;
        Ok(id)
    }

    /// Appends an encoded page of lvoxels, and returns its id among those.
    ///
    /// # Errors
    /// [`FormatError::Io`].
    pub fn push_lvoxel_page(&mut self, page: &EncodedLvoxels) -> Result<u32> {
        self.file.push(&BlockContent {
            kind: BlockKind::Lvoxels,
            stored: &page.bytes,
            raw_bytes: page.raw_bytes,
            records: page.decoded.len() as u32,
            nodes: 0,
            columns: page.mask,
            checksum: page.checksum,
        })?;
        for v in &page.decoded {
            self.sums.add_lvoxel(v);
        }
        self.lvoxel_columns.add(&page.columns);
        self.errors.add(&page.errors);
        self.lvoxel_stored += page.bytes.len() as u64;
        self.lvoxel_pages += 1;
        Ok(self.lvoxel_pages - 1)
    }

    /// Writes the tables, and gives the file its name. The root must be the last page of surfels,
    /// or `None` if there is no page; `cloud_sums` are those of the cloud's summary. The bytes of
    /// `levels` are filled in here.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for another root, [`FormatError::Io`], [`FormatError::Exists`] if
    /// the name was taken meanwhile.
    pub fn finish(
        self,
        root: Option<u32>,
        cloud_sums: Sums,
        mut levels: Vec<TreeLevel>,
    ) -> Result<TreeSummary> {
        if root != self.surfel_pages.checked_sub(1) {
            return Err(FormatError::invalid(
                "root page",
                format!("the last of {}", self.surfel_pages),
                format!("{root:?}"),
            )
            .at(self.file.path()));
        }
        let mut columns = self.surfel_columns.columns(self.surfel_stored);
        share_out(&mut levels, &columns, self.surfel_stored);
        columns.extend(self.lvoxel_columns.columns(self.lvoxel_stored));
        let mut left_out = self.surfel_columns.left_out();
        left_out.extend(self.lvoxel_columns.left_out());
        let summary = TreeSummary {
            sums: self.sums,
            cloud_sums,
            root_page: root,
            bounds: root.map(|_| self.last_bounds),
            nodes: self.nodes,
            surfel_pages: u64::from(self.surfel_pages),
            lvoxel_pages: u64::from(self.lvoxel_pages),
            levels,
            columns,
            left_out,
            errors: self.errors.list(),
        };
        self.file.finish(&summary)?;
        Ok(summary)
    }
}

/// Gives each level its share of the stored bytes, by its nodes and surfels.
fn share_out(levels: &mut [TreeLevel], columns: &[crate::ColumnBytes], stored: u64) {
    let of_nodes: u64 = columns
        .iter()
        .filter(|c| c.name.starts_with("node_") || c.name.starts_with("axis_"))
        .map(|c| c.stored_bytes)
        .sum();
    let of_surfels = stored.saturating_sub(of_nodes);
    let nodes: u64 = levels.iter().map(|l| l.nodes).sum();
    let surfels: u64 = levels.iter().map(|l| l.surfels).sum();
    let share = |part: u64, whole: u64, bytes: u64| {
        if whole == 0 {
            0.0
        } else {
            part as f64 / whole as f64 * bytes as f64
        }
    };
    for level in levels {
        let bytes = share(level.nodes, nodes, of_nodes) + share(level.surfels, surfels, of_surfels);
        level.bytes = bytes.round() as u64;
    }
}
