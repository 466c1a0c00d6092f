//! Resources that need no file: simple meshes around the origin, a plume of smoke,
//! and a flame.

use super::field::Field;
use super::nearest::nearest;
use super::samples::{Array, Number};
use crate::scene::Material;
use crate::scene::builder::{DEFAULT_ALBEDO, MeshInput};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use rayon::prelude::*;
use std::f64::consts::TAU;

const MESHES: [&str; 4] = ["quad", "cube", "sphere", "torus"];
const VOLUMES: [&str; 2] = ["plume", "flame"];

/// Voxels of the plume.
const PLUME_DIMS: [usize; 3] = [96, 128, 96];
/// Voxels of the flame.
const FLAME_DIMS: [usize; 3] = [64, 128, 64];

/// A mesh by name.
pub(super) fn mesh(name: &str) -> Result<MeshInput> {
    let mut mesh = match name {
        "quad" => quad(),
        "cube" => cube(),
        // Fine enough that a facet is below a pixel in the demo, seams excepted.
        "sphere" => revolve(128, 64, |v| {
            let (sin, cos) = libm::sincos(0.5 * TAU * v);
            [0.5 * sin, -0.5 * cos]
        }),
        "torus" => revolve(160, 64, |v| {
            let (sin, cos) = libm::sincos(TAU * v);
            [0.32 + 0.18 * cos, 0.18 * sin]
        }),
        _ => return Err(unknown("mesh", name, &MESHES)),
    };
    mesh.material = vec![0; mesh.triangles.len()];
    mesh.materials = vec![Material::diffuse(name, DEFAULT_ALBEDO)];
    Ok(mesh)
}

/// A volume by name.
pub(super) fn volume(name: &str) -> Result<Field> {
    let (dims, value): (_, fn(Vec3) -> f32) = match name {
        "plume" => (PLUME_DIMS, plume_density),
        "flame" => (FLAME_DIMS, flame_temperature),
        _ => return Err(unknown("volume", name, &VOLUMES)),
    };
    Ok(Field::of_array(Array {
        dims,
        bytes: samples(dims, value).into(),
        number: Number::F32,
        big_endian: false,
        rescale: None,
    }))
}

fn unknown(kind: &str, name: &str, known: &[&str]) -> Error {
    let error = Error::input(format!("there is no built-in {kind} \"{name}\""));
    match nearest(name, known) {
        Some(near) => error.hint(format!("did you mean \"builtin:{near}\"?")),
        None => error.hint(format!("built in are {}", known.join(", "))),
    }
}

fn quad() -> MeshInput {
    let corners = [[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]];
    MeshInput {
        positions: corners.map(|[x, z]| DVec3::new(x, 0.0, z)).to_vec(),
        uvs: corners
            .map(|[x, z]| Vec2::new(x as f32 + 0.5, z as f32 + 0.5))
            .to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        ..MeshInput::default()
    }
}

fn cube() -> MeshInput {
    let mut mesh = MeshInput::default();
    for side in 0..6 {
        let axis = side / 2;
        let out = if side % 2 == 0 { 0.5 } else { -0.5 };
        let first = mesh.positions.len() as u32;
        for [s, t] in [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]] {
            let mut p = [0.0; 3];
            p[axis] = out;
            // On the negative side one coordinate runs backwards, so that corners run
            // counter-clockwise there too.
            p[(axis + 1) % 3] = if out > 0.0 { s } else { -s };
            p[(axis + 2) % 3] = t;
            mesh.positions.push(DVec3::from(p));
            mesh.uvs.push(Vec2::new(s as f32 + 0.5, 0.5 - t as f32));
        }
        mesh.triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|v| v + first)));
    }
    mesh
}

/// A surface of revolution about y. `profile(v)` gives the distance from the axis and the height, v
/// from 0 to 1 with the outside on its right.
fn revolve(around: u32, along: u32, profile: impl Fn(f64) -> [f64; 2]) -> MeshInput {
    let mut mesh = MeshInput::default();
    for j in 0..=along {
        let v = f64::from(j) / f64::from(along);
        let [mut radius, height] = profile(v);
        if radius < 1e-12 {
            radius = 0.0;
        }
        let [r0, h0] = profile(v - 1e-5);
        let [r1, h1] = profile(v + 1e-5);
        // The tangent turned to the right; at a pole the distance from the axis changes sign, hence
        // abs.
        let (out, up) = match radius == 0.0 {
            true => (0.0, height.signum()),
            false => (h1 - h0, r0 - r1),
        };
        for i in 0..=around {
            let u = f64::from(i) / f64::from(around);
            let (sin, cos) = match i == around {
                true => (0.0, 1.0),
                false => libm::sincos(TAU * u),
            };
            mesh.positions
                .push(DVec3::new(radius * cos, height, -radius * sin));
            let normal = DVec3::new(out * cos, up, -out * sin).normalize_or_zero();
            mesh.normals.push(normal.as_vec3());
            mesh.uvs.push(Vec2::new(u as f32, 1.0 - v as f32));
        }
    }
    let row = around + 1;
    for j in 0..along {
        for i in 0..around {
            let [a, b] = [j * row + i, j * row + i + 1];
            let [c, d] = [a + row, b + row];
            // Quads at a pole have one side of length zero.
            if mesh.positions[a as usize] != mesh.positions[b as usize] {
                mesh.triangles.push([a, b, d]);
            }
            if mesh.positions[c as usize] != mesh.positions[d as usize] {
                mesh.triangles.push([a, d, c]);
            }
        }
    }
    mesh
}

