//! Direct light in media, so split that it can be interpolated between points.

use super::delta_lights::{self, SegmentFromLight};
use super::direct::DirectLight;
use super::emitters::{CutTolerance, Unshadowed};
use super::groups::Which;
use super::lights::Lights;
use super::shading_point::{INVERSE_SPHERE, MediumReceiver, PhaseReceiver};
use super::shadow_rays::ShadowRays;
use super::shadows::Shadows;
use super::sun::Sun;
use super::sun_depths::SunDepths;
use crate::math::{Ray, Rgb, SeenPhase, Spectrum};
use crate::scene::Light;
use crate::trace::short_of;
use glam::Vec3;
use std::ops::{AddAssign, Mul};

/// Direct light at a point of a medium, in two parts: that of point and spot lights changes without
/// bound near them, but the share of it that arrives changes no faster than media and shadows do.
/// So does that of suns where it is scattered by a phase function, which changes with the ray.
#[derive(Clone, Copy, Debug, Default)]
pub struct MediumLight {
    /// Share of [`Lights::unshadowed_along`] that arrives, per channel.
    pub share: Rgb,
    /// Mean over the sphere of the radiance of all other lights, weighed by the phase function.
    pub rest: Rgb,
}

impl AddAssign for MediumLight {
    fn add_assign(&mut self, o: Self) {
        self.share += o.share;
        self.rest += o.rest;
    }
}

impl Mul<f32> for MediumLight {
    type Output = Self;
    fn mul(self, s: f32) -> Self {
        Self {
            share: self.share * s,
            rest: self.rest * s,
        }
    }
}

impl<S: Shadows> Lights<'_, S> {
    /// [`Self::scattered`] in two parts, for what lies between points:
    /// [`Self::unshadowed_along`] times the share, and the rest. Media before suns are those of
    /// `suns`, or the scene's own.
    #[must_use]
    pub fn in_medium(
        &self,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
        seen: Option<SeenPhase>,
    ) -> MediumLight {
        if let Some(seen) = seen {
            let at = self.shading_point(point, rays, PhaseReceiver(seen));
            return MediumLight {
                share: self.share_of_directed(point, rays, suns, seen),
                rest: self.sum(&at, None, Which::Emitters).light() * INVERSE_SPHERE,
            };
        }
        let rest = self.sum(
            &self.shading_point(point, rays, MediumReceiver),
            suns,
            Which::Directional,
        );
        MediumLight {
            share: self.share_of_point_sources(point),
            rest: rest.light() * INVERSE_SPHERE,
        }
    }

    /// Mean over the sphere of the radiance of emitters at a point, if nothing is between; that of
    /// many roughly.
    #[must_use]
    pub fn unshadowed_of_emitters(&self, point: Vec3) -> Rgb {
        let tolerance = CutTolerance::SHADING_PARTS;
        Unshadowed::new(&self.emitters, tolerance, point, MediumReceiver).light * INVERSE_SPHERE
    }

    /// Share of all that point and spot lights send to a point of a medium that arrives, per
    /// channel.
    fn share_of_point_sources(&self, point: Vec3) -> Rgb {
        // What is beside a spot's beam counts little, but tells what arrives in a beam that passes
        // between such points.
        const BESIDE: f32 = 1e-3;
        let (mut arriving, mut sent) = (Rgb::BLACK, Rgb::BLACK);
        self.each_point_source(point, point, |position, intensity, light| {
            let to_light = position - point;
            let distance = to_light.length();
            if distance == 0.0 {
                return;
            }
            let d = to_light / distance;
            let light = intensity * (light.falloff(-d).max(BESIDE) / (distance * distance));
            let ray = Ray::new(point, d, short_of(position, distance));
            arriving += self.transmittance(&ray).filter(light);
            sent += light;
        });
        arriving.over(sent)
    }

    /// The same of all that point lights, spot lights and suns send, by what a ray sees scattered.
    fn share_of_directed(
        &self,
        point: Vec3,
        rays: ShadowRays,
        suns: Option<&SunDepths>,
        seen: SeenPhase,
    ) -> Rgb {
        // What is scattered elsewhere counts little, but tells what arrives.
        const LEAST: f32 = 1e-3;
        let (mut arriving, mut sent) = (Rgb::BLACK, Rgb::BLACK);
        let at = self.shading_point(point, rays, MediumReceiver);
        let mut add = |light: &Light, index: usize, sends: Rgb, to_light: Vec3| {
            let mut direct = DirectLight::default();
            let media = suns.and_then(|s| s.of(index));
            match Sun::of(light) {
                Some(sun) => sun.trace(&mut direct, index, &at, false, media),
                None => delta_lights::trace(&mut direct, light, index, &at, media),
            }
            let weight = seen.response(to_light).max(LEAST);
            arriving += direct.light() * weight;
            sent += sends * weight;
        };
        self.each_light(&at, Which::Directional, |index, light| {
            if let Light::Directional {
                direction,
                irradiance,
                ..
            } = *light
            {
                add(light, index, Rgb(irradiance), -direction);
            }
        });
        self.each_point_source(point, point, |position, intensity, light| {
            let to_light = position - point;
            let distance = to_light.length();
            if distance == 0.0 {
                return;
            }
            let d = to_light / distance;
            let weight = light.falloff(-d).max(LEAST) * seen.response(d).max(LEAST);
            let light = intensity * (weight / (distance * distance));
            let ray = Ray::new(point, d, short_of(position, distance));
            arriving += self.transmittance(&ray).filter(light);
            sent += light;
        });
        arriving.over(sent)
    }
}

