//! Indirect light on surfaces, gathered at few pixels and spread to all.
//!
//! Gathers stand at the pixels whose coordinates are multiples of the spacing: a lattice of the
//! whole frame, which no tile can move, so that merged tiles equal the frame. Where light may
//! change within less than that, by the harmonic distance of what was seen (Ward & Heckbert 1992),
//! others stand between them. Each gather is averaged with those around it, and a surface point
//! then averages the lattice around it, weighted by how alike normal and plane are and by distance
//! over that harmonic distance, of which less counts along a crease.

mod area;
mod gathers;
mod kept;

use super::WithSky;
use super::gatherer::GatherAtSurfaces;
use crate::Result;
use crate::gather::{DirectionOrder, Gathered, UnknownPatches, in_order_of_places};
use crate::image::Region;
use crate::math::{Ray, Rgb, SphereMap, sampling};
use crate::run::{Cancel, Task, memory};
use crate::trace::Surface;
use crate::view::View;
use area::Area;
use gathers::{Gathers, LATTICE, LatticeGather};
use glam::Vec3;
pub use kept::KeptGathers;
use rayon::prelude::*;

/// The part of the frame's lattice that a region needs.
#[derive(Debug)]
pub struct Lattice {
    gathers: Gathers,
    /// Of an environment that differs by direction gathers have the share that is not hidden: that
    /// changes less from one normal to another. By normal, what it is a share of.
    unhidden: Option<SphereMap>,
}

impl Lattice {
    /// Gathers around a surface point, along both axes, from which its light is taken.
    const LOOKUP_REACH: u32 = 2;
    /// Gathers around one, along both axes, with which it is averaged first.
    const SMOOTHING_REACH: u32 = 4;
    /// Below this sum of weights a surface gathers for itself.
    const MIN_WEIGHT: f32 = 0.1;
    /// Squares of this many by this many gathers share one sequence of directions.
    const SQUARE_EDGE: u32 = 4;

    /// Harmonic distance below which light may change within a step, over the length of that on the
    /// surface. Gathers are carried a quarter of that distance, and no less than 0.7 steps: half as
    /// far as those at which a cell is refined ask for.
    const TIGHT_STEPS: f32 = 1.4;
    /// The least cosine by which a step is taken to be longer where the camera looks along a
    /// surface.
    const MIN_GRAZING_COSINE: f32 = 0.2;

    /// A lattice without any gather.
    ///
    /// # Errors
    /// If there is no memory for it.
    pub fn empty(step: u32) -> Result<Self> {
        let area = Area {
            first: [0; 2],
            count: [0; 2],
        };
        Ok(Self {
            gathers: Gathers::new(step, area, Vec::new())?,
            unhidden: None,
        })
    }

    /// Pixels around a region whose gathers it needs.
    pub fn reach(step: u32) -> u32 {
        (Self::LOOKUP_REACH + Self::SMOOTHING_REACH + 1) * step
    }

    /// Whether light at what was gathered at, a point of a triangle with this normal, may change
    /// within a step that is so long there.
    pub fn is_tight(
        view: &View,
        (position, face_normal): (Vec3, Vec3),
        spacing: f32,
        gathered: &Gathered,
    ) -> bool {
        let to_camera = (view.camera.origin() - position).normalize_or_zero();
        let cos = face_normal.dot(to_camera).max(Self::MIN_GRAZING_COSINE);
        gathered.harmonic_distance * cos < Self::TIGHT_STEPS * spacing
    }

    /// Bytes that the lattice of a region takes at most while it is made.
    pub fn bytes(region: Region, step: u32, film: [u32; 2]) -> u64 {
        let gathered = Area::around(
            region,
            step,
            Self::LOOKUP_REACH + Self::SMOOTHING_REACH,
            film,
        );
        let smoothed = Area::around(region, step, Self::LOOKUP_REACH, film);
        // Lists of gathers, of which those at the border of the area have room for as many as the
        // others, and then the nodes that are made of them.
        let [columns, rows] = gathered.squares_along(Self::SQUARE_EDGE);
        let squares = u64::from(columns.end - columns.start) * u64::from(rows.end - rows.start);
        let gather = u64::from(Self::SQUARE_EDGE * Self::SQUARE_EDGE)
            * size_of::<(usize, LatticeGather)>() as u64;
        // While the lists are put into one list there are two of them.
        let lists = squares
            * (gather + (2 * size_of::<Vec<LatticeGather>>() + size_of::<[u32; 2]>()) as u64);
        // All cells may be refined.
        let middle = if step > 1 { Gathers::MIDDLE_BYTES } else { 0 };
        let place = Gathers::PLACE_BYTES + middle;
        let nodes = |area: &Area| (area.len() * place) as u64;
        nodes(&gathered) + lists.max(nodes(&smoothed))
    }

