//! What surfaces are painted with, over a pixel: textures change within it, light on one piece of
//! surface hardly does.

use super::pattern::Pattern;
use super::sample::Sample;
use super::shader::PixelShader;
use crate::math::Rgb;
use crate::shade::pixels::camera_media::{CameraMedia, PassedMedia};
use crate::trace::{Surface, weights_in_triangle};
use glam::Vec3;

impl<A: CameraMedia> PixelShader<'_, A> {
    /// Mean albedo of pixel (x, y), whose corners (upper left, upper right, lower left, lower
    /// right) are on one piece of surface; `None` where those corners tell it. As many points
    /// inside are looked at as edges take samples, without their light.
    pub fn paint(&self, x: u32, y: u32, corners: [&Sample<A::Passed>; 4]) -> Option<Rgb> {
        let scene = self.view.tracer.scene;
        if scene.textures.is_empty() && scene.mesh.colors.is_empty() {
            return None;
        }
        let surfaces = corners.map(|c| c.surface.as_ref());
        let like = surfaces[0]?;
        let albedos = surfaces.map(|s| s.map_or(like.albedo, |s| s.albedo));
        let texture = scene.materials[like.material as usize].texture;
        if texture.is_none() && albedos.iter().all(|a| *a == albedos[0]) {
            return None;
        }
        let pattern = Pattern::new(self.counts.edge, self.key(x, y));
        let at = |[u, v]: [f32; 2]| self.albedo_within([x, y], [u, v], corners);
        let middle = at([0.5; 2]).unwrap_or(like.albedo);
        let hides_detail = || texture.is_some_and(|t| self.is_finer_than_pixel(t, corners));
        if is_even(albedos.into_iter().chain([middle])) && !hides_detail() {
            return None;
        }
        let corner = pattern.corner_weight();
        let sum = albedos.into_iter().fold(Rgb::BLACK, |s, a| s + a);
        let (mut sum, mut weight) = (sum * corner, 4.0 * corner);
        for i in 0..self.counts.edge {
            if let Some(albedo) = at(pattern.point(i)) {
                sum += albedo;
                weight += 1.0;
            }
        }
        (weight > 0.0).then(|| sum * (1.0 / weight))
    }

    /// Mean of what pixel (x, y), whose corners are on one piece of surface, sends by itself;
    /// `None` where that has no texture, or the corners tell it.
    pub fn emission_over(&self, x: u32, y: u32, corners: [&Sample<A::Passed>; 4]) -> Option<Rgb> {
        let scene = self.view.tracer.scene;
        if scene.textures.is_empty() {
            return None;
        }
        let like = corners[0].surface.as_ref()?;
        let texture = scene.materials[like.material as usize].emission_texture?;
        let pattern = Pattern::new(self.counts.edge, self.key(x, y));
        let at = |uv: [f32; 2]| self.emission_within([x, y], uv, corners);
        let of_corners = corners.map(|c| {
            let surface = c.surface.as_ref();
            surface.map_or(Rgb::BLACK, |s| self.emission([x, y], c, s))
        });
        if is_even(of_corners.into_iter().chain(at([0.5; 2])))
            && !self.is_finer_than_pixel(texture, corners)
        {
            return None;
        }
        let corner = pattern.corner_weight();
        let sum = of_corners.into_iter().fold(Rgb::BLACK, |s, e| s + e);
        let (mut sum, mut weight) = (sum * corner, 4.0 * corner);
        for i in 0..self.counts.edge {
            if let Some(emission) = at(pattern.point(i)) {
                sum += emission;
                weight += 1.0;
            }
        }
        (weight > 0.0).then(|| sum * (1.0 / weight))
    }

    /// Whether so many texels lie between the corners of a pixel that these may miss some.
    fn is_finer_than_pixel(&self, texture: u32, corners: [&Sample<A::Passed>; 4]) -> bool {
        /// A line of one texel is then seven tenths of a pixel wide.
        const MOST: f32 = 2.0;
        let scene = self.view.tracer.scene;
        let (mesh, triangle) = (&scene.mesh, corners[0].triangle as usize);
        if mesh.uvs.is_empty() {
            return false;
        }
        let [a, b, c] = mesh.vertices_of(triangle).map(|i| mesh.uvs[i as usize]);
        let texture = &scene.textures[texture as usize];
        let texels = (b - a).perp_dot(c - a).abs() * texture.width as f32 * texture.height as f32;
        let area = |[p, q, r]: [Vec3; 3]| (q - p).cross(r - p).length();
        let of = |i: usize| corners[i].surface.map_or(Vec3::ZERO, |s| s.position);
        let of_pixel = area([of(0), of(1), of(2)]) + area([of(3), of(2), of(1)]);
        texels * of_pixel > 2.0 * MOST * area(mesh.corners(triangle))
    }

    /// Emission at a point of a pixel's square; `None` where its piece of surface is not there.
    fn emission_within(
        &self,
        [x, y]: [u32; 2],
        [u, v]: [f32; 2],
        corners: [&Sample<A::Passed>; 4],
    ) -> Option<Rgb> {
        let first = corners[0];
        let triangle = first.triangle;
        if corners[1..].iter().any(|c| c.triangle != triangle) {
            let sample = self.look(x as f32 + u, y as f32 + v);
            let surface = sample.surface.filter(|_| self.same_end(first, &sample))?;
            return Some(self.emission([x, y], &sample, &surface));
        }
        let mut surface = first.surface?;
        surface.position = point_between(corners, [u, v]);
        Some(self.emission([x, y], first, &surface))
    }

    /// Albedo at a point of a pixel's square; `None` where its piece of surface is not there.
    fn albedo_within(
        &self,
        [x, y]: [u32; 2],
        [u, v]: [f32; 2],
        corners: [&Sample<A::Passed>; 4],
    ) -> Option<Rgb> {
        let scene = self.view.tracer.scene;
        let [first, ..] = corners;
        let triangle = first.triangle;
        if corners[1..].iter().any(|c| c.triangle != triangle) {
            // Between the triangles of a finely divided mesh only rays tell.
            let sample = self.look(x as f32 + u, y as f32 + v);
            let surface = sample.surface.filter(|_| self.same_end(first, &sample))?;
            return Some(surface.albedo);
        }
        let point = point_between(corners, [u, v]);
        let weights = weights_in_triangle(scene.mesh.corners(triangle as usize), point);
        Some(Surface::albedo_at(scene, triangle, weights))
    }
}

/// The point of a surface in a pixel's square, by those of its corners.
fn point_between<T: PassedMedia>(corners: [&Sample<T>; 4], [u, v]: [f32; 2]) -> Vec3 {
    let of = |corner: &Sample<T>| corner.surface.map_or(Vec3::ZERO, |s| s.position);
    let [a, b, c, d] = corners.map(of);
    a.lerp(b, u).lerp(c.lerp(d, u), v)
}

/// Whether albedos differ so little that the mean of any is that of all.
fn is_even(albedos: impl Iterator<Item = Rgb>) -> bool {
    /// Of the largest.
    const LITTLE: f32 = 1.0 / 32.0;
    let (mut least, mut most) = ([f32::INFINITY; 3], [0.0_f32; 3]);
    for Rgb(albedo) in albedos {
        for c in 0..3 {
            least[c] = least[c].min(albedo[c]);
            most[c] = most[c].max(albedo[c]);
        }
    }
    (0..3).all(|c| most[c] - least[c] <= LITTLE * most[c])
}
