//! Gathers of a lattice, some of them in the middle of its cells, and means over them.

use super::area::Area;
use crate::Result;
use crate::gather::Gathered;
use crate::math::{self, Rgb};
use crate::run::memory;
use glam::Vec3;
use smallvec::SmallVec;
use std::f32::consts::PI;

/// A gather on the lattice.
#[derive(Clone, Copy, Debug)]
pub(super) struct LatticeGather {
    pub position: Vec3,
    pub normal: Vec3,
    pub gathered: Gathered,
    /// Scene length that one lattice step covers there.
    pub spacing: f32,
    /// Whether light there may change within less than that.
    pub is_tight: bool,
}

/// What there may be no memory for.
pub(super) const LATTICE: &str = "the lattice";

/// The gathers of a part of the lattice. A cell is what lies between four of them, and belongs to
/// the first; one with a gather in its middle, too, is refined.
#[derive(Debug)]
pub(super) struct Gathers {
    /// Pixels.
    pub step: u32,
    pub area: Area,
    /// By place.
    pub nodes: Vec<Option<LatticeGather>>,
    /// Which of `middles` is in the cell of each place, or [`Self::NO_MIDDLE`].
    middle_of: Vec<u32>,
    /// Row by row.
    pub middles: Vec<Middle>,
}

/// The middle of a refined cell.
#[derive(Clone, Copy, Debug)]
pub(super) struct Middle {
    /// The place that the cell belongs to.
    pub cell: [u32; 2],
    /// What gathers there, if anything is seen.
    pub node: Option<LatticeGather>,
}

/// Which gathers a mean takes.
struct Window {
    /// Steps up to which it does.
    reach: f32,
    /// How far apart they are, in steps.
    spacing: f32,
    /// Whether it takes those in the middle of cells.
    has_middles: bool,
}

impl Window {
    /// A window of `reach` gathers around a point, along both axes.
    fn new(reach: u32, is_refined: bool) -> Self {
        /// With one in the middle of each cell there are twice as many, as far apart as half of its
        /// diagonal.
        const WITH_MIDDLES: f32 = std::f32::consts::FRAC_1_SQRT_2;
        Self {
            // So about as many are taken.
            reach: reach as f32 * if is_refined { 0.75 } else { 1.0 },
            spacing: if is_refined { WITH_MIDDLES } else { 1.0 },
            has_middles: is_refined,
        }
    }
}

impl Gathers {
    /// No gather is in the middle.
    const NO_MIDDLE: u32 = u32::MAX;
    /// Bytes of a place, without the middle of its cell.
    pub const PLACE_BYTES: usize = size_of::<Option<LatticeGather>>() + size_of::<u32>();
    /// Bytes of the middle of a cell.
    pub const MIDDLE_BYTES: usize = size_of::<Middle>();