    /// Bytes that the lattice of a region surely takes: of gathers, and of their smoothed copies.
    pub fn least_bytes(region: Region, step: u32, film: [u32; 2]) -> [u64; 2] {
        [
            Self::LOOKUP_REACH + Self::SMOOTHING_REACH,
            Self::LOOKUP_REACH,
        ]
        .map(|reach| {
            let area = Area::around(region, step, reach, film);
            (area.len() as u64).saturating_mul(Gathers::PLACE_BYTES as u64)
        })
    }

    /// Gathers at the lattice pixels in and around a region; those that are `kept` are not made
    /// again.
    ///
    /// # Errors
    /// If cancelled, or if there is no memory for it.
    pub fn new(
        gatherer: &dyn GatherAtSurfaces,
        region: Region,
        step: u32,
        kept: Option<&KeptGathers>,
        cancel: &Cancel,
        task: &Task,
    ) -> Result<Self> {
        let film = gatherer.view().film;
        let film = [film.width, film.height];
        let receivers = Receivers {
            gatherer,
            order: &gatherer.order(Self::SQUARE_EDGE * Self::SQUARE_EDGE),
            step,
            kept,
            cancel,
            task,
        };
        let area = Area::around(
            region,
            step,
            Self::LOOKUP_REACH + Self::SMOOTHING_REACH,
            film,
        );
        let mut nodes = memory::filled(LATTICE, None, area.len())?;
        let squares = receivers.gather(&area, LatticeSite::Place, |_| true)?;
        for (index, node) in squares.into_iter().flatten() {
            nodes[index] = Some(node);
        }
        let mut rough = Gathers::new(step, area, nodes)?;
        if step > 1 {
            // Those farther away are in no mean that the region takes.
            let near = Area::around(
                region,
                step,
                Self::LOOKUP_REACH + Self::SMOOTHING_REACH - 1,
                film,
            );
            rough.refine(|g, at| near.index(at).is_some() && g.is_tight(at))?;
            let squares =
                receivers.gather(&area, LatticeSite::Middle, |at| rough.is_refined(at))?;
            for (index, node) in squares.into_iter().flatten() {
                rough.put_middle(index, node);
            }
        }
        let unhidden = gatherer.unhidden().cloned();
        Self::smooth(
            &rough,
            Area::around(region, step, Self::LOOKUP_REACH, film),
            unhidden,
        )
    }

    /// Each gather of an area averaged with those around it.
    fn smooth(rough: &Gathers, area: Area, unhidden: Option<SphereMap>) -> Result<Self> {
        let mut nodes = memory::filled(LATTICE, None, area.len())?;
        nodes
            .par_chunks_exact_mut(area.count[0] as usize)
            .zip(area.rows())
            .for_each(|(row, j)| {
                for (node, i) in row.iter_mut().zip(area.columns()) {
                    *node = rough.smoothed([i, j], Self::SMOOTHING_REACH);
                }
            });
        let mut smooth = Gathers::new(rough.step, area, nodes)?;
        smooth.refine(|_, at| rough.is_refined(at))?;
        smooth.middles.par_iter_mut().for_each(|middle| {
            middle.node = rough.smoothed_middle(middle.cell, Self::SMOOTHING_REACH);
        });
        Ok(Self {
            gathers: smooth,
            unhidden,
        })
    }

    /// Pixels from one gather to the next.
    #[must_use]
    pub fn step(&self) -> u32 {
        self.gathers.step
    }

    /// Irradiance at a surface seen by pixel (x, y); `None` if the lattice around it saw nothing
    /// like it.
    #[must_use]
    pub fn irradiance(&self, surface: &Surface, x: u32, y: u32) -> Option<WithSky> {
        let mean =
            (self.gathers).around(surface.position, surface.normal, [x, y], Self::LOOKUP_REACH)?;
        (mean.weight > Self::MIN_WEIGHT).then(|| {
            let share = 1.0 / mean.weight;
            let (all, sky) = (mean.light * share, mean.environment * share);
            match &self.unhidden {
                None => WithSky { all, sky },
                Some(unhidden) => {
                    let sky = sky * unhidden.get(surface.normal);
                    let all = all + sky;
                    WithSky { all, sky }
                }
            }
        })
    }
}

/// Where gathers stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LatticeSite {
    /// At places of the lattice.
    Place,
    /// In the middle of their cells.
    Middle,
}

