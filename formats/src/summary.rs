//! What a writer counted, kept at the end of the file.

use crate::record::Bounds;
use crate::scatter::ClusterId;

/// Counts and sums over points, which each stage must conserve.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct Sums {
    /// Surfels that were summed.
    pub surfels: u64,
    /// Sum of their areas, scene units squared.
    pub area: f64,
    /// Sum of area times pi times radiance, both sides, per channel.
    pub flux: [f64; 3],
    /// Per volume, in the order of the metadata.
    pub volumes: Vec<VolumeSums>,
}

/// Sums over the lvoxels of one volume.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct VolumeSums {
    /// Lvoxels that were summed, of all levels.
    pub lvoxels: u64,
    /// Sum over lvoxels of extinction times size, `sigma_t * 8^level`: per scene unit times voxels.
    /// Times the volume of a voxel it is the integral of extinction over space, where no block
    /// sticks out of its volume.
    pub extinction: f64,
}

impl Sums {
    /// Sums over no points, of so many volumes.
    #[must_use]
    pub fn of_nothing(volumes: usize) -> Self {
        Self {
            volumes: vec![VolumeSums::default(); volumes],
            ..Self::default()
        }
    }

    /// Count of lvoxels in all volumes; the largest number if they are more.
    #[must_use]
    pub fn lvoxels(&self) -> u64 {
        let counts = self.volumes.iter().map(|v| v.lvoxels);
        counts.fold(0, u64::saturating_add)
    }

    pub(crate) fn add_surfel(&mut self, surfel: &crate::Surfel) {
        let area = f64::from(surfel.area);
        self.surfels += 1;
        self.area += area;
        for i in 0..3 {
            let radiance = f64::from(surfel.front[i]) + f64::from(surfel.back[i]);
            self.flux[i] += area * std::f64::consts::PI * radiance;
        }
    }

    /// The volume's entry must exist.
    pub(crate) fn add_lvoxel(&mut self, lvoxel: &crate::Lvoxel) {
        let sums = &mut self.volumes[usize::from(lvoxel.volume)];
        sums.lvoxels += 1;
        sums.extinction += f64::from(lvoxel.sigma_t) * f64::from(1u32 << (3 * lvoxel.level));
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.surfels += other.surfels;
        self.area += other.area;
        for (a, b) in self.flux.iter_mut().zip(other.flux) {
            *a += b;
        }
        for (a, b) in self.volumes.iter_mut().zip(&other.volumes) {
            a.lvoxels += b.lvoxels;
            a.extinction += b.extinction;
        }
    }
}

/// A column that the file has.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct ColumnBytes {
    /// Name, as in `SPEC.md`.
    pub name: String,
    /// Bytes before compression.
    pub raw_bytes: u64,
    /// Bytes in the file. The columns of a tree's page are compressed together: there, each one's
    /// share is that of the same columns compressed apart, in a sample of the pages.
    pub stored_bytes: u64,
}

/// A column that some or all chunks or pages do without.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct LeftOut {
    /// Name, as in `SPEC.md`.
    pub name: String,
    /// Why it is not needed.
    pub because: String,
    /// Bytes that it would have taken before compression, where it was left out.
    pub raw_bytes: u64,
}

/// Summary of a cloud.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct CloudSummary {
    /// Counts and sums, of the values as a reader decodes them.
    pub sums: Sums,
    /// Box of all surfels, radii included; `None` without surfels.
    pub bounds: Option<Bounds>,
    /// Columns that are there.
    pub columns: Vec<ColumnBytes>,
    /// Columns that are not, or not everywhere.
    pub left_out: Vec<LeftOut>,
}

/// Counts of the nodes that are equally many steps below the root.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct TreeLevel {
    /// Nodes; one that links to a page and that page's root count once.
    pub nodes: u64,
    /// Nodes that hold surfels.
    pub leaves: u64,
    /// Surfels in these leaves.
    pub surfels: u64,
    /// Stored bytes of these nodes and surfels: a share of the file's, by their counts.
    pub bytes: u64,
}

/// The worst difference between a value as given and as stored, over the whole file.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct WorstError {
    /// Which value, and what it is measured in.
    pub name: String,
    /// Largest error of all values, in the unit that the name tells.
    pub worst: f64,
    /// The largest error that the format allows.
    pub bound: f64,
}

/// Summary of a tree.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct TreeSummary {
    /// Counts and sums of the values as a reader decodes them.
    pub sums: Sums,
    /// Counts and sums of the cloud that the tree was built from.
    pub cloud_sums: Sums,
    /// The page where traversal starts; `None` without surfels.
    pub root_page: Option<u32>,
    /// Box of all surfels, radii included; `None` without surfels.
    pub bounds: Option<Bounds>,
    /// Nodes in all pages; one that links to a page and that page's first are the same node,
    /// counted twice.
    pub nodes: u64,
    /// Pages of surfels and nodes.
    pub surfel_pages: u64,
    /// Pages of lvoxels.
    pub lvoxel_pages: u64,
    /// By steps below the root.
    pub levels: Vec<TreeLevel>,
    /// Columns that are there.
    pub columns: Vec<ColumnBytes>,
    /// Columns that are not, or not everywhere.
    pub left_out: Vec<LeftOut>,
    /// By kind of value, the largest difference between what was given and what is stored.
    pub errors: Vec<WorstError>,
}

/// Summary of scattered light.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct ScatterSummary {
    /// Which cluster each block holds, in the order of the file.
    pub clusters: Vec<ClusterId>,
    /// Columns that are there.
    pub columns: Vec<ColumnBytes>,
    /// Columns that are not, or not everywhere.
    pub left_out: Vec<LeftOut>,
}
