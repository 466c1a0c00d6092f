//! What the parts of a frame will cost, by a pilot that counts: rays, cells and lvoxels of few
//! pixels and gathers all over the frame, each with a fixed price. Seconds would not be the same
//! twice.

use super::frame::{FrameShader, FrameWork, Request};
use super::pixels::{
    CameraMedia, Confusion, EmitterBorders, PassedMedia, PilotMarch, PilotPixel, PixelShader,
    SampleCounts,
};
use super::settings::Settings;
use super::surfaces::Lattice;
use crate::Result;
use crate::gather::UnknownPatches;
use crate::image::{CellCost, CostMap, Region};
use crate::inscatter::{Marched, MediaCounts};
use crate::light::Lights;
use crate::math::sampling;
use crate::run::Walked;
use crate::trace::Surface;
use rayon::prelude::*;

/// Cells that a frame is looked at in, at least, if they are not smaller than the smallest.
const CELLS: usize = 1536;
/// Edges of cells, pixels.
const CELL_EDGES: [u32; 6] = [64, 48, 32, 24, 16, 8];
/// Pixels whose corners are looked at in each cell, along each axis.
const PIXELS_ALONG_CELL: u32 = 2;

/// Nanoseconds, about, of one thread of a processor of 2023; what counts is how they compare.
struct Price;

impl Price {
    /// A ray through triangles, and what is done with what it met.
    const RAY: f64 = 280.0;
    /// A cell of a medium that a shadow ray passed.
    const CELL: f64 = 20.0;
    /// An lvoxel that a ray passed.
    const LVOXEL: f64 = 40.0;
    /// A cell that a camera ray marched through.
    const MARCHED: f64 = 30.0;
    /// A part of a camera ray that was lit.
    const SEGMENT: f64 = 180.0;
    /// A cell that all rays of a sweep passed.
    const SWEPT: f64 = 18.0;
    /// A point of a medium that is lit, beside its rays.
    const LIT: f64 = 400.0;
    /// A point of a medium that gathers, beside its rays.
    const GATHERED: f64 = 2000.0;
    /// A pixel, beside its rays.
    const PIXEL: f64 = 150.0;
    /// A pixel that shows a surface more: indirect light is looked up.
    const SURFACE: f64 = 600.0;
    /// A sample inside a pixel, beside its rays.
    const SAMPLE: f64 = 150.0;
    /// A gather, beside its rays: it is averaged with others.
    const GATHER: f64 = 2000.0;

    fn of(walked: Walked) -> f64 {
        Self::RAY * walked.rays as f64
            + Self::CELL * walked.cells as f64
            + Self::LVOXEL * walked.lvoxels as f64
    }

    /// Light in media, but for what camera rays took themselves.
    fn of_light(counts: &MediaCounts) -> f64 {
        Self::LVOXEL * counts.lvoxels as f64 + Self::SWEPT * counts.cells as f64
    }

    fn of_march(marched: Marched) -> f64 {
        Self::MARCHED * marched.cells as f64 + Self::SEGMENT * marched.segments as f64
    }
}

/// The square cells that a frame is looked at in.
struct Cells {
    edge: u32,
    /// Row by row; those at the right and lower border may be smaller.
    regions: Vec<Region>,
}

impl Cells {
    fn of(film: [u32; 2]) -> Self {
        let all = Region::full(film[0], film[1]);
        let [larger @ .., smallest] = CELL_EDGES;
        let count = |edge: u32| film.map(|n| n.div_ceil(edge) as usize);
        let is_enough = |edge: &u32| count(*edge).into_iter().product::<usize>() >= CELLS;
        let edge = larger.into_iter().find(is_enough).unwrap_or(smallest);
        Self {
            edge,
            regions: all.blocks([edge; 2]),
        }
    }
}

/// A pilot of what the parts of a frame will cost.
#[derive(Clone, Copy, Debug)]
pub struct CostPilot;

impl FrameWork for CostPilot {
    type Output = CostMap;

    fn gather_rays(&self, request: &Request) -> usize {
        let film = request.scene.film;
        let cells = Cells::of([film.width, film.height]);
        cells.regions.len() * request.settings.samples as usize
    }

