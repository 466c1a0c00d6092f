//! Direct light at a point of a surface or of a medium, with shadow rays that see triangles and media.
//!
//! What a light would send without anything between is computed in closed form; rays measure only the share that
//! arrives. So a point in full light has no noise at all.

mod cut;
mod direct;
mod emitters;
mod lamps;
mod rays;
mod receiver;
mod shadows;
mod sight;
mod sun_depth;
#[cfg(test)]
mod tests;
mod tree;

use crate::math::Rgb;
use crate::math::sampling::{cosine_hemisphere, disk, sphere, tangents};
use crate::scene::Light;
use crate::trace::{self, Tracer};
use cut::Cut;
use emitters::Emitters;
use glam::Vec3;
use receiver::{Medium, Receiver, Surface};
use smallvec::SmallVec;
use std::f32::consts::PI;
use std::sync::Arc;
use tree::Tree;

pub use direct::{Arrival, Direct, InMedium};
pub use rays::ShadowRays;
pub use shadows::{OpticalDepth, SceneMedia, Shadows, Vacuum};
pub use sight::{Dimmed, Dimming, Sight};
pub use sun_depth::SunDepths;

const INVERSE_SPHERE: f32 = 1.0 / (4.0 * PI);

/// All lights of a scene but a constant environment, which gathering takes care of, and what shadow rays to them pass.
#[derive(Clone, Debug)]
pub struct Lights<'a, S = SceneMedia<'a>> {
    tracer: &'a Tracer<'a>,
    shadows: S,
    emitters: Arc<Emitters>,
    /// How many emissive triangles are asked, if they are many.
    care: Care,
    environment: Rgb,
}

/// How carefully many emissive triangles are asked.
#[derive(Clone, Copy, Debug)]
struct Care {
    /// Share of all light by which one group of them may be wrong.
    tolerance: f32,
    /// Whether rays tell what arrives of the groups' light, which has no noise, or all of it, which has no bias.
    is_share: bool,
    /// Rays for one to a few.
    rays: u32,
}

impl Care {
    const SHADING: Self = Self {
        tolerance: 0.03,
        is_share: true,
        rays: 4,
    };
    const BAKING: Self = Self {
        tolerance: 0.2,
        is_share: false,
        rays: 1,
    };
}

impl<'a> Lights<'a> {
    /// Finds the lights of the traced scene.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>) -> Self {
        Self {
            tracer,
            shadows: SceneMedia::default(),
            emitters: Arc::new(Emitters::new(tracer.scene)),
            care: Care::SHADING,
            environment: tracer.scene.environment(),
        }
    }

    /// The same lights, with other media than the scene's before emissive triangles, whose shadows are soft: coarser ones,
    /// that are passed faster.
    #[must_use]
    pub fn with_soft_shadows_through(mut self, depth: &'a dyn OpticalDepth) -> Self {
        self.shadows.before_triangles = Some(depth);
        self
    }

    /// The same lights, with the scene's own media before all of them.
    #[must_use]
    pub fn with_sharp_shadows(&self) -> Self {
        Self {
            shadows: SceneMedia::default(),
            ..self.clone()
        }
    }

    /// The same lights in a scene without media.
    #[must_use]
    pub fn in_vacuum(&self) -> Lights<'a, Vacuum> {
        Lights {
            tracer: self.tracer,
            shadows: Vacuum,
            emitters: Arc::clone(&self.emitters),
            care: self.care,
            environment: self.environment,
        }
    }
}

impl<'a, S: Shadows> Lights<'a, S> {
    /// The same lights, asked with less care where they are many: for points of which pictures see means of many only.
    #[must_use]
    pub fn for_baking(mut self) -> Self {
        self.care = Care::BAKING;
        self
    }

    fn transmittance(
        &self,
        origin: Vec3,
        direction: Vec3,
        t_max: f32,
        depth: Option<&dyn OpticalDepth>,
    ) -> f32 {
        self.shadows
            .transmittance(self.tracer, origin, direction, t_max, depth)
    }

    /// Share of light that gets from `origin` to `t_max` along a unit direction: 0 behind a surface, else what the scene's
    /// own media let through.
    #[must_use]
    pub fn through(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.transmittance(origin, direction, t_max, None)
    }

    /// What rays meet.
    #[must_use]
    pub fn tracer(&self) -> &'a Tracer<'a> {
        self.tracer
    }

    /// Radiance from where no surface is.
    #[must_use]
    pub fn environment(&self) -> Rgb {
        self.environment
    }

    /// Irradiance of a surface point on the side of `normal`; `face_normal` is the geometric one on that side, along
    /// which rays leave.
    #[must_use]
    pub fn irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Direct<S::Dimming> {
        let origin = point + face_normal * trace::offset(point);
        let receiver = Surface {
            normal,
            face_normal,
        };
        self.sum(origin, rays, receiver, None, |_| true)
    }

