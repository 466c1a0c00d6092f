//! Watertight ray casting (Woop, Benthin & Wald 2013) over the eight-wide compressed hierarchy of `obvhs`.
//!
//! The triangle tests of that crate leak at shared edges, it misses boxes for a direction component of -0.0, and it
//! passes over boxes that end less than 1e-4 units from the ray's origin; all three are cured here.

use crate::scene::Mesh;
use glam::{UVec2, Vec3, Vec3A};
use obvhs::cwbvh::{CwBvh, builder::build_cwbvh_from_tris};
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use obvhs::{BvhBuildParams, traverse};

/// Where a ray met a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray.
    pub t: f32,
    /// Index in the mesh.
    pub triangle: u32,
    /// Barycentric weights of the second and third corner.
    pub uv: [f32; 2],
}

/// All triangles of a mesh, ready for rays.
#[derive(Debug)]
pub struct TriangleBvh {
    bvh: CwBvh,
    leaves: Vec<Leaf>,
    /// Boxes and leaves are this many times larger than the mesh: a power of two, so that it changes no digit, and so
    /// large that 1e-4 of their units are less than f32 can tell.
    scale: f32,
}

#[derive(Clone, Copy, Debug)]
struct Leaf {
    corners: [Vec3; 3],
    triangle: u32,
}

impl TriangleBvh {
    /// Builds the hierarchy.
    #[must_use]
    pub fn new(mesh: &Mesh) -> Self {
        if mesh.triangles.is_empty() {
            return Self {
                bvh: CwBvh::default(),
                leaves: Vec::new(),
                scale: 1.0,
            };
        }
        let scale = box_scale(mesh);
        let triangles: Vec<Triangle> = (0..mesh.triangles.len())
            .map(|i| {
                let [v0, v1, v2] = mesh.corners(i).map(|p| Vec3A::from(p * scale));
                Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = build_cwbvh_from_tris(
            &triangles,
            BvhBuildParams::medium_build(),
            &mut Default::default(),
        );
        let leaves = bvh
            .primitive_indices
            .iter()
            .map(|&i| Leaf {
                corners: mesh.corners(i as usize).map(|p| p * scale),
                triangle: i,
            })
            .collect();
        Self { bvh, leaves, scale }
    }

    /// Nearest hit before `t_max`; of triangles at the same distance the first of the mesh.
    #[must_use]
    pub fn closest(&self, origin: Vec3, direction: Vec3, t_max: f32) -> Option<Hit> {
        let (origin, t_max) = (origin * self.scale, t_max * self.scale);
        let woop = Woop::new(origin, direction);
        let mut best: Option<Hit> = None;
        self.bvh.ray_traverse(
            ray(origin, direction, t_max),
            &mut RayHit::none(),
            |ray, i| {
                let leaf = &self.leaves[i];
                let Some((t, uv)) = woop.intersect(&leaf.corners) else {
                    return f32::INFINITY;
                };
                let first =
                    best.is_none_or(|b| t < b.t || (t == b.t && leaf.triangle < b.triangle));
                if t <= ray.tmax && t < t_max && first {
                    best = Some(Hit {
                        t,
                        triangle: leaf.triangle,
                        uv,
                    });
                }
                t
            },
        );
        best.map(|hit| Hit {
            t: hit.t / self.scale,
            ..hit
        })
    }

    /// Whether any triangle is hit before `t_max`.
    #[must_use]
    pub fn is_occluded(&self, origin: Vec3, direction: Vec3, t_max: f32) -> bool {
        if self.leaves.is_empty() {
            return false;
        }
        let (origin, t_max) = (origin * self.scale, t_max * self.scale);
        let woop = Woop::new(origin, direction);
        let ray = ray(origin, direction, t_max);
        let mut state = self.bvh.new_traversal(ray.direction);
        let mut node;
        let mut hit = false;
        'walk: {
            traverse!(
                self.bvh,
                node,
                state,
                node.intersect_ray(&ray, state.oct_inv4),
                {
                    if woop
                        .intersect(&self.leaves[state.primitive_id as usize].corners)
                        .is_some_and(|(t, _)| t < t_max)
                    {
                        hit = true;
                        break 'walk;
                    }
                }
            );
        }
        hit
    }
}

fn ray(origin: Vec3, direction: Vec3, t_max: f32) -> Ray {
    // Adding 0.0 turns -0.0 into 0.0.
    Ray::new(
        origin.into(),
        Vec3A::from(direction) + Vec3A::ZERO,
        0.0,
        t_max,
    )
}

/// The power of two that makes the largest coordinate of a mesh about 2^20.
fn box_scale(mesh: &Mesh) -> f32 {
    let largest = mesh
        .positions
        .iter()
        .fold(0.0_f32, |m, p| m.max(p.abs().max_element()));
    let (_, exponent) = libm::frexpf(largest);
    libm::ldexpf(1.0, (20 - exponent).clamp(-120, 120))
}

/// A ray sheared to run along +z, so that neighbouring triangles see bit-equal edge functions.
struct Woop {
    origin: Vec3,
    axes: [usize; 3],
    shear: [f32; 3],
}

impl Woop {
    fn new(origin: Vec3, direction: Vec3) -> Self {
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
            origin,
            axes: [x, y, z],
            shear: [d[x] / d[z], d[y] / d[z], 1.0 / d[z]],
        }
    }