    fn run<A: CameraMedia>(
        &self,
        frame: &FrameShader,
        media: &A,
        lights: &Lights<A::Shadows>,
    ) -> Result<CostMap> {
        let view = frame.view;
        let &Request { settings, job, .. } = frame.request;
        let film = [view.film.width, view.film.height];
        let borders = EmitterBorders::new(&view, NOWHERE, settings.edge_samples, &job.cancel)?;
        let pilot = Pilot {
            frame,
            shader: PixelShader {
                view,
                borders: &borders,
                lights,
                lattice: &Lattice::empty(settings.lattice)?,
                gatherer: frame.own_gatherer,
                media,
                counts: SampleCounts::of(settings),
                shows_background: settings.background,
                media_have_colors: view.tracer.scene.has_albedo_grids(),
                ends: None,
                cancel: &job.cancel,
            },
        };
        let cells = Cells::of(film);
        let task = (job.progress).task("pilot", cells.regions.len() as u64, "cells");
        let looked = cells.regions.par_iter().map(|&cell| {
            job.cancel.check()?;
            Ok(pilot.look(cell))
        });
        let looked = looked.collect::<Result<Vec<_>>>()?;
        let swept = Price::of_light(&media.counts());
        let gathers = pilot.gather(&looked)?;
        let marches = pilot.march(&cells.regions)?;
        task.add(cells.regions.len() as u64);
        let costs: Vec<CellCost> = (looked.iter().zip(gathers).zip(marches))
            .map(|((cell, gather), march)| CellCost {
                own: cell.own + march,
                around: gather,
                is_swept: march > 0.0,
            })
            .collect();
        let step = settings.lattice;
        let spread = match view.camera.is_pinhole() {
            true => 0,
            false => Confusion::of(&view).reach(),
        };
        let reach = [CORNERS_AROUND + spread, Lattice::reach(step) + spread];
        let once = SHARE_OF_SWEEPS * swept;
        Ok(CostMap::new(film, cells.edge, &costs, step, reach).with_sweeps(once))
    }
}

/// Pixels around a tile whose corners it looks at.
const CORNERS_AROUND: u32 = 3;

/// No pixel of a frame.
const NOWHERE: Region = Region {
    x0: 0,
    y0: 0,
    x1: 0,
    y1: 0,
};

/// The work of a pilot.
struct Pilot<'a, A: CameraMedia> {
    frame: &'a FrameShader<'a>,
    shader: PixelShader<'a, A>,
}

/// A cell whose pixels were looked at.
struct LookedAt {
    /// What a pixel costs without gathers and media before it.
    own: f64,
    /// The share of the pixels that see a surface.
    covered: f64,
    /// One of those surfaces, and how far away it is.
    surface: Option<(Surface, f32)>,
    /// Key of the cell's random choices.
    key: u64,
}

