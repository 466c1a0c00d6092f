//! Meshes of a builder joined to the one mesh of a scene.

use super::MeshInput;
use super::emission;
use super::masks;
use super::mesh::{MESH, extend_attribute};
use crate::run::{Cancel, memory};
use crate::scene::{Material, Mesh, Texture};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};

/// And the number of triangles of which a mask leaves nothing.
type Merged = (Mesh, Vec<Material>, Vec<Texture>, u64);

/// Refuses meshes that cannot be indexed.
pub(super) fn check_counts(vertices: usize, triangles: usize) -> Result<()> {
    if vertices > u32::MAX as usize {
        return Err(Error::input(format!(
            "the scene has {vertices} vertices, more than the {} that can be indexed",
            u32::MAX
        )));
    }
    if triangles > Mesh::MAX_TRIANGLES {
        return Err(Error::input(format!(
            "the scene has {triangles} triangles, more than the {} that it may have",
            Mesh::MAX_TRIANGLES
        )));
    }
    Ok(())
}

/// Joins meshes in world space to one in scene space, with their materials and textures.
///
/// # Errors
/// More vertices or triangles than can be indexed, no memory for them, or a stop on request.
pub(super) fn merge(
    meshes: Vec<MeshInput>,
    world_from_scene: DVec3,
    cancel: &Cancel,
) -> Result<Merged> {
    let (mut normals, mut colors, mut uvs) = (Vec::new(), Vec::new(), Vec::new());
    let mut opacities = Vec::new();
    let mut degenerate = 0;
    let mut materials = Vec::new();
    let mut textures = Vec::new();
    let vertices: usize = meshes.iter().map(|m| m.positions.len()).sum();
    let count: usize = meshes.iter().map(|m| m.triangles.len()).sum();
    check_counts(vertices, count)?;
    let mut positions: Vec<Vec3> = memory::room(MESH, vertices)?;
    let mut triangles = memory::room(MESH, count)?;
    let mut material_of = memory::room(MESH, count)?;
    for input in meshes {
        cancel.check()?;
        let first_vertex = positions.len();
        let first_material = materials.len() as u32;
        let first_texture = textures.len() as u32;
        let moved = input
            .positions
            .iter()
            .map(|p| (p - world_from_scene).as_vec3());
        positions.extend(moved);
        let total = positions.len();
        let mut own = input.normals;
        own.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        extend_attribute(&mut normals, own, first_vertex, total, Vec3::ZERO)?;
        extend_attribute(&mut colors, input.colors, first_vertex, total, [1.0; 3])?;
        let is_masked = input.materials.iter().any(|m| m.mask.is_some());
        let own = if is_masked {
            input.opacities
        } else {
            Vec::new()
        };
        extend_attribute(&mut opacities, own, first_vertex, total, 1.0)?;
        let textured = input.materials.iter().any(Material::has_texture);
        let mut own = if textured { input.uvs } else { Vec::new() };
        if textured {
            // Whoever sees a texture may count on there being coordinates.
            let missing = input.positions.len().saturating_sub(own.len());
            memory::grow(MESH, &mut own, missing)?;
            own.resize(input.positions.len(), Vec2::ZERO);
        }
        extend_attribute(&mut uvs, own, first_vertex, total, Vec2::ZERO)?;
        for (triangle, material) in input.triangles.iter().zip(&input.material) {
            cancel.check()?;
            let triangle = triangle.map(|v| v + first_vertex as u32);
            if has_area(triangle.map(|v| positions[v as usize].as_dvec3())) {
                triangles.push(triangle);
                material_of.push(material + first_material);
            } else {
                degenerate += 1;
            }
        }
        materials.extend(input.materials.into_iter().map(|mut m| {
            m.move_textures(first_texture);
            m
        }));
        textures.extend(input.textures);
    }
    let mut mesh = Mesh {
        positions: positions.into(),
        normals: normals.into(),
        colors: colors.into(),
        uvs: uvs.into(),
        opacities: opacities.into(),
        triangles: triangles.into(),
        material: material_of.into(),
        degenerate,
    };
    emission::settle(&mut mesh, &mut materials, &mut textures, cancel)?;
    let clear = masks::settle(&mut mesh, &mut materials, &mut textures, cancel)?;
    Ok((mesh, materials, textures, clear))
}

/// Whether the area of a triangle is more than the rounding of f64 makes of a line.
pub(super) fn has_area([a, b, c]: [DVec3; 3]) -> bool {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    let longest = ab
        .length_squared()
        .max(ac.length_squared())
        .max(bc.length_squared());
    ab.cross(ac).length() > 1e-14 * longest
}
