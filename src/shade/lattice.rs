//! Indirect light on surfaces, gathered at few pixels and spread to all.
//!
//! Gathers stand at the pixels whose coordinates are multiples of the spacing: a lattice of the whole frame, which no
//! tile can move, so that merged tiles equal the frame. Each gather is averaged with those around it, and a surface point
//! then averages the lattice around it, weighted
//! by how alike normal and plane are and by distance over the harmonic distance of what was seen there, which is how
//! fast indirect light can change (Ward & Heckbert 1992 for the measure).

use super::view::View;
use crate::gather::{Gathered, Gatherer, Medium, Order, Pages, Stretch, SurfacePoint};
use crate::image::Region;
use crate::math::{Rgb, sampling};
use crate::run::{Cancel, Task, memory};
use crate::trace::{Surface, offset};
use crate::{Result, math};
use glam::Vec3;
use rayon::prelude::*;
use smallvec::SmallVec;

/// A gather on the lattice.
#[derive(Clone, Copy, Debug)]
struct Node {
    position: Vec3,
    normal: Vec3,
    gathered: Gathered,
    /// Scene length that one lattice step covers there.
    spacing: f32,
}

/// The part of the frame's lattice that a region needs.
#[derive(Debug)]
pub struct Lattice {
    step: u32,
    area: Area,
    nodes: Vec<Option<Node>>,
}

impl Lattice {
    /// Steps around a surface point from which its light is taken.
    const REACH: u32 = 2;
    /// Steps around a gather with which it is averaged first.
    const SMOOTH: u32 = 4;
    /// Distance at which a gather's weight falls to 1/e, over the harmonic distance at both ends.
    const RANGE: f32 = 0.25;
    /// The least such distance, in lattice steps.
    const LEAST: f32 = 0.7;
    /// Below this sum of weights a surface gathers for itself.
    const TOO_FEW: f32 = 0.1;
    /// Squares of this many by this many gathers share one sequence of directions.
    const SIDE: u32 = 4;

    /// Bytes that the lattice of a region takes while it is made.
    pub fn bytes(region: Region, step: u32, film: [u32; 2]) -> u64 {
        let gathered = Area::around(region, step, Self::REACH + Self::SMOOTH, film);
        let smoothed = Area::around(region, step, Self::REACH, film);
        // Lists of gathers, of which those at the border of the area have room for as many as the others, and then the
        // nodes that are made of them.
        let [columns, rows] = gathered.squares_along(Self::SIDE);
        let squares = u64::from(columns.end - columns.start) * u64::from(rows.end - rows.start);
        let gather = u64::from(Self::SIDE * Self::SIDE) * size_of::<(usize, Node)>() as u64;
        // While the lists are put into one list there are two of them.
        let lists =
            squares * (gather + (2 * size_of::<Vec<Node>>() + size_of::<[u32; 2]>()) as u64);
        let nodes = |area: &Area| (area.len() * size_of::<Option<Node>>()) as u64;
        nodes(&gathered) + lists.max(nodes(&smoothed))
    }

    /// Bytes of it that are surely held: once they are smoothed, gathers and what is made of them.
    pub fn least_bytes(region: Region, step: u32, film: [u32; 2]) -> [u64; 2] {
        [Self::REACH + Self::SMOOTH, Self::REACH].map(|reach| {
            let area = Area::around(region, step, reach, film);
            (area.len() as u64).saturating_mul(size_of::<Option<Node>>() as u64)
        })
    }