    /// Mean over the sphere of the direct radiance at a point of a medium: its in-scattered radiance for an isotropic
    /// phase function.
    #[must_use]
    pub fn mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Direct<S::Dimming> {
        let mut direct = self.sum(point, rays, Medium, None, |_| true);
        direct.sharp *= INVERSE_SPHERE;
        direct.open *= INVERSE_SPHERE;
        direct
    }

    /// The same light in two parts, for what lies between points: `sent` times the share, and the rest. Media before suns
    /// are those of `suns`, or the scene's own.
    #[must_use]
    pub fn in_medium(&self, point: Vec3, rays: ShadowRays, suns: Option<&SunDepths>) -> InMedium {
        let rest = self.sum(point, rays, Medium, suns, |light| light.lamp().is_none());
        InMedium {
            share: self.share_of_lamps(point),
            rest: rest.light() * INVERSE_SPHERE,
        }
    }

    /// Irradiance of a surface point from the environment, by `rays.per_light` rays over the hemisphere. Gathering sees
    /// the environment by itself; baking does not gather.
    #[must_use]
    pub fn environment_irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Rgb {
        let (x, y) = tangents(normal);
        let origin = point + face_normal * trace::offset(point);
        let share = self.environment_share(origin, rays, |u| {
            let d = cosine_hemisphere(u);
            (x * d.x + y * d.y + normal * d.z).normalize()
        });
        self.environment * (PI * share)
    }

    /// Mean over the sphere of the environment's radiance at a point of a medium.
    #[must_use]
    pub fn environment_mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Rgb {
        self.environment * self.environment_share(point, rays, sphere)
    }

    fn environment_share(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        direction: impl Fn([f32; 2]) -> Vec3,
    ) -> f32 {
        if self.environment.is_black() {
            return 0.0;
        }
        let through = |i| {
            let direction = direction(rays.point(i, 62));
            self.transmittance(
                origin,
                direction,
                f32::INFINITY,
                self.shadows.before_triangles(),
            )
        };
        (0..rays.count()).map(through).sum::<f32>() / rays.count() as f32
    }

    /// Sums over the lights that are `asked` for and all emissive triangles. Media before suns are those of `suns`, or the scene's
    /// own.
    fn sum(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        receiver: impl Receiver,
        suns: Option<&SunDepths>,
        asked: impl Fn(&Light) -> bool,
    ) -> Direct<S::Dimming> {
        let mut total = Direct::default();
        for (index, light) in self.tracer.scene.lights.iter().enumerate() {
            if asked(light) {
                let asking = Asking {
                    origin,
                    rays,
                    receiver,
                    sun_depth: suns.and_then(|s| s.of(index)),
                };
                self.add_light(&mut total, light, index, &asking);
            }
        }
        self.add_emitters(&mut total, origin, rays, receiver);
        total
    }

