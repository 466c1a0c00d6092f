//! The watertight test of rays against triangles (Woop, Benthin & Wald 2013), four triangles at a
//! time.

use crate::math::Ray;
use crate::scene::Mesh;
use glam::{DVec3, Vec3};
use wide::{f32x4, i32x4};

/// Triangles of a block.
pub const LANES: usize = 4;

/// Four triangles, or fewer: corners of absent ones are not numbers, for which no comparison holds.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct Block {
    /// By corner and axis.
    corners: [[f32x4; 3]; 3],
    /// Indices in the mesh.
    pub triangles: [u32; LANES],
}

/// Four triangles, or fewer, by their vertices: 64 bytes in place of 160, and a few more steps to
/// the same corners.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub struct VertexBlock {
    /// By corner; absent triangles have the vertices of the first.
    vertices: [[u32; LANES]; 3],
    /// Indices in the mesh.
    pub triangles: [u32; LANES],
}

impl VertexBlock {
    /// Triangles of a mesh, of which there is at least one.
    #[must_use]
    pub fn new(mesh: &Mesh, triangles: &[u32]) -> Self {
        let of = |lane: usize| triangles.get(lane).copied();
        let lanes: [usize; LANES] = std::array::from_fn(|lane| lane);
        let vertex = |corner: usize, lane: usize| {
            mesh.triangles[of(lane).unwrap_or(triangles[0]) as usize][corner]
        };
        Self {
            vertices: [0, 1, 2].map(|corner| lanes.map(|lane| vertex(corner, lane))),
            triangles: lanes.map(|lane| of(lane).unwrap_or(u32::MAX)),
        }
    }

    /// The block of the same triangles with their corners, `scale` times larger; of absent ones
    /// only x is no number, which is enough. `coordinates` are those of all vertices, one by one.
    #[inline(always)]
    pub fn with_corners(&self, coordinates: &[f32], scale: f32) -> Block {
        let scale = f32x4::splat(scale);
        let triangles: i32x4 = bytemuck::cast(self.triangles);
        // All bits are set, which is no number.
        let absent: f32x4 = bytemuck::cast(triangles.simd_eq(i32x4::splat(-1)));
        // Loads of whole vertices that are then turned: numbers one by one take three times as
        // long.
        let corner = |vertices: &[u32; LANES]| {
            let [a, b, c, d] = *vertices;
            let [x, y, z, _] = f32x4::transpose([
                vertex(coordinates, a),
                vertex(coordinates, b),
                vertex(coordinates, c),
                vertex(coordinates, d),
            ]);
            [(x * scale) | absent, y * scale, z * scale]
        };
        let [a, b, c] = &self.vertices;
        Block {
            corners: [corner(a), corner(b), corner(c)],
            triangles: self.triangles,
        }
    }
}

/// The coordinates of a vertex, and one more number.
#[inline(always)]
fn vertex(coordinates: &[f32], vertex: u32) -> f32x4 {
    let at = 3 * vertex as usize;
    match coordinates.get(at..at + 4) {
        Some(&[x, y, z, w]) => f32x4::new([x, y, z, w]),
        _ => last_vertex(coordinates, at),
    }
}

#[cold]
fn last_vertex(coordinates: &[f32], at: usize) -> f32x4 {
    f32x4::new([
        coordinates[at],
        coordinates[at + 1],
        coordinates[at + 2],
        0.0,
    ])
}

/// The triangles of a block that the line of a ray meets, and where.
#[derive(Debug, Default)]
pub struct Met {
    /// A bit for each triangle met.
    pub lanes: u32,
    /// A bit for each whose corners wind clockwise as the ray sees them.
    pub backs: u32,
    /// Distances along the ray.
    pub t: [f32; LANES],
    /// Barycentric weights of second and third corners.
    pub uv: [[f32; LANES]; 2],
}

impl Block {
    /// Triangles of a mesh, `scale` times larger.
    #[must_use]
    pub fn new(mesh: &Mesh, triangles: &[u32], scale: f32) -> Self {
        let mut corners = [[[f32::NAN; LANES]; 3]; 3];
        let mut indices = [u32::MAX; LANES];
        for (lane, &triangle) in triangles.iter().enumerate() {
            indices[lane] = triangle;
            for (corner, p) in mesh.own_corners(triangle as usize).into_iter().enumerate() {
                for a in 0..3 {
                    corners[corner][a][lane] = p[a] * scale;
                }
            }
        }
        Self {
            corners: corners.map(|c| c.map(f32x4::new)),
            triangles: indices,
        }
    }

    /// The first and second corners, by axis.
    #[inline(always)]
    pub fn ends(&self) -> [[f32x4; 3]; 2] {
        let [first, second, _] = self.corners;
        [first, second]
    }

    /// A bit for each triangle that is there.
    #[inline(always)]
    pub fn present(&self) -> u32 {
        let there = self.triangles.iter().take_while(|t| **t != u32::MAX);
        (1 << there.count()) - 1
    }
}

