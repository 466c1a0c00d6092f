//! Light of many emissive triangles: a tree tells what they send, and each ray goes to a light that
//! it chooses by that.

use super::cut::Cut;
use super::direct::Direct;
use super::emitters::Emitters;
use super::receiver::Receiver;
use super::shading_point::ShadingPoint;
use super::shadows::Shadows;
use super::tree::Tree;
use crate::math::Rgb;
use glam::Vec3;

/// How carefully they are asked.
#[derive(Clone, Copy, Debug)]
pub struct Care {
    /// Share of all light by which one group of them may be wrong.
    tolerance: f32,
    /// Whether rays tell what arrives of the groups' light, which has no noise, or all of it, which
    /// has no bias.
    is_share: bool,
    /// Rays for one to a few.
    rays: u32,
}

impl Care {
    /// For points that pictures show.
    pub const SHADING: Self = Self {
        tolerance: 0.03,
        is_share: true,
        rays: 4,
    };
    /// For gathers, of which pictures show means, too: without bias as these do not go far.
    pub const GATHERING: Self = Self {
        tolerance: 0.1,
        is_share: false,
        rays: 1,
    };
    /// For points of which pictures show means of many.
    pub const BAKING: Self = Self {
        tolerance: 0.2,
        is_share: false,
        rays: 1,
    };
}

impl Care {
    /// The groups that stand for all emitters at a point.
    pub fn cut<'a, R: Receiver>(
        self,
        tree: &'a Tree,
        emitters: &Emitters,
        origin: Vec3,
        receiver: R,
    ) -> Cut<'a, R> {
        Cut::new(tree, emitters, origin, receiver, self.tolerance)
    }

    /// Adds what rays bring, and, where those tell it, what all emitters send.
    pub fn add<S: Shadows, R: Receiver>(
        self,
        total: &mut Direct<S::Dimming>,
        emitters: &Emitters,
        cut: &Cut<R>,
        at: &ShadingPoint<S, R>,
    ) {
        let rays = at.rays;
        let count = rays.count() * self.rays;
        let per_ray = 1.0 / self.rays as f32;
        let mut sent = Rgb::BLACK;
        for i in 0..count {
            let [u, v] = rays.point_of_many(i, self.rays);
            let Some(choice) = cut.choose(u) else {
                continue;
            };
            let emitter = emitters.get(choice.emitter);
            if let Some((w, through)) = at.ray_to(emitter, [choice.within, v], choice.chance) {
                let light = emitter.radiance * w;
                // As much of the light as a ray to any other light with an extent brings of its
                // own.
                total.note_ray(choice.emitter as usize, light * per_ray, through);
                sent += light;
            }
        }
        if !self.is_share {
            total.open += sent * (1.0 / count.max(1) as f32);
        }
    }

    /// What all emitters send with nothing between, if it is not for rays to tell.
    pub fn light<R: Receiver>(self, cut: &Cut<R>) -> Rgb {
        if self.is_share {
            cut.light()
        } else {
            Rgb::BLACK
        }
    }
}
