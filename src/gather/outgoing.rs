//! The radiance that surfaces send, by patches of the scene's triangles: for rays that end at the geometry itself.
//!
//! Rays tell exactly what a receiver sees, and no disk reaches over an edge. What is seen is asked of the tree once for each
//! patch, whose size goes by the solid angle that a node may have to be taken whole, and remembered.

use super::cone::OVERHANG;
use super::page::{ChildKind, DiskBlock, PageLeaves, WIDTH, WideNode};
use super::store::Page;
use super::{Crossing, Pages};
use crate::math::{Hit, Rgb};
use glam::Vec3;
use std::sync::atomic::{AtomicU64, Ordering};
use wide::f32x8;

/// The triangles of a scene, which the gather does not know itself: it works where only a tree is at hand, too.
pub trait Geometry: std::fmt::Debug + Sync {
    /// The nearest triangle before `t_max` along a ray of unit direction.
    fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit>;

    /// The corners of a triangle.
    fn corners(&self, triangle: u32) -> [Vec3; 3];

    /// Its unit normal, on the side its corners wind counter-clockwise.
    fn normal(&self, triangle: u32) -> Vec3;

    /// Area that a surfel on it stands for, over the mean of all surfels; `None` if it reflects nothing, so that a tree need
    /// not be asked.
    fn surfel_area_over_mean(&self, triangle: u32) -> Option<f32>;
}

/// How often a tree was asked what a patch sends. Threads that ask for one patch at the same time are counted each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Asked {
    /// Patches.
    pub patches: u64,
    /// Those where it knows no surface: they are black.
    pub unknown: u64,
}

/// What the surfaces of a scene send, as a tree has it.
///
/// Patches are remembered in a table of fixed size, in which later ones take the place of earlier ones. A patch sends what
/// it sends whoever asks, so that neither threads nor memory change a bit of the result.
#[derive(Debug)]
pub struct Outgoing<'a> {
    geometry: &'a dyn Geometry,
    /// Square of the edge below which patches are not divided, where surfels stand for their mean area.
    least: f32,
    /// Whether surfels of one piece of the scene have one size.
    is_even: bool,
    slots: Box<[Slot]>,
    patches: AtomicU64,
    unknown: AtomicU64,
}

impl<'a> Outgoing<'a> {
    /// Solid angle of a square over a patch's longest edge, over that under which a node is taken whole. Patches are
    /// triangles, and divided by four: on average they have an eighth of that square.
    const SIZE: f32 = 4.0;
    /// Divisions of a triangle's edges by two, at most.
    const MOST_LEVELS: u32 = 14;
    /// Binary logarithm of the slots: 4 MiB in all.
    const SLOTS: u32 = 18;

