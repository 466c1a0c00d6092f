//! Receivers: the places at which light is gathered once for the surfels around them.

use super::runs::{PageSurfels, Run};
use super::surface_below::surface_below;
use crate::Result;
use crate::gather::{Gatherer, MAX_PACKET, Medium};
use crate::math::sampling::{cosine_hemisphere, hash, sobol2, tangents};
use crate::math::{Hit, Ray, Rgb};
use crate::trace::{Tracer, offset};
use crate::tree::Pages;
use glam::Vec3;
use lvox_formats::record::SurfelPage;

/// A place on one side of a surface.
#[derive(Clone, Debug)]
pub struct Receiver {
    /// Scene space.
    pub point: Vec3,
    /// Unit normal of the side.
    pub normal: Vec3,
    /// The mean radiance that arrives, weighted by the cosine, of what the tree sends: irradiance
    /// over pi.
    pub gathered: Rgb,
    /// Area of the surfels that it stands for.
    pub area: f32,
    /// Surfaces that its rays met, in the order of rays; the others met none.
    pub met: Vec<Met>,
    /// Number of its rays.
    pub count: u32,
    /// Key of their directions.
    key: u32,
}

/// The surface that ended a ray.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// Which of the receiver's rays.
    pub ray: u32,
    /// Where.
    pub hit: Hit,
    /// How much of what the surface sends arrives: what media let through.
    pub arriving: f32,
}

impl Receiver {
    /// Its rays, by the cosine.
    pub fn rays(&self) -> impl Iterator<Item = Ray> {
        let (normal, key) = (self.normal, self.key);
        let (tangent, bitangent) = tangents(normal);
        let origin = self.point + normal * (8.0 * offset(self.point));
        (0..self.count).map(move |i| {
            let d = cosine_hemisphere(sobol2(i, 0, key));
            let direction = tangent * d.x + bitangent * d.y + normal * d.z;
            Ray::endless(origin, direction.normalize())
        })
    }
}

/// A run with its receivers.
#[derive(Clone, Copy, Debug)]
pub struct LitRun {
    /// The run.
    pub run: Run,
    /// Numbers of the receivers on the fronts and on the backs of its surfels.
    pub receivers: [u32; 2],
}

/// Gathers light at receivers.
pub struct ReceiverMaker<'a, P, M> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// Gathers from the tree.
    pub gatherer: Gatherer<'a, P, M>,
    /// Most surfels of a run.
    pub run_surfels: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl<P: Pages, M: Medium> ReceiverMaker<'_, P, M> {
    /// Light changes over about this share of the harmonic distance to what is seen: runs are no
    /// larger.
    const RANGE: f32 = 0.5;

    /// The receivers of a page, and its runs, whose receivers are numbered among these.
    ///
    /// # Errors
    /// A page that cannot be read.
    pub fn make(&self, page: &SurfelPage, id: u32) -> Result<(Vec<LitRun>, Vec<Receiver>)> {
        let surfels = PageSurfels::new(page);
        let mut runs = Vec::new();
        let mut receivers = Vec::new();
        let mut open: Vec<Run> = Vec::new();
        for root in surfels.roots(self.run_surfels) {
            open.extend(surfels.runs(root));
            while let Some(run) = open.pop() {
                let children = surfels.children(run.node);
                let sides = [false, true].map(|is_back| self.receiver(page, id, &run, is_back));
                // The side that sees farther is the one outside of what is solid.
                let range = sides[0].1.max(sides[1].1);
                if run.radius > Self::RANGE * range && !children.is_empty() {
                    open.extend(children.rev().filter_map(|c| surfels.run(c, run.facing)));
                    continue;
                }
                let first = receivers.len() as u32;
                receivers.extend(sides.map(|(receiver, _)| receiver));
                runs.push(LitRun {
                    run,
                    receivers: [first, first + 1],
                });
            }
        }
        self.gatherer.pages.check()?;
        Ok((runs, receivers))
    }

    /// The receiver on one side of a run, and the harmonic distance to what it sees.
    fn receiver(&self, page: &SurfelPage, id: u32, run: &Run, is_back: bool) -> (Receiver, f32) {
        let surfel = &page.surfels[run.surfel as usize];
        let sent = if is_back { surfel.back } else { surfel.front };
        let (point, normal) = surface_below(self.tracer, surfel)
            .map_or((surfel.position.into(), surfel.normal.into()), |s| {
                (s.position, s.face_normal)
            });
        let mut receiver = Receiver {
            point,
            normal: if is_back { -normal } else { normal },
            gathered: Rgb::BLACK,
            area: run.area,
            met: Vec::new(),
            count: 0,
            key: 0,
        };
        receiver.key = hash(&[
            self.seed,
            u64::from(id),
            u64::from(run.surfel),
            u64::from(is_back),
        ]) as u32;
        let samples = self.gatherer.settings.samples;
        // Many of those that send nothing are inside of what is solid. How many rays there are must
        // not depend on what they bring: that would leave out rare light.
        let is_lit = sent != [0.0; 3];
        let count = if is_lit { samples } else { samples.div_ceil(2) };
        let distance = self.gather(&mut receiver, count);
        (receiver, distance)
    }

    /// Gathers light at a receiver along so many rays; returns the harmonic distance to what they
    /// see.
    fn gather(&self, receiver: &mut Receiver, count: u32) -> f32 {
        receiver.count = count;
        let rays: Vec<Ray> = receiver.rays().collect();
        let (mut light, mut inverse) = (Rgb::BLACK, 0.0);
        let mut arriving = vec![0.0; rays.len()];
        self.gatherer.incident_along(&rays, |i, seen| {
            light += seen.radiance;
            inverse += seen.inverse_distance;
            arriving[i] = seen.arriving;
        });
        let mut hits = vec![None; rays.len()];
        for (rays, hits) in rays.chunks(MAX_PACKET).zip(hits.chunks_mut(MAX_PACKET)) {
            self.tracer.closest_of_packet(rays, hits);
        }
        receiver.met.clear();
        for (ray, (hit, arriving)) in (0..).zip(hits.into_iter().zip(arriving)) {
            receiver
                .met
                .extend(hit.map(|hit| Met { ray, hit, arriving }));
        }
        receiver.gathered = light * (1.0 / count as f32);
        count as f32 / inverse
    }
}
