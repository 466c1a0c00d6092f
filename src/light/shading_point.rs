//! A point that light falls on: what it responds to, and what its shadow rays pass.

use super::emitter::Emitter;
use super::shadow_rays::ShadowRays;
use super::shadows::{ShadowMedia, Shadows};
use crate::math::{Ray, SeenPhase, polygon};
use crate::trace::{self, Tracer};
use glam::Vec3;
use std::cell::Cell;
use std::f32::consts::PI;

/// A point that light falls on.
#[derive(Clone, Copy, Debug)]
pub struct ShadingPoint<'a, S, R> {
    /// Surfaces, and the scene's own media.
    pub tracer: &'a Tracer<'a>,
    /// What shadow rays pass beside surfaces.
    pub shadows: S,
    /// Where shadow rays begin, scene space: off the surface that the point is on, if any.
    pub origin: Vec3,
    /// Shadow rays to each light with an extent.
    pub rays: ShadowRays,
    /// What light falls on.
    pub receiver: R,
}

impl<S: Shadows, R> ShadingPoint<'_, S, R> {
    /// Share of light that gets here from `t_max` away along a unit direction, through `media` or
    /// the scene's own.
    pub fn transmittance(
        &self,
        direction: Vec3,
        t_max: f32,
        media: Option<&dyn ShadowMedia<S::Share>>,
    ) -> S::Share {
        self.shadows
            .transmittance(self.tracer, &Ray::new(self.origin, direction, t_max), media)
    }

    /// Share of light that gets here from a point of an emitter, `distance` along a unit direction.
    fn transmittance_from_emitter(&self, direction: Vec3, distance: f32) -> S::Share {
        let end = trace::short_of(self.origin + direction * distance, distance);
        self.transmittance(direction, end, self.shadows.before_emitters())
    }
}

/// What a ray to an emitter brings.
#[derive(Clone, Copy, Debug)]
pub struct EmitterRay<K> {
    /// Unit direction to the emitter.
    pub direction: Vec3,
    /// Unshadowed light per unit of the emitter's radiance, over what was expected of it.
    pub weight: f32,
    /// Share of that which arrives.
    pub transmittance: K,
}

impl<S: Shadows, R: Receiver> ShadingPoint<'_, S, R> {
    /// Traces a ray to the point of an emitter that two numbers in [0,1) choose. `expected` is the
    /// chance of the emitter, or the receiver's whole response to it. `None` if the ray counts for
    /// nothing.
    pub fn ray_to(
        &self,
        emitter: &Emitter,
        u: [f32; 2],
        expected: f32,
    ) -> Option<EmitterRay<S::Share>> {
        let towards = emitter.sample(self.origin, u, self.rays.near());
        let weight = self.receiver.response(towards.direction) / (towards.pdf * expected);
        (weight > 0.0 && weight.is_finite()).then(|| EmitterRay {
            direction: towards.direction,
            weight,
            transmittance: self.transmittance_from_emitter(towards.direction, towards.distance),
        })
    }
}

/// Share of the sphere that a unit of solid angle is, per steradian.
pub const INVERSE_SPHERE: f32 = 1.0 / (4.0 * PI);

/// What light falls on, as a type: light on surfaces is summed by code of its own.
pub trait Receiver: Copy {
    /// Response to light from a unit direction.
    fn response(self, d: Vec3) -> f32;

    /// Integral of the response over a triangle seen from the receiver at the origin: closed form,
    /// in units of the triangle's radiance.
    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32;

    /// Response of a receiver without normals to light from the middle of a sphere that is seen in a
    /// unit direction under an angle of this sine and cosine, and by how much more or less that may
    /// be from elsewhere on it.
    #[inline]
    fn response_to_sphere(self, _to_middle: Vec3, _angle: [f32; 2]) -> [f32; 2] {
        [1.0, 0.0]
    }

    /// Unit normals on whose side a light must be, that of the response first; `None` if light may
    /// come from anywhere.
    fn normals(self) -> Option<[Vec3; 2]>;

    /// Takes note of what arrives from a unit direction, of a delta light or along a ray to a light
    /// with an extent.
    #[inline]
    fn note(self, _from: Vec3, _light: f32, _of: Arrival) {}
}

/// What light arrives from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// A light without extent.
    Delta,
    /// A point of one with an extent, among others.
    Ray,
}

