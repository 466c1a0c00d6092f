//! The radiance that surfaces send, by patches of the scene's triangles: for rays that end at the geometry itself.
//!
//! Rays tell exactly what a receiver sees, and no disk reaches over an edge. What is seen is asked of the tree once for each
//! patch, whose size goes by the solid angle that a node may have to be taken whole, and remembered.

use super::bright::{BrightPatch, BrightPlaces, Disk, Search, Seed};
use super::geometry::Geometry;
use super::patch::Side;
use super::place::{Extent, Place};
use super::{Crossing, Pages};
use crate::math::{Hit, Rgb};
use glam::Vec3;
use std::sync::atomic::{AtomicU64, Ordering};

/// How often a tree was asked what a patch sends. Threads that ask for one patch at the same time are counted each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Asked {
    /// Patches that it was asked for, each time anew.
    pub patches: u64,
    /// Those where it knows no surface: they are black.
    pub unknown: u64,
    /// Those that are bright.
    pub bright: u64,
}

/// What is asked of the surface that ends a ray.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// A node seen under less than this may stand for all below it, steradians.
    pub max_solid_angle: f32,
    /// Whether bright patches are to be black.
    pub leave_out_bright: bool,
}

/// What the surfaces of a scene send, as a tree has it.
///
/// Patches are remembered in a table of fixed size, in which later ones take the place of earlier ones. A patch sends what
/// it sends whoever asks, so that neither threads nor memory change a bit of the result.
#[derive(Debug)]
pub struct Outgoing<'a> {
    geometry: &'a dyn Geometry,
    /// By triangle: rays wait for memory, and find all that most of them need in one place.
    extents: Box<[Extent]>,
    /// Whether surfels of one piece of the scene have one size.
    is_even: bool,
    /// The square over the longest edge of a patch need not be smaller than the area of so many of them.
    surfels_per_patch: f32,
    slots: Box<[Slot]>,
    /// What rays may leave out, if anything.
    bright: Option<BrightPlaces>,
    patches: AtomicU64,
    unknown: AtomicU64,
}

impl<'a> Outgoing<'a> {
    /// Solid angle of a square over a patch's longest edge, over that under which a node is taken whole. Patches are
    /// triangles, and divided by four: on average they have an eighth of that square.
    const SIZE: f32 = 4.0;
    /// Binary logarithm of the slots: 4 MiB in all.
    const SLOTS: u32 = 18;

    /// Nothing is known yet. `area_per_surfel` is that of the tree: patches need not be smaller than surfels tell apart.
    #[must_use]
    pub fn new(geometry: &'a dyn Geometry, area_per_surfel: f32) -> Self {
        let extent = |t| {
            let over_mean = geometry.surfel_area_over_mean(t);
            Extent::new(geometry.corners(t), over_mean.map(|a| a * area_per_surfel))
        };
        Self {
            geometry,
            extents: (0..geometry.triangles()).map(extent).collect(),
            is_even: true,
            surfels_per_patch: 1.0,
            slots: (0..1 << Self::SLOTS).map(|_| Slot::default()).collect(),
            bright: None,
            patches: AtomicU64::new(0),
            unknown: AtomicU64::new(0),
        }
    }

    /// For a tree whose surfels are of any size, as those that a camera saw are.
    #[must_use]
    pub fn of_uneven_surfels(mut self) -> Self {
        self.is_even = false;
        self
    }

    /// Divides triangles no further once the square over a patch's longest edge has the area of so many surfels, not of one. What is nearer
    /// than such a patch is large is blurred; patches larger than the boxes of leaves need none of those.
    #[must_use]
    pub fn in_patches_of(mut self, surfels: f32) -> Self {
        self.surfels_per_patch = surfels.max(1.0);
        self
    }

    /// How often the tree was asked so far.
    #[must_use]
    pub fn asked(&self) -> Asked {
        Asked {
            patches: self.patches.load(Ordering::Relaxed),
            unknown: self.unknown.load(Ordering::Relaxed),
            bright: self.bright.as_ref().map_or(0, |b| b.len() as u64),
        }
    }

    /// Most bright patches of a frame: more, as of a finely divided mesh in the sun, cost more than they bring.
    const MOST_BRIGHT: usize = 1 << 14;

