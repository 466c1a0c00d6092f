//! The surface at a point of a triangle: normals, albedo, emission.

use crate::math::Rgb;
use crate::scene::Scene;
use glam::Vec3;

/// What shading needs of a point on a triangle.
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
    /// Whether the normals were turned to the triangle's back.
    is_back: bool,
}

impl Surface {
    /// The surface at barycentric weights `uv` of the second and third corner.
    #[must_use]
    pub fn new(scene: &Scene, triangle: u32, uv: [f32; 2]) -> Self {
        let mesh = &scene.mesh;
        let index = mesh.triangles[triangle as usize].map(|i| i as usize);
        let weight = [1.0 - uv[0] - uv[1], uv[0], uv[1]];
        let [a, b, c] = index.map(|i| mesh.positions[i]);
        let position = a * weight[0] + b * weight[1] + c * weight[2];
        let face_normal = unit_normal([a, b, c]);
        let mut normal = face_normal;
        if !mesh.normals.is_empty() {
            let n = index
                .iter()
                .zip(weight)
                .map(|(&i, w)| mesh.normals[i] * w)
                .sum::<Vec3>();
            // Averaged normals of hard edges can point to the back; the face's own is right there.
            if n.dot(face_normal) > 1e-3 * n.length() && n.length_squared() > 0.0 {
                normal = n.normalize();
            }
        }
        let material = mesh.material[triangle as usize];
        let surface = &scene.materials[material as usize];
        let mut albedo = Rgb(surface.albedo);
        if let Some(t) = surface.texture
            && !mesh.uvs.is_empty()
        {
            let uv = index
                .iter()
                .zip(weight)
                .map(|(&i, w)| mesh.uvs[i] * w)
                .sum();
            albedo = albedo * Rgb(scene.textures[t as usize].sample(uv));
        }
        if !mesh.colors.is_empty() {
            albedo = albedo
                * index
                    .iter()
                    .zip(weight)
                    .map(|(&i, w)| Rgb(mesh.colors[i]) * w)
                    .fold(Rgb::BLACK, |s, c| s + c);
        }
        Self {
            position,
            face_normal,
            normal,
            albedo,
            material,
            is_back: false,
        }
    }

    /// Emitted radiance on the side that `towards` points to.
    #[must_use]
    pub fn emission(&self, scene: &Scene, towards: Vec3) -> Rgb {
        let material = &scene.materials[self.material as usize];
        let is_front = (towards.dot(self.face_normal) > 0.0) != self.is_back;
        if material.emits_both_sides || is_front {
            Rgb(material.emission)
        } else {
            Rgb::BLACK
        }
    }

    /// The same surface seen from the side that `towards` points to: both normals turned that way.
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

/// Unit normal of a triangle that is not degenerate, whatever its size.
#[must_use]
pub fn unit_normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    // Edges are normalised first: their product would underflow for a triangle of 1e-20 units.
    let (e, f) = (b - a, c - a);
    let scale = 1.0 / e.abs().max(f.abs()).max_element();
    (e * scale).cross(f * scale).normalize_or(Vec3::Z)
}