impl<S> Lights<'_, S> {
    /// Gives the point and spot lights to `add`, or those that stand for them along a segment if
    /// they are many, with their positions and intensities.
    fn each_point_source(&self, from: Vec3, to: Vec3, mut add: impl FnMut(Vec3, Rgb, &Light)) {
        let mut add_light = |light: &Light| {
            if let Some((position, intensity)) = light.point_source() {
                add(position, Rgb(intensity), light);
            }
        };
        match &self.groups {
            None => self.tracer.scene.lights.iter().for_each(add_light),
            Some(groups) => {
                let lights = groups.along([from, to], self.exactness);
                lights.for_each(|(_, light)| add_light(light));
            }
        }
    }

    fn point_sources(&self) -> impl Iterator<Item = Vec3> {
        let lights = self.tracer.scene.lights.iter();
        lights.filter_map(|l| l.point_source().map(|(at, _)| at))
    }

    /// Unshadowed light of point and spot lights in a medium: mean radiance over the sphere,
    /// averaged over a segment in closed form. As a ray sees it, weighed by the phase function, and
    /// that of suns as well. A beam around the segment is as wide as `width` tells at a point.
    #[must_use]
    pub fn unshadowed_along(
        &self,
        [from, to]: [Vec3; 2],
        width: impl Fn(Vec3) -> f32,
        seen: Option<SeenPhase>,
    ) -> Rgb {
        let mut total = Rgb::BLACK;
        self.each_point_source(from, to, |position, intensity, light| {
            let segment = SegmentFromLight::new(position, [from, to]).of_beam(width(position));
            let mean = segment.mean_inverse_square();
            if mean.is_finite() {
                let scattered = seen.map_or(1.0, |seen| segment.scattered(seen));
                total += intensity * (mean * INVERSE_SPHERE * segment.falloff(light) * scattered);
            }
        });
        if let Some(seen) = seen {
            total += self.unshadowed_suns(seen);
        }
        total
    }

    /// What a ray sees scattered of suns if nothing is before them.
    fn unshadowed_suns(&self, seen: SeenPhase) -> Rgb {
        let mut total = Rgb::BLACK;
        for light in &self.tracer.scene.lights {
            if let Light::Directional {
                direction,
                irradiance,
                ..
            } = *light
            {
                total += Rgb(irradiance) * (INVERSE_SPHERE * seen.response(-direction));
            }
        }
        total
    }

    /// Whether no light has an extent, so that [`MediumLight::rest`] has no noise of shadow rays.
    #[must_use]
    pub fn rest_is_exact(&self) -> bool {
        self.emitters.is_empty() && self.glow.is_none() && !self.has_wide_sun && !self.has_excess()
    }

    /// Whether there are lights whose shadows have sharp edges: points, spots and suns.
    #[must_use]
    pub fn has_sharp_shadows(&self) -> bool {
        let mut lights = self.tracer.scene.lights.iter();
        self.has_excess() || lights.any(|l| !matches!(l, Light::Environment { .. }))
    }

    /// Whether a point or spot light is nearer to a segment than `distance`; then, for the nearest,
    /// the place from 0 to 1 that halves its light on the segment.
    #[must_use]
    pub fn point_source_near(&self, from: Vec3, to: Vec3, distance: f32) -> Option<f32> {
        if let Some(groups) = &self.groups {
            let nearest = groups.nearest([from, to], distance);
            return nearest.map(|segment| segment.median());
        }
        self.point_sources()
            .map(|position| SegmentFromLight::new(position, [from, to]))
            .map(|segment| (segment.distance(), segment))
            .filter(|(d, _)| *d < distance)
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, segment)| segment.median())
    }
}
