//! Lvoxels along a ray: the blocks of each volume on its own index grid, walked front to back.
//!
//! | file | what it does |
//! | --- | --- |
//! | `grid` | the lvoxels of one volume |
//! | `levels` | cubes of them as they are seen from afar |
//! | `walk` | the way of a ray through them |
//! | `incident` | what arrives in them of the light of the others |

mod grid;
mod incident;
mod levels;
mod walk;

use crate::math::segment::{Interval, Segment, flatten_overlaps};
use crate::math::{Boxes, Ray, Rgb, Spectrum};
use glam::Vec3;
use grid::BlockGrid;
pub use grid::{Block, table_bytes};
pub use incident::IncidentGrid;
use levels::Levels;
use lvox_formats::record::{LightPart, Lvoxel, VolumeInfo};
use std::sync::OnceLock;
use walk::{Beam, Walk};

/// All lvoxels of a tree.
#[derive(Debug, Default)]
pub struct Media {
    volumes: Vec<BlockGrid<Block>>,
    /// By volume, cubes as seen from afar, if any ray has asked for those.
    levels: Vec<OnceLock<Levels>>,
    boxes: Boxes,
    /// The same lvoxels, which send nothing; none if they do not tell what arrives of their light.
    dark: Option<Box<Media>>,
}

/// An lvoxel as it lies in its volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LvoxelBlock {
    /// Its first voxel.
    pub first: [usize; 3],
    /// Voxels along its edge.
    pub edge: usize,
    /// Extinction per scene unit.
    pub sigma_t: f32,
    /// Source function: the mean over all directions.
    pub source: Rgb,
    /// Mean direction in which its light leaves, but what has scattered once, as [`Lvoxel`] has it.
    pub lobe: [i8; 3],
    /// Of its light, what has come straight from lights.
    pub single: LightPart,
}

impl LvoxelBlock {
    /// The lobes in which its light leaves.
    #[must_use]
    pub fn lobes(&self) -> TwoLobes {
        TwoLobes::new(self.lobe, self.single)
    }
}

/// The lobes in which light leaves an lvoxel, scene space.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TwoLobes {
    /// Share of what has come straight from lights and scattered once.
    pub single_share: f32,
    /// Mean direction in which that leaves.
    pub single: Vec3,
    /// The same of all other light.
    pub rest: Vec3,
}

impl TwoLobes {
    /// Of an lvoxel with these.
    #[must_use]
    pub fn new(lobe: [i8; 3], single: LightPart) -> Self {
        Self {
            single_share: f32::from(single.share) * (1.0 / LightPart::SHARE_ONE),
            single: mean_direction(single.lobe),
            rest: mean_direction(lobe),
        }
    }

    /// All light in one lobe.
    #[must_use]
    pub fn one(lobe: Vec3) -> Self {
        Self {
            rest: lobe,
            ..Self::default()
        }
    }

    /// Light that leaves in a unit direction, over the mean of all directions.
    #[inline]
    #[must_use]
    pub fn along(&self, travel: Vec3) -> f32 {
        let rest = in_lobe(self.rest, travel);
        if self.single_share == 0.0 {
            return rest;
        }
        rest + (in_lobe(self.single, travel) - rest) * self.single_share
    }
}

/// The mean direction in which light of such a lobe leaves, scene space.
#[must_use]
pub fn mean_direction(lobe: [i8; 3]) -> Vec3 {
    Vec3::from(lobe.map(f32::from)) * (1.0 / Lvoxel::LOBE_ONE)
}

/// Light that leaves in a unit direction, over the mean of all directions, where this is the mean
/// direction in which it leaves (Henyey & Greenstein 1941).
#[inline]
#[must_use]
pub fn in_lobe(lobe: Vec3, travel: Vec3) -> f32 {
    let squared = (travel - lobe).length_squared();
    (1.0 - lobe.length_squared()) / (squared * squared.sqrt())
}

/// The places of a tree's lvoxels. What they hold is read in a second pass over them, so that they
/// are never in memory twice.
#[derive(Debug)]
pub struct MediaLayout {
    volumes: Vec<BlockGrid<()>>,
}

