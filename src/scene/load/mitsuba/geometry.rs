//! Shapes of Mitsuba that are no files, as triangles.

use crate::scene::builder::MeshInput;
use glam::{DVec3, Vec2, Vec3};
use std::f64::consts::TAU;

/// Sides of what is round, and rings of a sphere from pole to pole.
const AROUND: u32 = 128;
const RINGS: u32 = 64;

/// From -1 to 1 in x and y, facing +z.
pub(super) fn rectangle() -> MeshInput {
    let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
    MeshInput {
        positions: corners.map(|[x, y]| DVec3::new(x, y, 0.0)).to_vec(),
        uvs: corners.map(|[x, y]| half(x, y)).to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..MeshInput::default()
    }
}

fn half(x: f64, y: f64) -> Vec2 {
    Vec2::new(0.5 * (x + 1.0) as f32, 0.5 * (y + 1.0) as f32)
}

/// From -1 to 1 along each axis.
pub(super) fn cube() -> MeshInput {
    /// The corners of each side, counter-clockwise from outside, by the sign of each coordinate: at
    /// (0, 1), (1, 1), (1, 0) and (0, 0) of its texture.
    const SIDES: [[[i8; 3]; 4]; 6] = [
        [[1, -1, -1], [1, -1, 1], [-1, -1, 1], [-1, -1, -1]],
        [[1, 1, -1], [-1, 1, -1], [-1, 1, 1], [1, 1, 1]],
        [[1, -1, -1], [1, 1, -1], [1, 1, 1], [1, -1, 1]],
        [[1, -1, 1], [1, 1, 1], [-1, 1, 1], [-1, -1, 1]],
        [[-1, -1, 1], [-1, 1, 1], [-1, 1, -1], [-1, -1, -1]],
        [[1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]],
    ];
    let mut mesh = MeshInput::default();
    for corners in SIDES {
        let first = mesh.positions.len() as u32;
        let positions = corners.map(|corner| DVec3::from(corner.map(f64::from)));
        mesh.positions.extend(positions);
        let uvs = [[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
        mesh.uvs.extend(uvs.map(Vec2::from));
        let pair = [[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|v| v + first));
        mesh.triangles.extend(pair);
    }
    mesh
}

/// Of radius 1 around z, facing +z. A texture goes around it by its v.
pub(super) fn disk() -> MeshInput {
    let mut mesh = MeshInput::default();
    let share = |i: f32| i / AROUND as f32;
    for i in 0..=AROUND {
        let (sin, cos) = around(i);
        mesh.positions.push(DVec3::new(cos, sin, 0.0));
        mesh.uvs.push(Vec2::new(1.0, share(i as f32)));
    }
    // The middle is at another place of the texture for each triangle.
    for i in 0..AROUND {
        let middle = mesh.positions.len() as u32;
        mesh.positions.push(DVec3::ZERO);
        mesh.uvs.push(Vec2::new(0.0, share(i as f32 + 0.5)));
        mesh.triangles.push([middle, i, i + 1]);
    }
    mesh
}

/// Of radius 1 around z, from 0 to 1, without its ends.
pub(super) fn cylinder() -> MeshInput {
    let mut mesh = rows(2, |row, (sin, cos)| {
        (DVec3::new(cos, sin, row.into()), DVec3::new(cos, sin, 0.0))
    });
    mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
    mesh
}

/// Of radius 1 around the origin, its poles along z.
pub(super) fn sphere() -> MeshInput {
    rows(RINGS + 1, |row, (sin, cos)| {
        let (ring, z) = match row {
            0 => (0.0, -1.0),
            RINGS => (0.0, 1.0),
            _ => {
                let (ring, z) = libm::sincos(0.5 * TAU * f64::from(row) / f64::from(RINGS));
                (ring, -z)
            }
        };
        let p = DVec3::new(ring * cos, ring * sin, z);
        (p, p)
    })
}

fn around(i: u32) -> (f64, f64) {
    match i % AROUND {
        0 => (0.0, 1.0),
        i => libm::sincos(TAU * f64::from(i) / f64::from(AROUND)),
    }
}

/// Rows of points around z from below, outside on the right of who goes up; each point with its
/// normal. Textures lie on it from above.
fn rows(count: u32, point: impl Fn(u32, (f64, f64)) -> (DVec3, DVec3)) -> MeshInput {
    let mut mesh = MeshInput::default();
    for row in 0..count {
        for i in 0..=AROUND {
            let (p, normal) = point(row, around(i));
            mesh.positions.push(p);
            mesh.normals.push(normal.as_vec3());
            let v = 1.0 - row as f32 / (count - 1) as f32;
            mesh.uvs.push(Vec2::new(i as f32 / AROUND as f32, v));
        }
    }
    let width = AROUND + 1;
    for row in 0..count - 1 {
        for i in 0..AROUND {
            let (a, b) = (row * width + i, (row + 1) * width + i);
            for triangle in [[a, a + 1, b + 1], [a, b + 1, b]] {
                // At the poles one side is a point.
                let [p, q, r] = triangle.map(|v| mesh.positions[v as usize]);
                if p != q && q != r && r != p {
                    mesh.triangles.push(triangle);
                }
            }
        }
    }
    mesh
}

/// Normals at vertices of a mesh that has none: the mean of its faces by their angles there.
pub(super) fn smooth(mesh: &mut MeshInput) {
    let mut sums = vec![DVec3::ZERO; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let corner = |i: usize| mesh.positions[triangle[i % 3] as usize];
        let normal = (corner(1) - corner(0)).cross(corner(2) - corner(0));
        let Some(normal) = normal.try_normalize() else {
            continue;
        };
        for i in 0..3 {
            let sides = [1, 2].map(|k| (corner(i + k) - corner(i)).try_normalize());
            if let [Some(a), Some(b)] = sides {
                sums[triangle[i] as usize] += normal * libm::acos(a.dot(b).clamp(-1.0, 1.0));
            }
        }
    }
    let unit = |n: DVec3| n.try_normalize().unwrap_or(DVec3::ZERO).as_vec3();
    mesh.normals = sums.into_iter().map(unit).collect::<Vec<Vec3>>();
}

/// Turns a mesh inside out.
pub(super) fn flip(mesh: &mut MeshInput) {
    mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    mesh.normals.iter_mut().for_each(|n| *n = -*n);
}

/// Makes the front of each triangle, which emits, the side that the mean of its normals points to:
/// in Mitsuba they decide, not the order of corners.
pub(super) fn face_as_normals(mesh: &mut MeshInput) {
    if mesh.normals.is_empty() {
        return;
    }
    for triangle in &mut mesh.triangles {
        let [a, b, c] = triangle.map(|v| mesh.positions[v as usize]);
        let unit = |v: u32| mesh.normals[v as usize].as_dvec3().normalize_or_zero();
        let sum: DVec3 = triangle.iter().map(|v| unit(*v)).sum();
        if (b - a).cross(c - a).dot(sum) < 0.0 {
            triangle.swap(1, 2);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Area, and volume by the divergence of x / 3 over fronts that face outwards.
    fn measures(mesh: &MeshInput) -> [f64; 2] {
        let mut sums = [0.0; 2];
        for t in &mesh.triangles {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            let area = 0.5 * (b - a).cross(c - a);
            sums[0] += area.length();
            sums[1] += a.dot(area) / 3.0;
        }
        sums
    }

    #[test]
    fn shapes_have_their_areas_and_face_outwards() {
        let pi = 0.5 * TAU;
        for (mesh, area, volume) in [
            (rectangle(), 4.0, 0.0),
            (cube(), 24.0, 8.0),
            (disk(), pi, 0.0),
            (cylinder(), TAU, TAU / 3.0),
            (sphere(), 2.0 * TAU, 2.0 * TAU / 3.0),
        ] {
            let found = measures(&mesh);
            assert!((found[0] / area - 1.0).abs() < 2e-3, "{found:?} {area}");
            assert!((found[1] - volume).abs() < 1e-2, "{found:?} {volume}");
        }
        for mesh in [rectangle(), disk()] {
            let [a, b, c] = mesh.triangles[0].map(|v| mesh.positions[v as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
        }
    }

    /// Where a texture is at a point of a mesh.
    fn uv_at(mesh: &MeshInput, point: [f64; 3]) -> [f32; 2] {
        let point = DVec3::from(point);
        let at = mesh.triangles.iter().find_map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            let normal = (b - a).cross(c - a);
            let weights = [[b, c], [c, a], [a, b]]
                .map(|[p, q]| (p - point).cross(q - point).dot(normal) / normal.length_squared());
            let off = (point - a).dot(normal.normalize()).abs();
            (off < 1e-2 && weights.iter().all(|w| *w > -1e-9)).then_some((t, weights))
        });
        let (triangle, weights) = at.expect("a point on the mesh");
        let corners = triangle.iter().zip(weights);
        let sum: Vec2 = corners.map(|(v, w)| mesh.uvs[*v as usize] * w as f32).sum();
        sum.to_array()
    }

    #[test]
    fn textures_lie_as_mitsuba_puts_them() {
        // What Mitsuba 3.7 says of points that rays meet there.
        for (mesh, point, expected) in [
            (rectangle(), [0.3, 0.4, 0.0], [0.65, 0.7]),
            (cube(), [0.5, 0.25, 1.0], [0.625, 0.75]),
            (disk(), [0.3, 0.4, 0.0], [0.5, 0.147_584]),
            (disk(), [0.3, -0.4, 0.0], [0.5, 0.852_416]),
            (cylinder(), [0.953_939, 0.3, 0.25], [0.048_493, 0.25]),
            (cylinder(), [-0.953_939, 0.3, 0.75], [0.451_507, 0.75]),
            (sphere(), [0.920_598, 0.3, 0.25], [0.050_138, 0.419_569]),
        ] {
            let found = uv_at(&mesh, point);
            let off = [0, 1].map(|a| (found[a] - expected[a]).abs());
            // Sides of what is round are flat.
            assert!(off.iter().all(|off| *off < 2e-3), "{point:?}: {found:?}");
        }
    }

    #[test]
    fn smooth_normals_of_a_cube_point_to_its_corners() {
        let mut mesh = sphere();
        let given = std::mem::take(&mut mesh.normals);
        smooth(&mut mesh);
        // But at the seam and the poles, where faces of one side alone count.
        let width = AROUND as usize + 1;
        let at = 32 * width + 17;
        assert!((mesh.normals[at] - given[at]).length() < 1e-3);
    }
}
