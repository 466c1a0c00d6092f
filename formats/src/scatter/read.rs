//! Reading scattered light.

use super::cluster::{CLUSTER_EDGE, COLUMNS, ClusterId, VertexCluster};
use super::write::{MAX_RAW_BYTES, check_order};
use crate::format::{Format, expect_count};
use crate::frame::{Block, BlockKind, FileKind};
use crate::opened::{Opened, check_sizes, nth};
use crate::summary::ScatterSummary;
use crate::{FormatError, Result, ScatterMeta, bytes};

/// The format of a file of scattered light.
#[derive(Debug)]
pub enum ScatterFormat {}

/// A file of scattered light that was opened: light at vertices inside media, in clusters.
pub type Scatter<D> = Opened<D, ScatterFormat>;

impl Format for ScatterFormat {
    type Meta = ScatterMeta;
    type Summary = ScatterSummary;
    type Blocks = Vec<Block>;
    const KIND: FileKind = FileKind::Scatter;

    fn check_meta(meta: &ScatterMeta) -> Result<()> {
        meta.validate()
    }

    fn check_summary(summary: &ScatterSummary, meta: &ScatterMeta) -> Result<()> {
        let ids = summary.clusters.iter();
        ids.map(|id| id.lattice(&meta.volumes))
            .try_for_each(|l| l.map(drop))
    }

    fn arrange(blocks: Vec<Block>, summary: &ScatterSummary) -> Result<Vec<Block>> {
        let found = summary.clusters.len() as u64;
        expect_count("clusters", blocks.len() as u64, found)?;
        let mut last = None;
        for (i, (block, id)) in blocks.iter().zip(&summary.clusters).enumerate() {
            check_order(last, (block.kind, *id))?;
            last = Some((block.kind, *id));
            let most = CLUSTER_EDGE.pow(3) as u32;
            if !(1..=most).contains(&block.records) || block.nodes != 0 {
                return Err(FormatError::invalid(
                    format!("vertices of block {i}"),
                    format!("1 to {most}, and no nodes"),
                    format!("{} and {} nodes", block.records, block.nodes),
                ));
            }
            if block.columns >> COLUMNS.len() != 0 {
                return Err(FormatError::invalid(
                    format!("columns of block {i}"),
                    format!("a mask of {} bits", COLUMNS.len()),
                    format!("{:#x}", block.columns),
                ));
            }
            check_sizes(block, i, MAX_RAW_BYTES)?;
        }
        Ok(blocks)
    }

    fn verify<D: AsRef<[u8]>, E: From<FormatError>>(
        scatter: &Scatter<D>,
        mut after_block: impl FnMut() -> Result<(), E>,
    ) -> Result<(), E> {
        for i in 0..scatter.blocks().len() {
            scatter.cluster(i)?;
            after_block()?;
        }
        Ok(())
    }
}

impl<D: AsRef<[u8]>> Scatter<D> {
    /// Clusters, in file order.
    pub fn blocks(&self) -> &[Block] {
        self.table()
    }

    /// The clusters of one kind of light in a volume: their numbers in the file, and which they
    /// are.
    pub fn clusters(
        &self,
        kind: BlockKind,
        volume: usize,
    ) -> impl Iterator<Item = (usize, ClusterId)> + '_ {
        let ids = self.blocks().iter().zip(&self.summary().clusters);
        ids.enumerate()
            .filter(move |(_, (b, id))| b.kind == kind && usize::from(id.volume) == volume)
            .map(|(i, (_, id))| (i, *id))
    }

    /// Checks the bytes of cluster `i` without decoding them.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] for damage, [`FormatError::Invalid`] for an `i` that does not
    /// exist.
    pub fn check_cluster(&self, i: usize) -> Result<()> {
        self.named(|| {
            let block = nth(self.blocks(), i, "cluster")?;
            bytes::check(self.stored(block), block.checksum, || {
                format!("cluster {i}")
            })
        })
    }

    /// Decodes cluster `i`.
    ///
    /// # Errors
    /// [`FormatError::Checksum`] or [`FormatError::Invalid`] for damage, or for an `i` that does
    /// not exist.
    pub fn cluster(&self, i: usize) -> Result<VertexCluster> {
        self.unpacked(self.blocks(), i, "cluster", |raw, block| {
            let id = self.summary().clusters[i];
            let records = block.records as usize;
            let volumes = &self.meta().volumes;
            VertexCluster::unpack(raw, block.columns, records, block.kind, id, volumes)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::VolumeInfo;

    #[test]
    fn clusters_outside_their_lattice_are_refused_when_a_file_is_opened() {
        let volume = VolumeInfo {
            name: "a".into(),
            dims: [40, 40, 40],
            index_from_scene: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]],
            albedo: [1.0; 3],
            extinction_color: [1.0; 3],
        };
        let meta = ScatterMeta {
            scene_hash: [0; 32],
            scene_name: String::new(),
            volumes: vec![volume],
            tree_hash: [0; 16],
            settings: Vec::new(),
        };
        let opened = |volume, level, zyx| {
            let id = ClusterId { volume, level, zyx };
            let summary = ScatterSummary {
                clusters: vec![id],
                ..ScatterSummary::default()
            };
            ScatterFormat::check_summary(&summary, &meta).map_err(|e| e.to_string())
        };
        opened(0, 0, [1, 1, 1]).unwrap();
        for (volume, level, zyx, expected) in [
            (1, 0, [0; 3], "a volume below 1"),
            (0, 4, [0; 3], "at most 3"),
            (0, 0, [0, 2, 0], "inside [41, 41, 41]"),
            (0, 3, [0, 0, 1], "inside [6, 6, 6]"),
            (0, 0, [u16::MAX; 3], "inside"),
        ] {
            let error = opened(volume, level, zyx).unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
