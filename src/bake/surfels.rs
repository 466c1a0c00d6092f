//! Area sampling of every surface: the cloud serves every camera, and what no camera sees bleeds
//! too.

use super::check_surfels;
use super::creases::Creases;
use crate::Result;
use crate::light::{Lights, ShadowRays, Shadows};
use crate::math::{Rgb, sampling};
use crate::run::Cancel;
use crate::scene::Scene;
use crate::trace::{Surface, Tracer};
use lvox_formats::record::Surfel;
use rayon::prelude::*;
use std::f32::consts::{FRAC_1_PI, PI};
use std::ops::Range;

/// The surfels of a bake, each made from its number alone.
pub struct SurfelSource<'a> {
    /// Numbers, of which some make no surfel.
    pub samples: u64,
    /// What the numbers are of, for progress.
    pub unit: &'static str,
    /// The surfel of a number below that.
    pub make: Box<dyn Fn(u64) -> Option<Surfel> + Sync + 'a>,
    /// The scene, if numbers that follow each other are on triangles that do.
    pub walked_mesh: Option<&'a Scene>,
}

impl<'a> SurfelSource<'a> {
    /// Surfels all over the area of a scene, their disks `overlap` times wider than disks of their
    /// area.
    pub fn by_area<S: Shadows>(
        maker: &'a SurfelMaker<'a, S>,
        sampler: AreaSampler<'a>,
        overlap: f32,
    ) -> Self {
        Self {
            samples: sampler.count(),
            unit: "surfels",
            make: Box::new(move |i| {
                let (triangle, uv) = sampler.sample(i);
                // So that the areas of those that are made add up to what masks leave.
                if maker.tracer.is_clear(triangle, uv) {
                    return None;
                }
                let area = sampler.area_per_sample(triangle);
                Some(maker.make(triangle, uv, area, overlap, i))
            }),
            walked_mesh: Some(maker.tracer.scene),
        }
    }

    /// The surfels of some numbers.
    ///
    /// # Errors
    /// A stop on request, or a surfel that files cannot hold.
    pub fn batch(&self, numbers: Range<u64>, cancel: &Cancel) -> Result<Vec<Surfel>> {
        let batch: Vec<Option<Surfel>> = numbers
            .into_par_iter()
            .map(|i| {
                cancel.check()?;
                Ok((self.make)(i))
            })
            .collect::<Result<_>>()?;
        let batch: Vec<Surfel> = batch.into_iter().flatten().collect();
        check_surfels(&batch)?;
        // The next batch is on other triangles.
        if let Some(scene) = self.walked_mesh {
            scene.release_mesh();
        }
        Ok(batch)
    }
}

/// Systematic sampling over the running area of a mesh, with that of each piece times its density:
/// sample `i` stands for one step of that, so counts follow area exactly, tiny triangles included,
/// and any range of samples can be made on its own.
#[derive(Debug)]
pub struct AreaSampler<'a> {
    tracer: &'a Tracer<'a>,
    /// Of all triangles before each [`PIECE`] of them, and of all.
    running_area: Vec<f64>,
    step: f64,
    count: u64,
    offset: f64,
    seed: u64,
}

/// Triangles between two running areas that are kept.
const PIECE: usize = 16;

/// Area of a triangle times the density of its piece.
fn weighted_area(tracer: &Tracer<'_>, triangle: usize) -> f64 {
    let mesh = &tracer.scene.mesh;
    let [a, b, c] = mesh.corners(triangle).map(|p| p.as_dvec3());
    let density = tracer.pieces.density(mesh.material_of(triangle));
    density * 0.5 * (b - a).cross(c - a).length()
}

