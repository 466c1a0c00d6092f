//! All triangles of a scene in one indexed mesh.

use super::Instances;
use crate::column::Column;
use crate::math::magnitude::to_unit;
use glam::{Vec2, Vec3};

/// Triangles with per-vertex attributes. Optional attributes are empty when no mesh of the scene
/// has them.
///
/// Lists are what is stored: where there are [`Instances`], what they place comes last in each, in
/// spaces of its own, and methods tell of the triangles of the scene.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions, scene space.
    pub positions: Column<Vec3>,
    /// Shading normals, unit length, per vertex; a zero vector means "use the face normal". Empty
    /// when no mesh has any.
    pub normals: Column<Vec3>,
    /// Linear RGB factors on the base colour, per vertex. Empty when no mesh has any.
    pub colors: Column<[f32; 3]>,
    /// Texture coordinates, per vertex, (0,0) top left as in glTF. Empty when no material has a
    /// texture.
    pub uvs: Column<Vec2>,
    /// Factors on the opacity of masks, per vertex. Empty when no mask has any.
    pub opacities: Column<f32>,
    /// Vertex indices, counter-clockwise seen from the front.
    pub triangles: Column<[u32; 3]>,
    /// Index into the scene's materials, per triangle.
    pub material: Column<u32>,
    /// Triangles of zero area that were dropped on loading.
    pub degenerate: u64,
    /// What is stored once and placed many times.
    pub instances: Instances,
}

impl Mesh {
    /// Triangles that the largest scene stores: what finds them has places for no more.
    pub(crate) const MAX_TRIANGLES: usize = 1 << 27;

    /// Bytes of memory that it takes.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        let vertices = size_of_val(&self.positions[..])
            + size_of_val(&self.normals[..])
            + size_of_val(&self.colors[..])
            + size_of_val(&self.uvs[..])
            + size_of_val(&self.opacities[..]);
        let triangles = size_of_val(&self.triangles[..]) + size_of_val(&self.material[..]);
        (vertices + triangles) as u64 + self.instances.bytes()
    }

    /// Corner positions of a triangle, scene space.
    #[must_use]
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vec3; 3] {
        match self.instances.is_flat(triangle) {
            true => self.own_corners(triangle),
            false => self.placed_corners(triangle),
        }
    }

    /// Corner positions of a triangle as it is stored, in its own space.
    #[must_use]
    #[inline]
    pub fn own_corners(&self, stored: usize) -> [Vec3; 3] {
        self.triangles[stored].map(|i| self.positions[i as usize])
    }

    /// Half the cross product of two sides: the face normal times the area.
    #[must_use]
    pub fn area_vector(&self, triangle: usize) -> Vec3 {
        let [a, b, c] = self.corners(triangle);
        0.5 * (b - a).cross(c - a)
    }

    /// Area of a triangle.
    #[must_use]
    pub fn area(&self, triangle: usize) -> f32 {
        let [a, b, c] = self.corners(triangle);
        let (e, f) = (b - a, c - a);
        // Squares of areas would leave the range of f32.
        let scale = to_unit(e.abs().max(f.abs()).max_element());
        0.5 * (e * scale).cross(f * scale).length() / scale / scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_of_any_scale_have_their_area() {
        for scale in [1e-18, 1e-10, 1.0, 1e10, 1e15_f32] {
            let mesh = Mesh {
                positions: [[0.0; 3], [scale, 0.0, 0.0], [0.0, 0.0, scale]]
                    .map(Vec3::from)
                    .to_vec()
                    .into(),
                triangles: vec![[0, 1, 2], [0, 1, 1]].into(),
                ..Mesh::default()
            };
            assert!((mesh.area(0) / (0.5 * scale * scale) - 1.0).abs() < 1e-6);
            assert_eq!(mesh.area(1), 0.0);
        }
    }
}
