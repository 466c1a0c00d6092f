//! A cluster: some of 32 x 32 x 32 vertices, and the light at them.

use crate::bytes::{self, Column, Cursor, column, floats, singles, triples};
use crate::frame::BlockKind;
use crate::record::VolumeInfo;
use crate::{FormatError, Result, check};

/// Vertices along an edge of a cluster.
pub const CLUSTER_EDGE: usize = 32;

/// Vertices along an edge of the cubes that a cluster is divided into.
pub const CUBE_EDGE: usize = 4;

/// Cubes of a cluster.
pub const CLUSTER_CUBES: usize = (CLUSTER_EDGE / CUBE_EDGE).pow(3);

/// Log2 of the voxels between vertices, at most.
const MAX_SPACING_LEVEL: u8 = 3;

/// Which cluster: its volume, the spacing of its vertices and its place among the clusters.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct ClusterId {
    /// The volume, by its number in the metadata.
    pub volume: u16,
    /// Log2 of the voxels between vertices.
    pub level: u8,
    /// The first vertex along z, y and x, over [`CLUSTER_EDGE`].
    pub zyx: [u16; 3],
}

impl ClusterId {
    /// The first vertex along x, y and z.
    #[must_use]
    pub fn first(&self) -> [usize; 3] {
        let [z, y, x] = self.zyx.map(|c| usize::from(c) * CLUSTER_EDGE);
        [x, y, z]
    }

    /// Vertices of the whole lattice along x, y and z, which are those of its cells. Readers index
    /// by what this returns for: a cluster that begins inside the lattice of a volume.
    ///
    /// # Errors
    /// [`FormatError::Invalid`] for a volume that is not there, a level above the coarsest, or a
    /// cluster outside the lattice.
    pub(crate) fn lattice(&self, volumes: &[VolumeInfo]) -> Result<[usize; 3]> {
        let wrong = |what: &str, expected: String, found: String| {
            let what = format!("{what} of the cluster at {:?}", self.first());
            FormatError::invalid(what, expected, found)
        };
        let volume = volumes.get(usize::from(self.volume));
        let Some(volume) = volume.filter(|_| self.level <= MAX_SPACING_LEVEL) else {
            let expected = format!(
                "a volume below {}, at most {MAX_SPACING_LEVEL}",
                volumes.len()
            );
            let found = format!("{}, {}", self.volume, self.level);
            return Err(wrong("volume or level", expected, found));
        };
        let count = volume
            .dims
            .map(|n| n.div_ceil(1 << self.level) as usize + 1);
        let first = self.first();
        if (0..3).any(|a| first[a] >= count[a]) {
            let found = format!("a cluster at {first:?}");
            return Err(wrong("vertices", format!("inside {count:?}"), found));
        }
        Ok(count)
    }
}

/// The vertices of a cluster that are lit, and what arrives there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct VertexCluster {
    /// By cube of 4 x 4 x 4 vertices, x first, a bit for each vertex, x first.
    pub chosen: Vec<u64>,
    /// For each chosen vertex, cube by cube: the share that arrives of what point and spot lights
    /// send, per channel. Empty for indirect light, or if nothing arrives.
    pub share: Vec<[f32; 3]>,
    /// For each chosen vertex, in that order: the mean over the sphere of all other radiance, of
    /// other lights or of what is gathered. Empty if there is none.
    pub light: Vec<[f32; 3]>,
}

/// By bit in the mask of a block.
pub const COLUMNS: [Column; 5] = [
    column("chosen", 8),
    column("share", 12),
    column("share_grey", 4),
    column("light", 12),
    column("light_grey", 4),
];
const CHOSEN: usize = 0;
const SHARE: usize = 1;
const LIGHT: usize = 3;

/// Columns of a cluster as they go to the file, before compression.
pub struct Packed {
    pub planes: Vec<u8>,
    pub mask: u32,
    pub records: usize,
    /// Column, and its planes.
    pub ranges: Vec<(usize, std::ops::Range<usize>)>,
    /// Column, and bytes that it would have taken.
    pub left_out: Vec<(usize, u64)>,
}

impl VertexCluster {
    /// Chosen vertices.
    #[must_use]
    pub fn len(&self) -> usize {
        self.chosen.iter().map(|c| c.count_ones() as usize).sum()
    }

