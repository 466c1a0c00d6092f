//! Links: how much of what arrives at one receiver goes on to another.

use super::places::Places;
use super::receivers::{Met, Receiver};
use crate::Result;
use crate::math::{Ray, Rgb};
use crate::run::Cancel;
use crate::scene::Scene;
use crate::trace::{Surface, Tracer, offset};
use glam::Vec3;
use rayon::prelude::*;

/// Receivers by place.
#[derive(Debug)]
pub struct Sites<'a> {
    /// The receivers.
    pub receivers: &'a [Receiver],
    tracer: &'a Tracer<'a>,
    places: Places,
    /// By receiver: the height up to which nothing is above it.
    clear: Vec<f32>,
}

/// Receivers that face as a place does and of which is asked whether it sees them, most.
const ASKED: usize = 8;

impl<'a> Sites<'a> {
    /// Bytes of each.
    pub const BYTES: usize = Places::BYTES + size_of::<f32>();
    /// Height above both at which a place has to see a receiver, over the distance between them:
    /// curved surfaces do not hide their own. No more than half of what is clear above the
    /// receiver: from higher up, what is inside of a thin wall would be seen.
    const HEIGHT: f32 = 0.25;

    /// Sorts receivers by place.
    pub fn new(receivers: &'a [Receiver], tracer: &'a Tracer<'a>) -> Self {
        Self {
            receivers,
            tracer,
            places: Places::new(receivers.iter().map(|r| (r.point, r.normal))),
            clear: (receivers.par_iter())
                .map(|r| clear_above(tracer, r))
                .collect(),
        }
    }

    /// Whether nothing stands between a place and a receiver: what is inside of a wall touches what
    /// is outside, and has none of its light.
    fn sees(&self, point: Vec3, normal: Vec3, receiver: u32) -> bool {
        let there = &self.receivers[receiver as usize];
        let height = Self::HEIGHT * point.distance(there.point) + 16.0 * offset(point);
        let height = height.min(0.5 * self.clear[receiver as usize]);
        let (from, to) = (point + normal * height, there.point + there.normal * height);
        !self.tracer.is_between(from, to)
    }

    /// The receivers nearest to a point that face as it does and that it sees, nearest first.
    pub fn near(&self, point: Vec3, normal: Vec3) -> impl Iterator<Item = u32> {
        let facing = self.places.nearest::<ASKED>(point, normal);
        (facing.into_iter()).filter(move |&i| self.sees(point, normal, i))
    }

    /// The receiver whose light is that of a point: the nearest that faces as it does and that it
    /// sees, or else the nearest that faces so.
    pub fn nearest(&self, point: Vec3, normal: Vec3) -> Option<u32> {
        // Most see it.
        let first = *self.places.nearest::<1>(point, normal).first()?;
        if self.sees(point, normal, first) {
            return Some(first);
        }
        self.near(point, normal).next().or(Some(first))
    }
}

/// The height up to which nothing is above a receiver.
fn clear_above(tracer: &Tracer, receiver: &Receiver) -> f32 {
    let (point, normal) = (receiver.point, receiver.normal);
    let from = 4.0 * offset(point);
    let ray = Ray::endless(point + normal * from, normal);
    tracer
        .closest(&ray)
        .map_or(f32::INFINITY, |hit| from + hit.t)
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
    /// Where those of each receiver start; one more for the end.
    starts: Vec<usize>,
    links: Vec<Link>,
}

impl Links {
    /// Bytes of each.
    pub const BYTES: usize = size_of::<Link>();

    /// Links receivers to those that are nearest to what their rays met.
    ///
    /// # Errors
    /// A stop on request.
    pub fn new(scene: &Scene, sites: &Sites, cancel: &Cancel) -> Result<Self> {
        let linked = sites.receivers.par_iter().map(|receiver| {
            cancel.check()?;
            let link = |&Met { hit, arriving, .. }: &Met| {
                let surface = Surface::new(scene, hit.triangle, hit.uv);
                let share = surface.albedo * (arriving / receiver.count as f32);
                let normal = surface.face_normal * if hit.is_back { -1.0 } else { 1.0 };
                (!share.is_black()).then(|| Link {
                    from: (sites.nearest(surface.position, normal)).unwrap_or(Link::NOWHERE),
                    share,
                })
            };
            Ok(receiver.met.iter().filter_map(link).collect::<Vec<_>>())
        });
        let linked = linked.collect::<Result<Vec<_>>>()?;
        let mut starts = Vec::with_capacity(linked.len() + 1);
        let mut links = Vec::with_capacity(linked.iter().map(Vec::len).sum());
        for own in linked {
            starts.push(links.len());
            links.extend(own);
        }
        starts.push(links.len());
        Ok(Self { starts, links })
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