/// A ray sheared to run along +z, so that neighbouring triangles see bit-equal edge functions.
#[derive(Debug)]
pub struct ShearedRay {
    /// Along `axes`.
    origin: [f32x4; 3],
    /// Across, across and along the ray.
    axes: [usize; 3],
    shear: [f32x4; 3],
    /// Origin and direction as they were given.
    line: [Vec3; 2],
}

impl ShearedRay {
    /// Shears a ray; where it ends does not matter.
    #[must_use]
    pub fn new(ray: &Ray) -> Self {
        let &Ray {
            origin, direction, ..
        } = ray;
        let d = direction.to_array();
        let z = if d[0].abs() > d[1].abs() {
            if d[0].abs() > d[2].abs() { 0 } else { 2 }
        } else if d[1].abs() > d[2].abs() {
            1
        } else {
            2
        };
        let (mut x, mut y) = ((z + 1) % 3, (z + 2) % 3);
        if d[z] < 0.0 {
            std::mem::swap(&mut x, &mut y);
        }
        Self {
            origin: [x, y, z].map(|a| f32x4::splat(origin[a])),
            axes: [x, y, z],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]].map(f32x4::splat),
            line: [origin, direction],
        }
    }

    /// Corners as the ray sees them: x and y across it, and distance along it.
    #[inline(always)]
    fn shear(&self, corner: &[f32x4; 3]) -> [f32x4; 3] {
        let along = corner[self.axes[2]] - self.origin[2];
        [
            (corner[self.axes[0]] - self.origin[0]) - self.shear[0] * along,
            (corner[self.axes[1]] - self.origin[1]) - self.shear[1] * along,
            self.shear[2] * along,
        ]
    }

    /// Distance over that of a triangle's farthest corner along the ray, below which it is found
    /// once more in double: beyond, some 1e-4 is left of the error of single precision.
    const NEAR: f32 = 1.0 / 256.0;
    /// The ratio below which a triangle is behind for sure, as the one that the ray leaves mostly
    /// is.
    const BEHIND: f32 = -16.0 * f32::EPSILON;

    /// The triangles of a block that the ray meets in front of its origin.
    #[must_use]
    #[inline(always)]
    pub fn meet(&self, block: &Block) -> Met {
        let a = self.shear(&block.corners[0]);
        let b = self.shear(&block.corners[1]);
        let c = self.shear(&block.corners[2]);
        let mut u = c[0] * b[1] - c[1] * b[0];
        let mut v = a[0] * c[1] - a[1] * c[0];
        let mut w = b[0] * a[1] - b[1] * a[0];
        let on_edge = u.simd_eq(f32x4::ZERO) | v.simd_eq(f32x4::ZERO) | w.simd_eq(f32x4::ZERO);
        if on_edge.any() {
            u = on_edge.select(exact_edge(&c, &b), u);
            v = on_edge.select(exact_edge(&a, &c), v);
            w = on_edge.select(exact_edge(&b, &a), w);
        }
        let front = u.simd_ge(f32x4::ZERO) & v.simd_ge(f32x4::ZERO) & w.simd_ge(f32x4::ZERO);
        let back = u.simd_le(f32x4::ZERO) & v.simd_le(f32x4::ZERO) & w.simd_le(f32x4::ZERO);
        let det = u + v + w;
        let hit = (front | back) & det.simd_ne(f32x4::ZERO);
        if hit.none() {
            return Met::default();
        }
        let mut t = (u * a[2] + v * b[2] + w * c[2]) / det;
        // Distances are as exact as the farthest corner's: of a triangle's plane near by even the
        // sign is rounding.
        let reach = a[2].abs().fast_max(b[2].abs()).fast_max(c[2].abs());
        let near = hit
            & t.simd_lt(reach * f32x4::splat(Self::NEAR))
            & t.simd_gt(reach * f32x4::splat(Self::BEHIND));
        if near.any() {
            t = exact_distances(self.line, block, near.to_bitmask(), t);
        }
        Met {
            lanes: (hit & t.simd_gt(f32x4::ZERO)).to_bitmask(),
            backs: det.simd_lt(f32x4::ZERO).to_bitmask(),
            t: t.to_array(),
            uv: [v / det, w / det].map(f32x4::to_array),
        }
    }
}

/// The edge function of points in the plane across the ray, in f64, where the products are exact.
#[cold]
fn exact_edge(p: &[f32x4; 3], q: &[f32x4; 3]) -> f32x4 {
    let [px, py, qx, qy] = [p[0], p[1], q[0], q[1]].map(f32x4::to_array);
    f32x4::from(std::array::from_fn::<f32, LANES, _>(|k| {
        let [px, py, qx, qy] = [px[k], py[k], qx[k], qy[k]].map(f64::from);
        (px * qy - py * qx) as f32
    }))
}

