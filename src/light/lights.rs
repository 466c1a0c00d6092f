//! All lights of a scene, and what a point gets of them.

use super::direct::Direct;
use super::emitter::Emitter;
use super::emitters::Emitters;
use super::many_emitters::Care;
use super::prospect::Prospect;
use super::rays::ShadowRays;
use super::receiver::{INVERSE_SPHERE, Medium, Receiver, Surface};
use super::shading_point::ShadingPoint;
use super::shadows::{SceneMedia, Shadows};
use super::sharp;
use super::soft_shadows::SoftShadows;
use super::sun::Sun;
use super::sun_depth::SunDepths;
use super::vacuum::Vacuum;
use crate::math::Rgb;
use crate::scene::Light;
use crate::trace::{self, Tracer};
use glam::Vec3;
use std::sync::Arc;

/// All lights of a scene but a constant environment, which gathering takes care of, and what shadow
/// rays to them pass.
#[derive(Clone, Debug)]
pub struct Lights<'a, S = SceneMedia<'a>> {
    pub(super) tracer: &'a Tracer<'a>,
    shadows: S,
    /// Those of the scene that are no triangles.
    lights: &'a [Light],
    pub(super) emitters: Arc<Emitters>,
    /// How emissive triangles are asked, if they are many.
    care: Care,
    environment: Rgb,
}

impl<'a> Lights<'a> {
    /// Finds the lights of the traced scene.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>) -> Self {
        Self {
            tracer,
            shadows: SceneMedia::default(),
            lights: &tracer.scene.lights,
            emitters: Arc::new(Emitters::new(tracer.scene)),
            care: Care::SHADING,
            environment: tracer.scene.environment(),
        }
    }

    /// The same lights, with these media before emissive triangles instead of the scene's own, if
    /// there are any.
    #[must_use]
    pub fn with_soft_shadows_through(mut self, media: Option<&'a SoftShadows>) -> Self {
        self.shadows.before_triangles = media;
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

    /// These emissive triangles instead of all lights, for gathers.
    #[must_use]
    pub fn of_emitters(&self, emitters: Vec<Emitter>) -> Self {
        Self {
            lights: &[],
            emitters: Arc::new(Emitters::of(emitters)),
            care: Care::GATHERING,
            environment: Rgb::BLACK,
            ..self.clone()
        }
    }

    /// The same lights in a scene without media.
    #[must_use]
    pub fn in_vacuum(&self) -> Lights<'a, Vacuum> {
        Lights {
            tracer: self.tracer,
            shadows: Vacuum,
            lights: self.lights,
            emitters: Arc::clone(&self.emitters),
            care: self.care,
            environment: self.environment,
        }
    }
}

impl<'a, S: Shadows> Lights<'a, S> {
    /// The same lights, asked with less care where they are many: for points of which pictures see
    /// means of many only.
    #[must_use]
    pub fn for_baking(mut self) -> Self {
        self.care = Care::BAKING;
        self
    }

    /// Share of light that gets from `origin` to `t_max` along a unit direction: 0 behind a
    /// surface, else what the scene's own media let through.
    #[must_use]
    pub fn through(&self, origin: Vec3, direction: Vec3, t_max: f32) -> f32 {
        self.shadows
            .transmittance(self.tracer, origin, direction, t_max, None)
    }

    /// The scene that shadow rays are traced in.
    #[must_use]
    pub fn tracer(&self) -> &'a Tracer<'a> {
        self.tracer
    }

    /// Radiance from where no surface is.
    #[must_use]
    pub fn environment(&self) -> Rgb {
        self.environment
    }

    /// What emissive triangles would send to a surface.
    #[must_use]
    pub fn prospect(&self, surface: &trace::Surface) -> Prospect<'_> {
        let at = OnSurface::new(surface.position, surface.normal, surface.face_normal);
        Prospect::new(&self.emitters, self.care, at.origin, at.receiver)
    }

    /// Irradiance of a surface by a prospect from it or from beside it, and by what that says of
    /// `open` light.
    #[must_use]
    pub fn irradiance_by(
        &self,
        surface: &trace::Surface,
        prospect: &Prospect,
        open: Rgb,
        rays: ShadowRays,
    ) -> Direct<S::Dimming> {
        let at = OnSurface::new(surface.position, surface.normal, surface.face_normal);
        self.sum_by(
            prospect,
            open,
            &self.shading_point(at.origin, rays, at.receiver),
            None,
            |_| true,
        )
    }

    /// Irradiance of a surface point on the side of `normal`; `face_normal` is the geometric one on
    /// that side, along which rays leave.
    #[must_use]
    pub fn irradiance(
        &self,
        point: Vec3,
        normal: Vec3,
        face_normal: Vec3,
        rays: ShadowRays,
    ) -> Direct<S::Dimming> {
        let at = OnSurface::new(point, normal, face_normal);
        self.sum(
            &self.shading_point(at.origin, rays, at.receiver),
            None,
            |_| true,
        )
    }

    /// Mean over the sphere of the direct radiance at a point of a medium: its in-scattered
    /// radiance for an isotropic phase function.
    #[must_use]
    pub fn mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Direct<S::Dimming> {
        let mut direct = self.sum(&self.shading_point(point, rays, Medium), None, |_| true);
        direct.sharp *= INVERSE_SPHERE;
        direct.open *= INVERSE_SPHERE;
        direct
    }

    /// A point that asks these lights.
    pub(super) fn shading_point<R>(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        receiver: R,
    ) -> ShadingPoint<'a, S, R> {
        ShadingPoint {
            tracer: self.tracer,
            shadows: self.shadows,
            origin,
            rays,
            receiver,
        }
    }

    /// Sums over the lights that are `asked` for and all emissive triangles. Media before suns are
    /// those of `suns`, or the scene's own.
    pub(super) fn sum(
        &self,
        at: &ShadingPoint<S, impl Receiver>,
        suns: Option<&SunDepths>,
        asked: impl Fn(&Light) -> bool,
    ) -> Direct<S::Dimming> {
        let prospect = Prospect::new(&self.emitters, self.care, at.origin, at.receiver);
        self.sum_by(&prospect, prospect.open, at, suns, asked)
    }

    fn sum_by<R: Receiver>(
        &self,
        prospect: &Prospect<R>,
        open: Rgb,
        at: &ShadingPoint<S, R>,
        suns: Option<&SunDepths>,
        asked: impl Fn(&Light) -> bool,
    ) -> Direct<S::Dimming> {
        let mut total = Direct::default();
        for (index, light) in self.lights.iter().enumerate() {
            if !asked(light) {
                continue;
            }
            let depth = suns.and_then(|s| s.of(index));
            match Sun::of(light) {
                Some(sun) => sun.add(&mut total, index, at, depth),
                None => sharp::add(&mut total, light, index, at, depth),
            }
        }
        total.open += open;
        prospect.add(&mut total, at);
        total
    }
}

/// A point of a surface that asks for light.
struct OnSurface {
    /// Where rays begin: off the surface.
    origin: Vec3,
    receiver: Surface,
}

impl OnSurface {
    fn new(point: Vec3, normal: Vec3, face_normal: Vec3) -> Self {
        Self {
            origin: point + face_normal * trace::offset(point),
            receiver: Surface {
                normal,
                face_normal,
            },
        }
    }
}
