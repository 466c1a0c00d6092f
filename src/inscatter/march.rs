//! The way of a camera ray through media: how much of what is behind comes through, and what they
//! add.

use super::counts;
use super::gatherer::GatherInMedia;
use super::seen_channels::{OPAQUE, SeenChannels};
use super::source::{InScatter, RayMemo};
use crate::math::segment::{Composite, Segment};
use crate::math::{Ray, Rgb, Spectrum};
use crate::trace::{Cells, RayInVolume};
use glam::Vec3;
use std::cell::{Cell, RefCell};

/// What a march took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Marched {
    /// Cells that the ray passed; of media that may overlap those that were lit.
    pub cells: u64,
    /// Segments whose source function was asked for.
    pub segments: u64,
}

/// Cells in a row that are lit as one.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    near: f32,
    far: f32,
    tau: f32,
    /// Optical depth times the middle of each cell.
    moment: f32,
    cells: u32,
}

/// A camera ray on its way.
struct CameraRay<'a, 'b, G: GatherInMedia> {
    light: &'a InScatter<'b, G>,
    ray: &'a Ray,
    passed: Composite<G::Share>,
    /// Extinction by channel over that of the cells.
    color: [f32; 3],
    memo: RayMemo,
    /// What the last lit part of the ray sends.
    source: Rgb,
    /// Parts that were lit.
    lit: u64,
    /// Cells that are not lit yet.
    open: Option<Stretch>,
    /// Where they end at the latest.
    end: f32,
    /// Edge of a voxel.
    voxel: f32,
}

/// Optical depth of cells that are lit as one, at most, where all of it is seen; what is seen by a
/// share may be deeper.
const STRETCH_DEPTH: f32 = 0.3;
/// The most that is lit as one.
const MAX_STRETCH_DEPTH: f32 = 0.7;
/// The same at fronts, where each part is lit at points of its own.
const FRONT_STRETCH_DEPTH: f32 = 0.5;
const MAX_FRONT_STRETCH_DEPTH: f32 = 2.0;

/// Optical depth of a cell that is lit in pieces, and of a row of cells that is lit as one at most,
/// where this share of the light is seen.
#[inline]
fn stretch_depths(is_front: bool, seen: f32) -> [f32; 2] {
    match is_front {
        true => [(FRONT_STRETCH_DEPTH / seen).min(MAX_FRONT_STRETCH_DEPTH); 2],
        false => [STRETCH_DEPTH, (STRETCH_DEPTH / seen).min(MAX_STRETCH_DEPTH)],
    }
}

impl<G: GatherInMedia> InScatter<'_, G> {
    /// Passes a ray from the camera.
    pub fn march(&self, ray: &Ray) -> Composite<G::Share> {
        self.march_counted(ray).0
    }

    /// Passes a ray from the camera, and tells what that took: cells that it passed, and segments
    /// whose source function was asked for.
    pub fn march_counted(&self, ray: &Ray) -> (Composite<G::Share>, Marched) {
        match self.view.tracer.volumes {
            [volume] => match Cells::new(volume, ray) {
                Some(cells) => self.march_one(ray, cells, volume.extinction_color),
                None => Default::default(),
            },
            _ => self.march_all(ray),
        }
    }

    /// Passes a single volume.
    fn march_one(
        &self,
        ray: &Ray,
        cells: Cells,
        color: [f32; 3],
    ) -> (Composite<G::Share>, Marched) {
        let voxel = self.view.tracer.volumes[0].longest_voxel_edge();
        let mut camera_ray = CameraRay {
            light: self,
            ray,
            passed: Composite::default(),
            color,
            memo: RayMemo::default(),
            source: Rgb::BLACK,
            lit: 0,
            open: None,
            end: 0.0,
            voxel,
        };
        let mut marched = 0;
        let shows_voxels = |edge, distance| self.view.shows_voxels(edge * voxel, distance);
        cells.each_by_middle(shows_voxels, |cell| {
            marched += 1;
            match cell.far - cell.near <= 3.0_f32.sqrt() * voxel {
                true => camera_ray.add_cell(cell),
                false => camera_ray.add_coarse_cell(cell),
            }
        });
        camera_ray.light_open();
        counts::add(&self.counters.marched, marched);
        counts::add(&self.counters.segments, camera_ray.lit);
        let took = Marched {
            cells: marched,
            segments: camera_ray.lit,
        };
        (camera_ray.passed, took)
    }

    /// Passes volumes that may overlap.
    fn march_all(&self, ray: &Ray) -> (Composite<G::Share>, Marched) {
        let mut passed = Composite::<G::Share>::default();
        let memo = RefCell::new(RayMemo::default());
        // What the ray sees last, once that is all that it sees.
        let last = Cell::new(None);
        let lit = Cell::new(0);
        let seen = Cell::new(passed.transmittance);
        self.view.tracer.march(
            ray,
            |volume, part, _| {
                last.get().unwrap_or_else(|| {
                    lit.set(lit.get() + 1);
                    let ends = [ray.at(part.near), ray.at(part.far)];
                    let memo = &mut memo.borrow_mut();
                    self.source(volume, ends, part.tau, seen.get(), memo)
                })
            },
            |s: Segment<G::Share>| {
                passed.medium(s.tau, s.source);
                seen.set(passed.transmittance);
                if passed.transmittance.most() < OPAQUE && last.get().is_none() {
                    last.set(Some(s.source));
                }
                passed.transmittance.most() > Composite::<G::Share>::NOTHING
            },
        );
        counts::add(&self.counters.segments, lit.get());
        let took = Marched {
            cells: lit.get(),
            segments: lit.get(),
        };
        (passed, took)
    }
}

