//! The surface at a point of a triangle: normals, albedo, emission.

use crate::math::Rgb;
use crate::scene::Scene;
use glam::Vec3;

/// The surface at a point of a triangle, as shading needs it.
#[derive(Clone, Copy, Debug)]
pub struct Surface {
    /// Point in scene space.
    pub position: Vec3,
    /// Unit normal of the triangle, on the side its corners wind counter-clockwise.
    pub face_normal: Vec3,
    /// Unit shading normal, on the same side.
    pub normal: Vec3,
    /// Diffuse albedo: base colour times texture times vertex colour.
    pub albedo: Rgb,
    /// Index into the scene's materials.
    pub material: u32,
    /// Whether its material reflects anything, here or beside: where a texture is black, a pixel
    /// may show what is not.
    pub reflects: bool,
    /// Whether the normals were turned to the triangle's back.
    is_back: bool,
}

impl Surface {
    /// The surface at barycentric weights `uv` of the second and third corner.
    #[must_use]
    pub fn new(scene: &Scene, triangle: u32, uv: [f32; 2]) -> Self {
        let mesh = &scene.mesh;
        let weight = [1.0 - uv[0] - uv[1], uv[0], uv[1]];
        let [a, b, c] = mesh.corners(triangle as usize);
        // In double, so that the point is off the plane by its own rounding alone, however large
        // the triangle is.
        let [u, v] = uv.map(f64::from);
        let [p, q, r] = [a, b, c].map(|p| p.as_dvec3());
        let position = (p * (1.0 - u - v) + q * u + r * v).as_vec3();
        let face_normal = unit_normal([a, b, c]);
        let mut normal = face_normal;
        if !mesh.normals.is_empty() {
            let normals = mesh.normals_of(triangle as usize).into_iter();
            let n = normals.zip(weight).map(|(n, w)| n * w).sum::<Vec3>();
            // Averaged normals of hard edges can point to the back; the face's own is right there.
            if n.dot(face_normal) > 1e-3 * n.length() && n.length_squared() > 0.0 {
                normal = n.normalize();
            }
        }
        let material = mesh.material_of(triangle as usize);
        Self {
            position,
            face_normal,
            normal,
            albedo: Self::albedo_at(scene, triangle, uv),
            material,
            reflects: !Rgb(scene.materials[material as usize].albedo).is_black(),
            is_back: false,
        }
    }

    /// Diffuse albedo at barycentric weights `uv` of the second and third corner.
    #[must_use]
    pub fn albedo_at(scene: &Scene, triangle: u32, uv: [f32; 2]) -> Rgb {
        let mesh = &scene.mesh;
        let material = &scene.materials[mesh.material_of(triangle as usize) as usize];
        let mut albedo = Rgb(material.albedo);
        let texture = material.texture.filter(|_| !mesh.uvs.is_empty());
        if texture.is_none() && mesh.colors.is_empty() {
            return albedo;
        }
        let index = mesh.vertices_of(triangle as usize).map(|i| i as usize);
        let weight = [1.0 - uv[0] - uv[1], uv[0], uv[1]];
        let corners = index.into_iter().zip(weight);
        if let Some(t) = texture {
            let uv = corners.clone().map(|(i, w)| mesh.uvs[i] * w).sum();
            albedo = albedo * Rgb(scene.textures[t as usize].sample(uv));
        }
        if !mesh.colors.is_empty() {
            let mix = |s, (i, w): (usize, f32)| s + Rgb(mesh.colors[i]) * w;
            albedo = albedo * corners.fold(Rgb::BLACK, mix);
        }
        albedo
    }

    /// Emitted radiance at barycentric weights `uv` of the second and third corner, on the sides
    /// that emit.
    #[must_use]
    pub fn emission_at(scene: &Scene, triangle: u32, uv: [f32; 2]) -> Rgb {
        let mesh = &scene.mesh;
        let material = &scene.materials[mesh.material_of(triangle as usize) as usize];
        let emission = Rgb(material.emission);
        match material.emission_texture.filter(|_| !mesh.uvs.is_empty()) {
            None => emission,
            Some(t) => {
                let vertices = mesh.vertices_of(triangle as usize);
                let [a, b, c] = vertices.map(|i| mesh.uvs[i as usize]);
                let uv = a * (1.0 - uv[0] - uv[1]) + b * uv[0] + c * uv[1];
                emission * Rgb(scene.textures[t as usize].sample(uv))
            }
        }
    }

    /// Emitted radiance on the side that `towards` points to, of a surface on `triangle`.
    #[must_use]
    pub fn emission(&self, scene: &Scene, triangle: u32, towards: Vec3) -> Rgb {
        let material = &scene.materials[self.material as usize];
        let is_front = (towards.dot(self.face_normal) > 0.0) != self.is_back;
        if !(material.emits_both_sides || is_front) {
            return Rgb::BLACK;
        }
        if material.emission_texture.is_none() {
            return Rgb(material.emission);
        }
        let corners = scene.mesh.corners(triangle as usize);
        Self::emission_at(scene, triangle, weights_in_triangle(corners, self.position))
    }