/// What gathers on a lattice.
struct Receivers<'a> {
    gatherer: &'a dyn GatherAtSurfaces,
    order: &'a DirectionOrder,
    step: u32,
    kept: Option<&'a KeptGathers>,
    cancel: &'a Cancel,
    task: &'a Task,
}

/// The receivers of a square of the lattice.
struct SquareReceivers {
    /// Where each of them is.
    all: Vec<Receiver>,
    /// Where those stand that are to gather, and the range of directions of each.
    surfaces: Vec<(Surface, u32)>,
    /// Key of their directions.
    seed: u64,
}

/// A receiver of the lattice.
struct Receiver {
    at: [u32; 2],
    /// The number of its place in the area.
    index: usize,
    /// Its normal, and the normal of the triangle.
    normals: [Vec3; 2],
    /// Without light yet.
    node: LatticeGather,
    /// What was gathered there, if that is kept.
    kept: Option<Gathered>,
}

impl Receivers<'_> {
    /// The gathers of the wanted places of an area, square by square, and the numbers of those
    /// places.
    fn gather(
        &self,
        area: &Area,
        site: LatticeSite,
        is_wanted: impl Fn([u32; 2]) -> bool + Sync,
    ) -> Result<Vec<Vec<(usize, LatticeGather)>>> {
        /// Squares whose patches are found together, so that what is known of rays to come takes
        /// some MiB at most.
        const TOGETHER: usize = 1024;
        let middle = Lattice::SQUARE_EDGE / 2;
        let seen = |square: [u32; 2]| {
            let at = square.map(|c| c * Lattice::SQUARE_EDGE + middle);
            let seen = self.seen_at(at, LatticeSite::Place);
            (square, seen.map_or(Vec3::ZERO, |(_, node)| node.position))
        };
        // Squares near each other in the scene need the same pages of the tree.
        let squares = area.squares(Lattice::SQUARE_EDGE).into_par_iter().map(seen);
        let squares = in_order_of_places(squares.collect(), |(_, position)| *position);
        let mut gathered = Vec::with_capacity(squares.len());
        for together in squares.chunks(TOGETHER) {
            if self.gatherer.has_unknown() {
                let unknown = together.par_iter().map(|(square, _)| {
                    self.cancel.check()?;
                    let receivers = self.receivers_in(area, *square, site, &is_wanted);
                    Ok((self.gatherer).unknown_to_neighbours(
                        &receivers.surfaces,
                        receivers.seed,
                        self.order,
                    ))
                });
                let unknown = unknown.collect::<Result<Vec<_>>>()?;
                self.gatherer.evaluate(UnknownPatches::of_all(unknown));
            }
            // Threads take one after the other, so that all are at about one place.
            let squares = together.iter().par_bridge().map(|(square, _)| {
                self.cancel.check()?;
                // How many stand in the middle of cells was not known when the task was told its
                // length.
                if site == LatticeSite::Place {
                    self.task
                        .add(u64::from(Lattice::SQUARE_EDGE * Lattice::SQUARE_EDGE));
                }
                Ok(self.gather_in(area, *square, site, &is_wanted))
            });
            gathered.extend(squares.collect::<Result<Vec<_>>>()?);
        }
        Ok(gathered)
    }

    /// The receivers at the wanted places of a square of the lattice.
    fn receivers_in(
        &self,
        area: &Area,
        [i, j]: [u32; 2],
        site: LatticeSite,
        is_wanted: impl Fn([u32; 2]) -> bool,
    ) -> SquareReceivers {
        const SQUARE_EDGE: u32 = Lattice::SQUARE_EDGE;
        let (mut all, mut surfaces) = (Vec::new(), Vec::new());
        for (y, x) in (0..SQUARE_EDGE).flat_map(|y| (0..SQUARE_EDGE).map(move |x| (y, x))) {
            let at = [i * SQUARE_EDGE + x, j * SQUARE_EDGE + y];
            let Some(index) = area.index(at).filter(|_| is_wanted(at)) else {
                continue;
            };
            let Some((surface, node)) = self.seen_at(at, site) else {
                continue;
            };
            let kept = self.kept.and_then(|kept| kept.get(at, site));
            all.push(Receiver {
                at,
                index,
                normals: [surface.normal, surface.face_normal],
                node,
                kept,
            });
            if kept.is_none() {
                // The stretches of each quarter of a square follow one another.
                surfaces.push((surface, morton(x, y)));
            }
        }
        let key = [self.gatherer.view().seed, u64::from(i), u64::from(j), 1];
        let seed = sampling::hash(match site {
            LatticeSite::Place => &key[..3],
            LatticeSite::Middle => &key,
        });
        SquareReceivers {
            all,
            surfaces,
            seed,
        }
    }

    /// The gathers of the wanted places of a square of the lattice, and the numbers of those
    /// places.
    fn gather_in(
        &self,
        area: &Area,
        square: [u32; 2],
        site: LatticeSite,
        is_wanted: impl Fn([u32; 2]) -> bool,
    ) -> Vec<(usize, LatticeGather)> {
        let SquareReceivers {
            all,
            surfaces,
            seed,
        } = self.receivers_in(area, square, site, is_wanted);
        let view = self.gatherer.view();
        let gathered = (self.gatherer).gather_neighbours(&surfaces, seed, self.order);
        let mut gathered = gathered.into_iter();
        let lit = all.into_iter().filter_map(|receiver| {
            let Receiver {
                at,
                index,
                normals: [normal, face_normal],
                mut node,
                kept,
            } = receiver;
            let gathered = kept.or_else(|| {
                let gathered = gathered.next()?;
                if let Some(kept) = self.kept {
                    kept.put(at, site, &gathered);
                }
                Some(gathered)
            })?;
            node.gathered = match self.gatherer.unhidden() {
                None => gathered,
                Some(unhidden) => as_share(gathered, unhidden.get(normal)),
            };
            let seen = (node.position, face_normal);
            node.is_tight = Lattice::is_tight(view, seen, node.spacing, &gathered);
            Some((index, node))
        });
        lit.collect()
    }

    /// The surface that a place of the lattice sees, or the middle of its cell, and a gather there
    /// that has no light yet.
    fn seen_at(&self, place: [u32; 2], site: LatticeSite) -> Option<(Surface, LatticeGather)> {
        let view = self.gatherer.view();
        let offset = match site {
            LatticeSite::Place => 0.0,
            LatticeSite::Middle => 0.5 * self.step as f32,
        };
        let [x, y] = place.map(|c| (c * self.step) as f32 + offset + 0.5);
        let direction = view.camera.direction(&view.film, x, y);
        let origin = view.camera.origin();
        let hit = view.tracer.closest_seen(&Ray::endless(origin, direction))?;
        let surface = Surface::new(view.tracer.scene, hit.triangle, hit.uv).facing(-direction);
        let node = LatticeGather {
            position: surface.position,
            normal: surface.normal,
            gathered: Gathered::default(),
            spacing: hit.t * view.pixel_angle * self.step as f32,
            is_tight: false,
        };
        Some((surface, node))
    }
}

