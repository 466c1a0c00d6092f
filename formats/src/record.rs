//! The records that the files hold, decoded. Lengths are in scene units, radiance is linear
//! Rec.709.
//!
//! How each value is stored, and how exactly, is stated in `SPEC.md` alone.

use bincode::de::Decoder;
use bincode::enc::Encoder;
use bincode::error::{DecodeError, EncodeError};

/// An oriented opaque disk, clipped where its surface ends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Surfel {
    /// Centre, in scene space.
    pub position: [f32; 3],
    /// Unit normal of the front side.
    pub normal: [f32; 3],
    /// Radius of the disk before it is clipped, scene units.
    pub radius: f32,
    /// The surface area that this sample stands for; less than the disk's, so that disks overlap
    /// and leave no holes.
    pub area: f32,
    /// Diffuse radiance that leaves the front side.
    pub front: [f32; 3],
    /// Diffuse radiance that leaves the back side.
    pub back: [f32; 3],
    /// Lines at which the disk ends before its radius does.
    pub clips: Clips,
}

/// Up to three half-planes through which a disk is cut, each a line in the disk's plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clips {
    /// Number of `edges` that hold.
    pub count: u8,
    /// The cutting lines; those from `count` on mean nothing.
    pub edges: [ClipEdge; 3],
}

impl Clips {
    /// Whether a point of the disk, in units of its radius, is left.
    #[must_use]
    pub fn keep(&self, point: [f32; 2]) -> bool {
        Lines::of(self).keep(point)
    }
}

/// The edges of [`Clips`], with the sines and cosines of their angles.
struct Lines {
    count: usize,
    /// Sine, cosine and offset.
    lines: [[f32; 3]; 3],
}

impl Lines {
    fn of(clips: &Clips) -> Self {
        let count = usize::from(clips.count.min(3));
        let mut lines = [[0.0; 3]; 3];
        for (line, edge) in lines.iter_mut().zip(&clips.edges[..count]) {
            let (sin, cos) = libm::sincosf(edge.angle);
            *line = [sin, cos, edge.offset];
        }
        Self { count, lines }
    }

    fn keep(&self, point: [f32; 2]) -> bool {
        self.lines[..self.count]
            .iter()
            .all(|[sin, cos, offset]| point[0] * cos + point[1] * sin <= offset + 1e-4)
    }

    /// Corners of what is left of the unit disk.
    fn corners(&self) -> ([[f32; 2]; 9], usize) {
        let mut corners = [[0.0; 2]; 9];
        let mut count = 0;
        let mut add = |p: [f32; 2]| {
            if self.keep(p) {
                corners[count] = p;
                count += 1;
            }
        };
        let lines = &self.lines[..self.count];
        for (i, [sin, cos, offset]) in lines.iter().enumerate() {
            let half = (1.0 - offset * offset).max(0.0).sqrt();
            for s in [-half, half] {
                add([offset * cos - s * sin, offset * sin + s * cos]);
            }
            for [sin2, cos2, offset2] in &lines[i + 1..] {
                let det = cos * sin2 - sin * cos2;
                if det.abs() > 1e-6 {
                    let p = [
                        (offset * sin2 - offset2 * sin) / det,
                        (offset2 * cos - offset * cos2) / det,
                    ];
                    if p[0] * p[0] + p[1] * p[1] <= 1.0 {
                        add(p);
                    }
                }
            }
        }
        (corners, count)
    }
}

/// How far a clipped disk reaches from its centre, wherever that is.
///
/// A linear function over a disk cut by half-planes is largest where the circle is extreme, if
/// that point is not cut away, else at a corner: where a line meets the circle or another line.
#[derive(Clone, Copy)]
pub(crate) struct Reach {
    /// Towards -x, -y, -z, and towards x, y, z.
    towards: [[f32; 3]; 2],
    /// Whether the centre itself may be cut away: it is in the box nevertheless.
    is_clipped: bool,
}

