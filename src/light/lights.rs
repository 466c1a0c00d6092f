//! All lights of a scene, and what a point gets of them.

use super::delta_lights;
use super::direct::DirectLight;
use super::emitter::Emitter;
use super::emitters::{CutTolerance, Emitters, Unshadowed};
use super::glow::Glow;
use super::groups::{Exactness, LightGroups, Which};
use super::shading_point::{
    DirectedReceiver, INVERSE_SPHERE, MediumReceiver, PhaseReceiver, Receiver, ShadingPoint,
    SurfaceReceiver, Travel,
};
use super::shadow_rays::ShadowRays;
use super::shadows::{MediaBeforeSuns, SceneMedia, Shadows, SoftShadowMedia, Vacuum};
use super::sky::Sky;
use super::sun::Sun;
use super::sun_depths::SunDepths;
use crate::math::sampling::{cosine_hemisphere, sphere, tangents};
use crate::math::{Environment, Ray, Rgb, SeenPhase, Spectrum};
use crate::scene::Light;
use crate::trace::{self, Tracer};
use glam::Vec3;
use std::f32::consts::PI;
use std::sync::Arc;

/// All lights of a scene, and what shadow rays to them pass. An environment counts only where it is
/// asked for by name, but for the excess of an image: gathering takes care of it.
#[derive(Clone, Debug)]
pub struct Lights<'a, S = SceneMedia<'a>> {
    pub(super) tracer: &'a Tracer<'a>,
    shadows: S,
    /// Lights of the scene that are no triangles.
    lights: &'a [Light],
    /// Groups of those, and how exactly these tell their light, if they are many.
    pub(super) groups: Option<Arc<LightGroups>>,
    pub(super) exactness: Exactness,
    /// Whether one of them is a sun with an extent.
    pub(super) has_wide_sun: bool,
    pub(super) emitters: Arc<Emitters>,
    /// The light of emissive volumes.
    pub(super) glow: Option<Arc<Glow>>,
    /// How exactly the light of many emitters is known.
    tolerance: CutTolerance,
    environment: Rgb,
    /// The environment image, with that.
    sky: Option<Arc<Sky>>,
}

impl<'a, K: Spectrum> Lights<'a, SceneMedia<'a, K>> {
    /// Finds the lights of the traced scene.
    #[must_use]
    pub fn new(tracer: &'a Tracer<'a>) -> Self {
        Self {
            tracer,
            shadows: SceneMedia::default(),
            lights: &tracer.scene.lights,
            groups: LightGroups::new(&tracer.scene.lights).map(Arc::new),
            exactness: Exactness::SHADING,
            has_wide_sun: tracer.scene.lights.iter().any(|l| Sun::of(l).is_some()),
            emitters: Arc::new(Emitters::new(tracer.scene)),
            glow: Glow::new(&tracer.scene.emissive).map(Arc::new),
            tolerance: CutTolerance::SHADING,
            environment: tracer.scene.environment(),
            sky: Self::sky(tracer),
        }
    }

    fn sky(tracer: &Tracer) -> Option<Arc<Sky>> {
        let image = tracer.scene.environment_image.as_ref()?;
        Some(Arc::new(Sky::new(image, tracer.scene.environment())))
    }

    /// Puts `media`, if any, in the place of the scene's own before emitters.
    #[must_use]
    pub fn with_soft_shadows(mut self, media: Option<&'a SoftShadowMedia>) -> Self {
        self.shadows.before_emitters = media;
        self
    }

    /// Copies the lights, with other media than the scene's own before suns where these say so.
    #[must_use]
    pub fn with_media_before_suns<'s>(
        &self,
        suns: &'s dyn MediaBeforeSuns<K>,
    ) -> Lights<'a, SceneMedia<'s, K>>
    where
        'a: 's,
    {
        self.behind(SceneMedia {
            before_suns: Some(suns),
            ..self.shadows
        })
    }

    /// Copies the lights, with the scene's own media before all of them.
    #[must_use]
    pub fn with_sharp_shadows(&self) -> Self {
        Self {
            shadows: SceneMedia::default(),
            ..self.clone()
        }
    }

    /// Makes lights of these emitters alone, for gathers in the same scene.
    #[must_use]
    pub fn of_emitters(&self, emitters: Vec<Emitter>) -> Self {
        Self {
            lights: &[],
            groups: None,
            emitters: Arc::new(Emitters::of(emitters)),
            glow: None,
            tolerance: CutTolerance::GATHERING,
            environment: Rgb::BLACK,
            sky: None,
            ..self.clone()
        }
    }

    /// Copies the lights, in the same scene without its media.
    #[must_use]
    pub fn in_vacuum(&self) -> Lights<'a, Vacuum> {
        self.behind(Vacuum)
    }

    fn behind<S>(&self, shadows: S) -> Lights<'a, S> {
        Lights {
            tracer: self.tracer,
            shadows,
            lights: self.lights,
            groups: self.groups.clone(),
            exactness: self.exactness,
            has_wide_sun: self.has_wide_sun,
            emitters: Arc::clone(&self.emitters),
            glow: self.glow.clone(),
            tolerance: self.tolerance,
            environment: self.environment,
            sky: self.sky.clone(),
        }
    }
}

