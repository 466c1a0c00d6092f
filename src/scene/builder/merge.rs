//! Meshes of a builder joined to the one mesh of a scene.

use super::FAR;
use super::MeshInput;
use super::copies::Copies;
use super::emission;
use super::masks;
use super::mesh::{MESH, extend_attribute};
use crate::run::{Cancel, memory};
use crate::scene::{Instances, Material, Mesh, Prototype, Texture};
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec2, Vec3};

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
    let parts = || {
        let copies = |m: &MeshInput| m.copies.iter().map(|c| c.mesh.counts()).collect::<Vec<_>>();
        meshes
            .iter()
            .flat_map(move |m| copies(m).into_iter().chain([m.counts()]))
    };
    let vertices: usize = parts().map(|[vertices, _]| vertices).sum();
    let count: usize = parts().map(|[_, triangles]| triangles).sum();
    check_counts(vertices, count)?;
    let mut lists = Lists {
        positions: memory::room(MESH, vertices)?,
        triangles: memory::room(MESH, count)?,
        material: memory::room(MESH, count)?,
        ..Lists::default()
    };
    let mut materials = Vec::new();
    let mut textures = Vec::new();
    let mut copies = Vec::new();
    for mut input in meshes {
        cancel.check()?;
        let of = Materials {
            first: materials.len() as u32,
            are_masked: input.materials.iter().any(|m| m.mask.is_some()),
            are_textured: input.materials.iter().any(Material::has_texture),
        };
        let first_texture = textures.len() as u32;
        materials.extend(input.materials.drain(..).map(|mut m| {
            m.move_textures(first_texture);
            m
        }));
        textures.append(&mut input.textures);
        copies.extend(
            std::mem::take(&mut input.copies)
                .into_iter()
                .map(|c| (c, of)),
        );
        lists.add(input, of, world_from_scene, cancel)?;
    }
    let mut prototypes = Vec::new();
    let mut places = Vec::new();
    for (number, (copies, of)) in (0..).zip(copies) {
        let (prototype, origin) = lists.add_prototype(copies.mesh, of, cancel)?;
        prototypes.push(prototype);
        let from_prototype = DAffine3::from_translation(origin);
        let scene_from_world = DAffine3::from_translation(-world_from_scene);
        let maps = copies.world_from_mesh.into_iter();
        places.extend(maps.map(|map| (number, scene_from_world * map * from_prototype)));
    }
    let mut mesh = lists.into_mesh();
    mesh.instances = Instances::new(prototypes, places).ok_or_else(too_many)?;
    emission::settle(&mut mesh, &mut materials, &mut textures, cancel)?;
    let clear = masks::settle(&mut mesh, &mut materials, &mut textures, cancel)?;
    mesh.find_bounds();
    Ok((mesh, materials, textures, clear))
}

fn too_many() -> Error {
    Error::input(format!(
        "the instances of the scene have more than the {} triangles that can be numbered",
        Instances::MAX_TRIANGLES
    ))
}

/// The materials of a mesh among all.
#[derive(Clone, Copy)]
struct Materials {
    first: u32,
    are_masked: bool,
    are_textured: bool,
}

/// Lists of a mesh in the making.
#[derive(Default)]
struct Lists {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    colors: Vec<[f32; 3]>,
    uvs: Vec<Vec2>,
    opacities: Vec<f32>,
    triangles: Vec<[u32; 3]>,
    material: Vec<u32>,
    degenerate: u64,
}

impl Lists {
    /// Appends a mesh whose place is that of `origin` less.
    fn add(
        &mut self,
        input: MeshInput,
        of: Materials,
        origin: DVec3,
        cancel: &Cancel,
    ) -> Result<()> {
        let first_vertex = self.positions.len();
        let moved = input.positions.iter().map(|p| (p - origin).as_vec3());
        self.positions.extend(moved);
        let total = self.positions.len();
        let mut own = input.normals;
        own.iter_mut().for_each(|n| *n = n.normalize_or_zero());
        extend_attribute(&mut self.normals, own, first_vertex, total, Vec3::ZERO)?;
        extend_attribute(
            &mut self.colors,
            input.colors,
            first_vertex,
            total,
            [1.0; 3],
        )?;
        let own = if of.are_masked {
            input.opacities
        } else {
            Vec::new()
        };
        extend_attribute(&mut self.opacities, own, first_vertex, total, 1.0)?;
        let mut own = if of.are_textured {
            input.uvs
        } else {
            Vec::new()
        };
        if of.are_textured {
            // Whoever sees a texture may count on there being coordinates.
            let missing = input.positions.len().saturating_sub(own.len());
            memory::grow(MESH, &mut own, missing)?;
            own.resize(input.positions.len(), Vec2::ZERO);
        }
        extend_attribute(&mut self.uvs, own, first_vertex, total, Vec2::ZERO)?;
        for (triangle, material) in input.triangles.iter().zip(&input.material) {
            cancel.check()?;
            let triangle = triangle.map(|v| v + first_vertex as u32);
            if has_area(triangle.map(|v| self.positions[v as usize].as_dvec3())) {
                self.triangles.push(triangle);
                self.material.push(material + of.first);
            } else {
                self.degenerate += 1;
            }
        }
        Ok(())
    }

    /// Appends a mesh in its own space, moved to the origin if it is far from that. Returns where
    /// it is, and what was its origin.
    fn add_prototype(
        &mut self,
        input: MeshInput,
        of: Materials,
        cancel: &Cancel,
    ) -> Result<(Prototype, DVec3)> {
        let alone = Copies {
            mesh: input,
            world_from_mesh: vec![DAffine3::IDENTITY],
        };
        let [min, max] = alone.bounds();
        let (centre, radius) = (0.5 * (min + max), 0.5 * (max - min).length());
        let origin = match centre.length() > FAR * radius && centre.is_finite() {
            true => centre,
            false => DVec3::ZERO,
        };
        let (vertices, triangles) = (self.positions.len() as u32, self.triangles.len() as u32);
        self.add(alone.mesh, of, origin, cancel)?;
        let prototype = Prototype {
            triangles: triangles..self.triangles.len() as u32,
            vertices: vertices..self.positions.len() as u32,
        };
        Ok((prototype, origin))
    }

    fn into_mesh(self) -> Mesh {
        Mesh {
            positions: self.positions.into(),
            normals: self.normals.into(),
            colors: self.colors.into(),
            uvs: self.uvs.into(),
            opacities: self.opacities.into(),
            triangles: self.triangles.into(),
            material: self.material.into(),
            degenerate: self.degenerate,
            instances: Instances::default(),
        }
    }
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