    /// Gathers at places of the lattice, and none between them.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn new(step: u32, area: Area, nodes: Vec<Option<LatticeGather>>) -> Result<Self> {
        Ok(Self {
            step,
            area,
            middle_of: memory::filled(LATTICE, Self::NO_MIDDLE, nodes.len())?,
            nodes,
            middles: Vec::new(),
        })
    }

    /// Refines the cells that `is_refined` says, which hears the gathers at places: makes room for
    /// what is in their middle.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn refine(&mut self, is_refined: impl Fn(&Self, [u32; 2]) -> bool) -> Result<()> {
        let mut count = 0;
        for (index, at) in self.area.places().enumerate() {
            if is_refined(self, at) {
                self.middle_of[index] = count;
                count += 1;
            }
        }
        self.middles = memory::room(LATTICE, count as usize)?;
        let cells = self.area.places().zip(&self.middle_of);
        let refined = cells.filter(|(_, middle)| **middle != Self::NO_MIDDLE);
        self.middles
            .extend(refined.map(|(cell, _)| Middle { cell, node: None }));
        Ok(())
    }

    /// Whether light may change within a cell, as any of its corners says.
    pub fn is_tight(&self, [i, j]: [u32; 2]) -> bool {
        [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]]
            .into_iter()
            .any(|at| self.node(at).is_some_and(|node| node.is_tight))
    }

    /// Whether the cell of a place is refined.
    pub fn is_refined(&self, at: [u32; 2]) -> bool {
        let index = self.area.index(at);
        index.is_some_and(|index| self.middle_of[index] != Self::NO_MIDDLE)
    }

    /// Puts a gather in the middle of a refined cell, by the number of its place.
    pub fn put_middle(&mut self, place: usize, node: LatticeGather) {
        self.middles[self.middle_of[place] as usize].node = Some(node);
    }

    #[inline]
    fn node(&self, at: [u32; 2]) -> Option<&LatticeGather> {
        self.nodes[self.area.index(at)?].as_ref()
    }

    #[inline]
    fn middle(&self, at: [u32; 2]) -> Option<&LatticeGather> {
        let middle = self.middle_of[self.area.index(at)?];
        self.middles.get(middle as usize)?.node.as_ref()
    }

    /// The gather at a place averaged with those up to `reach` gathers around it.
    pub fn smoothed(&self, at: [u32; 2], reach: u32) -> Option<LatticeGather> {
        let [i, j] = at;
        let is_refined = [[0, 0], [1, 0], [0, 1], [1, 1]].into_iter().any(|[x, y]| {
            let before = i.checked_sub(x).zip(j.checked_sub(y));
            before.is_some_and(|(i, j)| self.is_refined([i, j]))
        });
        let window = Window::new(reach, is_refined);
        self.smooth(self.node(at)?, at.map(|c| c as f32), &window)
    }

    /// The gather in the middle of a cell averaged with those up to `reach` gathers around it.
    pub fn smoothed_middle(&self, at: [u32; 2], reach: u32) -> Option<LatticeGather> {
        let window = Window::new(reach, true);
        self.smooth(self.middle(at)?, at.map(|c| c as f32 + 0.5), &window)
    }

    fn smooth(&self, node: &LatticeGather, at: [f32; 2], window: &Window) -> Option<LatticeGather> {
        let mean = self.mean(node.position, node.normal, at, window)?;
        Some(LatticeGather {
            gathered: Gathered {
                light: mean.light * (1.0 / mean.weight),
                environment: mean.environment * (1.0 / mean.weight),
                harmonic_distance: mean.harmonic_distance,
                toward: mean.toward,
            },
            ..*node
        })
    }

    /// Weighted sum of up to `reach` gathers around a pixel, of those that lie on a surface like
    /// the one given.
    pub fn around(
        &self,
        position: Vec3,
        normal: Vec3,
        pixel: [u32; 2],
        reach: u32,
    ) -> Option<Mean> {
        let window = Window::new(reach, self.is_refined(pixel.map(|c| c / self.step)));
        let at = pixel.map(|c| c as f32 / self.step as f32);
        self.mean(position, normal, at, &window)
    }

    /// Weighted sum of the gathers in a window around a point, in steps.
    fn mean(&self, position: Vec3, normal: Vec3, at: [f32; 2], window: &Window) -> Option<Mean> {
        let mut candidates = Candidates {
            position,
            normal,
            at,
            window,
            found: SmallVec::new(),
            closeness: 0.0,
            nearness: 0.0,
            toward: Vec3::ZERO,
        };
        let [columns, rows] = self.area.near(at, window.reach);
        for j in rows {
            for i in columns.clone() {
                if let Some(node) = self.node([i, j]) {
                    candidates.add(node, [i, j].map(|c| c as f32));
                }
            }
        }
        if window.has_middles {
            let [columns, rows] = self.area.near(at.map(|c| c - 0.5), window.reach);
            for j in rows {
                for i in columns.clone() {
                    if let Some(node) = self.middle([i, j]) {
                        candidates.add(node, [i, j].map(|c| c as f32 + 0.5));
                    }
                }
            }
        }
        candidates.mean()
    }
}

/// Gathers that a mean takes without asking for memory: more than the windows of today hold.
const MAX_INLINE_CANDIDATES: usize = 84;

