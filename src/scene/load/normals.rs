//! Shading normals recomputed at a crease angle: smooth where faces meet gently, split where they
//! meet sharply.

use crate::Result;
use crate::run::Cancel;
use crate::scene::builder::MeshInput;
use glam::{DVec3, Vec3};
use std::collections::HashMap;

/// At a vertex of more faces than this the corners keep their face normals: comparing all pairs
/// would take for ever.
const MOST_FACES: usize = 4096;

/// Gives `mesh` normals: at each corner the area-weighted mean over the faces around the point that
/// turn less than `crease_rad` from the corner's own face. Vertices are split where their corners
/// differ.
///
/// # Errors
/// If cancelled.
pub(super) fn crease(mesh: &mut MeshInput, crease_rad: f64, cancel: &Cancel) -> Result<()> {
    for copies in &mut mesh.copies {
        crease(&mut copies.mesh, crease_rad, cancel)?;
    }
    let corners = mesh.triangles.len() * 3;
    let face = |t: usize| {
        let [a, b, c] = mesh.triangles[t].map(|i| mesh.positions[i as usize]);
        0.5 * (b - a).cross(c - a)
    };
    let area_vectors: Vec<DVec3> = (0..mesh.triangles.len()).map(face).collect();
    let unit: Vec<DVec3> = area_vectors.iter().map(|n| n.normalize_or_zero()).collect();

    // Files split vertices for reasons of their own, so faces meet where positions are equal, not
    // where indices are.
    let mut point_of_vertex: Vec<u32> = Vec::with_capacity(mesh.positions.len());
    let mut points: HashMap<[u64; 3], u32> = HashMap::with_capacity(mesh.positions.len());
    for p in &mesh.positions {
        cancel.check()?;
        // Adding zero makes -0 equal to 0.
        let key = p.to_array().map(|x| (x + 0.0).to_bits());
        let next = points.len() as u32;
        point_of_vertex.push(*points.entry(key).or_insert(next));
    }
    let point = |corner: usize| point_of_vertex[mesh.triangles[corner / 3][corner % 3] as usize];
    let mut first = vec![0_usize; points.len() + 1];
    for corner in 0..corners {
        first[point(corner) as usize + 1] += 1;
    }
    for p in 0..points.len() {
        first[p + 1] += first[p];
    }
    let mut faces = vec![0_u32; corners];
    let mut next = first.clone();
    for corner in 0..corners {
        let slot = &mut next[point(corner) as usize];
        faces[*slot] = (corner / 3) as u32;
        *slot += 1;
    }

    let least_cos = libm::cos(crease_rad);
    let normal = |corner: usize| {
        let own = unit[corner / 3];
        let p = point(corner) as usize;
        let around = &faces[first[p]..first[p + 1]];
        if around.len() > MOST_FACES {
            return own.as_vec3();
        }
        let sum: DVec3 = around
            .iter()
            .filter(|&&f| unit[f as usize].dot(own) >= least_cos)
            .map(|&f| area_vectors[f as usize])
            .sum();
        sum.normalize_or(own).as_vec3()
    };
    let mut normals = Vec::with_capacity(corners);
    for corner in 0..corners {
        cancel.check()?;
        normals.push(normal(corner));
    }
    split(mesh, &normals, cancel)
}

/// Makes vertices anew, one for each pair of an old vertex and a normal that its corners have.
fn split(mesh: &mut MeshInput, normal_of_corner: &[Vec3], cancel: &Cancel) -> Result<()> {
    let old = std::mem::take(mesh);
    let mut made: HashMap<(u32, [u32; 3]), u32> = HashMap::with_capacity(old.positions.len());
    for (t, triangle) in old.triangles.iter().enumerate() {
        cancel.check()?;
        let vertices = std::array::from_fn(|k| {
            let v = triangle[k];
            let normal = normal_of_corner[t * 3 + k];
            let key = (v, normal.to_array().map(f32::to_bits));
            *made.entry(key).or_insert_with(|| {
                mesh.positions.push(old.positions[v as usize]);
                mesh.normals.push(normal);
                mesh.colors.extend(old.colors.get(v as usize));
                mesh.uvs.extend(old.uvs.get(v as usize));
                mesh.opacities.extend(old.opacities.get(v as usize));
                mesh.positions.len() as u32 - 1
            })
        });
        mesh.triangles.push(vertices);
    }
    mesh.material = old.material;
    mesh.materials = old.materials;
    mesh.textures = old.textures;
    mesh.copies = old.copies;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two unit squares that share an edge, the second turned up by `angle` about it.
    fn fold(angle: f64) -> MeshInput {
        let up = DVec3::new(angle.cos(), angle.sin(), 0.0);
        MeshInput {
            positions: vec![
                DVec3::NEG_X,
                DVec3::ZERO,
                DVec3::Z,
                DVec3::NEG_X + DVec3::Z,
                up,
                up + DVec3::Z,
                // The same edge again, as files with split vertices have it.
                DVec3::new(-0.0, 0.0, 0.0),
                DVec3::Z,
            ],
            triangles: vec![[0, 3, 2], [0, 2, 1], [6, 7, 5], [6, 5, 4]],
            material: vec![0; 4],
            ..MeshInput::default()
        }
    }

    #[test]
    fn a_gentle_fold_is_smooth_and_a_sharp_one_is_split() {
        let mut gentle = fold(30_f64.to_radians());
        crease(&mut gentle, 40_f64.to_radians(), &Cancel::default()).unwrap();
        let expected = Vec3::new(-(15_f32.to_radians().sin()), 15_f32.to_radians().cos(), 0.0);
        for (p, n) in gentle.positions.iter().zip(&gentle.normals) {
            if p.x == 0.0 {
                // Three triangles meet at one end of the edge, so the weights differ a little from
                // one half each.
                assert!(n.dot(expected) > 0.98, "{p} {n}");
            }
        }
        let mut sharp = fold(50_f64.to_radians());
        crease(&mut sharp, 40_f64.to_radians(), &Cancel::default()).unwrap();
        for t in &sharp.triangles {
            let [a, b, c] = t.map(|i| sharp.positions[i as usize]);
            let face = (b - a).cross(c - a).normalize().as_vec3();
            for i in t {
                assert!(sharp.normals[*i as usize].dot(face) > 0.9999);
            }
        }
        assert_eq!(sharp.positions.len(), 8);
    }
}