    /// Finds the patches that send more than `least`, by the mean channel, where at least `support` seeds speak for them. From then on
    /// rays that are to leave them out meet black there, and patches may be as small as surfels: large ones would blur the borders of
    /// bright places. None where there are too many.
    pub fn find_bright<P: Pages>(
        &mut self,
        pages: &P,
        seeds: &[Seed],
        support: usize,
        least: f32,
    ) -> Vec<BrightPatch> {
        let surfels_per_patch = std::mem::replace(&mut self.surfels_per_patch, 1.0);
        let mut places = BrightPlaces::new(self.extents.len());
        let mut patches = Vec::new();
        let mut stack = Vec::new();
        let search = Search {
            pages,
            seeds,
            support,
            least,
        };
        let is_few = search.for_each(|disk| {
            if let Some((hit, extent)) = self.below(disk)
                && let Some(place) = places.add(&hit, extent)
            {
                let normal = self.geometry.normal(hit.triangle);
                patches.push(BrightPatch {
                    corners: place.corners(self.geometry.corners(hit.triangle)),
                    normal: if hit.is_back { -normal } else { normal },
                    radiance: self.ask(pages, &place, &mut stack),
                });
            }
            patches.len() <= Self::MOST_BRIGHT
        });
        if !is_few || patches.is_empty() {
            self.surfels_per_patch = surfels_per_patch;
            return Vec::new();
        }
        self.bright = Some(places);
        patches
    }

    /// The triangle that a disk stands on, if that reflects anything.
    fn below(&self, disk: &Disk) -> Option<(Hit, Extent)> {
        let height = 0.5 * disk.radius;
        let above = disk.centre + disk.normal * height;
        let hit = (self.geometry).closest(above, -disk.normal, 2.0 * height)?;
        let extent = self.extents[hit.triangle as usize];
        (extent.least != Extent::BLACK).then_some((hit, extent))
    }

    /// What a patch sends, as the tree has it; black where it knows no surface.
    // Few rays ask, and the others need not hold what asking takes.
    #[cold]
    fn ask<P: Pages>(&self, pages: &P, place: &Place, stack: &mut Vec<(f32, u32, u32)>) -> Rgb {
        let triangle = place.triangle;
        let normal = self.geometry.normal(triangle);
        let side = Side {
            corners: self.geometry.corners(triangle),
            normal: if place.is_back { -normal } else { normal },
            is_back: place.is_back,
            extent: self.extents[triangle as usize].of_surfels(self.surfels_per_patch),
            is_even: self.is_even,
            geometry: self.geometry,
        };
        let found = side.radiance(place, pages, stack);
        self.patches.fetch_add(1, Ordering::Relaxed);
        if found.is_none() {
            self.unknown.fetch_add(1, Ordering::Relaxed);
        }
        found.unwrap_or(Rgb::BLACK)
    }

    /// The surface that ends a ray of unit direction before `t_max`, if one does, and what it sends towards its origin: nothing where
    /// it is a bright patch and those are left out.
    #[must_use]
    // Not inlined by itself once it is compiled for more than one kind of medium.
    #[inline(always)]
    pub fn cast<P: Pages>(
        &self,
        pages: &P,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        wanted: Wanted,
        stack: &mut Vec<(f32, u32, u32)>,
    ) -> Option<Crossing> {
        let hit = self.geometry.closest(origin, direction, t_max)?;
        let crossing = |radiance| {
            Some(Crossing {
                t: hit.t,
                opacity: 1.0,
                radiance,
            })
        };
        let extent = self.extents[hit.triangle as usize];
        if extent.least == Extent::BLACK {
            return crossing(Rgb::BLACK);
        }
        let Extent { edge2, least } = extent.of_surfels(self.surfels_per_patch);
        let size = Self::SIZE * wanted.max_solid_angle * hit.t * hit.t;
        let mut place = Place::new(&hit, edge2, size.max(least));
        let bright = self.bright.as_ref();
        if let Some((around, is_bright)) = bright.and_then(|b| b.at(&hit, extent)) {
            if is_bright && wanted.leave_out_bright {
                return crossing(Rgb::BLACK);
            }
            // One that is not bright holds none that is.
            place = place.smaller(around);
        }
        // Places answer otherwise where near patches are large, and the table outlives that.
        let key = place.key() | u64::from(self.surfels_per_patch > 1.0) << 63;
        let hash = key.wrapping_mul(SCATTER) >> (64 - Self::SLOTS);
        let slot = &self.slots[hash as usize];
        let radiance = slot.get(key).unwrap_or_else(|| {
            let packed = pack(self.ask(pages, &place, stack));
            slot.set(key, packed);
            packed
        });
        crossing(unpack(radiance))
    }
}

