//! The radiance that surfaces send, by patches of the scene's triangles: for rays that end at the
//! geometry itself.
//!
//! Rays tell exactly what a receiver sees, and no disk reaches over an edge. What is seen is asked
//! of the tree once for each patch, whose size goes by the solid angle that a node may have to be
//! taken whole, and remembered.

use super::bright::{self, BrightDiskSearch, BrightHit, BrightPatch, BrightPatchIndex, DiskSide};
use super::crossing::Crossing;
use super::geometry::Geometry;
use super::order::in_order_of_places;
use super::patch::TriangleSide;
use super::patch_id::{PatchExtent, PatchId};
use super::radiance_cache::RadianceCache;
use crate::Result;
use crate::math::{Hit, Ray, Rgb};
use crate::tree::OpenTree;
use crate::tree::SurfelStore;
use crate::tree::traversal::OpenNodes;
use rayon::prelude::*;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// Counts of the patches that were evaluated. Threads that evaluate one patch at the same time are
/// counted each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PatchStats {
    /// Patches that were evaluated, each time anew.
    pub patches: u64,
    /// Patches at which the tree knows no surface: they are black.
    pub unknown: u64,
    /// Bright patches.
    pub bright: u64,
    /// Whether the unknown are an appreciable part of what gather rays met.
    pub misses_surfels: bool,
}

/// The request that a ray makes of the patch that ends it.
#[derive(Clone, Copy, Debug)]
pub struct PatchRequest {
    /// A node seen under less than this may stand for all below it, steradians.
    pub max_solid_angle: f32,
    /// Whether bright patches are to be black.
    pub leave_out_bright: bool,
}

/// Patches that rays end on whose radiance is still to be evaluated.
///
/// In the order in which rays meet them they ask for pages of the tree all over it, each time
/// anew: where pages live in a cache, patches are found first and then evaluated in the order of
/// their places, so that each page is needed in one short time.
#[derive(Clone, Debug, Default)]
pub struct UnknownPatches(Vec<u64>);

impl UnknownPatches {
    /// All of some.
    #[must_use]
    pub fn of_all(all: Vec<Self>) -> Self {
        let mut keys: Vec<u64> = all.into_iter().flat_map(|u| u.0).collect();
        keys.par_sort_unstable();
        keys.dedup();
        Self(keys)
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// The extent of a triangle, where surfels stand for such an area on the mean.
#[inline(never)]
fn extent(geometry: &dyn Geometry, area_per_surfel: f32, triangle: u32) -> PatchExtent {
    let over_mean = geometry.surfel_area_over_mean(triangle);
    let least = over_mean.map(|a| a * area_per_surfel);
    PatchExtent::new(geometry.corners(triangle), least)
}

/// Most rays of a packet.
pub const MAX_PACKET: usize = 64;

/// The radiance that leaves the scene's surfaces, evaluated from a tree patch by patch, and cached.
///
/// Patches are remembered in a table of fixed size, in which later ones take the place of earlier
/// ones. A patch sends what it sends whoever asks, so that neither threads nor memory change a bit
/// of the result.
#[derive(Debug)]
pub struct PatchRadiance<'a> {
    geometry: &'a dyn Geometry,
    /// By triangle: rays wait for memory, and find all that most of them need in one place.
    extents: Box<[PatchExtent]>,
    /// Area of a surfel of the tree, scene units squared.
    area_per_surfel: f32,
    /// Whether surfels of one piece of the scene have one size.
    is_even: bool,
    /// The square over the longest edge of a patch need not be smaller than the area of so many of
    /// them.
    surfels_per_patch: f32,
    cache: RadianceCache,
    /// The bright patches that rays may leave out, if any were found.
    bright: Option<BrightPatchIndex>,
    patches: AtomicU64,
    unknown: AtomicU64,
}

impl<'a> PatchRadiance<'a> {
    /// Ratio of the solid angle of a square over a patch's longest edge to that under which a node
    /// is taken whole. Patches are triangles, and divided by four: on average they have an eighth
    /// of that square.
    const PATCH_TO_CUT: f32 = 4.0;
    /// The ratio where there are bright patches, whose borders large ones would blur.
    const FINE_PATCH_TO_CUT: f32 = 2.0;

    /// Prepares patches of which none is evaluated yet. `area_per_surfel` is that of the tree,
    /// scene units squared: patches need not be smaller than surfels tell apart. The cache has room
    /// for the patches that about `rays` rays end on.
    ///
    /// # Errors
    /// No memory for the cache.
    pub fn new(geometry: &'a dyn Geometry, area_per_surfel: f32, rays: usize) -> Result<Self> {
        let extent = |t| extent(geometry, area_per_surfel, t);
        Ok(Self {
            geometry,
            area_per_surfel,
            extents: (0..geometry.triangles()).map(extent).collect(),
            is_even: true,
            surfels_per_patch: 1.0,
            cache: RadianceCache::new(rays)?,
            bright: None,
            patches: AtomicU64::new(0),
            unknown: AtomicU64::new(0),
        })
    }