/// Densities in [0,1] of smoke that rises from the middle of the floor of [0,1]^3, bends and
/// spreads.
/// Values in the middle of the voxels of a unit cube, x fastest.
fn samples([nx, ny, nz]: [usize; 3], value: fn(Vec3) -> f32) -> Vec<u8> {
    let at = |i: usize, n: usize| (i as f32 + 0.5) / n as f32;
    (0..ny * nz)
        .into_par_iter()
        .flat_map_iter(|row| {
            (0..nx).flat_map(move |i| {
                let p = Vec3::new(at(i, nx), at(row % ny, ny), at(row / ny, nz));
                value(p).to_le_bytes()
            })
        })
        .collect()
}

fn plume_density(p: Vec3) -> f32 {
    let height = p.y;
    let wobble = Vec3::new(
        noise(Vec3::new(0.5, 2.5 * height, 7.3)) - 0.5,
        0.0,
        noise(Vec3::new(9.1, 2.5 * height, 3.7)) - 0.5,
    );
    // Turbulence grows with height: the jet is smooth where it leaves the floor.
    let growth = (0.15 + height).min(1.0);
    let warp = Vec3::new(
        noise(p * 3.0 + 11.0) - 0.5,
        noise(p * 3.0 + 23.0) - 0.5,
        noise(p * 3.0 + 37.0) - 0.5,
    );
    let q = p + 0.3 * growth * warp + 0.35 * height * wobble;
    let from_axis = Vec3::new(q.x - 0.5, 0.0, q.z - 0.5).length();
    let radius = 0.10 + 0.30 * height;
    if radius - from_axis + 0.45 * growth * MOST_TURBULENCE < 0.0 {
        return 0.0;
    }
    let detail = turbulence(q * Vec3::new(6.0, 5.0, 6.0));
    let depth = radius - from_axis + 0.45 * growth * (detail - 0.5);
    let fade = smooth(p.y / 0.03) * smooth((1.0 - p.y) / 0.3);
    let sides = [p.x, 1.0 - p.x, p.z, 1.0 - p.z]
        .map(|d| smooth((d - 0.01) / 0.06))
        .iter()
        .product::<f32>();
    smooth(depth / 0.14) * (0.45 + 0.55 * detail) * (1.0 - 0.4 * height) * fade * sides
}

/// The temperature of a flame, 0 around it and 1 where it is hottest.
fn flame_temperature(p: Vec3) -> f32 {
    let height = p.y;
    // Tongues are long, and reach the farther off the higher they are.
    let stretched = p * Vec3::new(4.0, 2.2, 4.0);
    let warp = Vec3::new(
        turbulence(stretched + 3.0) - 0.5,
        0.0,
        turbulence(stretched + 17.0) - 0.5,
    );
    let sway = Vec3::new(
        noise(Vec3::new(4.1, 2.0 * height, 1.3)) - 0.5,
        0.0,
        noise(Vec3::new(2.7, 2.0 * height, 8.9)) - 0.5,
    );
    let q = p + warp * (0.06 + 0.5 * height) + sway * (0.5 * height);
    let from_axis = Vec3::new(q.x - 0.5, 0.0, q.z - 0.5).length();
    let radius = 0.26 * (height / 0.12).min(1.0).sqrt() * (1.0 - height).max(0.0);
    if radius - from_axis + 0.3 * height * MOST_TURBULENCE < 0.0 {
        return 0.0;
    }
    let licks = turbulence(q * Vec3::new(9.0, 4.0, 9.0));
    let depth = radius - from_axis + 0.3 * height * (licks - 0.5);
    let hot = smooth(depth / 0.07) * smooth((1.0 - height) / 0.2) * smooth(height / 0.02);
    match hot > 0.0 {
        true => hot * (0.75 + 0.25 * smooth(depth / 0.16)) * (1.0 - 0.25 * height),
        false => 0.0,
    }
}