impl MediaLayout {
    /// No lvoxels yet, in these volumes.
    #[must_use]
    pub fn new(volumes: &[VolumeInfo]) -> Self {
        Self {
            volumes: volumes.iter().map(BlockGrid::new).collect(),
        }
    }

    /// Notes where an lvoxel is. They may come in any order; the first in a brick decides on the
    /// size of the brick's blocks, and of two in one place. One that does not fit in is left out.
    pub fn note(&mut self, l: &Lvoxel) {
        if let Some(volume) = self.volumes.get_mut(usize::from(l.volume)) {
            volume.note(l);
        }
    }

    /// Bytes that the media will hold.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let blocks: u64 = self.volumes.iter().map(BlockGrid::count).sum();
        let rest: usize = self.volumes.iter().map(with_levels).sum();
        let lobed = (self.volumes.iter()).filter(|v| v.has_lobes);
        let lobes = lobed.map(BlockGrid::count).sum::<u64>() * size_of::<[i8; 3]>() as u64;
        let scattering = (self.volumes.iter()).filter(|v| v.has_singles);
        let singles = scattering.map(BlockGrid::count).sum::<u64>();
        let lobes = lobes + singles * size_of::<LightPart>() as u64;
        let blocks_and_rest = blocks * size_of::<Block>() as u64 + rest as u64;
        if !self.volumes.iter().any(|v| v.has_incident) {
            return blocks_and_rest + lobes;
        }
        let telling = (self.volumes.iter()).filter(|v| v.has_incident);
        let incident = telling.map(BlockGrid::count).sum::<u64>() * size_of::<Rgb>() as u64;
        2 * blocks_and_rest + lobes + incident
    }

    /// Media whose lvoxels are all empty; [`Media::place`] fills them in.
    #[must_use]
    pub fn allocate(self) -> Media {
        Media {
            boxes: Boxes::new(self.volumes.iter().map(BlockGrid::bounds)),
            levels: self.volumes.iter().map(|_| OnceLock::new()).collect(),
            volumes: self.volumes.into_iter().map(BlockGrid::allocate).collect(),
            dark: None,
        }
    }
}

impl Media {
    /// Lays out lvoxels, which may come in any order but must lie inside their volumes, as readers
    /// promise.
    #[must_use]
    pub fn new(volumes: &[VolumeInfo], lvoxels: impl IntoIterator<Item = Lvoxel>) -> Self {
        let lvoxels: Vec<Lvoxel> = lvoxels.into_iter().collect();
        let mut layout = MediaLayout::new(volumes);
        lvoxels.iter().for_each(|l| layout.note(l));
        let mut media = layout.allocate();
        lvoxels.iter().for_each(|l| media.place(l));
        media.with_dark()
    }

    /// Fills in an lvoxel that was noted; the first in its place stays.
    pub fn place(&mut self, l: &Lvoxel) {
        if let Some(volume) = self.volumes.get_mut(usize::from(l.volume)) {
            volume.place(l);
        }
    }

    /// All lvoxels are filled in.
    #[must_use]
    pub fn with_dark(mut self) -> Self {
        if self.volumes.iter().any(|v| v.has_incident) {
            self.dark = Some(Box::new(Self {
                volumes: self.volumes.iter().map(BlockGrid::dark).collect(),
                levels: self.volumes.iter().map(|_| OnceLock::new()).collect(),
                boxes: self.boxes.clone(),
                dark: None,
            }));
        }
        self
    }

    /// Lvoxels that send no light where they tell what arrives of it, as [`Self::incident`] has it;
    /// else these.
    #[must_use]
    pub fn without_incident(&self) -> &Self {
        self.dark.as_deref().unwrap_or(self)
    }

    /// Whether any volume stops one channel of light more than another.
    #[must_use]
    pub fn are_colored(&self) -> bool {
        self.volumes.iter().any(|v| v.extinction_color != [1.0; 3])
    }

