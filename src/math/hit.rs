//! Where rays meet triangles.

/// The point at which a ray met a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray.
    pub t: f32,
    /// Index in the mesh.
    pub triangle: u32,
    /// Barycentric weights of the second and third corner.
    pub uv: [f32; 2],
    /// Whether the ray came from the side from which the corners wind clockwise.
    pub is_back: bool,
}