    /// Bytes that the patches of so many triangles take, with a cache for those that so many rays
    /// end on.
    #[must_use]
    pub fn bytes_for(triangles: usize, rays: usize) -> u64 {
        (triangles * size_of::<PatchExtent>()) as u64 + RadianceCache::bytes_for(rays)
    }

    /// The same patches, with their radiance in a file that other processes add to and take from.
    /// `scene` is a digest of surfaces and materials; the tree and the size of patches are part of
    /// the file's identity, too, so that this comes last.
    ///
    /// # Errors
    /// A file that cannot be made or mapped, or that is of another scene, tree or size of patches.
    pub fn cached_in(mut self, file: &Path, scene: &str, tree: &OpenTree) -> Result<Self> {
        let mut identity = blake3::Hasher::new();
        identity.update(env!("CARGO_PKG_VERSION").as_bytes());
        identity.update(&tree.tree().content_hash());
        identity.update(&self.surfels_per_patch.to_le_bytes());
        identity.update(scene.as_bytes());
        self.cache = RadianceCache::in_file(file, identity.finalize().into())?;
        Ok(self)
    }

    /// Radiance that leaves the scene's surfaces by what a tree says of them, with room to remember
    /// the patches that about so many rays end on.
    ///
    /// # Errors
    /// No memory for the cache.
    pub fn of_tree(geometry: &'a dyn Geometry, tree: &OpenTree, rays: usize) -> Result<Self> {
        let patches = Self::new(geometry, tree.area_per_surfel(), rays)?;
        // Surfels of one piece of the scene have one size where disks are made to overlap.
        if tree.tree().meta().cloud.disk_overlap > 0.0 {
            Ok(patches)
        } else {
            Ok(patches.of_uneven_surfels())
        }
    }

    /// The same patches for a tree whose surfels are of any size, as those that a camera saw are.
    #[must_use]
    pub fn of_uneven_surfels(mut self) -> Self {
        self.is_even = false;
        self
    }

    /// Divides triangles no further once the square over a patch's longest edge has the area of so
    /// many surfels, not of one. What is nearer than such a patch is large is blurred; patches
    /// larger than the boxes of leaves need none of those.
    #[must_use]
    pub fn in_patches_of(mut self, surfels: f32) -> Self {
        self.surfels_per_patch = surfels.max(1.0);
        self
    }

    /// Returns the counts so far.
    #[must_use]
    pub fn stats(&self) -> PatchStats {
        let patches = self.patches.load(Ordering::Relaxed);
        let unknown = self.unknown.load(Ordering::Relaxed);
        PatchStats {
            patches,
            unknown,
            bright: self.bright.as_ref().map_or(0, |b| b.len() as u64),
            // Where other processes have filled the cache, the few patches that are new to it stand
            // for nothing.
            misses_surfels: unknown as f64 > Self::APPRECIABLE * patches as f64
                && 2 * patches >= self.cache.entries(),
        }
    }

    /// The least share of patches that counts.
    const APPRECIABLE: f64 = 0.05;

    /// Most bright patches of a frame: more, as of a finely divided mesh in the sun, cost more than
    /// they bring.
    const MAX_BRIGHT_PATCHES: usize = 1 << 14;

    /// Finds the patches that send more than `least`, by the mean channel, where at least `support`
    /// hits speak for them. From then on rays that are to leave them out meet black there, and
    /// patches are smaller, near ones as small as surfels may be: large ones would blur the borders
    /// of bright places. None where there are too many.
    pub fn find_bright(
        &mut self,
        pages: &SurfelStore,
        hits: &[BrightHit],
        support: usize,
        least: f32,
    ) -> Vec<BrightPatch> {
        let surfels_per_patch = std::mem::replace(&mut self.surfels_per_patch, 1.0);
        let mut ids = BrightPatchIndex::new(self.extents.len());
        let mut patches = Vec::new();
        let mut open = OpenNodes::default();
        let search = BrightDiskSearch {
            pages,
            hits,
            support,
            least,
        };
        let is_few = search.for_each(|disk| {
            if let Some((hit, extent)) = self.below(disk)
                && let Some(id) = ids.add(&hit, extent)
            {
                let normal = self.geometry.normal(hit.triangle);
                let radiance = self.evaluate(pages, &id, &mut open);
                patches.push(BrightPatch {
                    corners: id.corners(self.geometry.corners(hit.triangle)),
                    normal: if hit.is_back { -normal } else { normal },
                    radiance: radiance * bright::mean_opacity(self.geometry, &id),
                });
            }
            patches.len() <= Self::MAX_BRIGHT_PATCHES
        });
        if !is_few || patches.is_empty() {
            self.surfels_per_patch = surfels_per_patch;
            return Vec::new();
        }
        self.bright = Some(ids);
        patches
    }

