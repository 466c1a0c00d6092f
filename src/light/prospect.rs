//! What emissive triangles would send to a point with nothing between. Rays to them are chosen by
//! it.

use super::cut::Cut;
use super::direct::Direct;
use super::emitters::Emitters;
use super::few_emitters::Chances;
use super::many_emitters::Care;
use super::receiver::{Receiver, Surface};
use super::shading_point::ShadingPoint;
use super::shadows::Shadows;
use crate::math::Rgb;
use glam::Vec3;

/// What emissive triangles would send to a point with nothing between, and the chances of each to
/// get a ray of the point. It serves others beside that point as well: chances need not fit
/// exactly.
#[derive(Debug)]
pub struct Prospect<'a, R = Surface> {
    /// Irradiance of a surface, or the integral of radiance over the sphere in a medium; black
    /// where rays are to tell.
    pub open: Rgb,
    emitters: &'a Emitters,
    from: From<'a, R>,
}

#[derive(Debug)]
enum From<'a, R> {
    Few(Chances),
    Many(Care, Cut<'a, R>),
}

impl<'a, R: Receiver> Prospect<'a, R> {
    /// That of a point that sees lights by `receiver`.
    pub(super) fn new(emitters: &'a Emitters, care: Care, origin: Vec3, receiver: R) -> Self {
        let (open, from) = match emitters.tree() {
            None => {
                let chances = Chances::new(emitters, origin, receiver);
                (chances.light, From::Few(chances))
            }
            Some(tree) => {
                let cut = care.cut(tree, emitters, origin, receiver);
                (care.light(&cut), From::Many(care, cut))
            }
        };
        Self {
            open,
            emitters,
            from,
        }
    }

    /// Adds what rays of this point, or of one beside it, bring.
    pub(super) fn add<S: Shadows>(&self, total: &mut Direct<S::Dimming>, at: &ShadingPoint<S, R>) {
        match &self.from {
            From::Few(chances) => chances.add(total, self.emitters, at),
            From::Many(care, cut) => care.add(total, self.emitters, cut, at),
        }
    }
}