    /// Whether two normals are so close that light comes from nearly the same angles to both.
    #[must_use]
    pub fn faces_as(&self, other: &Self) -> bool {
        const SAME: f32 = 0.9995;
        self.normal.dot(other.normal) > SAME
    }

    /// This surface as seen from the side that `towards` points to: both normals turned that way.
    #[must_use]
    pub fn facing(mut self, towards: Vec3) -> Self {
        if self.face_normal.dot(towards) < 0.0 {
            self.face_normal = -self.face_normal;
            self.normal = -self.normal;
            self.is_back = !self.is_back;
        }
        self
    }
}

/// Distance, in scene units, that rays which leave a surface at `point` are moved off it along the
/// normal: more than the rounding of the point, and of other faces in the same place. It does not
/// depend on what else is in the scene.
#[must_use]
pub fn offset(point: Vec3) -> f32 {
    const ROUNDING: f32 = 32.0 * f32::EPSILON;
    ROUNDING * point.abs().max_element()
}

/// Length of a ray to a light at `target`, which is `distance` away: it ends before the surface
/// that shines, or that holds a point light.
#[must_use]
pub fn short_of(target: Vec3, distance: f32) -> f32 {
    distance * (1.0 - 1e-4) - offset(target)
}

/// Weights of the second and third corner of a triangle at a point of its plane; those of its first
/// corner if it has no area.
#[must_use]
pub fn weights_in_triangle([a, b, c]: [Vec3; 3], point: Vec3) -> [f32; 2] {
    // Products of the edges of a triangle of 1e-20 units would underflow.
    let (e, f) = (b - a, c - a);
    let scale = 1.0 / e.abs().max(f.abs()).max_element();
    let [e, f, p] = [e, f, point - a].map(|v| v * scale);
    let (ee, ef, ff) = (e.dot(e), e.dot(f), f.dot(f));
    let (pe, pf) = (p.dot(e), p.dot(f));
    let area2 = ee * ff - ef * ef;
    if area2 > 0.0 {
        [(ff * pe - ef * pf) / area2, (ee * pf - ef * pe) / area2]
    } else {
        [0.0; 2]
    }
}

/// Unit normal of a triangle that is not degenerate, whatever its size.
#[must_use]
pub fn unit_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    // Edges are normalised first: their product would underflow for a triangle of 1e-20 units.
    let (e, f) = (b - a, c - a);
    let scale = 1.0 / e.abs().max(f.abs()).max_element();
    (e * scale).cross(f * scale).normalize_or(Vec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling::{hash, triangle, unit};
    use crate::scene::Material;

    #[test]
    fn weights_tell_where_a_point_is() {
        for scale in [1e-20_f32, 1.0, 1e15] {
            let corners = [[1.0, 2.0, 0.5], [3.0, -1.0, 0.0], [0.0, 2.5, 4.0]];
            let corners = corners.map(|c| Vec3::from(c) * scale);
            let [a, b, c] = corners;
            for [u, v] in [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.3, 0.2], [-0.1, 0.7]] {
                let point = a + (b - a) * u + (c - a) * v;
                let [found_u, found_v] = weights_in_triangle(corners, point);
                assert!((found_u - u).abs() < 1e-5 && (found_v - v).abs() < 1e-5);
            }
            assert_eq!(weights_in_triangle([a, b, b], b), [0.0; 2]);
        }
        assert_eq!(weights_in_triangle([Vec3::ONE; 3], Vec3::X), [0.0; 2]);
    }

    /// A tilted triangle that is a million times larger than what is looked at near its middle.
    #[test]
    fn points_are_off_their_plane_by_less_than_rays_are_moved() {
        let mut scene = Scene::without_picture();
        let corners = [[-1e6, 3e5, -9e5], [-1e6, -2e5, 9e5], [1.1e6, 1e5, 3.0]].map(Vec3::from);
        scene.mesh.positions = corners.to_vec().into();
        scene.mesh.triangles = vec![[0, 1, 2]].into();
        scene.mesh.material = vec![0].into();
        scene.materials = vec![Material::diffuse("", [0.5; 3])];
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let normal = (b - a).cross(c - a).normalize();
        for i in 0..1000 {
            let w = triangle([unit(hash(&[i, 0])), unit(hash(&[i, 1]))]);
            let surface = Surface::new(&scene, 0, [w[1], w[2]]);
            let off = (surface.position.as_dvec3() - a).dot(normal).abs();
            let moved = f64::from(offset(surface.position));
            assert!(off < 0.1 * moved, "{off} {moved}");
        }
    }
}