    /// Finds the triangle that a disk stands on, if that reflects anything.
    fn below(&self, disk: &DiskSide) -> Option<(Hit, PatchExtent)> {
        let height = 0.5 * disk.radius;
        let above = disk.centre + disk.normal * height;
        let hit = (self.geometry).closest(&Ray::new(above, -disk.normal, 2.0 * height))?;
        let extent = self.extent(hit.triangle);
        (extent.least != PatchExtent::BLACK).then_some((hit, extent))
    }

    /// Evaluates the radiance that a patch sends; black where the tree knows no surface.
    // Few rays ask, and the others need not hold what asking takes.
    #[cold]
    fn evaluate(&self, pages: &SurfelStore, id: &PatchId, open: &mut OpenNodes<()>) -> Rgb {
        let triangle = id.triangle;
        let normal = self.geometry.normal(triangle);
        let side = TriangleSide {
            corners: self.geometry.corners(triangle),
            normal: if id.is_back { -normal } else { normal },
            is_back: id.is_back,
            extent: self.extent(triangle).of_surfels(self.surfels_per_patch),
            is_even: self.is_even,
            geometry: self.geometry,
        };
        let found = side.radiance(id, pages, open);
        self.patches.fetch_add(1, Ordering::Relaxed);
        if found.is_none() {
            self.unknown.fetch_add(1, Ordering::Relaxed);
        }
        found.unwrap_or(Rgb::BLACK)
    }

    /// Returns the surface that ends a ray, if one does, and what it sends towards the ray's
    /// origin: nothing where it is a bright patch and those are left out.
    #[must_use]
    // Not inlined by itself once it is compiled for more than one kind of medium.
    #[inline(always)]
    pub fn cast(
        &self,
        pages: &SurfelStore,
        ray: &Ray,
        request: PatchRequest,
        open: &mut OpenNodes<()>,
    ) -> Option<Crossing> {
        let hit = self.geometry.closest(ray)?;
        Some(Crossing {
            t: hit.t,
            opacity: 1.0,
            radiance: self.sent(pages, &hit, request, open),
        })
    }

    /// Returns what a surface that ends a ray sends towards the ray's origin, as [`Self::cast`]
    /// does.
    #[must_use]
    #[inline(always)]
    pub fn sent(
        &self,
        pages: &SurfelStore,
        hit: &Hit,
        request: PatchRequest,
        open: &mut OpenNodes<()>,
    ) -> Rgb {
        match self.patch_of(hit, request) {
            None => Rgb::BLACK,
            Some(id) => {
                let known = self.cache.get(self.key(&id));
                known.unwrap_or_else(|| self.fill(pages, &id, open))
            }
        }
    }

    /// Finds what [`Self::cast`] does for each ray of a packet, at most [`MAX_PACKET`], in `ends`.
    /// They share their way to the triangles, and those that are looked up together wait at the
    /// same time for the cache, which is in memory that is far away.
    pub fn cast_packet(
        &self,
        pages: &SurfelStore,
        rays: &[Ray],
        request: PatchRequest,
        open: &mut OpenNodes<()>,
        ends: &mut [Option<Crossing>; MAX_PACKET],
    ) {
        let mut ids = [None; MAX_PACKET];
        let mut hits = [None; MAX_PACKET];
        self.geometry
            .closest_of_packet(rays, &mut hits[..rays.len()]);
        for ((hit, end), id) in hits.iter().zip(&mut *ends).zip(&mut ids) {
            *id = hit.and_then(|hit| self.patch_of(&hit, request));
            if let Some(id) = id {
                self.cache.prefetch(self.key(id));
            }
            *end = hit.map(|hit| Crossing {
                t: hit.t,
                opacity: 1.0,
                radiance: Rgb::BLACK,
            });
        }
        let known = ids.map(|id| id.map(|p| (self.cache.get(self.key(&p)), p)));
        for (end, known) in ends.iter_mut().zip(known) {
            if let (Some(end), Some((radiance, id))) = (end, known) {
                // One before it may have asked.
                let known = radiance.or_else(|| self.cache.get(self.key(&id)));
                end.radiance = known.unwrap_or_else(|| self.fill(pages, &id, open));
            }
        }
    }