/// 2^64 over the golden ratio: the upper bits of a product depend on all bits of the other factor (Fibonacci hashing).
const SCATTER: u64 = 0x9E37_79B9_7F4A_7C15;

/// A key and what belongs to it: the key mixed with the value, then the value, so that halves of two entries written at the
/// same time do not fit each other (Hyatt & Mann 2002).
#[derive(Debug)]
struct Slot([AtomicU64; 2]);

impl Default for Slot {
    /// Answers for no key. Not of zeros, though it might be: pages of memory that are read before they are written to are
    /// mapped twice, the second time in all threads.
    fn default() -> Self {
        Self([Self::NO_KEY.into(), 0.into()])
    }
}

impl Slot {
    /// No place's: those have a leading bit.
    const NO_KEY: u64 = 1;

    #[inline]
    fn get(&self, key: u64) -> Option<u64> {
        let [mixed, value] = self.0.each_ref().map(|v| v.load(Ordering::Relaxed));
        (mixed ^ Self::spread(value) == key).then_some(value)
    }

    #[inline]
    fn set(&self, key: u64, value: u64) {
        self.0[0].store(key ^ Self::spread(value), Ordering::Relaxed);
        self.0[1].store(value, Ordering::Relaxed);
    }

    /// Keys and values have a structure, by which one could be taken for another. A product alone spreads bits upwards only:
    /// light of one channel would leave the lower bits of keys as they are, and halves of two entries could make a
    /// third key.
    #[inline]
    fn spread(value: u64) -> u64 {
        let upwards = value.wrapping_mul(SCATTER);
        (upwards ^ upwards >> 32).wrapping_mul(SCATTER)
    }
}

/// Three radiances of at least 0 in 21 bits each: an f32 without its sign and its last ten digits, 6e-5 of its value.
#[inline]
fn pack(c: Rgb) -> u64 {
    // Adding 0 turns -0 into 0.
    let [r, g, b] =
        c.0.map(|v| u64::from(((v + 0.0).to_bits() + (1 << 9)) >> 10));
    r << 42 | g << 21 | b
}

#[inline]
fn unpack(v: u64) -> Rgb {
    Rgb([v >> 42, v >> 21, v].map(|v| f32::from_bits((v as u32 & 0x1f_ffff) << 10)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn radiance_survives_packing() {
        for v in [0.0, -0.0, 1e-36, 1e-30, 0.3, 1.0, 7e4, 1e30] {
            let Rgb(got) = unpack(pack(Rgb([v, 2.0 * v, 0.5 * v])));
            for (got, v) in got.into_iter().zip([v, 2.0 * v, 0.5 * v]) {
                assert!((got - v).abs() <= 6.2e-5 * v, "{got} {v}");
            }
        }
    }

    #[test]
    fn a_slot_answers_for_its_key_alone() {
        let slot = Slot::default();
        assert_eq!(slot.get(5), None);
        slot.set(5, 77);
        assert_eq!((slot.get(5), slot.get(4)), (Some(77), None));
        // Half of another entry.
        slot.0[1].store(78, Ordering::Relaxed);
        assert_eq!(slot.get(5), None);
    }

    /// Of entries of two triangles whose light has one channel, no half of one with half of the other makes an entry of any
    /// triangle with the same patch: that is all that a key differs by from others of its table.
    #[test]
    fn halves_of_entries_of_light_of_one_channel_do_not_make_a_third() {
        let sides = [0, 1, 2].map(|c| {
            (1..200).map(move |i| {
                let mut light = [0.0; 3];
                light[c] = 0.37 + 0.01 * i as f32;
                pack(Rgb(light))
            })
        });
        let values: Vec<u64> = sides.into_iter().flatten().collect();
        let patch = 0x1234_5678_u64;
        for (i, &a) in values.iter().enumerate() {
            for &b in &values[..i] {
                let slot = Slot::default();
                slot.set(7 << 32 | patch, a);
                slot.0[1].store(b, Ordering::Relaxed);
                let mixed = slot.0[0].load(Ordering::Relaxed);
                let key = mixed ^ Slot::spread(b);
                assert_ne!(key & 0xffff_ffff, patch, "{a:x} {b:x}");
            }
        }
    }
}