impl<A: CameraMedia> Pilot<'_, A> {
    /// Looks at a few pixels of a cell.
    fn look(&self, cell: Region) -> LookedAt {
        let key = sampling::seeded(self.shader.view.seed, &[cell.x0, cell.y0].map(u64::from));
        const ALONG: u32 = PIXELS_ALONG_CELL;
        let pixels = (0..ALONG * ALONG).map(|i| {
            let [u, v] = sampling::unit2(sampling::seeded(key, &[i.into()]));
            let within = |from: u32, to: u32, part: u32, u: f32| {
                let at = (part as f32 + u) / ALONG as f32 * (to - from) as f32;
                (from + at as u32).min(to - 1)
            };
            let x = within(cell.x0, cell.x1, i % ALONG, u);
            let y = within(cell.y0, cell.y1, i / ALONG, v);
            self.shader.pilot(x, y)
        });
        let pixels: Vec<PilotPixel> = pixels.collect();
        let share = 1.0 / pixels.len() as f64;
        let seen: Vec<_> = pixels.iter().filter_map(|p| p.surface).collect();
        let chosen = (sampling::unit(key) * seen.len() as f32) as usize;
        LookedAt {
            own: pixels.iter().map(|p| self.price(p)).sum::<f64>() * share,
            covered: seen.len() as f64 * share,
            surface: seen.get(chosen.min(seen.len().max(1) - 1)).copied(),
            key,
        }
    }

    /// What a pixel costs by itself.
    fn price(&self, pixel: &PilotPixel) -> f64 {
        let counts = &self.shader.counts;
        let edge = counts.edge_of(pixel.is_masked);
        // Pixels share corners with their neighbours.
        let corner = 0.25 * Price::of(pixel.corners);
        let shadows = (corner - Price::RAY).max(0.0);
        let sample = corner + Price::SAMPLE + shadows * f64::from(counts.shadow - 1);
        let mut price = Price::PIXEL;
        if pixel.surface.is_some() {
            price += Price::SURFACE;
        }
        if counts.pixel > 1 {
            let more = edge.saturating_sub(counts.pixel);
            let differs = pixel.has_edge || pixel.has_penumbra;
            let samples = counts.pixel + if differs { more } else { 0 };
            return price + f64::from(samples) * sample;
        }
        price += corner;
        if pixel.has_penumbra {
            price += PENUMBRA_RAYS * shadows;
        }
        if pixel.has_edge {
            price += f64::from(edge) * sample;
        }
        price
    }

    /// What the gathers of each cell cost, by pixel.
    fn gather(&self, cells: &[LookedAt]) -> Result<Vec<f64>> {
        let gatherer = self.frame.lattice_gatherer;
        let Settings {
            lattice, samples, ..
        } = *self.frame.request.settings;
        let cancel = &self.frame.request.job.cancel;
        let order = gatherer.order(1);
        if gatherer.has_unknown() {
            let unknown = cells.par_iter().filter_map(|cell| {
                let (surface, _) = cell.surface?;
                Some(gatherer.unknown_to_neighbours(&[(surface, 0)], cell.key, &order))
            });
            gatherer.evaluate(UnknownPatches::of_all(unknown.collect()));
        }
        let gathers = cells.par_iter().map(|cell| {
            cancel.check()?;
            let Some((surface, t)) = cell.surface else {
                return Ok(0.0);
            };
            let before = Walked::of_thread();
            let gathered = gatherer.gather_neighbours(&[(surface, 0)], cell.key, &order);
            // Patches may be evaluated for whichever gather is first: only that takes other rays.
            let walked = Walked {
                rays: samples.into(),
                ..Walked::of_thread() - before
            };
            let view = &self.shader.view;
            let spacing = t * view.pixel_angle * lattice as f32;
            let seen = (surface.position, surface.face_normal);
            let is_tight = (gathered.iter()).any(|g| Lattice::is_tight(view, seen, spacing, g));
            let count = if is_tight && lattice > 1 { 2.0 } else { 1.0 };
            let price = count * (Price::of(walked) + Price::GATHER);
            Ok(cell.covered * price / f64::from(lattice * lattice))
        });
        let gathers = gathers.collect::<Result<Vec<_>>>()?;
        gatherer.check()?;
        Ok(gathers)
    }

    /// What the media before each cell cost, by pixel.
    fn march(&self, cells: &[Region]) -> Result<Vec<f64>> {
        if A::Passed::IS_VACUUM {
            return Ok(vec![0.0; cells.len()]);
        }
        let cancel = &self.frame.request.job.cancel;
        let march = |cell: &Region| {
            cancel.check()?;
            let x = cell.x0 + cell.width() / 2;
            let y = cell.y0 + cell.height() / 2;
            Ok(self.shader.pilot_march(x, y))
        };
        let count = || (Walked::so_far(), self.shader.media.counts());
        let before = count();
        let first: Result<Vec<_>> = cells.par_iter().map(march).collect();
        drop(first?);
        let between = count();
        // Once all vertices are lit, each ray tells what it takes itself.
        let again = cells.par_iter().map(march).collect::<Result<Vec<_>>>()?;
        let own = |took: &PilotMarch| {
            let marched = took.marched;
            Price::of(took.walked) - Price::CELL * marched.cells as f64 + Price::of_march(marched)
        };
        let after = count();
        let samples = f64::from(self.shader.counts.volume);
        let lights = |from: &(Walked, MediaCounts), to: &(Walked, MediaCounts)| {
            let walked = to.0 - from.0;
            let gathered = (to.1.gathered - from.1.gathered) as f64;
            let gather = Price::LVOXEL * walked.lvoxels as f64
                + gathered * (Price::GATHERED + samples * Price::RAY);
            let lit = Price::LIT * (to.1.lit - from.1.lit) as f64;
            let direct = Price::of(walked)
                - Price::LVOXEL * walked.lvoxels as f64
                - gathered * samples * Price::RAY;
            [lit + direct, gather]
        };
        let [first, again_all] = [lights(&before, &between), lights(&between, &after)];
        // What lit the vertices cannot be told for each ray, as rays share them: each pays by those
        // that it asks.
        let asked = |walked: &Walked| {
            let to_gather = walked.asked_to_gather;
            [walked.asked - to_gather, to_gather].map(|n| n as f64)
        };
        let all = asked(&(after.0 - between.0));
        let each: [f64; 2] = std::array::from_fn(|i| (first[i] - again_all[i]) / all[i].max(1.0));
        let price = |took: &PilotMarch| {
            let [direct, gather] = asked(&took.walked);
            let vertices = direct * each[0] + gather * each[1];
            took.share * own(took) + SHARE_OF_VERTEX * vertices
        };
        Ok(again.iter().map(price).collect())
    }
}

/// Shadow rays more of a corner in a penumbra.
const PENUMBRA_RAYS: f64 = 3.0;
/// Of the cells that the sweeps of a frame pass, the share that those of a tile do which sees the
/// medium: they come from all around it.
const SHARE_OF_SWEEPS: f64 = 0.4;
/// Of the vertices that a ray of a pilot needs first, what each pixel of a picture does on average,
/// as others need them, too.
const SHARE_OF_VERTEX: f64 = 0.01;