impl<S> Lights<'_, S> {
    /// Whether shadow rays go to parts of an environment image.
    pub fn has_excess(&self) -> bool {
        self.sky.as_ref().is_some_and(|sky| sky.excess.is_some())
    }
}

impl<'a, S: Shadows> Lights<'a, S> {
    /// Makes light of many lights less exact: for points of which pictures show means of many.
    #[must_use]
    pub fn for_baking(mut self) -> Self {
        self.tolerance = CutTolerance::BAKING;
        self.exactness = Exactness::BAKING;
        self
    }

    /// The corners of emissive triangles.
    pub fn emitters(&self) -> impl Iterator<Item = [Vec3; 3]> {
        self.emitters.corners()
    }

    /// Share of light that gets from the end of a ray to its origin: 0 behind a surface, else what
    /// the scene's own media let through.
    #[must_use]
    pub fn transmittance(&self, ray: &Ray) -> S::Share {
        self.shadows.transmittance(self.tracer, ray, None)
    }

    /// The same for a ray of a camera, which passes surfaces that it does not see.
    #[must_use]
    pub fn seen_transmittance(&self, ray: &Ray) -> S::Share {
        match self.tracer.are_all_seen() {
            true => self.transmittance(ray),
            false => self.tracer.seen_transmittance(ray),
        }
    }

    /// The scene that shadow rays are traced in.
    #[must_use]
    pub fn tracer(&self) -> &'a Tracer<'a> {
        self.tracer
    }