    /// Nothing is known yet. `area_per_surfel` is that of the tree: patches need not be smaller than surfels tell apart.
    #[must_use]
    pub fn new(geometry: &'a dyn Geometry, area_per_surfel: f32) -> Self {
        Self {
            geometry,
            least: area_per_surfel,
            is_even: true,
            slots: (0..1 << Self::SLOTS).map(|_| Slot::default()).collect(),
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

    /// How often the tree was asked so far.
    #[must_use]
    pub fn asked(&self) -> Asked {
        Asked {
            patches: self.patches.load(Ordering::Relaxed),
            unknown: self.unknown.load(Ordering::Relaxed),
        }
    }

    /// What a patch sends, as the tree has it; black where it knows no surface.
    fn ask<P: Pages>(&self, pages: &P, patch: &Patch, stack: &mut Vec<(f32, u32, u32)>) -> Rgb {
        let normal = self.geometry.normal(patch.triangle);
        let normal = if patch.is_back { -normal } else { normal };
        let found = patch.radiance(normal, pages, stack);
        self.patches.fetch_add(1, Ordering::Relaxed);
        if found.is_none() {
            self.unknown.fetch_add(1, Ordering::Relaxed);
        }
        found.unwrap_or(Rgb::BLACK)
    }

    /// The surface that ends a ray of unit direction before `t_max`, if one does, and what it sends towards its origin.
    #[must_use]
    // Else it is not where it serves several kinds of media.
    #[inline(always)]
    pub fn cast<P: Pages>(
        &self,
        pages: &P,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        max_solid_angle: f32,
        stack: &mut Vec<(f32, u32, u32)>,
    ) -> Option<Crossing> {
        let hit = self.geometry.closest(origin, direction, t_max)?;
        let Some(area_over_mean) = self.geometry.surfel_area_over_mean(hit.triangle) else {
            return Some(Crossing {
                t: hit.t,
                opacity: 1.0,
                radiance: Rgb::BLACK,
            });
        };
        let size = Self::SIZE * max_solid_angle * hit.t * hit.t;
        let patch = self.patch(&hit, direction, size, self.least * area_over_mean);
        let hash = patch.key.wrapping_mul(SCATTER) >> (64 - Self::SLOTS);
        let slot = &self.slots[hash as usize];
        let radiance = slot.get(patch.key).unwrap_or_else(|| {
            let packed = pack(self.ask(pages, &patch, stack));
            slot.set(patch.key, packed);
            packed
        });
        Some(Crossing {
            t: hit.t,
            opacity: 1.0,
            radiance: unpack(radiance),
        })
    }

    /// The part of the triangle that was met: its edges are divided by two until the longest is at most the root of
    /// `size` long, or of `least`, about as long as surfels stand apart.
    fn patch(&self, hit: &Hit, direction: Vec3, size: f32, least: f32) -> Patch {
        let size = size.max(least);
        let [a, b, c] = self.geometry.corners(hit.triangle);
        let (e, f) = (b - a, c - a);
        let mut area = e
            .length_squared()
            .max(f.length_squared())
            .max((f - e).length_squared());
        let mut level = 0;
        while area > size && level < Self::MOST_LEVELS {
            area *= 0.25;
            level += 1;
        }
        let parts = (1 << level) as f32;
        let [u, v] = hit.uv.map(|w| w.clamp(0.0, 1.0) * parts);
        // Rounding may put a hit beyond the edge across from the first corner.
        let i = u.floor().min(parts - 1.0);
        let j = v.floor().min(parts - 1.0 - i);
        let is_upper = i + j + 1.0 < parts && (u - i) + (v - j) > 1.0;
        let third = if is_upper { 2.0 / 3.0 } else { 1.0 / 3.0 };
        let middle = a + e * ((i + third) / parts) + f * ((j + third) / parts);
        let is_back = e.cross(f).dot(direction) > 0.0;
        // The leading bit of the column tells the level.
        let column = i as u64 | 1 << level;
        Patch {
            key: u64::from(hit.triangle) << 32
                | u64::from(is_back) << 31
                | u64::from(is_upper) << 30
                | column << 15
                | j as u64,
            middle,
            triangle: hit.triangle,
            is_back,
            area: area.max(least),
            own2: if self.is_even && least > 0.0 {
                2.0 * least
            } else {
                f32::INFINITY
            },
        }
    }
}

/// 2^64 over the golden ratio: the upper bits of a product depend on all bits of the other factor (Fibonacci hashing).
const SCATTER: u64 = 0x9E37_79B9_7F4A_7C15;

/// A key and what belongs to it: the key mixed with the value, then the value, so that halves of two entries written at the
/// same time do not fit each other (Hyatt & Mann 2002).
#[derive(Debug, Default)]
struct Slot([AtomicU64; 2]);

impl Slot {
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

/// A part of one side of a triangle.
#[derive(Debug)]
struct Patch {
    key: u64,
    /// Where the tree is asked.
    middle: Vec3,
    triangle: u32,
    /// Whether it is the side from which the corners wind clockwise.
    is_back: bool,
    /// Square of its longest edge, and at least that of a disk.
    area: f32,
    /// Square of a radius that the disks of its own surface are below. Larger ones are of something else near by, which must
    /// not drown them.
    own2: f32,
}

impl Patch {
    /// Nodes up to this many times the area of a patch are taken whole.
    const WHOLE: f32 = 4.0;

    /// What it sends on the side of its unit `normal`: a mean over the disks and small nodes that hold its middle. `None` where
    /// the tree knows no surface.
    fn radiance<P: Pages>(
        &self,
        normal: Vec3,
        pages: &P,
        stack: &mut Vec<(f32, u32, u32)>,
    ) -> Option<Rgb> {
        let root = pages.root()?;
        let mut mean = Mean::default();
        stack.clear();
        stack.push((0.0, root, 0));
        let mut page_id = root;
        let mut page = pages.page(root);
        while let Some((_, id, node)) = stack.pop() {
            if id != page_id {
                page = pages.page(id);
                page_id = id;
            }
            let nodes = page.nodes();
            let Some(node) = nodes.nodes.get(node as usize) else {
                continue;
            };
            let mut holding = self.within(node);
            while holding != 0 {
                let k = holding.trailing_zeros() as usize;
                holding &= holding - 1;
                if node.cross_section[k] < Self::WHOLE * self.area {
                    let proxy = &nodes.proxies[node.first_proxy as usize + k];
                    mean.add(proxy.facing(normal.to_array()));
                    continue;
                }
                match node.kind[k] {
                    ChildKind::Leaf => {
                        let leaves = page.leaves();
                        if let Some(block) = leaves.blocks.get(node.child[k] as usize) {
                            mean.add_disks(leaves, block, self, normal);
                        }
                    }
                    ChildKind::Inner => stack.push((0.0, id, node.child[k])),
                    ChildKind::Page => stack.push((0.0, node.child[k], 0)),
                    ChildKind::None => {}
                }
            }
        }
        mean.radiance()
    }

    /// A bit for each child whose box holds the middle.
    #[inline]
    fn within(&self, node: &WideNode) -> u32 {
        /// Distance from a box within which a point is taken to be in it, over the size of the box: rounding, and surfels
        /// that stand a little inside of curved surfaces.
        const MARGIN: f32 = 0.02;
        let mut outside2 = f32x8::ZERO;
        for (a, p) in self.middle.to_array().into_iter().enumerate() {
            let (min, max, p) = (
                f32x8::from(node.min[a]),
                f32x8::from(node.max[a]),
                f32x8::splat(p),
            );
            let outside = (min - p).fast_max(p - max).fast_max(f32x8::ZERO);
            outside2 += outside * outside;
        }
        let margin2 = f32x8::from(node.cross_section) * f32x8::splat(MARGIN * MARGIN);
        outside2.simd_le(margin2).to_bitmask() & node.used
    }
}

/// A mean of what surfaces send, weighted by area: a running one, since areas times radiance leave the range of f32.
#[derive(Debug)]
struct Mean {
    sent: [f32; 3],
    area: f32,
    /// The disk that comes nearest to holding the point: how far it is from that, and what it sends.
    nearest: (f32, [f32; 3]),
}

impl Default for Mean {
    fn default() -> Self {
        Self {
            sent: [0.0; 3],
            area: 0.0,
            nearest: (Self::FARTHEST, [0.0; 3]),
        }
    }
}

impl Mean {
    /// Cosine between the normals of a disk and of a patch from which on both are one surface.
    const ALIKE: f32 = 0.7;
    /// A disk further away than this says nothing: five radii along its plane, half a radius off it.
    const FARTHEST: f32 = 25.0;

    #[inline]
    fn add(&mut self, (sent, area): ([f32; 3], f32)) {
        if area > 0.0 {
            self.area += area;
            let share = area / self.area;
            for (s, v) in self.sent.iter_mut().zip(sent) {
                *s += (v - *s) * share;
            }
        }
    }

    /// Disks that hold the middle of the patch, the more the nearer theirs is.
    fn add_disks(&mut self, leaves: &PageLeaves, block: &DiskBlock, patch: &Patch, normal: Vec3) {
        let (p, n) = (patch.middle.to_array(), normal.to_array());
        let mut reach = [0.0_f32; WIDTH];
        let mut cos = [0.0_f32; WIDTH];
        for k in 0..WIDTH {
            let [x, y, z] = [0, 1, 2].map(|a| p[a] - block.centre[a][k]);
            let normal = [0, 1, 2].map(|a| block.normal[a][k]);
            let height = x * normal[0] + y * normal[1] + z * normal[2];
            // What is off the plane by more than disks of one surface stand out over each other is of another one.
            let off = height * height / (OVERHANG * OVERHANG);
            let larger = (block.radius2[k] / patch.own2).max(1.0);
            reach[k] = (x * x + y * y + z * z + off * larger) / block.radius2[k];
            cos[k] = n[0] * normal[0] + n[1] * normal[1] + n[2] * normal[2];
        }
        for k in 0..block.count as usize {
            if cos[k].abs() < Self::ALIKE || reach[k] >= self.nearest.0.max(1.0) {
                continue;
            }
            let light = &leaves.lights[block.first_light as usize + k];
            let sent = if cos[k] > 0.0 {
                light.front
            } else {
                light.back
            };
            if reach[k] < self.nearest.0 {
                self.nearest = (reach[k], sent);
            }
            let offset = std::array::from_fn(|a| p[a] - block.centre[a][k]);
            if reach[k] < 1.0 && !leaves.is_clipped(light, offset) {
                self.add((sent, block.radius2[k].min(patch.own2) * (1.0 - reach[k])));
            }
        }
    }

    /// `None` where there was no surface.
    fn radiance(&self) -> Option<Rgb> {
        if self.area > 0.0 {
            Some(Rgb(self.sent))
        } else {
            (self.nearest.0 < Self::FARTHEST).then_some(Rgb(self.nearest.1))
        }
    }
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

    /// One triangle in the plane z = 0, seen from above.
    #[derive(Debug)]
    struct Alone;

    impl Geometry for Alone {
        fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
            let t = -origin.z / direction.z;
            let p = origin + direction * t;
            let hit = p.x >= 0.0 && p.y >= 0.0 && p.x + p.y <= 1.0 && t > 0.0 && t < t_max;
            hit.then_some(Hit {
                t,
                triangle: 0,
                uv: [p.x, p.y],
            })
        }

        fn corners(&self, _: u32) -> [Vec3; 3] {
            [Vec3::ZERO, Vec3::X, Vec3::Y]
        }

        fn normal(&self, _: u32) -> Vec3 {
            Vec3::Z
        }

        fn surfel_area_over_mean(&self, _: u32) -> Option<f32> {
            Some(1.0)
        }
    }

    #[test]
    fn patches_hold_their_hits_and_are_as_small_as_asked() {
        let outgoing = Outgoing::new(&Alone, 0.0);
        let mut keys = std::collections::BTreeMap::new();
        for i in 0..2000 {
            let [a, b] = crate::math::sampling::r2(i, [0.5; 2]);
            // Some on the edges, some on corners of patches.
            let uv = match i % 4 {
                0 => [0.25 * (4.0 * a).floor(), 0.25 * (4.0 * b).floor()],
                1 => [a, 1.0 - a],
                _ => [a, b],
            };
            if uv[0] + uv[1] > 1.0 + 1e-6 {
                continue;
            }
            let hit = Hit {
                t: 1.0,
                triangle: 0,
                uv,
            };
            let patch = outgoing.patch(&hit, -Vec3::Z, 0.13, 0.0);
            assert!(patch.area <= 0.13 && patch.area > 0.13 / 4.0);
            let m = patch.middle;
            assert!(m.x > 0.0 && m.y > 0.0 && m.x + m.y < 1.0, "{uv:?}: {m}");
            let off = Vec3::new(uv[0], uv[1], 0.0) - m;
            assert!(off.length() < 0.13_f32.sqrt(), "{uv:?}: {m}");
            let middle = *keys.entry(patch.key).or_insert(m);
            assert_eq!(middle, m);
        }
        // Three halvings of the longest edge, the root of two.
        assert_eq!(keys.len(), 16);
        let below = outgoing.patch(
            &Hit {
                t: 1.0,
                triangle: 0,
                uv: [0.1, 0.1],
            },
            Vec3::Z,
            0.13,
            0.0,
        );
        assert!(!keys.contains_key(&below.key) && below.is_back);
    }
}