    /// Gathers at the lattice pixels in and around a region.
    ///
    /// # Errors
    /// If cancelled, or if there is no memory for it.
    pub fn new<P: Pages, M: Medium>(
        view: &View,
        gatherer: &Gatherer<P, M>,
        region: Region,
        step: u32,
        cancel: &Cancel,
        task: &Task,
    ) -> Result<Self> {
        let film = [view.film.width, view.film.height];
        let gathered = Area::around(region, step, Self::REACH + Self::SMOOTH, film);
        let order = gatherer.order(Self::SIDE * Self::SIDE);
        let squares: Vec<Vec<(usize, Node)>> = gathered
            .squares(Self::SIDE)
            .into_par_iter()
            .map(|square| {
                cancel.check()?;
                task.add(u64::from(Self::SIDE * Self::SIDE));
                Ok(Self::gather_in(
                    view, gatherer, &gathered, square, step, &order,
                ))
            })
            .collect::<Result<_>>()?;
        let mut nodes = memory::filled("the lattice", None, gathered.len())?;
        for (at, node) in squares.into_iter().flatten() {
            nodes[at] = Some(node);
        }
        let rough = Self {
            step,
            area: gathered,
            nodes,
        };
        let area = Area::around(region, step, Self::REACH, film);
        let mut nodes = memory::filled("the lattice", None, area.len())?;
        nodes
            .par_chunks_exact_mut(area.count[0] as usize)
            .zip(area.rows())
            .for_each(|(row, j)| {
                for (node, i) in row.iter_mut().zip(area.columns()) {
                    *node = rough.smoothed([i, j]);
                }
            });
        Ok(Self { step, area, nodes })
    }

    /// The gathers of a square of the lattice that are in an area, and their places there.
    fn gather_in<P: Pages, M: Medium>(
        view: &View,
        gatherer: &Gatherer<P, M>,
        area: &Area,
        [i, j]: [u32; 2],
        step: u32,
        order: &Order,
    ) -> Vec<(usize, Node)> {
        let (mut nodes, mut points) = (Vec::new(), Vec::new());
        for (y, x) in (0..Self::SIDE).flat_map(|y| (0..Self::SIDE).map(move |x| (y, x))) {
            let at = [i * Self::SIDE + x, j * Self::SIDE + y];
            let Some(place) = area.index(at) else {
                continue;
            };
            let Some((surface, spacing)) = Self::seen_at(view, at, step) else {
                continue;
            };
            let node = Node {
                position: surface.position,
                normal: surface.normal,
                gathered: Gathered::default(),
                spacing,
            };
            nodes.push((place, node));
            points.push(SurfacePoint {
                position: off_surface(view, &surface),
                normal: surface.normal,
                face_normal: surface.face_normal,
                // The stretches of each quarter of a square follow one another.
                stretch: morton(x, y),
            });
        }
        let seed = sampling::hash(&[view.seed, u64::from(i), u64::from(j)]);
        let gathered = gatherer.irradiance_of_neighbours(&points, seed, order);
        for ((_, node), gathered) in nodes.iter_mut().zip(gathered) {
            node.gathered = gathered;
        }
        nodes
    }

    /// The surface that a place of the lattice sees, and the scene length that one step covers there.
    fn seen_at(view: &View, at: [u32; 2], step: u32) -> Option<(Surface, f32)> {
        let [x, y] = at.map(|c| (c * step) as f32 + 0.5);
        let direction = view.camera.direction(&view.film, x, y);
        let origin = view.camera.origin();
        let hit = view.tracer.closest(origin, direction, f32::INFINITY)?;
        let surface = Surface::new(view.tracer.scene, hit.triangle, hit.uv).facing(-direction);
        Some((surface, hit.t * view.pixel_angle * step as f32))
    }

    /// A gather averaged with those around it.
    fn smoothed(&self, at: [u32; 2]) -> Option<Node> {
        let node = self.nodes[self.area.index(at)?]?;
        let centre = at.map(|c| c as f32 * self.step as f32);
        let mean = self.average(node.position, node.normal, centre, Self::SMOOTH)?;
        Some(Node {
            gathered: Gathered {
                light: mean.light * (1.0 / mean.weight),
                harmonic_distance: mean.harmonic_distance,
            },
            ..node
        })
    }

