//! Indirect light on surfaces, gathered at few pixels and spread to all.
//!
//! Gathers stand at the pixels whose coordinates are multiples of the spacing: a lattice of the whole frame, which no
//! tile can move, so that merged tiles equal the frame. A surface point then averages the lattice around it, weighted
//! by how alike normal and plane are and by distance over the harmonic distance of what was seen there, which is how
//! fast indirect light can change (Ward & Heckbert 1992 for the measure).

use super::view::View;
use crate::gather::{Gathered, Gatherer, Pages};
use crate::image::Region;
use crate::math::{Rgb, sampling};
use crate::run::{Cancel, Task};
use crate::trace::Surface;
use crate::{Result, math};
use glam::Vec3;
use rayon::prelude::*;

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
    first: [u32; 2],
    count: [u32; 2],
    nodes: Vec<Option<Node>>,
}

impl Lattice {
    /// Pixels around a surface point from which its light is taken, in lattice steps.
    const REACH: u32 = 2;
    /// Distance at which a gather's weight falls to 1/e, over the harmonic distance at both ends.
    const RANGE: f32 = 0.25;
    /// The least such distance, in lattice steps.
    const LEAST: f32 = 0.35;
    /// Below this sum of weights a surface gathers for itself.
    const TOO_FEW: f32 = 0.4;

    /// Gathers at the lattice pixels in and around a region.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new<P: Pages>(
        view: &View,
        gatherer: &Gatherer<P>,
        region: Region,
        step: u32,
        cancel: &Cancel,
        task: &Task,
    ) -> Result<Self> {
        let [w, h] = [view.film.width, view.film.height];
        let from = |v: u32| (v / step).saturating_sub(Self::REACH);
        // A pixel's lower right corner has the next one's coordinates.
        let to = |v: u32, n: u32| (v / step + 1 + Self::REACH).min((n - 1) / step);
        let first = [from(region.x0), from(region.y0)];
        let last = [to(region.x1, w), to(region.y1, h)];
        let count = [last[0] - first[0] + 1, last[1] - first[1] + 1];
        let rows: Vec<Vec<Option<Node>>> = (0..count[1])
            .into_par_iter()
            .map(|j| {
                cancel.check()?;
                let row = (0..count[0])
                    .map(|i| {
                        Self::gather_at(
                            view,
                            gatherer,
                            (first[0] + i) * step,
                            (first[1] + j) * step,
                            step,
                        )
                    })
                    .collect();
                task.add(u64::from(count[0]));
                Ok(row)
            })
            .collect::<Result<_>>()?;
        Ok(Self {
            step,
            first,
            count,
            nodes: rows.into_iter().flatten().collect(),
        })
    }

    fn gather_at<P: Pages>(
        view: &View,
        gatherer: &Gatherer<P>,
        x: u32,
        y: u32,
        step: u32,
    ) -> Option<Node> {
        let direction = view
            .camera
            .direction(&view.film, x as f32 + 0.5, y as f32 + 0.5);
        let hit = view
            .tracer
            .closest(view.camera.origin(), direction, f32::INFINITY)?;
        let surface = Surface::new(view.tracer.scene, hit.triangle, hit.uv).facing(-direction);
        let seed = sampling::hash(&[view.seed, u64::from(x), u64::from(y)]);
        Some(Node {
            position: surface.position,
            normal: surface.normal,
            gathered: gather_surface(view, gatherer, &surface, seed),
            spacing: hit.t * view.pixel_angle * step as f32,
        })
    }

    /// Irradiance at a surface seen by pixel (x, y); `None` if the lattice around it saw nothing like it.
    #[must_use]
    pub fn irradiance(&self, surface: &Surface, x: u32, y: u32) -> Option<Rgb> {
        let near = |v: u32, first: u32, count: u32| {
            let c = v / self.step;
            let lower = c.saturating_sub(Self::REACH).max(first) - first;
            let upper = (c + 1 + Self::REACH).min(first + count - 1) - first;
            lower..=upper
        };
        // What the neighbours saw, the nearest above all, tells how far light can be carried to this point.
        let mut candidates = [(0.0_f32, 0.0_f32, 0_usize); 36];
        let mut count = 0;
        let (mut closeness, mut nearness) = (0.0_f32, 0.0_f32);
        let reach = Self::REACH as f32 * self.step as f32;
        for j in near(y, self.first[1], self.count[1]) {
            for i in near(x, self.first[0], self.count[0]) {
                let at = (j * self.count[0] + i) as usize;
                let Some(node) = &self.nodes[at] else {
                    continue;
                };
                let alike = node.normal.dot(surface.normal);
                if alike <= 0.7 {
                    continue;
                }
                let px = (self.first[0] + i) as f32 * self.step as f32 - x as f32;
                let py = (self.first[1] + j) as f32 * self.step as f32 - y as f32;
                // The window closes before the lattice's reach ends, so that it has no edge.
                let window = 1.0 - (px * px + py * py) / (reach * reach);
                if window <= 0.0 {
                    continue;
                }
                let offset = surface.position - node.position;
                let height = offset
                    .dot(surface.normal)
                    .abs()
                    .max(offset.dot(node.normal).abs());
                // Off the plane light changes faster: contact and thin steps are there.
                let d2 = offset.length_squared() + 8.0 * height * height;
                let weight = window * window * alike.powi(8);
                candidates[count] = (weight, d2, at);
                count += 1;
                let close = weight / (d2 + 0.01 * node.spacing * node.spacing);
                closeness += close / node.gathered.harmonic_distance;
                nearness += close;
            }
        }
        let here = nearness / closeness;
        let (mut sum, mut total) = (Rgb::BLACK, 0.0_f32);
        for &(weight, d2, at) in &candidates[..count] {
            let Some(node) = &self.nodes[at] else {
                continue;
            };
            let range = (Self::RANGE * node.gathered.harmonic_distance.min(here))
                .max(Self::LEAST * node.spacing);
            let weight = weight * math::exp::exp_neg(d2 / (range * range));
            sum += node.gathered.light * weight;
            total += weight;
        }
        (total > Self::TOO_FEW).then(|| sum * (1.0 / total))
    }
}
/// Gathers over the hemisphere of a surface.
#[must_use]
pub fn gather_surface<P: Pages>(
    view: &View,
    gatherer: &Gatherer<P>,
    surface: &Surface,
    seed: u64,
) -> Gathered {
    let origin = surface.position + surface.face_normal * view.tracer.offset;
    gatherer.irradiance(origin, surface.normal, seed)
}