/// 0 below 0, 1 above 1, without a kink at either.
fn smooth(x: f32) -> f32 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

/// What turbulence is above 1/2 at most, and a little more.
const MOST_TURBULENCE: f32 = 0.501;

/// Octaves of noise, in [0,1] and around 1/2.
fn turbulence(p: Vec3) -> f32 {
    let mut sum = 0.0;
    let mut weight = 0.5;
    let mut q = p;
    for _ in 0..4 {
        sum += weight * noise(q);
        weight *= 0.5;
        q = q * 2.03 + 5.2;
    }
    sum / (1.0 - 2.0 * weight)
}

/// Random values in [0,1] at whole coordinates, smoothly joined.
fn noise(p: Vec3) -> f32 {
    let cell = p.floor();
    let f = (p - cell).to_array().map(smooth);
    let c = cell.as_ivec3();
    let value = |corner: usize| {
        let mut h = 0x9e37_79b9_u32;
        for (a, x) in c.to_array().into_iter().enumerate() {
            h ^= x.wrapping_add((corner >> a & 1) as i32) as u32;
            h = h.wrapping_mul(0x85eb_ca6b);
            h ^= h >> 15;
            h = h.wrapping_mul(0xc2b2_ae35);
            h ^= h >> 13;
        }
        h as f32 / u32::MAX as f32
    };
    let mix = |a: f32, b: f32, t: f32| a + (b - a) * t;
    let edge = |corner: usize| mix(value(corner), value(corner + 1), f[0]);
    let side = |corner: usize| mix(edge(corner), edge(corner + 2), f[1]);
    mix(side(0), side(4), f[2])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Surface area, and volume by the divergence theorem: negative if inside out.
    fn area_and_volume(mesh: &MeshInput) -> (f64, f64) {
        let sum = |f: &dyn Fn([DVec3; 3]) -> f64| -> f64 {
            let corners = |t: &[u32; 3]| t.map(|i| mesh.positions[i as usize]);
            mesh.triangles.iter().map(|t| f(corners(t))).sum()
        };
        (
            sum(&|[a, b, c]| 0.5 * (b - a).cross(c - a).length()),
            sum(&|[a, b, c]| a.dot(b.cross(c)) / 6.0),
        )
    }

    #[test]
    fn shapes_have_their_area_and_face_outwards() {
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 5e-3;
        let pi = 0.5 * TAU;
        for (name, area, volume) in [
            ("cube", 6.0, 1.0),
            ("sphere", pi, pi / 6.0),
            (
                "torus",
                TAU * TAU * 0.32 * 0.18,
                0.5 * TAU * TAU * 0.32 * 0.18 * 0.18,
            ),
        ] {
            let mesh = mesh(name).unwrap();
            mesh.check().unwrap();
            let found = area_and_volume(&mesh);
            assert!(near(found.0, area), "{name}: {found:?}");
            assert!(near(found.1, volume), "{name}: {found:?}");
            for t in &mesh.triangles {
                let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
                let face = (b - a).cross(c - a).normalize().as_vec3();
                for i in t {
                    let Some(n) = mesh.normals.get(*i as usize) else {
                        continue;
                    };
                    assert!(n.dot(face) > 0.99, "{name} {n} {face}");
                }
            }
        }
        let [a, b, c] = mesh("quad").unwrap().triangles[0].map(|i| quad().positions[i as usize]);
        assert_eq!((b - a).cross(c - a), DVec3::Y);
    }

    #[test]
    fn the_plume_is_in_range_and_ends_inside_its_box() {
        let field = volume("plume").unwrap();
        let [nx, ny, nz] = field.dims;
        let mut sum = 0.0;
        for k in 0..nz {
            for j in 0..ny {
                for i in 0..nx {
                    let value = field.value([i, j, k]);
                    assert!((0.0..=1.0).contains(&value));
                    let at_side = i == 0 || i == nx - 1 || k == 0 || k == nz - 1 || j == ny - 1;
                    assert!(!at_side || value < 0.01, "{i} {j} {k}: {value}");
                    sum += f64::from(value);
                }
            }
        }
        let mean = sum / (nx * ny * nz) as f64;
        assert!((0.02..0.3).contains(&mean), "{mean}");
    }

    #[test]
    fn a_wrong_name_gets_a_hint() {
        let e = mesh("spere").unwrap_err();
        assert_eq!(e.hint_text(), Some("did you mean \"builtin:sphere\"?"));
        assert!(volume("x").is_err());
    }
}