/// A piece of surface, lit on the side of both normals, by the cosine to the first.
#[derive(Clone, Copy, Debug)]
pub struct SurfaceReceiver {
    /// Normal for shading, interpolated over the triangle; unit length, scene space.
    pub normal: Vec3,
    /// Normal of the triangle itself; unit length, scene space.
    pub face_normal: Vec3,
}

impl Receiver for SurfaceReceiver {
    #[inline]
    fn response(self, d: Vec3) -> f32 {
        if d.dot(self.face_normal) > 0.0 {
            d.dot(self.normal).max(0.0)
        } else {
            0.0
        }
    }

    #[inline]
    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32 {
        if self.normal == self.face_normal {
            polygon::irradiance(corners, self.normal)
        } else {
            polygon::irradiance_above(corners, self.normal, self.face_normal)
        }
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        Some([self.normal, self.face_normal])
    }
}

/// A point of a medium with an isotropic phase function.
#[derive(Clone, Copy, Debug)]
pub struct MediumReceiver;

impl Receiver for MediumReceiver {
    #[inline]
    fn response(self, _: Vec3) -> f32 {
        1.0
    }

    #[inline]
    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32 {
        polygon::solid_angle(corners)
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        None
    }
}

/// A point of a medium that sums up, beside its light, in which direction that travels.
#[derive(Clone, Copy, Debug)]
pub struct DirectedReceiver<'a>(pub &'a Travel);

/// Sums of light times the direction in which it travels: of delta lights, and along rays.
#[derive(Debug, Default)]
pub struct Travel {
    pub delta: Cell<Vec3>,
    pub rays: Cell<Vec3>,
}

impl Receiver for DirectedReceiver<'_> {
    #[inline]
    fn response(self, d: Vec3) -> f32 {
        MediumReceiver.response(d)
    }

    #[inline]
    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32 {
        MediumReceiver.response_to_triangle(corners)
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        None
    }

    fn note(self, from: Vec3, light: f32, of: Arrival) {
        let sum = match of {
            Arrival::Delta => &self.0.delta,
            Arrival::Ray => &self.0.rays,
        };
        sum.set(sum.get() - from * light);
    }
}

/// A point of a medium whose phase function is not isotropic, as one ray sees it.
#[derive(Clone, Copy, Debug)]
pub struct PhaseReceiver(pub SeenPhase);

impl PhaseReceiver {
    /// Parts along each edge of a triangle, over which the response is summed.
    const PARTS: u8 = 4;
    /// The same for a triangle whose squared size over its squared distance is below [`Self::FAR`].
    const FEW_PARTS: u8 = 2;
    const FAR: f32 = 0.02;
}

impl Receiver for PhaseReceiver {
    #[inline]
    fn response(self, d: Vec3) -> f32 {
        self.0.response(d)
    }

    /// The solid angle times the mean response of the parts of the triangle, each by its own solid
    /// angle: that of the whole is exact, and so is a response that does not change over it.
    fn response_to_triangle(self, corners: [Vec3; 3]) -> f32 {
        let [a, b, c] = corners;
        let (ab, ac) = (b - a, c - a);
        let middle = (a + b + c) * (1.0 / 3.0);
        let size = ab.length_squared().max(ac.length_squared());
        let is_far = size < Self::FAR * middle.length_squared();
        let n = if is_far { Self::FEW_PARTS } else { Self::PARTS };
        let normal = ab.cross(ac);
        let step = 1.0 / f32::from(n);
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in 0..n {
            // Two triangles to a cell, but for the last in a row.
            for k in 0..2 * (n - i) - 1 {
                let (j, offset) = (k / 2, if k % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 });
                let [u, v] = [j, i].map(|w| (f32::from(w) + offset) * step);
                let p = a + ab * u + ac * v;
                let inverse = 1.0 / p.length();
                let weight = (p.dot(normal)).abs() * (inverse * inverse * inverse);
                sum += weight * self.0.response(p * inverse);
                weights += weight;
            }
        }
        if weights > 0.0 && weights.is_finite() {
            polygon::solid_angle(corners) * (sum / weights)
        } else {
            0.0
        }
    }

    #[inline]
    fn response_to_sphere(self, to_middle: Vec3, angle: [f32; 2]) -> [f32; 2] {
        self.0.response_to_sphere(to_middle, angle)
    }

    #[inline]
    fn normals(self) -> Option<[Vec3; 2]> {
        None
    }
}