    /// Whether there is no lvoxel at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.volumes.iter().all(|v| v.blocks.is_empty())
    }

    /// Bytes of memory that all lvoxels take.
    #[must_use]
    pub fn bytes(&self) -> usize {
        let own: usize = self.volumes.iter().map(with_levels).sum();
        own + self.dark.as_ref().map_or(0, |dark| dark.bytes())
    }

    /// Voxels along each axis of a volume, if there is one of this number.
    #[must_use]
    pub fn dims(&self, volume: usize) -> Option<[usize; 3]> {
        Some(self.volumes.get(volume)?.dims.map(|n| n as usize))
    }

    /// Gives all lvoxels of a volume to `take`.
    pub fn each_block(&self, volume: usize, take: &mut impl FnMut(LvoxelBlock)) {
        if let Some(volume) = self.volumes.get(volume) {
            volume.each_block(take);
        }
    }

    /// The light that the lvoxels of a volume send each other; `None` if they do not tell.
    #[must_use]
    pub fn incident(&self, volume: usize) -> Option<IncidentGrid<'_>> {
        let grid = self.volumes.get(volume)?;
        (!grid.incident.is_empty()).then_some(IncidentGrid(grid))
    }

    /// Gives every segment of a ray in an lvoxel, front to back, to `add` until that says no;
    /// returns whether it never did.
    #[inline]
    pub fn walk<K: Spectrum>(&self, ray: &Ray, add: &mut impl FnMut(Segment<K>) -> bool) -> bool {
        self.walk_lit(ray, -ray.direction, 0.0, add)
    }

    /// The same for light that travels with the ray, not against it.
    pub fn walk_with<K: Spectrum>(
        &self,
        ray: &Ray,
        add: &mut impl FnMut(Segment<K>) -> bool,
    ) -> bool {
        self.walk_lit(ray, ray.direction, 0.0, add)
    }

    /// [`Self::walk`] for a beam that is so wide at a distance of 1: cubes of lvoxels that are
    /// narrower are one segment, where light differs little in them.
    #[inline]
    pub fn walk_beam<K: Spectrum>(
        &self,
        ray: &Ray,
        width: f32,
        add: &mut impl FnMut(Segment<K>) -> bool,
    ) -> bool {
        self.walk_lit(ray, -ray.direction, width, add)
    }

    #[inline]
    fn walk_lit<K: Spectrum>(
        &self,
        ray: &Ray,
        travel: Vec3,
        width: f32,
        add: &mut impl FnMut(Segment<K>) -> bool,
    ) -> bool {
        let beam = Beam { ray, travel, width };
        let boxes = self.boxes.along(ray);
        let mut met = boxes.filter_map(|v| {
            let volume = &self.volumes[v];
            let walk = Walk::new(volume, &self.levels[v], &beam)?;
            Some((volume.extinction_color, walk))
        });
        match (met.next(), met.next()) {
            (None, _) => true,
            (Some((color, walk)), None) => walk.run(&mut |s| add(tinted(&s, &color))),
            (Some(first), Some(second)) => {
                // What lvoxels send is known: walking them to their end costs little.
                let walks = [first, second].into_iter().chain(met).map(|(color, walk)| {
                    let mut all = Vec::new();
                    walk.run(&mut |s| {
                        let s: Segment<K> = tinted(&s, &color);
                        all.push(Interval {
                            near: s.near,
                            far: s.far,
                            tau: s.tau,
                            of: s.source,
                        });
                        true
                    });
                    all.into_iter()
                });
                flatten_overlaps(walks, |source| source, add)
            }
        }
    }
}

/// Bytes of the lvoxels of a volume, and of its levels at most.
fn with_levels<B>(grid: &BlockGrid<B>) -> usize {
    grid.bytes() + Levels::most_bytes(grid)
}

/// A segment of a medium of such a colour.
#[inline(always)]
fn tinted<K: Spectrum>(s: &Segment, color: &[f32; 3]) -> Segment<K> {
    Segment {
        near: s.near,
        far: s.far,
        tau: K::tinted(s.tau, color),
        source: s.source,
    }
}