impl Reach {
    pub fn of(surfel: &Surfel) -> Self {
        let (tangent, bitangent) = tangent_frame(surfel.normal);
        let is_clipped = surfel.clips.count != 0;
        let mut towards = [[0.0; 3]; 2];
        if !is_clipped {
            for axis in 0..3 {
                let (t, b) = (tangent[axis], bitangent[axis]);
                let reach = (t * t + b * b).sqrt() * surfel.radius;
                (towards[0][axis], towards[1][axis]) = (-reach, reach);
            }
            return Self {
                towards,
                is_clipped,
            };
        }
        let lines = Lines::of(&surfel.clips);
        let (corners, count) = lines.corners();
        for axis in 0..3 {
            let (t, b) = (tangent[axis], bitangent[axis]);
            let length = (t * t + b * b).sqrt();
            for (towards, sign) in towards.iter_mut().zip([-1.0, 1.0]) {
                let extreme = [sign * t / length, sign * b / length];
                let reach = if length > 0.0 && lines.keep(extreme) {
                    sign * length
                } else {
                    let along = corners[..count]
                        .iter()
                        .map(|c| sign * (c[0] * t + c[1] * b));
                    sign * along.fold(0.0, f32::max)
                };
                towards[axis] = reach * surfel.radius;
            }
        }
        Self {
            towards,
            is_clipped,
        }
    }

    /// The tight box of the disk around a place.
    pub fn around(&self, position: [f32; 3]) -> Bounds {
        let [min, max] = self
            .towards
            .map(|reach| std::array::from_fn(|axis| position[axis] + reach[axis]));
        if !self.is_clipped {
            return Bounds { min, max };
        }
        let at = |p: [f32; 3]| Bounds { min: p, max: p };
        at(position).union(at(min)).union(at(max))
    }
}

/// A line in the plane of a disk: points with `x cos(angle) + y sin(angle) > offset * radius` are
/// cut away, where (x, y) are coordinates from the disk's centre in the tangent frame of
/// [`tangent_frame`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClipEdge {
    /// Direction of the line's outward normal, radians in [0, 2 pi).
    pub angle: f32,
    /// Distance of the line from the centre over the radius, in [0, 1].
    pub offset: f32,
}

/// The two tangents that belong to a unit normal (Duff et al. 2017), without a branch at the pole.
///
/// Clip edges are stored relative to this frame of the *decoded* normal, so it is part of the
/// format.
#[must_use]
pub fn tangent_frame(n: [f32; 3]) -> ([f32; 3], [f32; 3]) {
    let sign = 1.0f32.copysign(n[2]);
    let a = -1.0 / (sign + n[2]);
    let b = n[0] * n[1] * a;
    (
        [1.0 + sign * n[0] * n[0] * a, sign * b, -sign * n[0]],
        [b, sign + n[1] * n[1] * a, -n[1]],
    )
}

/// A block of participating medium: an axis-aligned cube of 2^level voxels a side in the index
/// space of its volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lvoxel {
    /// Index into the file's table of volumes.
    pub volume: u16,
    /// The block spans voxels `block * 2^level` to `(block + 1) * 2^level` on each axis; at most
    /// [`MAX_LEVEL`].
    pub level: u8,
    /// Place of the block x, y, z in its volume, in blocks of its own level.
    pub block: [u16; 3],
    /// Mean extinction, per scene unit.
    pub sigma_t: f32,
    /// Source function: radiance in-scattered per unit optical depth, albedo included; weighted by
    /// extinction over the block. The mean over all directions.
    pub source: [f32; 3],
    /// Mean direction in which its light leaves, scene space, by [`Lvoxel::LOBE_ONE`] to a length
    /// of 1; 0 if it leaves alike in all directions.
    pub lobe: [i8; 3],
    /// Of its light, what has come straight from lights; `lobe` is that of the rest. In trees whose
    /// light has bounced; no share of it if all light is in one lobe.
    pub single: LightPart,
    /// Radiance that arrives from the lvoxels of its volume, scattered any number of times: the
    /// mean over all directions and over the block. In trees whose light has bounced; 0 if unknown.
    pub incident: [f32; 3],
}

impl Lvoxel {
    /// What stands for 1 in a lobe.
    pub const LOBE_ONE: f32 = 127.0;

    /// Whether a lobe is shorter than 1.
    #[must_use]
    pub fn is_lobe(lobe: [i8; 3]) -> bool {
        /// Its square.
        const LONGEST: i32 = 126 * 126;
        let square = |c: i8| i32::from(c) * i32::from(c);
        lobe.into_iter().map(square).sum::<i32>() <= LONGEST
    }
}

/// A part of the light that leaves an lvoxel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightPart {
    /// Its share of all, by [`LightPart::SHARE_ONE`] to all of it.
    pub share: u8,
    /// Mean direction in which it leaves, as that of an [`Lvoxel`].
    pub lobe: [i8; 3],
}

impl LightPart {
    /// What stands for all light.
    pub const SHARE_ONE: f32 = 255.0;