impl<'a> AreaSampler<'a> {
    /// A sampler of about `count` points over the triangles of a scene.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>, count: u64, seed: u64) -> Self {
        let mesh = &tracer.scene.mesh;
        let (flat, triangles) = (mesh.flat_count(), mesh.triangle_count());
        let mut sum = 0.0;
        let mut running_area = Vec::with_capacity(triangles / PIECE + 2);
        let alone = flat.next_multiple_of(PIECE).min(triangles);
        for t in 0..alone {
            if t % PIECE == 0 {
                running_area.push(sum);
            }
            sum += weighted_area(tracer, t);
        }
        // Of instances there may be a hundred times as many: pieces of them side by side.
        let pieces = (alone..triangles).into_par_iter().step_by(PIECE);
        let areas = pieces.map(|first| {
            let piece = first..triangles.min(first + PIECE);
            let areas = mesh.placed_areas(piece);
            let weighted = areas.map(|(m, area)| tracer.pieces.density(m) * area);
            weighted.sum::<f64>()
        });
        for area in areas.collect::<Vec<f64>>() {
            running_area.push(sum);
            sum += area;
        }
        running_area.push(sum);
        let count = if sum > 0.0 { count.max(1) } else { 0 };
        let offset = f64::from(sampling::unit(sampling::mix(seed)));
        Self {
            tracer,
            running_area,
            step: sum / count.max(1) as f64,
            count,
            offset,
            seed,
        }
    }

    /// Samples over all surfaces; [`Self::sample`] takes numbers below it.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Area that a sample of a triangle stands for.
    #[must_use]
    pub fn area_per_sample(&self, triangle: u32) -> f32 {
        let material = self.tracer.scene.mesh.material_of(triangle as usize);
        (self.step / self.tracer.pieces.density(material)) as f32
    }

    /// Triangle of a sample, and the barycentric weights of its second and third corner.
    #[must_use]
    pub fn sample(&self, i: u64) -> (u32, [f32; 2]) {
        let target = (i as f64 + self.offset) * self.step;
        let pieces = self.running_area.len() - 1;
        let piece = self.running_area[1..].partition_point(|&a| a <= target);
        let piece = piece.min(pieces - 1);
        let triangles = self.tracer.scene.mesh.triangle_count();
        let (first, end) = (piece * PIECE, triangles.min((piece + 1) * PIECE));
        // The same sum as that over all, from here on.
        let mut before = self.running_area[piece];
        let mut t = first;
        while t + 1 < end {
            let behind = before + weighted_area(self.tracer, t);
            if behind > target {
                break;
            }
            before = behind;
            t += 1;
        }
        let first = (before / self.step - self.offset).ceil().max(0.0) as u64;
        let bits = sampling::hash(&[self.seed, t as u64]);
        let u = sampling::r2(i.saturating_sub(first), sampling::unit2(bits));
        let w = sampling::triangle(u);
        (t as u32, [w[1], w[2]])
    }
}

/// Makes surfels: what they are lit by, and where their disks end.
#[derive(Debug)]
pub struct SurfelMaker<'a, S> {
    /// The scene, for shadow rays and for where samples lie.
    pub tracer: &'a Tracer<'a>,
    /// The lights of the scene.
    pub lights: &'a Lights<'a, S>,
    /// Creases at which disks end.
    pub creases: &'a Creases<'a>,
    /// Shadow rays to each area light, a side.
    pub shadow_rays: u32,
    /// Key of the bake.
    pub seed: u64,
}

impl<S: Shadows> SurfelMaker<'_, S> {
    /// The surfel at a point of a triangle that stands for `area`, its disk `overlap` times wider
    /// than a disk of that area; `key` tells it from others.
    #[must_use]
    pub fn make(&self, triangle: u32, uv: [f32; 2], area: f32, overlap: f32, key: u64) -> Surfel {
        let surface = Surface::new(self.tracer.scene, triangle, uv);
        let radius = overlap * (area / PI).sqrt();
        let leaving = |side: Surface| {
            if side.albedo.is_black() {
                return Rgb::BLACK;
            }
            let seed = sampling::hash(&[self.seed, key]);
            let sequence = |per_light| ShadowRays::Sequence {
                per_light,
                first: 0,
                seed,
            };
            let (rays, all_round) = (sequence(self.shadow_rays), sequence(4 * self.shadow_rays));
            let (p, n, f) = (side.position, side.normal, side.face_normal);
            let light = self.lights.irradiance(p, n, f, rays).light()
                + self.lights.environment_irradiance(p, n, f, all_round);
            side.albedo * light * FRAC_1_PI
        };
        Surfel {
            position: surface.position.to_array(),
            normal: surface.face_normal.to_array(),
            radius,
            area,
            front: leaving(surface).0,
            back: leaving(surface.facing(-surface.face_normal)).0,
            clips: self
                .creases
                .clips(triangle, surface.position, surface.face_normal, radius),
        }
    }
}
