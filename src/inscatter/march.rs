//! The way of a camera ray through media: how much of what is behind comes through, and what they
//! add.

use super::counts;
use super::gatherer::GatherInMedia;
use super::seen_channels::{OPAQUE, SeenChannels};
use super::source::{InScatter, RayMemo};
use crate::math::segment::{Composite, Segment};
use crate::math::{Ray, Rgb, Spectrum};
use crate::trace::{Cells, RayInVolume};
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
        let mut camera_ray = CameraRay {
            light: self,
            ray,
            passed: Composite::default(),
            color,
            memo: RayMemo::default(),
            source: Rgb::BLACK,
            lit: 0,
        };
        let mut open: Option<Stretch> = None;
        let mut most = 0.0;
        let mut marched = 0;
        let voxel = self.view.tracer.volumes[0].longest_voxel_edge();
        let shows_voxels = |edge, distance| self.view.shows_voxels(edge * voxel, distance);
        let mut add = |camera_ray: &mut CameraRay<G>, cell: RayInVolume| {
            let seen = camera_ray.passed.transmittance.most();
            if seen < OPAQUE {
                camera_ray.pass(cell.tau);
                let seen = camera_ray.passed.transmittance.most();
                return seen > Composite::<G::Share>::NOTHING;
            }
            let through = camera_ray.passed.transmittance;
            let of_seen = SeenChannels::new(through, &color).extinction;
            let front = self.front_spacing(0, ray.at(0.5 * (cell.near + cell.far)));
            let [deepest, depth] = stretch_depths(front.is_some(), seen);
            if cell.tau * of_seen > deepest {
                if let Some(stretch) = open.take() {
                    camera_ray.add_stretch(stretch);
                }
                cell.pieces().for_each(|piece| camera_ray.add_piece(piece));
                return true;
            }
            if let Some(stretch) = open.as_mut() {
                let fits =
                    (stretch.tau + cell.tau) * of_seen <= depth && cell.far - stretch.near <= most;
                if fits {
                    stretch.add(cell);
                    return true;
                }
                camera_ray.add_stretch(*stretch);
            }
            let least = || self.least_spacing(0, ray.at(0.5 * (cell.near + cell.far)));
            most = front.unwrap_or_else(|| least().max(camera_ray.memo.evenly_lit()));
            let mut stretch = Stretch {
                near: cell.near,
                far: cell.near,
                tau: 0.0,
                moment: 0.0,
                cells: 0,
            };
            stretch.add(cell);
            open = Some(stretch);
            true
        };
        cells.each_by_middle(shows_voxels, |cell| {
            marched += 1;
            if cell.far - cell.near <= 3.0_f32.sqrt() * voxel {
                return add(&mut camera_ray, cell);
            }
            // Light may change within a coarse cell.
            let middle = ray.at(0.5 * (cell.near + cell.far));
            let longest = (self.front_spacing(0, middle)).unwrap_or_else(|| {
                (self.least_spacing(0, middle)).max(camera_ray.memo.evenly_lit())
            });
            let mut parts = cell.parts(longest.max(voxel));
            parts.all(|part| add(&mut camera_ray, part))
        });
        if let Some(stretch) = open.take() {
            camera_ray.add_stretch(stretch);
        }
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

    fn add(&mut self, ends: [glam::Vec3; 2], tau: f32) {
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