/// What was gathered, with the light of the environment apart, as a share of what nothing hides.
fn as_share(gathered: Gathered, unhidden: Rgb) -> Gathered {
    let Gathered {
        light, environment, ..
    } = gathered;
    let share = |c: usize| match unhidden.0[c] {
        all if all > 0.0 => environment.0[c] / all,
        _ => 0.0,
    };
    Gathered {
        light: Rgb(std::array::from_fn(|c| {
            (light.0[c] - environment.0[c]).max(0.0)
        })),
        environment: Rgb(std::array::from_fn(share)),
        ..gathered
    }
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
    fn the_bytes_of_a_lattice_are_those_of_its_lists_and_nodes() {
        // An area of 14 by 14 places, in 5 by 4 squares of the whole lattice.
        let region = Region {
            x0: 36,
            y0: 28,
            x1: 38,
            y1: 29,
        };
        let area = Area::around(
            region,
            4,
            Lattice::LOOKUP_REACH + Lattice::SMOOTHING_REACH,
            [100, 60],
        );
        assert_eq!((area.first, area.count), ([3, 1], [14, 14]));
        let squares = area.squares(Lattice::SQUARE_EDGE).len();
        assert_eq!(squares, 5 * 4);
        // All cells may be refined, but for those of a pixel.
        for (step, per_place) in [(4, 2), (1, 1)] {
            let area = Area::around(
                region,
                step,
                Lattice::LOOKUP_REACH + Lattice::SMOOTHING_REACH,
                [100, 60],
            );
            let squares = area.squares(Lattice::SQUARE_EDGE).len();
            let lists = squares * 16 * size_of::<(usize, LatticeGather)>();
            let least = lists + area.len() * per_place * size_of::<Option<LatticeGather>>();
            let bytes = Lattice::bytes(region, step, [100, 60]) as usize;
            assert!(
                bytes >= least && bytes < least + least / 6,
                "{bytes} {least}"
            );
        }
    }
}