/// Gathers that a mean around a point takes.
struct Candidates<'a> {
    position: Vec3,
    normal: Vec3,
    /// Where on the lattice, in steps.
    at: [f32; 2],
    window: &'a Window,
    /// Weights but for how far light is carried, squared distances, gathers. Not an array, which
    /// would be cleared for each point.
    found: SmallVec<[(f32, f32, &'a LatticeGather); MAX_INLINE_CANDIDATES]>,
    /// Sums by how near they are: of one over their harmonic distances, and of one.
    closeness: f32,
    nearness: f32,
    /// Of what points to what is near, as the first.
    toward: Vec3,
}

impl<'a> Candidates<'a> {
    /// Distance at which a gather's weight falls to 1/e, over the harmonic distance at both ends.
    const RANGE_OVER_HARMONIC: f32 = 0.25;
    /// The least such distance, over that between gathers.
    const MIN_RANGE_STEPS: f32 = 0.7;
    /// Length of the mean of directions to what is near, each over its distance, times the harmonic
    /// distance, beside a wall without end and nothing else: of two walls it is shorter, of a
    /// small thing longer.
    const OF_CREASE: f32 = 3.0 / 16.0 * PI;
    /// By how much it may be another in a crease.
    const OF_CREASE_RANGE: f32 = 0.1;
    /// Share by which squared distances along a crease count less: light changes across it.
    const ALONG_CREASE: f32 = 0.95;

    /// Adds a gather that stands at a point of the lattice, if it is in the window and on a surface
    /// like that of the mean.
    #[inline(always)]
    fn add(&mut self, node: &'a LatticeGather, [x, y]: [f32; 2]) {
        let alike = node.normal.dot(self.normal);
        if alike <= 0.7 {
            return;
        }
        let (x, y) = (x - self.at[0], y - self.at[1]);
        // The window closes before the lattice's reach ends, so that it has no edge.
        let share = 1.0 - (x * x + y * y) / (self.window.reach * self.window.reach);
        if share <= 0.0 {
            return;
        }
        let offset = self.position - node.position;
        let height = (offset.dot(self.normal).abs()).max(offset.dot(node.normal).abs());
        // Off the plane light changes faster: contact and thin steps are there.
        let d2 = offset.length_squared() + 8.0 * height * height;
        let weight = share * share * alike.powi(8);
        self.found.push((weight, d2, node));
        let spacing = self.window.spacing * node.spacing;
        let close = weight / (d2 + 0.01 * spacing * spacing);
        self.closeness += close / node.gathered.harmonic_distance;
        self.nearness += close;
        self.toward += node.gathered.toward * close;
    }

    /// The direction of the crease that the point lies in, and by which share squared distances
    /// along it count less; as little as it is like one.
    fn crease(&self) -> (Vec3, f32) {
        let toward = (self.toward / self.closeness).reject_from_normalized(self.normal);
        let length = toward.length();
        let off = (length - Self::OF_CREASE) / Self::OF_CREASE_RANGE;
        let share = Self::ALONG_CREASE * (1.0 - off * off);
        if share > 0.0 {
            (self.normal.cross(toward / length), share)
        } else {
            (Vec3::ZERO, 0.0)
        }
    }

    /// What the neighbours saw, the nearest above all, tells how far light can be carried to the
    /// point.
    fn mean(self) -> Option<Mean> {
        if self.found.is_empty() {
            return None;
        }
        let mut mean = Mean {
            light: Rgb::BLACK,
            environment: Rgb::BLACK,
            weight: 0.0,
            harmonic_distance: self.nearness / self.closeness,
            toward: self.toward / self.nearness,
        };
        let (along, share) = self.crease();
        for (weight, d2, node) in self.found {
            let step = along.dot(self.position - node.position);
            let d2 = (d2 - share * step * step).max(0.0);
            let range = (Self::RANGE_OVER_HARMONIC
                * node.gathered.harmonic_distance.min(mean.harmonic_distance))
            .max(Self::MIN_RANGE_STEPS * self.window.spacing * node.spacing);
            let weight = weight * math::exp::exp_neg(d2 / (range * range));
            mean.light += node.gathered.light * weight;
            mean.environment += node.gathered.environment * weight;
            mean.weight += weight;
        }
        Some(mean)
    }
}

/// A weighted sum of gathers.
pub(super) struct Mean {
    pub light: Rgb,
    /// Of that, what comes straight from the environment.
    pub environment: Rgb,
    pub weight: f32,
    harmonic_distance: f32,
    toward: Vec3,
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gathers on a plane, a step of 4 pixels and one unit apart, of light that the place tells.
    fn on_plane(count: u32, harmonic_distance: f32, light: impl Fn(f32) -> f32) -> Gathers {
        let node = |[x, y]: [f32; 2]| LatticeGather {
            position: Vec3::new(x, 0.0, y),
            normal: Vec3::Y,
            gathered: Gathered {
                light: Rgb::splat(light(x)),
                environment: Rgb::BLACK,
                harmonic_distance,
                toward: Vec3::ZERO,
            },
            spacing: 1.0,
            is_tight: x > 3.5,
        };
        let area = Area {
            first: [0; 2],
            count: [count; 2],
        };
        let places = area.places();
        let nodes = places.map(|at| Some(node(at.map(|c| c as f32)))).collect();
        let mut gathers = Gathers::new(4, area, nodes).unwrap();
        gathers.refine(Gathers::is_tight).unwrap();
        for place in 0..area.len() {
            let at = area.places().nth(place).unwrap();
            if gathers.is_refined(at) {
                gathers.put_middle(place, node(at.map(|c| c as f32 + 0.5)));
            }
        }
        gathers
    }

    /// Light at a pixel of a row through the middles of cells.
    fn light(gathers: &Gathers, x: u32) -> f32 {
        let position = Vec3::new(x as f32 / 4.0, 0.0, 4.5);
        let mean = gathers.around(position, Vec3::Y, [x, 18], 2).unwrap();
        mean.light.0[0] / mean.weight
    }

    #[test]
    fn cells_are_refined_beside_gathers_that_ask_for_it() {
        let gathers = on_plane(8, 1.0, |x| x);
        for x in 0..8 {
            assert_eq!(gathers.is_refined([x, 3]), x >= 3, "{x}");
        }
        assert!(!gathers.is_refined([8, 0]));
        let cells: Vec<_> = gathers.middles.iter().map(|m| m.cell).collect();
        assert_eq!(cells.len(), 8 * 5);
        assert!(cells.is_sorted_by_key(|[x, y]| [*y, *x]));
        for (i, cell) in cells.into_iter().enumerate() {
            let node = gathers.middle(cell).unwrap();
            assert_eq!(node.position.x, cell[0] as f32 + 0.5, "{i}");
        }
        assert!(gathers.middle([2, 3]).is_none() && gathers.middle([8, 8]).is_none());
    }

    #[test]
    fn means_have_no_bias_where_light_is_linear_and_take_middles_where_it_is_not() {
        let linear = on_plane(9, 4.0, |x| 1.0 + x);
        for x in [8, 10, 16, 18, 20, 22] {
            assert!(
                (light(&linear, x) - 1.0 - x as f32 / 4.0).abs() < 0.04,
                "{x}"
            );
        }
        // A crest of half a step, which gathers at whole steps do not see.
        let crest = on_plane(9, 1.0, |x| f32::from(u8::from(x.fract() == 0.5)));
        assert_eq!(light(&crest, 6), 0.0);
        assert!(light(&crest, 18) > 0.5);
        let node = crest.smoothed([1, 4], 4).unwrap();
        assert_eq!(node.gathered.light, Rgb::BLACK);
        let [corner, middle] = [
            crest.smoothed([5, 4], 4).unwrap(),
            crest.smoothed_middle([5, 4], 4).unwrap(),
        ];
        let [corner, middle] = [corner, middle].map(|n| n.gathered.light.0[0]);
        assert!(corner < 0.5 && middle > 0.5, "{corner} {middle}");
        assert!(crest.smoothed_middle([1, 4], 4).is_none());
    }

    /// Length of what points to what is near beside walls without end, at a distance of 1: one
    /// along x, or another along y, too.
    fn length_beside_walls(has_second: bool) -> f32 {
        const COUNT: u32 = 300;
        let (mut toward, mut closeness) = ([0.0; 2], 0.0);
        for i in 0..COUNT * COUNT {
            let [u, v] = [i % COUNT, i / COUNT].map(|k| (k as f32 + 0.5) / COUNT as f32);
            let (sin, cos) = (2.0 * PI * v).sin_cos();
            let [x, y] = [cos, sin].map(|c| c * u.sqrt());
            let inverse_distance = if has_second { x.max(y) } else { x }.max(0.0);
            toward[0] += x * inverse_distance;
            toward[1] += y * inverse_distance;
            closeness += inverse_distance;
        }
        f32::hypot(toward[0], toward[1]) / closeness
    }

    #[test]
    fn one_wall_makes_a_crease_and_two_do_not() {
        type C = Candidates<'static>;
        assert!((length_beside_walls(false) - C::OF_CREASE).abs() < 1e-3);
        assert!(length_beside_walls(true) < C::OF_CREASE - C::OF_CREASE_RANGE);
    }

    #[test]
    fn means_are_longer_along_creases() {
        let light = |toward: Vec3| {
            let mut gathers = on_plane(9, 1.0, |x| f32::from(u8::from(x % 2.0 == 0.0)));
            let nodes = gathers.nodes.iter_mut().flatten();
            nodes.for_each(|node| node.gathered.toward = toward * Candidates::OF_CREASE);
            gathers.smoothed([2, 4], 4).unwrap().gathered.light.0[0]
        };
        let everywhere = light(Vec3::ZERO);
        assert!(everywhere > 0.75, "{everywhere}");
        assert!(light(Vec3::X) >= everywhere - 0.02);
        assert!((light(Vec3::Z) - 0.5).abs() < 0.1, "{}", light(Vec3::Z));
    }
}