impl Stretch {
    fn add(&mut self, cell: RayInVolume) {
        self.far = cell.far;
        self.tau += cell.tau;
        self.cells += 1;
        self.moment += cell.tau * (0.5 * (cell.near + cell.far));
    }
}

impl<G: GatherInMedia> CameraRay<'_, '_, G> {
    /// Adds a cell to those in a row that are lit as one; `false` once nothing is seen of the next.
    #[inline]
    fn add_cell(&mut self, cell: RayInVolume) -> bool {
        let seen = self.passed.transmittance.most();
        if seen < OPAQUE {
            self.pass(cell.tau);
            let seen = self.passed.transmittance.most();
            return seen > Composite::<G::Share>::NOTHING;
        }
        let of_seen = SeenChannels::new(self.passed.transmittance, &self.color).extinction;
        let front = self.front_spacing(cell);
        let [deepest, depth] = stretch_depths(front.is_some(), seen);
        if cell.tau * of_seen > deepest {
            self.light_open();
            cell.pieces().for_each(|piece| self.add_piece(piece));
            return true;
        }
        if let Some(stretch) = self.open.as_mut() {
            let fits = (stretch.tau + cell.tau) * of_seen <= depth && cell.far <= self.end;
            if fits {
                stretch.add(cell);
                return true;
            }
            self.light_open();
        }
        self.end = cell.near + front.unwrap_or_else(|| self.even_spacing(cell));
        let mut stretch = Stretch {
            near: cell.near,
            far: cell.near,
            tau: 0.0,
            moment: 0.0,
            cells: 0,
        };
        stretch.add(cell);
        self.open = Some(stretch);
        true
    }

    /// The same of one so wide that light may change in it: it is cut where others in a row end.
    fn add_coarse_cell(&mut self, cell: RayInVolume) -> bool {
        let mut rest = cell;
        loop {
            let end = match self.open {
                Some(_) if self.end > rest.near + self.voxel => self.end,
                _ => {
                    self.light_open();
                    let (first, _) = rest.cut(rest.near + self.voxel);
                    let front = self.front_spacing(first);
                    let longest = front.unwrap_or_else(|| self.even_spacing(first));
                    rest.near + longest.max(self.voxel)
                }
            };
            let (first, behind) = rest.cut(end);
            if !self.add_cell(first) {
                return false;
            }
            match behind {
                Some(behind) => rest = behind,
                None => return true,
            }
        }
    }

    /// Lights the cells that are not lit yet.
    fn light_open(&mut self) {
        if let Some(stretch) = self.open.take() {
            self.add_stretch(stretch);
        }
    }

    fn front_spacing(&self, cell: RayInVolume) -> Option<f32> {
        self.light.front_spacing(0, self.middle(cell))
    }

    /// Scene units around a cell that need no light between.
    fn even_spacing(&self, cell: RayInVolume) -> f32 {
        let least = self.light.least_spacing(0, self.middle(cell));
        least.max(self.memo.evenly_lit())
    }

    fn middle(&self, cell: RayInVolume) -> Vec3 {
        self.ray.at(0.5 * (cell.near + cell.far))
    }

    /// A part of a cell.
    fn add_piece(&mut self, piece: RayInVolume) {
        let ends = [self.ray.at(piece.near), self.ray.at(piece.far)];
        self.add(ends, piece.tau);
    }

    /// Cells in a row, lit around the middle of what they hold.
    fn add_stretch(&mut self, s: Stretch) {
        let shift = if s.cells > 1 && s.tau > 0.0 {
            s.moment / s.tau - 0.5 * (s.near + s.far)
        } else {
            0.0
        };
        let ends = [self.ray.at(s.near + shift), self.ray.at(s.far + shift)];
        self.add(ends, s.tau);
    }

    fn add(&mut self, ends: [Vec3; 2], tau: f32) {
        let seen = self.passed.transmittance;
        self.source = self.light.source(0, ends, tau, seen, &mut self.memo);
        self.lit += 1;
        self.pass(tau);
    }

    /// Passes a part of such a depth that sends what the last one did.
    fn pass(&mut self, tau: f32) {
        let tau = G::Share::tinted(tau, &self.color);
        self.passed.medium(tau, self.source);
    }
}