    #[inline]
    fn intersect(&self, corners: &[Vec3; 3]) -> Option<(f32, [f32; 2])> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        let [a, b, c] = corners.map(|p| (p - self.origin).to_array());
        let (ax, ay) = (a[kx] - sx * a[kz], a[ky] - sy * a[kz]);
        let (bx, by) = (b[kx] - sx * b[kz], b[ky] - sy * b[kz]);
        let (cx, cy) = (c[kx] - sx * c[kz], c[ky] - sy * c[kz]);
        let mut u = cx * by - cy * bx;
        let mut v = ax * cy - ay * cx;
        let mut w = bx * ay - by * ax;
        if u == 0.0 || v == 0.0 || w == 0.0 {
            // On an edge in f32: decide in f64, where the products are exact.
            let edge = |px: f32, py: f32, qx: f32, qy: f32| {
                (f64::from(px) * f64::from(qy) - f64::from(py) * f64::from(qx)) as f32
            };
            u = edge(cx, cy, bx, by);
            v = edge(ax, ay, cx, cy);
            w = edge(bx, by, ax, ay);
        }
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let det = u + v + w;
        if det == 0.0 {
            return None;
        }
        let t = (u * (sz * a[kz]) + v * (sz * b[kz]) + w * (sz * c[kz])) / det;
        // `t > 0` is false for NaN, too.
        (t > 0.0).then(|| (t, [v / det, w / det]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;

    /// A closed sphere of shared vertices.
    fn sphere(rings: u32, segments: u32) -> Mesh {
        let mut mesh = Mesh::default();
        for r in 0..=rings {
            let (sin, cos) = sampling::sin_cos_turns(0.5 * r as f32 / rings as f32);
            for s in 0..segments {
                let (y, x) = sampling::sin_cos_turns(s as f32 / segments as f32);
                mesh.positions.push(Vec3::new(sin * x, sin * y, cos));
            }
        }
        for r in 0..rings {
            for s in 0..segments {
                let at = |r: u32, s: u32| {
                    // The poles are one vertex each.
                    if r == 0 {
                        0
                    } else if r == rings {
                        rings * segments
                    } else {
                        r * segments + s % segments
                    }
                };
                let (a, b, c, d) = (at(r, s), at(r, s + 1), at(r + 1, s), at(r + 1, s + 1));
                mesh.triangles.extend(
                    [[a, c, d], [a, d, b]]
                        .iter()
                        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[0] != t[2]),
                );
            }
        }
        mesh.material = vec![0; mesh.triangles.len()];
        mesh
    }

    #[test]
    fn nothing_escapes_from_a_closed_mesh_not_even_through_its_edges() {
        let mesh = sphere(40, 64);
        let bvh = TriangleBvh::new(&mesh);
        let origin = Vec3::new(0.1, 0.03, -0.2);
        for i in 0..100_000 {
            let d = sampling::sphere(sampling::r2(i, [0.0; 2]));
            assert!(bvh.closest(origin, d, f32::INFINITY).is_some());
            assert!(bvh.is_occluded(origin, d, 10.0));
        }
        for (i, t) in mesh.triangles.iter().enumerate() {
            for e in 0..3 {
                let (a, b) = (
                    mesh.positions[t[e] as usize],
                    mesh.positions[t[(e + 1) % 3] as usize],
                );
                for k in 0..8 {
                    let u = sampling::unit(sampling::hash(&[i as u64, e as u64, k]));
                    let d = (a + (b - a) * u - origin).normalize();
                    assert!(
                        bvh.closest(origin, d, f32::INFINITY).is_some(),
                        "edge of triangle {i}"
                    );
                }
            }
        }
    }

    #[test]
    fn hits_agree_with_a_linear_scan_and_axis_directions_hit() {
        let mesh = sphere(12, 20);
        let bvh = TriangleBvh::new(&mesh);
        for i in 0..2000 {
            let o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
            let d = sampling::sphere(sampling::r2(i, [0.7; 2]));
            let woop = Woop::new(o, d);
            let scan = (0..mesh.triangles.len())
                .filter_map(|t| woop.intersect(&mesh.corners(t)))
                .map(|h| h.0)
                .min_by(f32::total_cmp);
            assert_eq!(bvh.closest(o, d, f32::INFINITY).map(|h| h.t), scan);
        }
        for d in [
            Vec3::new(-0.0, -1.0, -0.0),
            Vec3::new(0.0, 1.0, -0.0),
            Vec3::new(-1.0, -0.0, 0.0),
        ] {
            assert!(
                bvh.closest(Vec3::new(0.01, 0.02, 0.03), d, f32::INFINITY)
                    .is_some(),
                "{d}"
            );
        }
    }

    #[test]
    fn hits_scale_with_the_mesh_and_near_ones_are_not_missed() {
        let mesh = sphere(12, 20);
        let bvh = TriangleBvh::new(&mesh);
        for exponent in [-40, -20, 20, 40] {
            let scale = libm::ldexpf(1.0, exponent);
            let mut scaled = mesh.clone();
            scaled.positions.iter_mut().for_each(|p| *p *= scale);
            let scaled = TriangleBvh::new(&scaled);
            for i in 0..2000 {
                // Half of the origins are within 1e-5 of the surface, outside or inside.
                let mut o = 2.0 * sampling::sphere(sampling::r2(i, [0.3; 2]));
                let d = sampling::sphere(sampling::r2(i, [0.7; 2]));
                if i % 2 == 0 {
                    let Some(hit) = bvh.closest(o, -o.normalize(), f32::INFINITY) else {
                        panic!("the middle is inside")
                    };
                    o -= o.normalize() * (hit.t - 1e-5 * (i % 5) as f32 + 2e-5);
                }
                let hit = bvh.closest(o, d, f32::INFINITY);
                let woop = Woop::new(o, d);
                let scan = (0..mesh.triangles.len())
                    .filter_map(|t| woop.intersect(&mesh.corners(t)))
                    .map(|h| h.0)
                    .min_by(f32::total_cmp);
                assert_eq!(hit.map(|h| h.t), scan);
                let far = scaled.closest(o * scale, d, f32::INFINITY);
                assert_eq!(far.map(|h| h.t), hit.map(|h| h.t * scale));
                assert_eq!(
                    scaled.is_occluded(o * scale, d, f32::INFINITY),
                    hit.is_some()
                );
            }
        }
    }

    #[test]
    fn an_empty_mesh_is_never_hit() {
        let bvh = TriangleBvh::new(&Mesh::default());
        assert!(bvh.closest(Vec3::ZERO, Vec3::Z, f32::INFINITY).is_none());
        assert!(!bvh.is_occluded(Vec3::ZERO, Vec3::Z, f32::INFINITY));
    }
}