    /// The bytes that files have.
    #[must_use]
    pub(crate) fn bytes(self) -> [u8; 4] {
        let [x, y, z] = self.lobe.map(|c| c as u8);
        [self.share, x, y, z]
    }

    /// The inverse of [`LightPart::bytes`].
    #[must_use]
    pub(crate) fn of_bytes([share, lobe @ ..]: [u8; 4]) -> Self {
        Self {
            share,
            lobe: lobe.map(|c| c as i8),
        }
    }
}

/// The coarsest lvoxel is 2^3 voxels a side, which is also the brick in which the level is one.
pub const MAX_LEVEL: u8 = 3;

/// Most voxels of a volume along an axis: lvoxels number blocks, at the coarsest level, in 16 bits.
pub const MAX_VOXELS_ALONG: u32 = 65_536 << MAX_LEVEL;

/// Most volumes of a cloud, which lvoxels number in 16 bits.
pub const MAX_VOLUMES: usize = 65_535;

/// A volume, as far as readers must know it to place its lvoxels.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct VolumeInfo {
    /// Name from the scene.
    pub name: String,
    /// Voxels along x, y, z of index space, 1 to [`MAX_VOXELS_ALONG`].
    pub dims: [u32; 3],
    /// Affine map from scene space to index space, column by column: three axes, then the
    /// translation. Voxel (i,j,k) spans (i,j,k) to (i+1,j+1,k+1).
    pub index_from_scene: [[f64; 3]; 4],
    /// Single-scattering albedo, constant over the volume.
    pub albedo: [f32; 3],
    /// Extinction of red, green and blue over `sigma_t` of its lvoxels, each in `[0,1]` and one of
    /// them 1: all of a grey medium.
    #[serde(default = "grey", skip_serializing_if = "is_grey")]
    pub extinction_color: [f32; 3],
}

/// The extinction of a volume that stops red, green and blue unlike, over that of the channel that
/// it stops most.
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
pub struct ExtinctionColor {
    /// Number of the volume.
    pub volume: u32,
    /// Red, green and blue, each in `[0,1]`, one of them 1 and one less.
    pub color: [f32; 3],
}

fn grey() -> [f32; 3] {
    [1.0; 3]
}

fn is_grey(color: &[f32; 3]) -> bool {
    *color == grey()
}

impl ExtinctionColor {
    pub(crate) fn is_grey(&self) -> bool {
        is_grey(&self.color)
    }
}

impl VolumeInfo {
    /// Whether it stops red, green and blue alike.
    #[must_use]
    pub fn is_grey(&self) -> bool {
        is_grey(&self.extinction_color)
    }
}

/// Without the colour, which goes behind all else of the metadata.
impl bincode::Encode for VolumeInfo {
    fn encode<E: Encoder>(&self, encoder: &mut E) -> Result<(), EncodeError> {
        let place = (self.dims, self.index_from_scene);
        (&self.name, place, self.albedo).encode(encoder)
    }
}

impl<C> bincode::Decode<C> for VolumeInfo {
    fn decode<D: Decoder<Context = C>>(decoder: &mut D) -> Result<Self, DecodeError> {
        let (name, (dims, index_from_scene), albedo) = bincode::Decode::decode(decoder)?;
        Ok(Self {
            name,
            dims,
            index_from_scene,
            albedo,
            extinction_color: grey(),
        })
    }
}

bincode::impl_borrow_decode!(VolumeInfo);

/// An axis-aligned box in scene space.
#[derive(
    Clone,
    Copy,
    Debug,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct Bounds {
    /// The least x, y, z.
    pub min: [f32; 3],
    /// The greatest x, y, z.
    pub max: [f32; 3],
}

impl Bounds {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self {
        min: [f32::INFINITY; 3],
        max: [f32::NEG_INFINITY; 3],
    };

    /// The smallest box that holds both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            min: std::array::from_fn(|i| self.min[i].min(other.min[i])),
            max: std::array::from_fn(|i| self.max[i].max(other.max[i])),
        }
    }

    /// The tight box of a clipped disk.
    #[must_use]
    pub fn of_surfel(surfel: &Surfel) -> Self {
        Reach::of(surfel).around(surfel.position)
    }
}