    /// Irradiance at a surface seen by pixel (x, y); `None` if the lattice around it saw nothing like it.
    #[must_use]
    pub fn irradiance(&self, surface: &Surface, x: u32, y: u32) -> Option<Rgb> {
        let centre = [x as f32, y as f32];
        let mean = self.average(surface.position, surface.normal, centre, Self::REACH)?;
        (mean.weight > Self::TOO_FEW).then(|| mean.light * (1.0 / mean.weight))
    }

    /// Weighted sum of the gathers within `reach` steps of a place in the frame that lie on a surface like the one given.
    fn average(&self, position: Vec3, normal: Vec3, centre: [f32; 2], reach: u32) -> Option<Mean> {
        let step = self.step as f32;
        let [columns, rows] = self.area.near(centre.map(|c| c / step), reach);
        // What the neighbours saw, the nearest above all, tells how far light can be carried to this point.
        // Not an array, which would be cleared for each point.
        let mut candidates = SmallVec::<[(f32, f32, &Node); MOST]>::new();
        let (mut closeness, mut nearness) = (0.0_f32, 0.0_f32);
        let reach = reach as f32 * step;
        for j in rows {
            for i in columns.clone() {
                let Some(at) = self.area.index([i, j]) else {
                    continue;
                };
                let Some(node) = &self.nodes[at] else {
                    continue;
                };
                let alike = node.normal.dot(normal);
                if alike <= 0.7 {
                    continue;
                }
                let px = i as f32 * step - centre[0];
                let py = j as f32 * step - centre[1];
                // The window closes before the lattice's reach ends, so that it has no edge.
                let window = 1.0 - (px * px + py * py) / (reach * reach);
                if window <= 0.0 {
                    continue;
                }
                let offset = position - node.position;
                let height = offset.dot(normal).abs().max(offset.dot(node.normal).abs());
                // Off the plane light changes faster: contact and thin steps are there.
                let d2 = offset.length_squared() + 8.0 * height * height;
                let weight = window * window * alike.powi(8);
                candidates.push((weight, d2, node));
                let close = weight / (d2 + 0.01 * node.spacing * node.spacing);
                closeness += close / node.gathered.harmonic_distance;
                nearness += close;
            }
        }
        if candidates.is_empty() {
            return None;
        }
        let mut mean = Mean {
            light: Rgb::BLACK,
            weight: 0.0,
            harmonic_distance: nearness / closeness,
        };
        for (weight, d2, node) in candidates {
            let range = (Self::RANGE * node.gathered.harmonic_distance.min(mean.harmonic_distance))
                .max(Self::LEAST * node.spacing);
            let weight = weight * math::exp::exp_neg(d2 / (range * range));
            mean.light += node.gathered.light * weight;
            mean.weight += weight;
        }
        Some(mean)
    }
}

/// Most gathers that an average may take.
const MOST: usize = (2 * Lattice::SMOOTH as usize + 1).pow(2);

/// A weighted sum of gathers.
struct Mean {
    light: Rgb,
    weight: f32,
    harmonic_distance: f32,
}

/// A rectangle of the frame's lattice.
#[derive(Clone, Copy, Debug)]
struct Area {
    first: [u32; 2],
    count: [u32; 2],
}

impl Area {
    /// What lies within `reach` steps of a region's pixels and their corners.
    fn around(region: Region, step: u32, reach: u32, film: [u32; 2]) -> Self {
        let from = |v: u32| (v / step).saturating_sub(reach);
        // A pixel's lower right corner has the next one's coordinates.
        let to = |v: u32, n: u32| (v / step + 1 + reach).min((n - 1) / step);
        let first = [from(region.x0), from(region.y0)];
        let last = [to(region.x1, film[0]), to(region.y1, film[1])];
        Self {
            first,
            count: [last[0] - first[0] + 1, last[1] - first[1] + 1],
        }
    }

    /// The squares of so many by so many places of the whole lattice that the area has a part in.
    fn squares(&self, side: u32) -> Vec<[u32; 2]> {
        let [columns, rows] = self.squares_along(side);
        rows.flat_map(|j| columns.clone().map(move |i| [i, j]))
            .collect()
    }

