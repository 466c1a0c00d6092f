//! Links: how much of what arrives at one receiver goes on to another.

use super::light::Share;
use super::places::Places;
use super::receivers::{Met, Receiver};
use super::surface_below::SAME;
use crate::Result;
use crate::math::{Ray, Rgb};
use crate::run::Cancel;
use crate::scene::Scene;
use crate::trace::{Surface, Tracer};
use arrayvec::ArrayVec;
use glam::Vec3;
use lvox_formats::record::Surfel;
use rayon::prelude::*;

/// Receivers by place.
#[derive(Debug)]
pub struct Sites<'a> {
    /// The receivers.
    pub receivers: &'a [Receiver],
    /// The scene.
    pub tracer: &'a Tracer<'a>,
    places: Places,
}

/// Receivers that face as a place does and of which is asked whether it sees them, most.
pub const ASKED: usize = 8;

impl<'a> Sites<'a> {
    /// Bytes of each.
    pub const BYTES: usize = Places::BYTES;

    /// Sorts receivers by place, of which every second is the back of the one before it.
    pub fn new(receivers: &'a [Receiver], tracer: &'a Tracer<'a>) -> Self {
        let fronts = receivers.iter().step_by(2);
        let places = Places::new(fronts.map(|r| (r.point, r.normal)));
        Self::at_places(receivers, tracer, places)
    }

    /// Receivers that were sorted.
    pub fn at_places(receivers: &'a [Receiver], tracer: &'a Tracer<'a>, places: Places) -> Self {
        Self {
            receivers,
            tracer,
            places,
        }
    }

    /// Their order.
    pub fn into_places(self) -> Places {
        self.places
    }

    /// Whether nothing stands between a place and a receiver.
    pub fn sees(&self, point: Vec3, normal: Vec3, receiver: u32) -> bool {
        self.receivers[receiver as usize].is_seen(self.tracer, point, normal)
    }

    /// The surface that a surfel stands on, if it is what a receiver meets first on its way to one
    /// side of it: a place that the receiver sees for certain.
    pub fn met(&self, surfel: &Surfel, normal: Vec3, receiver: u32) -> Option<Surface> {
        /// How far from the surfel's middle that may be, over its radius: files round places.
        const NEAR: f32 = 0.1;
        let (there, point) = (
            &self.receivers[receiver as usize],
            Vec3::from(surfel.position),
        );
        let (near, height) = (NEAR * surfel.radius, there.height(point));
        if height < near {
            return None;
        }
        let from = there.point + there.normal * height;
        let distance = from.distance(point);
        let hit =
            (self.tracer).closest(&Ray::new(from, (point - from) / distance, distance + near))?;
        let surface = Surface::new(self.tracer.scene, hit.triangle, hit.uv);
        let is_own = hit.t >= distance - near && surface.face_normal.dot(normal).abs() > SAME;
        is_own.then(|| surface.facing(normal))
    }

    /// The receivers nearest to a point that face as it does, nearest first.
    pub fn around(&self, point: Vec3, normal: Vec3) -> ArrayVec<u32, ASKED> {
        self.places.nearest(point, normal)
    }

    /// The receiver whose light is that of a point: the nearest that faces as it does and that it
    /// sees, or else the nearest that faces so.
    pub fn nearest(&self, point: Vec3, normal: Vec3) -> Option<u32> {
        // Most see it.
        let first = *self.places.nearest::<1>(point, normal).first()?;
        if self.sees(point, normal, first) {
            return Some(first);
        }
        let around = self.around(point, normal).into_iter();
        let mut seen = around.filter(|&i| self.sees(point, normal, i));
        seen.next().or(Some(first))
    }
}

/// How much of the light at a receiver goes on, by channel.
#[derive(Clone, Copy, Debug)]
struct Link {
    from: u32,
    share: Rgb,
}

impl Link {
    /// The end of a link that leads to no receiver.
    const NOWHERE: u32 = u32::MAX;
}

/// The links of all receivers.
pub struct Links {
    /// By receiver: what arrives of what the runs of all send, irradiance over pi.
    pub direct: Vec<Rgb>,
    /// Where those of each receiver start; one more for the end.
    starts: Vec<usize>,
    links: Vec<Link>,
}

impl Links {
    /// Bytes of each.
    pub const BYTES: usize = size_of::<Link>();

    /// Links receivers to those that are nearest to what the rays of each met.
    ///
    /// # Errors
    /// A stop on request.
    pub fn new<K: Share>(
        scene: &Scene,
        sites: &Sites,
        met: &[Vec<Met<K>>],
        cancel: &Cancel,
    ) -> Result<Self> {
        let linked = sites.receivers.par_iter().zip(met).map(|(receiver, met)| {
            cancel.check()?;
            let mut direct = Rgb::BLACK;
            let link = |&Met { hit, arriving, .. }: &Met<K>| {
                let surface = Surface::new(scene, hit.triangle, hit.uv);
                let arriving = arriving.each(|a| a / receiver.count as f32);
                let share = arriving.filter(surface.albedo);
                if share.is_black() {
                    return None;
                }
                let normal = surface.face_normal * if hit.is_back { -1.0 } else { 1.0 };
                let from = sites.nearest(surface.position, normal);
                if let Some(from) = from {
                    let sent = sites.receivers[from as usize].sent_at(surface.position);
                    direct += arriving.filter(sent);
                }
                Some(Link {
                    from: from.unwrap_or(Link::NOWHERE),
                    share,
                })
            };
            let own: Vec<Link> = met.iter().filter_map(link).collect();
            Ok((direct, own))
        });
        let linked = linked.collect::<Result<Vec<_>>>()?;
        let mut starts = Vec::with_capacity(linked.len() + 1);
        let mut links = Vec::with_capacity(linked.iter().map(|(_, own)| own.len()).sum());
        let mut direct = Vec::with_capacity(linked.len());
        for (of_runs, own) in linked {
            direct.push(of_runs);
            starts.push(links.len());
            links.extend(own);
        }
        starts.push(links.len());
        Ok(Self {
            direct,
            starts,
            links,
        })
    }

    /// Links to nowhere: rays that met what has no receiver near by.
    pub fn lost(&self) -> usize {
        let links = self.links.iter();
        links.filter(|l| l.from == Link::NOWHERE).count()
    }

    /// Number of links.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    fn own(&self, receiver: usize) -> &[Link] {
        &self.links[self.starts[receiver]..self.starts[receiver + 1]]
    }

    /// What arrives at a receiver of what all receivers have.
    pub fn arriving(&self, receiver: usize, light: &[Rgb]) -> Rgb {
        let own = self.own(receiver).iter();
        own.fold(Rgb::BLACK, |sum, link| {
            match light.get(link.from as usize) {
                Some(light) => sum + *light * link.share,
                None => sum,
            }
        })
    }
}