    fn add_light<R: Receiver>(
        &self,
        total: &mut Direct<S::Dimming>,
        light: &Light,
        index: usize,
        asking: &Asking<R>,
    ) {
        let &Asking {
            origin,
            receiver,
            sun_depth,
            ..
        } = asking;
        if let Light::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        } = *light
        {
            if angular_radius_rad > 0.0 {
                let sun = Sun {
                    direction,
                    irradiance: Rgb(irradiance),
                    angular_radius_rad,
                };
                self.add_sun(total, &sun, index, asking);
                return;
            }
            let w = receiver.response(-direction);
            if w > 0.0 {
                let through = self.transmittance(origin, -direction, f32::INFINITY, sun_depth);
                total.sight.note_sharp(index, through);
                total.sharp += Rgb(irradiance) * (w * through);
            }
        }
        let Some((position, intensity)) = light.lamp() else {
            return;
        };
        let to_light = position - origin;
        let distance = to_light.length();
        if distance == 0.0 {
            return;
        }
        let d = to_light / distance;
        let w = receiver.response(d) / (distance * distance) * light.falloff(-d);
        if w > 0.0 {
            let through = self.transmittance(origin, d, distance, None);
            total.sight.note_sharp(index, through);
            total.sharp += Rgb(intensity) * (w * through);
        }
    }

    /// A sun with an extent: a cone of directions of constant radiance.
    fn add_sun<R: Receiver>(
        &self,
        total: &mut Direct<S::Dimming>,
        sun: &Sun,
        index: usize,
        asking: &Asking<R>,
    ) {
        let &Asking {
            origin,
            rays,
            receiver,
            sun_depth,
        } = asking;
        let (x, y) = tangents(-sun.direction);
        let radius = libm::sinf(sun.angular_radius_rad);
        for i in 0..rays.count() {
            let [u, v] = disk(rays.point(i, index as u32)).map(|c| c * radius);
            // Points of the disk are spread by their cosine to the sun's axis.
            let cos = (1.0 - u * u - v * v).max(1e-4).sqrt();
            let d = (-sun.direction * cos + x * u + y * v).normalize();
            let w = receiver.response(d) / cos;
            if w > 0.0 {
                let light = sun.irradiance * w;
                total.open += light * (1.0 / rays.count() as f32);
                let through = self.transmittance(origin, d, f32::INFINITY, sun_depth);
                total.note_ray(index, light, through);
            }
        }
    }

    fn add_emitters(
        &self,
        total: &mut Direct<S::Dimming>,
        origin: Vec3,
        rays: ShadowRays,
        receiver: impl Receiver,
    ) {
        if let Some(tree) = self.emitters.tree() {
            self.add_many_emitters(total, tree, origin, rays, receiver);
            return;
        }
        if self.emitters.is_empty() {
            return;
        }
        // Not an array, which would be cleared for each point.
        let mut chosen = SmallVec::<[Chosen; Emitters::FEW]>::new();
        let mut unoccluded = Rgb::BLACK;
        let mut sum = 0.0;
        for (index, emitter) in self.emitters.facing(origin) {
            let response = receiver.of_triangle(emitter.corners.map(|c| c - origin));
            let light = emitter.radiance * response;
            let power = light.mean();
            if power > 0.0 {
                unoccluded += light;
                sum += power;
                chosen.push(Chosen {
                    index,
                    running_power: sum,
                    response,
                });
            }
        }
        if chosen.is_empty() {
            return;
        }
        total.open += unoccluded;
        // Rays share the emitters out by what each would send; each ray counts by what its point would send.
        for i in 0..rays.count() {
            let [u, v] = rays.point(i, 63);
            let target = u * sum;
            let k = chosen
                .iter()
                .position(|c| target < c.running_power)
                .unwrap_or(chosen.len() - 1);
            let below = if k == 0 {
                0.0
            } else {
                chosen[k - 1].running_power
            };
            let within = ((target - below) / (chosen[k].running_power - below)).clamp(0.0, 1.0);
            let index = chosen[k].index;
            let emitter = self.emitters.get(index);
            let (d, distance, pdf) = emitter.look_at(origin, [within, v]);
            // What this point sends over what its emitter was expected to: near 1.
            let w = receiver.response(d) / (pdf * chosen[k].response);
            if w > 0.0 {
                // Stop short of the light itself.
                let end = distance * (1.0 - 1e-4) - trace::offset(origin + d * distance);
                let through = self.transmittance(origin, d, end, self.shadows.before_triangles());
                let light = emitter.radiance * (w * sum / emitter.radiance.mean());
                // Emitters of one surface are told apart no further than sharing a bit with another.
                total.note_ray(index as usize, light, through);
            }
        }
    }

    /// The same for many: a tree tells what they send, and each ray goes to a light that it chooses by that.
    fn add_many_emitters(
        &self,
        total: &mut Direct<S::Dimming>,
        tree: &Tree,
        origin: Vec3,
        rays: ShadowRays,
        receiver: impl Receiver,
    ) {
        let cut = Cut::new(tree, &self.emitters, origin, receiver, self.care.tolerance);
        let count = rays.count() * self.care.rays;
        let per_ray = 1.0 / self.care.rays as f32;
        let mut sent = Rgb::BLACK;
        for i in 0..count {
            let [u, v] = rays.point_of_many(i, self.care.rays);
            let Some(choice) = cut.choose(u) else {
                continue;
            };
            let emitter = self.emitters.get(choice.emitter);
            let (d, distance, pdf) = emitter.look_at(origin, [choice.within, v]);
            let w = receiver.response(d) / (pdf * choice.chance);
            if w > 0.0 && w.is_finite() {
                // Stop short of the light itself.
                let end = distance * (1.0 - 1e-4) - trace::offset(origin + d * distance);
                let through = self.transmittance(origin, d, end, self.shadows.before_triangles());
                let light = emitter.radiance * w;
                // As much of the light as a ray to any other light with an extent brings of its own.
                total.note_ray(choice.emitter as usize, light * per_ray, through);
                sent += light;
            }
        }
        total.open += if self.care.is_share {
            cut.light()
        } else {
            sent * (1.0 / count.max(1) as f32)
        };
    }
}

/// A point that asks for light.
struct Asking<'a, R> {
    origin: Vec3,
    rays: ShadowRays,
    receiver: R,
    /// The media before a sun, if not the scene's own.
    sun_depth: Option<&'a dyn OpticalDepth>,
}

/// A directional light with an extent.
struct Sun {
    direction: Vec3,
    irradiance: Rgb,
    angular_radius_rad: f32,
}

/// An emitter that rays of a point may go to.
#[derive(Clone, Copy)]
struct Chosen {
    index: u32,
    running_power: f32,
    /// Closed form of the receiver's response to it, per unit radiance.
    response: f32,
}