    fn squares_along(&self, side: u32) -> [std::ops::Range<u32>; 2] {
        [0, 1].map(|a| self.first[a] / side..(self.first[a] + self.count[a]).div_ceil(side))
    }

    /// How many places.
    fn len(&self) -> usize {
        self.count[0] as usize * self.count[1] as usize
    }

    fn columns(&self) -> std::ops::Range<u32> {
        self.first[0]..self.first[0] + self.count[0]
    }

    fn rows(&self) -> std::ops::Range<u32> {
        self.first[1]..self.first[1] + self.count[1]
    }

    fn index(&self, at: [u32; 2]) -> Option<usize> {
        let [i, j] = [0, 1].map(|a| at[a].wrapping_sub(self.first[a]));
        let inside = i < self.count[0] && j < self.count[1];
        inside.then(|| j as usize * self.count[0] as usize + i as usize)
    }

    /// Columns and rows of the area less than `reach` steps from a point of the frame, in steps.
    fn near(&self, centre: [f32; 2], reach: u32) -> [std::ops::Range<u32>; 2] {
        [0, 1].map(|a| {
            let from = (centre[a] - reach as f32).ceil().max(self.first[a] as f32) as u32;
            let to = (centre[a] + reach as f32).floor() as u32 + 1;
            from..to.min(self.first[a] + self.count[a])
        })
    }
}

/// Disks stand where their places were rounded to, some of them before the wall that the receiver is on: gathers start so
/// many times further off it than rays to triangles need.
const ROUNDING: f32 = 8.0;

/// Gathers over the hemisphere of a surface.
#[must_use]
pub fn gather_surface<P: Pages, M: Medium>(
    view: &View,
    gatherer: &Gatherer<P, M>,
    surface: &Surface,
    stretch: Stretch,
) -> Gathered {
    let origin = off_surface(view, surface);
    gatherer.irradiance(origin, surface.normal, surface.face_normal, stretch)
}

/// Where the rays of a gather start: off the surfaces that the point's own may meet there, too.
fn off_surface(view: &View, surface: &Surface) -> Vec3 {
    let towards_camera = (view.camera.origin() - surface.position).normalize_or_zero();
    let off = surface.face_normal + towards_camera;
    surface.position + off * (ROUNDING * offset(surface.position))
}

/// Place of a point of a small square along the curve that fills each quarter before the next.
fn morton(x: u32, y: u32) -> u32 {
    (0..4).fold(0, |m, bit| {
        m | (x >> bit & 1) << (2 * bit) | (y >> bit & 1) << (2 * bit + 1)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lattice_of_the_largest_film_can_be_counted() {
        const SIDE: u32 = 65_536;
        let film = Region::full(SIDE, SIDE);
        let area = Area::around(film, 1, Lattice::REACH, [SIDE; 2]);
        assert_eq!(area.len(), 1 << 32);
        assert_eq!(area.index([SIDE - 1; 2]), Some((1 << 32) - 1));
        assert_eq!(area.index([SIDE, 0]), None);
    }

    #[test]
    fn the_bytes_of_a_lattice_are_those_of_its_lists_and_nodes() {
        // An area of 14 by 14 places, in 5 by 4 squares of the whole lattice.
        let region = Region {
            x0: 36,
            y0: 28,
            x1: 38,
            y1: 29,
        };
        let area = Area::around(region, 4, Lattice::REACH + Lattice::SMOOTH, [100, 60]);
        assert_eq!((area.first, area.count), ([3, 1], [14, 14]));
        let squares = area.squares(Lattice::SIDE).len();
        assert_eq!(squares, 5 * 4);
        let least = squares * 16 * size_of::<(usize, Node)>() + 14 * 14 * size_of::<Option<Node>>();
        let bytes = Lattice::bytes(region, 4, [100, 60]) as usize;
        assert!(
            bytes >= least && bytes < least + least / 10,
            "{bytes} {least}"
        );
    }
}
