//! Receivers: the places at which light is gathered once for the surfels around them.

use super::light::Share;
use super::runs::{PageSurfels, Run};
use super::surface_below::surface_below;
use crate::gather::{MAX_PACKET, Medium};
use crate::math::sampling::{cosine_hemisphere, hash, sobol2, tangents};
use crate::math::segment::Composite;
use crate::math::{Hit, Ray, Rgb};
use crate::trace::{Tracer, offset};
use glam::Vec3;
use lvox_formats::record::{Surfel, SurfelPage};

/// A place on one side of a surface.
#[derive(Clone, Debug)]
pub struct Receiver {
    /// Scene space.
    pub point: Vec3,
    /// Unit normal of the side.
    pub normal: Vec3,
    /// The mean radiance that the surfels of its run send on this side, of the light in the tree.
    pub sent: Rgb,
    /// The same by place, of those that it sees, where it is uneven.
    pub parts: Box<[Part]>,
    /// The mean radiance, weighted by the cosine, that arrives of what media send of the light in
    /// the tree: irradiance over pi.
    pub from_media: Rgb,
    /// Area of the surfels that it stands for.
    pub area: f32,
    /// The height up to which nothing is above it.
    clear: f32,
    /// Number of its rays.
    pub count: u32,
    /// Key of their directions.
    key: u32,
}

/// A few surfels of a run that lie beside each other.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    /// Their middle.
    point: Vec3,
    /// The mean radiance that they send.
    sent: Rgb,
}

impl Part {
    /// Most surfels of each.
    const SURFELS: usize = 4;
    /// Mean distance from the mean radiance of a run, over that, up to which it is even.
    const EVEN: f32 = 0.05;

    /// What one side of a surfel sends.
    fn light(surfel: &Surfel, is_back: bool) -> Rgb {
        Rgb(if is_back { surfel.back } else { surfel.front })
    }

    /// Whether one side of a run sends about this everywhere.
    fn are_even(own: &[&Surfel], sent: Rgb, is_back: bool) -> bool {
        let (mut off, mut all) = (0.0, 0.0);
        for surfel in own {
            let light = Self::light(surfel, is_back);
            let apart: [f32; 3] = std::array::from_fn(|c| (light.0[c] - sent.0[c]).abs());
            off += surfel.area * Rgb(apart).mean();
            all += surfel.area * sent.mean();
        }
        off <= Self::EVEN * all
    }

    /// That of some surfels; `None` if they have no area.
    fn of(surfels: &[&Surfel], is_back: bool) -> Option<Self> {
        let (mut point, mut sum, mut area) = (Vec3::ZERO, Rgb::BLACK, 0.0);
        for surfel in surfels {
            point += Vec3::from(surfel.position);
            sum += Self::light(surfel, is_back) * surfel.area;
            area += surfel.area;
        }
        (area > 0.0).then(|| Self {
            point: point / surfels.len() as f32,
            sent: sum * (1.0 / area),
        })
    }
}

/// The height up to which nothing is above a receiver.
fn clear_above(tracer: &Tracer, receiver: &Receiver) -> f32 {
    let (point, normal) = (receiver.point, receiver.normal);
    let from = 4.0 * offset(point);
    let ray = Ray::endless(point + normal * from, normal);
    let hit = tracer.closest(&ray);
    hit.map_or(f32::INFINITY, |hit| from + hit.t)
}

/// The surface that ended a ray.
#[derive(Clone, Copy, Debug)]
pub struct Met<K> {
    /// Which of the receiver's rays.
    pub ray: u32,
    /// Where.
    pub hit: Hit,
    /// How much of what the surface sends arrives: what media let through.
    pub arriving: K,
}

impl Receiver {
    /// Height above both at which a place has to see a receiver, over the distance between them:
    /// curved surfaces do not hide their own. No more than half of what is clear above the
    /// receiver: from higher up, what is inside of a thin wall would be seen.
    const HEIGHT: f32 = 0.25;

    /// The height above both at which a place has to see it.
    pub fn height(&self, point: Vec3) -> f32 {
        let height = Self::HEIGHT * point.distance(self.point) + 16.0 * offset(point);
        height.min(0.5 * self.clear)
    }

    /// Whether nothing stands between it and a place on a surface: what is inside of a wall touches
    /// what is outside, and has none of its light.
    pub fn is_seen(&self, tracer: &Tracer, point: Vec3, normal: Vec3) -> bool {
        let height = self.height(point);
        let (from, to) = (point + normal * height, self.point + self.normal * height);
        !tracer.is_between(from, to)
    }

    /// Keeps what the surfels of its run send that it sees, by place, where that is uneven.
    fn divide(&mut self, tracer: &Tracer, own: &[&Surfel], is_back: bool) {
        if Part::are_even(own, self.sent, is_back) {
            return;
        }
        let seen = own.iter().copied().filter(|surfel| {
            let normal = Vec3::from(surfel.normal) * if is_back { -1.0 } else { 1.0 };
            self.is_seen(tracer, surfel.position.into(), normal)
        });
        let seen: Vec<&Surfel> = seen.collect();
        let parts = seen.chunks(Part::SURFELS);
        self.parts = parts.filter_map(|few| Part::of(few, is_back)).collect();
    }

