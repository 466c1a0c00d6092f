//! How a group of emissive triangles falls into two.

use crate::math::Rgb;
use glam::Vec3;

/// One side of an emissive triangle.
#[derive(Clone, Copy)]
pub struct EmitterSide {
    pub corners: [Vec3; 3],
    pub normal: Vec3,
    pub middle: Vec3,
    pub area: f32,
    pub radiance: Rgb,
    /// Index of the emitter.
    pub emitter: u32,
    /// Whether the other side emits, too.
    pub is_pair: bool,
}

impl EmitterSide {
    /// Flux over pi, mean channel.
    pub fn power(&self) -> f32 {
        self.area * self.radiance.mean()
    }

    /// Coordinate that groups are split by: of three positions, then of three directions.
    fn coordinate(&self, axis: usize) -> f32 {
        if axis < 3 {
            self.middle[axis]
        } else {
            self.normal[axis - 3]
        }
    }
}

/// Orders a group of two or more so that it falls into two halves, and tells where: by the least
/// sum of power times squared diagonal times solid angle of what the halves light.
pub fn split(sides: &mut [EmitterSide], depth: u32) -> usize {
    /// Deeper than this, groups are halved by number.
    const MAX_DEPTH: u32 = 60;
    let half = sides.len() / 2;
    if depth >= MAX_DEPTH {
        return half;
    }
    let mut whole = SplitBin::default();
    sides.iter().for_each(|s| whole.add(s));
    let extent = whole.max - whole.min;
    let mut best: Option<Split> = None;
    for axis in (0..6).filter_map(|axis| SplitAxis::new(sides, axis)) {
        // Thin boxes are cut across.
        let thin = if axis.index < 3 && extent[axis.index] > 0.0 {
            extent.max_element() / extent[axis.index]
        } else {
            1.0
        };
        let (last_bin, cost) = match axis.cheapest(sides, thin) {
            Some(found) => found,
            None => continue,
        };
        if best.as_ref().is_none_or(|b| cost < b.cost) {
            best = Some(Split {
                axis,
                last_bin,
                cost,
            });
        }
    }
    let Some(Split { axis, last_bin, .. }) = best else {
        return half;
    };
    // Stable, so that equal scenes have equal trees.
    sides.sort_by_key(|s| axis.bin(s) > last_bin);
    sides.partition_point(|s| axis.bin(s) <= last_bin)
}

/// Where a group falls into two.
struct Split {
    axis: SplitAxis,
    /// The last bin of the first half.
    last_bin: usize,
    cost: f32,
}

/// A coordinate of sides, in equal bins from the least to the largest.
struct SplitAxis {
    index: usize,
    low: f32,
    bins_per_unit: f32,
}

impl SplitAxis {
    const BINS: usize = 12;

    /// `None` if the sides do not differ in it.
    fn new(sides: &[EmitterSide], index: usize) -> Option<Self> {
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for s in sides {
            let at = s.coordinate(index);
            (low, high) = (low.min(at), high.max(at));
        }
        let bins_per_unit = Self::BINS as f32 / (high - low);
        bins_per_unit.is_finite().then_some(Self {
            index,
            low,
            bins_per_unit,
        })
    }

    fn bin(&self, side: &EmitterSide) -> usize {
        let at = (side.coordinate(self.index) - self.low) * self.bins_per_unit;
        (at as usize).min(Self::BINS - 1)
    }

    /// The last bin of the first half where splitting costs least, and that cost; costs count
    /// `weight` times.
    fn cheapest(&self, sides: &[EmitterSide], weight: f32) -> Option<(usize, f32)> {
        let mut bins = [SplitBin::default(); Self::BINS];
        sides.iter().for_each(|s| bins[self.bin(s)].add(s));
        let mut above = [SplitBin::default(); Self::BINS];
        for b in (0..Self::BINS - 1).rev() {
            above[b] = above[b + 1];
            above[b].join(&bins[b + 1]);
        }
        let mut best: Option<(usize, f32)> = None;
        let mut below = SplitBin::default();
        for b in 0..Self::BINS - 1 {
            below.join(&bins[b]);
            if below.count == 0 || above[b].count == 0 {
                continue;
            }
            let cost = weight * (below.cost() + above[b].cost());
            if best.is_none_or(|(_, least)| cost < least) {
                best = Some((b, cost));
            }
        }
        best
    }
}

/// Sides that fall together when a split is sought.
#[derive(Clone, Copy)]
struct SplitBin {
    min: Vec3,
    max: Vec3,
    /// Sum of normals by power.
    normals: Vec3,
    power: f32,
    count: u32,
}

impl Default for SplitBin {
    fn default() -> Self {
        Self {
            min: Vec3::INFINITY,
            max: Vec3::NEG_INFINITY,
            normals: Vec3::ZERO,
            power: 0.0,
            count: 0,
        }
    }
}

impl SplitBin {
    fn add(&mut self, side: &EmitterSide) {
        for c in side.corners {
            (self.min, self.max) = (self.min.min(c), self.max.max(c));
        }
        self.normals += side.normal * side.power();
        self.power += side.power();
        self.count += 1;
    }

    fn join(&mut self, other: &Self) {
        (self.min, self.max) = (self.min.min(other.min), self.max.max(other.max));
        self.normals += other.normals;
        self.power += other.power;
        self.count += other.count;
    }

    /// Power times squared diagonal times what is lit, over 2 pi: a hemisphere, wider by a cap that
    /// has the mean of these normals.
    fn cost(&self) -> f32 {
        let cos_cap = (2.0 * self.normals.length() / self.power - 1.0).clamp(-1.0, 1.0);
        let sin_cap = (1.0 - cos_cap * cos_cap).sqrt();
        let lit = if cos_cap > 0.0 { 1.0 + sin_cap } else { 2.0 };
        self.power * (self.max - self.min).length_squared() * lit
    }
}