/// Sums and means over all surfels below a node, by which the node can stand for them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SurfelAggregate {
    /// Sum of surfel areas.
    pub area: f32,
    /// Mean of the surfels' centres weighted by their areas, scene space.
    pub centre: [f32; 3],
    /// Sum of area times normal.
    pub normal_sum: [f32; 3],
    /// Sum of area times n n^T: xx, yy, zz, xy, xz, yz. The area projected along w is about
    /// `sqrt(area * w^T M w)`.
    pub second_moment: [f32; 6],
    /// Area of fronts projected towards +x, -x, +y, -y, +z, -z. That of backs towards a direction
    /// is that of fronts towards the opposite one.
    pub axis_area: [f32; 6],
    /// Mean radiance of fronts towards the same six directions, weighted by that projected area.
    pub axis_radiance: [[f32; 3]; 6],
    /// Mean radiance of backs towards the same six directions, weighted by their projected area.
    /// Fronts and backs are apart, as one side of a shell has nothing of the light of the other.
    pub back_radiance: [[f32; 3]; 6],
}

/// A node of the tree over surfels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Tight box of all surfels below, radii included, as decoded: never smaller than the true one.
    pub bounds: Bounds,
    /// The children: nodes, surfels, or another page.
    pub below: Below,
    /// Sums and means over all surfels below.
    pub aggregate: SurfelAggregate,
}

/// The children of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Below {
    /// Nodes `first..first + count` of the same page; count is 1 to 8.
    Nodes {
        /// Index in the page.
        first: u32,
        /// Children, 1 to 8.
        count: u8,
    },
    /// Surfels `first..first + count` of the same page; count is 1 to 8.
    Surfels {
        /// Index in the page.
        first: u32,
        /// Children, 1 to 8.
        count: u8,
    },
    /// Another page, whose node 0 this is.
    Page(u32),
    /// Another page, whose node 0 this is; all nodes right below that send about what it sends, so
    /// that who takes this one whole need not look at them.
    EvenPage(u32),
}

impl Below {
    /// Number of surfels right below; `None` if nodes or a page are below.
    #[must_use]
    pub fn surfels(&self) -> Option<u8> {
        match *self {
            Self::Surfels { count, .. } => Some(count),
            _ => None,
        }
    }

    /// The page below; `None` if what is below is in the same page.
    #[must_use]
    pub fn page(&self) -> Option<u32> {
        match *self {
            Self::Page(page) | Self::EvenPage(page) => Some(page),
            Self::Nodes { .. } | Self::Surfels { .. } => None,
        }
    }
}

/// A decoded page of the tree over surfels: a self-contained subtree with its root at node 0.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfelPage {
    /// Nodes; siblings are adjacent, parents come before their children.
    pub nodes: Vec<Node>,
    /// Surfels of this page's leaves, in leaf order.
    pub surfels: Vec<Surfel>,
}

/// The surfels of a [`SurfelPage`] without its nodes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfelLeaves {
    /// Number of surfels of each leaf, in the order of the page's nodes.
    pub counts: Vec<u8>,
    /// Surfels, in the same order.
    pub surfels: Vec<Surfel>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_box_of_a_clipped_disk_is_tight() {
        let mut clips = Clips {
            count: 2,
            ..Clips::default()
        };
        clips.edges[0] = ClipEdge {
            angle: 0.3,
            offset: 0.2,
        };
        clips.edges[1] = ClipEdge {
            angle: 2.0,
            offset: 0.5,
        };
        let n = [0.48, -0.6, 0.64];
        for clips in [Clips::default(), clips] {
            let surfel = Surfel {
                position: [1.0, 2.0, 3.0],
                normal: n,
                radius: 2.0,
                clips,
                ..Surfel::default()
            };
            let bounds = Bounds::of_surfel(&surfel);
            let (t, b) = tangent_frame(n);
            let mut seen = Bounds::EMPTY;
            for i in 0..1000 {
                for j in 0..=100 {
                    let (r, phi) = (j as f32 / 100.0, i as f32 * std::f32::consts::TAU / 1000.0);
                    let p = [r * phi.cos(), r * phi.sin()];
                    if clips.keep(p) {
                        let at = std::array::from_fn(|a| {
                            surfel.position[a] + 2.0 * (p[0] * t[a] + p[1] * b[a])
                        });
                        seen = seen.union(Bounds { min: at, max: at });
                    }
                }
            }
            for a in 0..3 {
                assert!(
                    (bounds.min[a] - seen.min[a]).abs() < 0.03,
                    "{bounds:?} {seen:?}"
                );
                assert!(
                    (bounds.max[a] - seen.max[a]).abs() < 0.03,
                    "{bounds:?} {seen:?}"
                );
            }
        }
    }
}