    /// What the surfels of its run send around a place.
    pub fn sent_at(&self, point: Vec3) -> Rgb {
        let distance2 = |part: &&Part| part.point.distance_squared(point);
        let nearest = (self.parts.iter()).min_by(|a, b| distance2(a).total_cmp(&distance2(b)));
        nearest.map_or(self.sent, |part| part.sent)
    }

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

/// By receiver: the surfaces that its rays met, in the order of rays; the others met none.
pub type MetByReceiver<K> = Vec<Vec<Met<K>>>;

/// The receivers of a page.
#[derive(Debug)]
pub struct PageReceivers<K> {
    /// Its runs, whose receivers are numbered among these.
    pub runs: Vec<LitRun>,
    /// Fronts before backs.
    pub receivers: Vec<Receiver>,
    /// What their rays met.
    pub met: MetByReceiver<K>,
}

/// A receiver, what its rays met, and the harmonic distance to all that.
type Looking<K> = (Receiver, Vec<Met<K>>, f32);

/// Makes the receivers of runs.
pub struct ReceiverMaker<'a, M> {
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    /// The media that rays pass.
    pub media: M,
    /// Rays of each.
    pub samples: u32,
    /// Most surfels of a run.
    pub run_surfels: u32,
    /// Key of all random choices.
    pub seed: u64,
}

impl<M: Medium<Share: Share>> ReceiverMaker<'_, M> {
    /// Light changes over about this share of the harmonic distance to what is seen: runs are no
    /// larger.
    const RANGE: f32 = 0.2;

    /// The receivers of a page.
    pub fn make(&self, page: &SurfelPage, id: u32) -> PageReceivers<M::Share> {
        let surfels = PageSurfels::new(page);
        let mut made = PageReceivers {
            runs: Vec::new(),
            receivers: Vec::new(),
            met: Vec::new(),
        };
        let mut open: Vec<Run> = Vec::new();
        for root in surfels.roots(self.run_surfels) {
            open.extend(surfels.runs(root));
            while let Some(run) = open.pop() {
                let children = surfels.children(run.node);
                let sides = self.receivers(page, id, &run);
                // The side that sees farther is the one outside of what is solid.
                let range = sides[0].2.max(sides[1].2);
                if run.radius > Self::RANGE * range && !children.is_empty() {
                    open.extend(children.rev().filter_map(|c| surfels.run(c, run.facing)));
                    continue;
                }
                let first = made.receivers.len() as u32;
                let own = surfels.of_run(&run);
                for (is_back, (mut receiver, met, _)) in [false, true].into_iter().zip(sides) {
                    receiver.clear = clear_above(self.tracer, &receiver);
                    receiver.divide(self.tracer, &own, is_back);
                    made.receivers.push(receiver);
                    made.met.push(met);
                }
                made.runs.push(LitRun {
                    run,
                    receivers: [first, first + 1],
                });
            }
        }
        made
    }

    /// The receivers on both sides of a run.
    fn receivers(&self, page: &SurfelPage, id: u32, run: &Run) -> [Looking<M::Share>; 2] {
        let surfel = &page.surfels[run.surfel as usize];
        let (point, normal) = surface_below(self.tracer, surfel)
            .map_or((surfel.position.into(), surfel.normal.into()), |s| {
                (s.position, s.face_normal)
            });
        [false, true].map(|is_back| {
            let mut receiver = Receiver {
                point,
                normal: if is_back { -normal } else { normal },
                sent: run.sent[usize::from(is_back)],
                parts: Box::default(),
                from_media: Rgb::BLACK,
                area: run.area,
                clear: 0.0,
                count: 0,
                key: hash(&[
                    self.seed,
                    u64::from(id),
                    u64::from(run.surfel),
                    u64::from(is_back),
                ]) as u32,
            };
            // Many of those that send nothing are inside of what is solid. How many rays there are
            // must not depend on what they bring: that would leave out rare light.
            receiver.count = match receiver.sent.is_black() {
                true => self.samples.div_ceil(2),
                false => self.samples,
            };
            let (met, distance) = self.look(&mut receiver);
            (receiver, met, distance)
        })
    }

    /// Finds what the rays of a receiver meet, and what media send along them; returns the
    /// surfaces, and the harmonic distance to all that.
    fn look(&self, receiver: &mut Receiver) -> (Vec<Met<M::Share>>, f32) {
        let rays: Vec<Ray> = receiver.rays().collect();
        let mut hits = vec![None; rays.len()];
        for (rays, hits) in rays.chunks(MAX_PACKET).zip(hits.chunks_mut(MAX_PACKET)) {
            self.tracer.closest_of_packet(rays, hits);
        }
        let mut met = Vec::new();
        let (mut light, mut inverse) = (Rgb::BLACK, 0.0);
        for ((number, ray), hit) in (0..).zip(rays).zip(hits) {
            let distance = hit.map_or(f32::INFINITY, |hit| hit.t);
            let mut passed = Composite::default();
            let stopped = (self.media).pass(&ray.up_to(distance), 0.0, &[], &mut passed);
            light += passed.radiance;
            inverse += stopped.share * stopped.inverse_distance + (1.0 - stopped.share) / distance;
            met.extend(hit.map(|hit| Met {
                ray: number,
                hit,
                arriving: passed.transmittance,
            }));
        }
        receiver.from_media = light * (1.0 / receiver.count as f32);
        (met, receiver.count as f32 / inverse)
    }
}