/// Distances to the planes of the triangles of some lanes, in double; the others stay.
#[cold]
fn exact_distances(line: [Vec3; 2], block: &Block, lanes: u32, t: f32x4) -> f32x4 {
    let corners = block.corners.map(|c| c.map(f32x4::to_array));
    let [origin, direction] = line.map(|v| v.as_dvec3());
    let mut t = t.to_array();
    for k in (0..LANES).filter(|k| lanes >> k & 1 == 1) {
        let [a, b, c] = corners.map(|c| DVec3::from(c.map(|v| f64::from(v[k]))));
        let normal = (b - a).cross(c - a);
        let exact = normal.dot(a - origin) / normal.dot(direction);
        if exact.is_finite() {
            t[k] = exact as f32;
        }
    }
    f32x4::from(t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    /// Moller & Trumbore 1997, in f64: distance, weights of the second and third corner.
    fn plain(corners: [Vec3; 3], origin: Vec3, direction: Vec3) -> Option<[f64; 3]> {
        let [a, b, c] = corners.map(|p| p.as_dvec3());
        let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
        let (e, f) = (b - a, c - a);
        let p = d.cross(f);
        let det = e.dot(p);
        let s = (o - a) / det;
        let (u, v) = (s.dot(p), d.dot(s.cross(e)));
        let t = f.dot(s.cross(e));
        (det != 0.0 && u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some([t, u, v])
    }

    #[test]
    fn four_lanes_meet_what_one_triangle_in_double_does() {
        let mut mesh = Mesh::default();
        let number = |i: u32, a: u64| sampling::unit(sampling::hash(&[u64::from(i), a])) - 0.5;
        for i in 0..4000 {
            let corner = |k: u64| Vec3::from([0, 1, 2].map(|a| number(i, 3 * k + a)));
            mesh.positions.extend([corner(0), corner(1), corner(2)]);
            mesh.triangles.push([3 * i, 3 * i + 1, 3 * i + 2]);
        }
        let (mut met, mut missed) = (0, 0);
        for first in (0..4000).step_by(LANES) {
            let origin = 0.5 * Vec3::from([10, 11, 12].map(|a| number(first, a)));
            let direction = sampling::sphere([13, 14].map(|a| number(first, a) + 0.5));
            let lanes: Vec<u32> = (first..first + 4).collect();
            let got = ShearedRay::new(&Ray::endless(origin, direction))
                .meet(&Block::new(&mesh, &lanes, 1.0));
            for (k, &triangle) in lanes.iter().enumerate() {
                let expected = plain(mesh.corners(triangle as usize), origin, direction);
                assert_eq!(got.lanes >> k & 1 == 1, expected.is_some(), "{triangle}");
                let Some([t, u, v]) = expected else {
                    missed += 1;
                    continue;
                };
                met += 1;
                let close = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-4 * (1.0 + b.abs());
                assert!(close(got.t[k], t) && close(got.uv[0][k], u) && close(got.uv[1][k], v));
            }
        }
        assert!(met > 200 && missed > 200, "{met} {missed}");
    }

    #[test]
    fn distances_to_a_huge_triangle_are_exact_near_it() {
        const HEIGHT: f32 = 1e-3;
        for turn in 0..3 {
            let turned = |p: Vec3| Vec3::from(std::array::from_fn(|a| p[(a + turn) % 3]));
            let corners = [[-1e6, 0.0, -9e5], [-1e6, 0.0, 9e5], [1.1e6, 0.0, 3.0]];
            let mesh = Mesh {
                positions: corners.map(|c| turned(Vec3::from(c))).to_vec().into(),
                triangles: vec![[0, 1, 2]].into(),
                ..Mesh::default()
            };
            let block = Block::new(&mesh, &[0], 1.0);
            for i in 0..1000 {
                let [x, z, u, v] = [1, 2, 3, 4].map(|s| sampling::unit(sampling::hash(&[i, s])));
                let origin = turned(Vec3::new(x, HEIGHT, z));
                let mut way = sampling::sphere([u, v]);
                way.y = way.y.abs() + 1e-3;
                let way = way.normalize();
                assert_eq!(
                    ShearedRay::new(&Ray::endless(origin, turned(way)))
                        .meet(&block)
                        .lanes,
                    0
                );
                way_down(
                    &block,
                    origin,
                    turned(Vec3::new(way.x, -way.y, way.z)),
                    HEIGHT / way.y,
                );
            }
        }
    }

    fn way_down(block: &Block, origin: Vec3, way: Vec3, t: f32) {
        let met = ShearedRay::new(&Ray::endless(origin, way)).meet(block);
        assert!(
            met.lanes == 1 && (met.t[0] / t - 1.0).abs() < 1e-5,
            "{met:?} {t}"
        );
    }

    #[test]
    fn absent_lanes_are_never_met() {
        let mesh = Mesh {
            positions: vec![
                Vec3::new(-1.0, -1.0, 1.0),
                Vec3::new(3.0, -1.0, 1.0),
                Vec3::new(-1.0, 3.0, 1.0),
            ]
            .into(),
            triangles: vec![[0, 1, 2]].into(),
            ..Mesh::default()
        };
        let met =
            ShearedRay::new(&Ray::endless(Vec3::ZERO, Vec3::Z)).meet(&Block::new(&mesh, &[0], 1.0));
        assert_eq!((met.lanes, met.t[0]), (1, 1.0));
    }
}