    /// Whether no vertex is chosen.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Refuses what no reader would take.
    fn check(&self, kind: BlockKind, id: ClusterId, volumes: &[VolumeInfo]) -> Result<()> {
        let wrong = |what: &str, expected: String, found: String| {
            let what = format!("{what} of the cluster at {:?}", id.first());
            Err(FormatError::invalid(what, expected, found))
        };
        let count = id.lattice(volumes)?;
        if self.chosen.len() != CLUSTER_CUBES || self.is_empty() {
            return wrong(
                "cubes",
                format!("{CLUSTER_CUBES}, with vertices"),
                self.chosen.len().to_string(),
            );
        }
        let first = id.first();
        for (i, &chosen) in self.chosen.iter().enumerate() {
            if chosen & !inside(std::array::from_fn(|a| first[a] + cube(i)[a]), count) != 0 {
                return wrong(
                    "vertices",
                    format!("inside {count:?}"),
                    format!("{chosen:#x} in cube {i}"),
                );
            }
        }
        if kind == BlockKind::Indirect && !self.share.is_empty() {
            return wrong("columns", "no share of point lights".into(), "one".into());
        }
        for (name, values) in [("share", &self.share), ("light", &self.light)] {
            if !values.is_empty() && values.len() != self.len() {
                return wrong(
                    name,
                    format!("{} values", self.len()),
                    values.len().to_string(),
                );
            }
            if let Some(c) = values.iter().find(|c| !check::is_radiance(**c)) {
                let expected = "finite numbers of at least 0".into();
                return wrong(name, expected, format!("{c:?}"));
            }
        }
        Ok(())
    }

    /// The columns that it needs.
    pub fn pack(&self, kind: BlockKind, id: ClusterId, volumes: &[VolumeInfo]) -> Result<Packed> {
        self.check(kind, id, volumes)?;
        let records = self.len();
        let mut packed = Packed {
            planes: Vec::new(),
            mask: 0,
            records,
            ranges: Vec::new(),
            left_out: Vec::new(),
        };
        let mut push = |index: usize, rows: Vec<u8>| {
            let from = packed.planes.len();
            bytes::to_planes(&rows, COLUMNS[index].width, &mut packed.planes);
            packed.mask |= 1 << index;
            packed.ranges.push((index, from..packed.planes.len()));
        };
        push(
            CHOSEN,
            self.chosen.iter().flat_map(|c| c.to_le_bytes()).collect(),
        );
        for (index, values) in [(SHARE, &self.share), (LIGHT, &self.light)] {
            let bytes_each = COLUMNS[index].width as u64;
            let saved = if values.iter().all(|c| *c == [0.0; 3]) {
                bytes_each
            } else if values.iter().all(|[r, g, b]| r == g && g == b) {
                push(index + 1, floats(values.iter().map(|c| [c[0]])));
                bytes_each - COLUMNS[index + 1].width as u64
            } else {
                push(index, floats(values.iter().copied()));
                0
            };
            // Gathered light never has a share of point and spot lights.
            if saved > 0 && !(index == SHARE && kind == BlockKind::Indirect) {
                packed.left_out.push((index, saved * records as u64));
            }
        }
        Ok(packed)
    }

    /// Reads columns in planes, of so many vertices.
    pub fn unpack(
        planes: &[u8],
        mask: u32,
        records: usize,
        kind: BlockKind,
        id: ClusterId,
        volumes: &[VolumeInfo],
    ) -> Result<Self> {
        let mut cursor = Cursor::new(planes, "columns of a cluster");
        let mut rows = |index: usize, count: usize| -> Result<Option<Vec<u8>>> {
            if mask >> index & 1 == 0 {
                return Ok(None);
            }
            let width = COLUMNS[index].width;
            Ok(Some(bytes::from_planes(cursor.take(count * width)?, width)))
        };
        let chosen = rows(CHOSEN, CLUSTER_CUBES)?.unwrap_or_default();
        let (chosen, _) = chosen.as_chunks::<8>();
        let mut cluster = Self {
            chosen: chosen.iter().map(|c| u64::from_le_bytes(*c)).collect(),
            ..Self::default()
        };
        if cluster.len() != records {
            return Err(FormatError::invalid(
                "chosen vertices",
                records.to_string(),
                cluster.len(),
            ));
        }
        for (index, values) in [(SHARE, &mut cluster.share), (LIGHT, &mut cluster.light)] {
            match (rows(index, records)?, rows(index + 1, records)?) {
                (None, None) => {}
                (Some(rgb), None) => *values = triples(&rgb),
                (None, Some(grey)) => *values = singles(&grey).map(|v| [v; 3]).collect(),
                (Some(_), Some(_)) => {
                    return Err(FormatError::invalid(
                        "columns of a cluster",
                        "colour or grey",
                        "both",
                    ));
                }
            }
        }
        cursor.end()?;
        cluster.check(kind, id, volumes)?;
        Ok(cluster)
    }
}

/// The first vertex of a cube, from that of its cluster.
fn cube(i: usize) -> [usize; 3] {
    const ALONG: usize = CLUSTER_EDGE / CUBE_EDGE;
    [i % ALONG, i / ALONG % ALONG, i / (ALONG * ALONG)].map(|c| c * CUBE_EDGE)
}

/// A bit for each vertex of a cube that a lattice of `count` has.
fn inside(first: [usize; 3], count: [usize; 3]) -> u64 {
    if (0..3).all(|a| first[a] + CUBE_EDGE <= count[a]) {
        return u64::MAX;
    }
    (0..64).fold(0, |bits, i| {
        let at = [
            i % CUBE_EDGE,
            i / CUBE_EDGE % CUBE_EDGE,
            i / (CUBE_EDGE * CUBE_EDGE),
        ];
        let is_inside = (0..3).all(|a| first[a] + at[a] < count[a]);
        bits | u64::from(is_inside) << i
    })
}