    /// What gathers meet where no surface is.
    #[must_use]
    pub fn environment(&self) -> Environment<'_> {
        match &self.sky {
            Some(sky) => Environment::mapped(&sky.map),
            None => Environment::even(self.environment),
        }
    }

    /// The environment of one colour.
    pub(super) fn even_environment(&self) -> Rgb {
        self.environment
    }

    /// Radiance that a camera sees in a direction in which no surface is, within about an angle.
    #[must_use]
    pub fn seen_environment(&self, direction: Vec3, angle: f32) -> Rgb {
        match &self.tracer.scene.environment_image {
            _ if !self.tracer.scene.is_environment_seen => Rgb::BLACK,
            Some(image) => self.environment + image.seen_within(direction, angle),
            None => self.environment,
        }
    }

    /// Unshadowed light of emitters on a surface.
    #[must_use]
    pub fn unshadowed(&self, surface: &trace::Surface) -> Unshadowed<'_> {
        let at = OnSurface::new(surface.position, surface.normal, surface.face_normal);
        Unshadowed::new(&self.emitters, self.tolerance, at.origin, at.receiver)
    }

    /// Irradiance of a surface, where `unshadowed`, of this or a nearby point, chooses rays to
    /// emitters, and `light` is the unshadowed light that it told, or a mean of several.
    #[must_use]
    pub fn irradiance_by(
        &self,
        surface: &trace::Surface,
        unshadowed: &Unshadowed,
        light: Rgb,
        rays: ShadowRays,
    ) -> DirectLight {
        let at = OnSurface::new(surface.position, surface.normal, surface.face_normal);
        let at = self.shading_point(at.origin, rays, at.receiver);
        self.sum_by(unshadowed, light, &at, None, Which::All)
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
    ) -> DirectLight {
        let at = OnSurface::new(point, normal, face_normal);
        let at = self.shading_point(at.origin, rays, at.receiver);
        self.sum(&at, None, Which::All)
    }

    /// Mean over the sphere of the direct radiance at a point of a medium: its in-scattered
    /// radiance for an isotropic phase function.
    #[must_use]
    pub fn mean_radiance(&self, point: Vec3, rays: ShadowRays) -> DirectLight {
        self.mean_radiance_through(point, rays, None)
    }

    /// The same, where media before suns are those of `suns`, or the scene's own.
    pub(super) fn mean_radiance_through(
        &self,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
    ) -> DirectLight {
        let at = self.shading_point(point, rays, MediumReceiver);
        let mut direct = self.sum(&at, suns, Which::All);
        direct.delta *= INVERSE_SPHERE;
        direct.unshadowed *= INVERSE_SPHERE;
        direct.sky.unshadowed *= INVERSE_SPHERE;
        direct
    }

    /// The same light, with the sum over it of its mean channel times the direction in which it
    /// travels.
    pub(super) fn directed_through(
        &self,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
    ) -> (Rgb, Vec3) {
        let travel = Travel::default();
        let at = self.shading_point(point, rays, DirectedReceiver(&travel));
        let direct = self.sum(&at, suns, Which::All);
        // Rays tell shares, as in [`DirectLight::light`].
        let by_rays = direct.ratio.unshadowed.mean();
        let scale = match by_rays > 0.0 {
            true => direct.unshadowed.mean() / by_rays,
            false => 0.0,
        };
        let way = travel.delta.get() + travel.rays.get() * scale;
        (direct.light() * INVERSE_SPHERE, way * INVERSE_SPHERE)
    }

    /// Radiance that a medium of albedo 1 scatters along a ray at a point, of all lights: that of
    /// [`Self::mean_radiance`] if its phase function is isotropic.
    #[must_use]
    pub fn scattered(&self, point: Vec3, rays: ShadowRays, seen: Option<SeenPhase>) -> DirectLight {
        let Some(seen) = seen else {
            return self.mean_radiance(point, rays);
        };
        let at = self.shading_point(point, rays, PhaseReceiver(seen));
        let mut direct = self.sum(&at, None, Which::All);
        direct.delta *= INVERSE_SPHERE;
        direct.unshadowed *= INVERSE_SPHERE;
        direct.sky.unshadowed *= INVERSE_SPHERE;
        direct
    }

    /// Irradiance of a surface point from an environment, but for the excess of an image, for those
    /// who do not gather it:
    /// by as many rays over the hemisphere as `rays` are.
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
        self.environment_mean(origin, rays, PI, |u| {
            let d = cosine_hemisphere(u);
            (x * d.x + y * d.y + normal * d.z).normalize()
        })
    }

    /// Mean over the sphere of the radiance of an environment, but for the excess of an image, at a
    /// point of a medium.
    #[must_use]
    pub fn environment_mean_radiance(&self, point: Vec3, rays: ShadowRays) -> Rgb {
        self.environment_mean(point, rays, 1.0, sphere)
    }

    /// The same as a ray sees the medium there.
    #[must_use]
    pub fn scattered_environment(
        &self,
        point: Vec3,
        rays: ShadowRays,
        seen: Option<SeenPhase>,
    ) -> Rgb {
        let Some(seen) = seen else {
            return self.environment_mean_radiance(point, rays);
        };
        self.environment_mean(point, rays, 1.0, |u| seen.sample(u))
    }

    /// The mean over the sphere of the radiance of an environment, with the sum over it of
    /// its mean channel times the direction in which it travels.
    pub(super) fn directed_environment(&self, point: Vec3, rays: ShadowRays) -> (Rgb, Vec3) {
        let environment = self.environment();
        let mut way = Vec3::ZERO;
        if environment.is_black() {
            return (Rgb::BLACK, way);
        }
        let at = self.shading_point(point, rays, ());
        let scale = 1.0 / rays.count() as f32;
        let (mut even, mut by_direction) = (S::Share::default(), Rgb::BLACK);
        for i in 0..rays.count() {
            let direction = sphere(rays.point(i, 62));
            let media = at.shadows.before_emitters();
            let through = at.transmittance(direction, f32::INFINITY, media) * scale;
            match environment.map() {
                None => {
                    even += through;
                    way -= direction * through.mean();
                }
                Some(map) => {
                    let light = through.filter(map.radiance.get(direction));
                    by_direction += light;
                    way -= direction * light.mean();
                }
            }
        }
        match environment.map() {
            None => (even.filter(self.environment), way * self.environment.mean()),
            Some(_) => (by_direction, way),
        }
    }

    /// Mean over rays of what gathers meet where no surface is, times `scale`.
    fn environment_mean(
        &self,
        origin: Vec3,
        rays: ShadowRays,
        scale: f32,
        direction: impl Fn([f32; 2]) -> Vec3,
    ) -> Rgb {
        let environment = self.environment();
        if environment.is_black() {
            return Rgb::BLACK;
        }
        let at = self.shading_point(origin, rays, ());
        let ray = |i| {
            let direction = direction(rays.point(i, 62));
            let media = at.shadows.before_emitters();
            (direction, at.transmittance(direction, f32::INFINITY, media))
        };
        let rays_of_all = (0..rays.count()).map(ray);
        let count = rays.count() as f32;
        if environment.map().is_none() {
            let sum = rays_of_all.fold(S::Share::default(), |sum, (_, share)| sum + share);
            return (sum.each(|sum| sum / count) * scale).filter(self.environment);
        }
        let arriving = rays_of_all.map(|(d, share)| share.filter(environment.radiance(d)));
        arriving.fold(Rgb::BLACK, |sum, light| sum + light) * (scale / count)
    }

    /// A point that light falls on, in the scene of these lights.
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

    /// Sums over the lights that are asked for and all emitters. Media before suns are those of
    /// `suns`, or the scene's own.
    pub(super) fn sum(
        &self,
        at: &ShadingPoint<S, impl Receiver>,
        suns: Option<&SunDepths>,
        which: Which,
    ) -> DirectLight {
        let unshadowed = Unshadowed::new(&self.emitters, self.tolerance, at.origin, at.receiver);
        self.sum_by(&unshadowed, unshadowed.light, at, suns, which)
    }

    fn sum_by<R: Receiver>(
        &self,
        unshadowed: &Unshadowed<R>,
        light_of_emitters: Rgb,
        at: &ShadingPoint<S, R>,
        suns: Option<&SunDepths>,
        which: Which,
    ) -> DirectLight {
        let mut total = DirectLight::default();
        self.each_light(at, which, |index, light| {
            let media = suns.and_then(|s| s.of(index));
            match Sun::of(light) {
                Some(sun) => {
                    sun.trace(&mut total, index, at, self.tolerance.by_rays_alone(), media)
                }
                None => {
                    // Those before a disk would make its shadows too sharp.
                    let media = media.or_else(|| self.shadows.before_sun(index));
                    delta_lights::trace(&mut total, light, index, at, media);
                }
            }
        });
        total.unshadowed += light_of_emitters;
        unshadowed.trace(&mut total, at);
        if let Some(glow) = &self.glow {
            match self.tolerance.by_rays_alone() {
                true => glow.trace_alone(&mut total, at),
                false => glow.trace(&mut total, at),
            }
        }
        if let Some(excess) = self.sky.as_ref().and_then(|sky| sky.excess.as_ref()) {
            excess.trace(&mut total, at, self.tolerance.by_rays_alone());
        }
        total
    }
}

impl<S: Shadows> Lights<'_, S> {
    /// Gives the lights that are no triangles, or those that stand for them at a point if they are
    /// many, to `add` with their numbers.
    #[inline]
    pub(super) fn each_light<R: Receiver>(
        &self,
        at: &ShadingPoint<S, R>,
        which: Which,
        mut add: impl FnMut(usize, &Light),
    ) {
        match &self.groups {
            None => {
                let lights = self.lights.iter().enumerate();
                let asked = lights.filter(|(_, light)| which.counts(light));
                asked.for_each(|(index, light)| add(index, light));
            }
            Some(groups) => {
                let lights = groups.at_point(which, at.origin, at.receiver, self.exactness);
                lights.for_each(|(index, light)| add(index, light));
            }
        }
    }
}

/// A point of a surface that light falls on.
struct OnSurface {
    /// Where rays begin: off the surface.
    origin: Vec3,
    receiver: SurfaceReceiver,
}

impl OnSurface {
    fn new(point: Vec3, normal: Vec3, face_normal: Vec3) -> Self {
        Self {
            origin: point + face_normal * trace::offset(point),
            receiver: SurfaceReceiver {
                normal,
                face_normal,
            },
        }
    }
}