    /// The patches that some rays end on and that are not in the cache.
    pub fn unknown_along(&self, rays: &[Ray], request: PatchRequest) -> UnknownPatches {
        let mut keys = Vec::new();
        for packet in rays.chunks(MAX_PACKET) {
            let mut hits = [None; MAX_PACKET];
            let hits = &mut hits[..packet.len()];
            self.geometry.closest_of_packet(packet, hits);
            let ids = hits.iter().flatten();
            let ids = ids.filter_map(|hit| self.patch_of(hit, request));
            keys.extend(
                ids.filter(|id| self.cache.get(self.key(id)).is_none())
                    .map(|id| id.key()),
            );
        }
        keys.sort_unstable();
        keys.dedup();
        UnknownPatches(keys)
    }

    /// Evaluates patches, one after the other along a curve through all their places, and fills the
    /// cache with their radiance.
    pub fn evaluate_in_order(&self, pages: &SurfelStore, unknown: UnknownPatches) {
        /// Patches that a thread takes at a time: few, so that all threads are at about one place.
        const TOGETHER: usize = 64;
        let middle = |key: &u64| {
            let id = PatchId::of_key(*key);
            id.middle(self.geometry.corners(id.triangle))
        };
        let keys = in_order_of_places(unknown.0, middle);
        keys.chunks(TOGETHER).par_bridge().for_each(|together| {
            let mut open = OpenNodes::default();
            for key in together {
                self.fill(pages, &PatchId::of_key(*key), &mut open);
            }
        });
    }

    #[inline]
    fn extent(&self, triangle: u32) -> PatchExtent {
        match self.extents.get(triangle as usize) {
            Some(extent) => *extent,
            None => extent(self.geometry, self.area_per_surfel, triangle),
        }
    }

    /// Returns the patch that was met, unless it is black.
    #[inline]
    fn patch_of(&self, hit: &Hit, request: PatchRequest) -> Option<PatchId> {
        let extent = self.extent(hit.triangle);
        if extent.least == PatchExtent::BLACK {
            return None;
        }
        let PatchExtent { edge2, least } = extent.of_surfels(self.surfels_per_patch);
        let bright = self.bright.as_ref();
        let size = if bright.is_some() {
            Self::FINE_PATCH_TO_CUT
        } else {
            Self::PATCH_TO_CUT
        };
        let size = size * request.max_solid_angle * hit.t * hit.t;
        let id = PatchId::new(hit, edge2, size.max(least));
        match bright.and_then(|b| b.at(hit, extent)) {
            Some((_, true)) if request.leave_out_bright => None,
            // One that is not bright holds none that is.
            Some((around, _)) => Some(id.smaller(around)),
            None => Some(id),
        }
    }

    /// Key of a patch in the cache. Patches have other radiance where near ones are large, and the
    /// cache outlives that.
    #[inline]
    fn key(&self, id: &PatchId) -> u64 {
        id.key() | u64::from(self.surfels_per_patch > 1.0) << 63
    }

    /// Evaluates a patch and fills the cache with its radiance.
    #[cold]
    fn fill(&self, pages: &SurfelStore, id: &PatchId, open: &mut OpenNodes<()>) -> Rgb {
        let radiance = self.evaluate(pages, id, open);
        self.cache.insert(self.key(id), radiance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gather::patch::tests::Wall;

    #[test]
    fn patches_are_half_as_large_where_there_are_bright_ones() {
        // One triangle, whose longest edge is the root of two.
        let mut outgoing = PatchRadiance::new(&Wall(1.0), 1e-6, 1).unwrap();
        let request = PatchRequest {
            max_solid_angle: 0.02,
            leave_out_bright: true,
        };
        let level = |outgoing: &PatchRadiance, t: f32| {
            let hit = Hit {
                t,
                triangle: 0,
                uv: [0.3, 0.2],
                is_back: false,
            };
            outgoing.patch_of(&hit, request).unwrap().level()
        };
        // Edges of two by two, one, a half and so on, squared, and squares of a little more than
        // those.
        let squares = [0.51, 0.13, 0.033];
        let distances = squares.map(|s: f32| (s / (PatchRadiance::PATCH_TO_CUT * 0.02)).sqrt());
        assert_eq!(distances.map(|t| level(&outgoing, t)), [1, 2, 3]);
        outgoing.bright = Some(BrightPatchIndex::new(1));
        assert_eq!(distances.map(|t| level(&outgoing, t)), [2, 3, 4]);
        let farther = distances.map(|t| t * 2.0_f32.sqrt());
        assert_eq!(farther.map(|t| level(&outgoing, t)), [1, 2, 3]);
    }
}
