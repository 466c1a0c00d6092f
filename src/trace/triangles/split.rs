//! Where triangles part: binned surface area heuristic (Wald 2007), in the cost of blocks.

use crate::scene::Mesh;
use crate::trace::watertight::LANES;
use glam::{Vec3A, Vec4};
use rayon::prelude::*;

/// Bins along each axis.
const BINS: usize = 16;
/// Triangles that are counted into bins by one thread. More are counted in parallel.
const CHUNK: usize = 1 << 14;

/// A box along the axes, in the scale of the hierarchy.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub min: Vec3A,
    pub max: Vec3A,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self {
        min: Vec3A::INFINITY,
        max: Vec3A::NEG_INFINITY,
    };

    #[inline(always)]
    pub(super) fn with(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    #[inline(always)]
    fn at(point: Vec3A) -> Self {
        Self {
            min: point,
            max: point,
        }
    }

    /// Half of the surface; 0 of an empty box.
    #[inline(always)]
    pub(super) fn half_area(self) -> f32 {
        let d = (self.max - self.min).max(Vec3A::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// A triangle that is to find its place: its box, and its index in the lanes that are left.
#[derive(Clone, Copy, Debug)]
pub(super) struct Item {
    min: Vec4,
    max: Vec4,
}

impl Item {
    /// Bits that make a number of an index that is not too small to be added fast.
    const NORMAL: u32 = 1 << 30;

    /// A triangle of a mesh, `scale` times larger.
    pub(super) fn new(mesh: &Mesh, triangle: u32, scale: f32) -> Self {
        let [a, b, c] = mesh.own_corners(triangle as usize).map(|p| p * scale);
        // The least of numbers would pass over what is none.
        let finite = if (a + b + c).is_finite() {
            0.0
        } else {
            f32::NAN
        };
        Self {
            min: (a.min(b).min(c) + finite).extend(f32::from_bits(triangle | Self::NORMAL)),
            max: a.max(b).max(c).extend(0.0),
        }
    }

    #[inline(always)]
    pub(super) fn triangle(&self) -> u32 {
        const { assert!(Mesh::MAX_TRIANGLES < Self::NORMAL as usize) };
        self.min.w.to_bits() & !Self::NORMAL
    }

    /// Whether all corners are numbers.
    pub(super) fn is_finite(&self) -> bool {
        let Bounds { min, max } = self.bounds();
        (max - min).is_finite()
    }

    #[inline(always)]
    fn bounds(&self) -> Bounds {
        Bounds {
            min: Vec3A::from_vec4(self.min),
            max: Vec3A::from_vec4(self.max),
        }
    }

    /// Twice the middle of the box.
    #[inline(always)]
    fn middle(&self) -> Vec3A {
        Vec3A::from_vec4(self.min + self.max)
    }
}

/// Triangles that follow each other.
#[derive(Clone, Copy, Debug)]
pub(super) struct Group {
    pub first: usize,
    pub end: usize,
    pub bounds: Bounds,
    /// Of the middles of their boxes, doubled.
    middles: Bounds,
    /// No two of the triangles are equal, as far as it matters.
    distinct: bool,
}

impl Group {
    /// The group of some triangles, of which the first has the index `first`.
    pub(super) fn new(items: &[Item], first: usize) -> Self {
        let both = |items: &[Item]| {
            let empty = [Bounds::EMPTY; 2];
            items.iter().fold(empty, |[bounds, middles], item| {
                [
                    bounds.with(item.bounds()),
                    middles.with(Bounds::at(item.middle())),
                ]
            })
        };
        let merged = |a: [Bounds; 2], b: [Bounds; 2]| [a[0].with(b[0]), a[1].with(b[1])];
        let [bounds, middles] = if items.len() > CHUNK {
            let chunks = items.par_chunks(CHUNK).map(both);
            chunks.reduce(|| [Bounds::EMPTY; 2], merged)
        } else {
            both(items)
        };
        Self {
            first,
            end: first + items.len(),
            bounds,
            middles,
            distinct: false,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.end - self.first
    }

    /// Whether what [`Self::drop_equals`] leaves out is left out.
    pub(super) fn is_distinct(&self) -> bool {
        self.distinct
    }

    /// Half of the surface of the box.
    pub(super) fn half_area(&self) -> f32 {
        self.bounds.half_area()
    }

    /// The plane that parts the group so that rays pay the least, if one parts it.
    pub(super) fn plane(&self, items: &[Item]) -> Option<Plane> {
        let bins = Bins::of(items, self.middles)?;
        bins.best()
    }

    /// Parts the group, whose items these are, at a plane.
    pub(super) fn part(&self, items: &mut [Item], plane: Plane) -> [Self; 2] {
        let is_below = |item: &Item| plane.scale.at(item.middle())[plane.axis] < plane.end;
        let (mut left, mut right) = (0, items.len());
        loop {
            while left < right && is_below(&items[left]) {
                left += 1;
            }
            while left < right && !is_below(&items[right - 1]) {
                right -= 1;
            }
            if left == right {
                break;
            }
            right -= 1;
            items.swap(left, right);
            left += 1;
        }
        let (lower, upper) = items.split_at(left);
        let middles = [lower, upper].map(|items| {
            let middles = items.iter().map(|item| Bounds::at(item.middle()));
            middles.fold(Bounds::EMPTY, Bounds::with)
        });
        let at = self.first + left;
        let ranges = [(self.first, at), (at, self.end)];
        std::array::from_fn(|side| Self {
            first: ranges[side].0,
            end: ranges[side].1,
            bounds: plane.bounds[side],
            middles: middles[side],
            distinct: false,
        })
    }

    /// Parts the group in the middle of its order.
    pub(super) fn halve(&self, items: &[Item]) -> [Self; 2] {
        let (left, right) = items.split_at(items.len() / 2);
        let at = self.first + left.len();
        [(left, self.first), (right, at)].map(|(items, first)| Self {
            distinct: self.distinct,
            ..Self::new(items, first)
        })
    }

    /// Leaves out all but the first of triangles whose corners are the same, in the same order: it
    /// is the one that rays find. Once for a group and its parts.
    pub(super) fn drop_equals(&mut self, mesh: &Mesh, items: &mut [Item]) {
        let corners = |item: &Item| {
            let corners = mesh.own_corners(item.triangle() as usize);
            corners.map(|p| p.to_array().map(f32::to_bits))
        };
        items.par_sort_unstable_by_key(|item| (corners(item), item.triangle()));
        let mut kept = 1;
        for i in 1..items.len() {
            if corners(&items[i]) != corners(&items[kept - 1]) {
                items[kept] = items[i];
                kept += 1;
            }
        }
        self.end = self.first + kept;
        self.distinct = true;
    }
}

/// Blocks that triangles fill.
fn blocks(triangles: usize) -> usize {
    triangles.div_ceil(LANES)
}

/// Where the middles of boxes are among the bins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scale {
    min: Vec3A,
    bins_per_unit: Vec3A,
}

impl Scale {
    /// In bins.
    #[inline(always)]
    fn at(&self, middle: Vec3A) -> Vec3A {
        (middle - self.min) * self.bins_per_unit
    }

    #[inline(always)]
    fn bin(&self, middle: Vec3A) -> [usize; 3] {
        let at = self.at(middle).to_array();
        at.map(|v| (v as i32 as usize).min(BINS - 1))
    }
}

/// A plane between two bins, and what is on its sides.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    scale: Scale,
    axis: usize,
    /// Where the lower side ends, in bins.
    end: f32,
    bounds: [Bounds; 2],
    /// What a ray pays on both sides, in tests of blocks times half an area.
    pub cost: f32,
}

/// Triangles by the bins that the middles of their boxes are in, along each axis.
struct Bins {
    scale: Scale,
    bounds: [[Bounds; BINS]; 3],
    counts: [[u32; BINS]; 3],
}

impl Bins {
    /// `None` if all are in one place.
    fn of(items: &[Item], middles: Bounds) -> Option<Self> {
        // An axis along which there is no way to tell them apart has one bin.
        let bins_per_unit = (middles.max - middles.min).to_array().map(|extent| {
            let bins = BINS as f32 / extent;
            if bins.is_finite() { bins } else { 0.0 }
        });
        if bins_per_unit == [0.0; 3] {
            return None;
        }
        let scale = Scale {
            min: middles.min,
            bins_per_unit: bins_per_unit.into(),
        };
        let count = |items: &[Item]| {
            let mut bins = Self {
                scale,
                bounds: [[Bounds::EMPTY; BINS]; 3],
                counts: [[0; BINS]; 3],
            };
            for item in items {
                let bounds = item.bounds();
                for (a, k) in scale.bin(item.middle()).into_iter().enumerate() {
                    bins.bounds[a][k] = bins.bounds[a][k].with(bounds);
                    bins.counts[a][k] += 1;
                }
            }
            bins
        };
        if items.len() <= CHUNK {
            return Some(count(items));
        }
        items.par_chunks(CHUNK).map(count).reduce_with(|mut a, b| {
            for axis in 0..3 {
                for k in 0..BINS {
                    a.bounds[axis][k] = a.bounds[axis][k].with(b.bounds[axis][k]);
                    a.counts[axis][k] += b.counts[axis][k];
                }
            }
            a
        })
    }

    fn best(&self) -> Option<Plane> {
        let mut best: Option<(f32, u32, Plane)> = None;
        for axis in 0..3 {
            let (bounds, counts) = (&self.bounds[axis], &self.counts[axis]);
            // Of the bins from one on.
            let mut upper = [(Bounds::EMPTY, 0); BINS];
            let mut sum = (Bounds::EMPTY, 0);
            for k in (1..BINS).rev() {
                sum = (sum.0.with(bounds[k]), sum.1 + counts[k]);
                upper[k] = sum;
            }
            let mut lower = (Bounds::EMPTY, 0);
            for last in 0..BINS - 1 {
                lower = (lower.0.with(bounds[last]), lower.1 + counts[last]);
                let sides = [lower, upper[last + 1]];
                // The same as the plane before, or not between two.
                if counts[last] == 0 || sides[1].1 == 0 {
                    continue;
                }
                let cost = sides.map(|(b, count)| b.half_area() * blocks(count as usize) as f32);
                let cost = cost[0] + cost[1];
                // Where all cost the same, the parts that are most alike.
                let larger = sides[0].1.max(sides[1].1);
                let better = |&(c, l, _): &(f32, u32, _)| cost < c || (cost == c && larger < l);
                if best.as_ref().is_none_or(better) {
                    let plane = Plane {
                        scale: self.scale,
                        axis,
                        end: (last + 1) as f32,
                        bounds: sides.map(|(b, _)| b),
                        cost,
                    };
                    best = Some((cost, larger, plane));
                }
            }
        }
        best.map(|(_, _, plane)| plane)
    }
}
