//! Instances as a packed file holds them: prototypes in its description, places as rows.

use super::PackedScene;
use crate::formats::{PackedColumn, PackedInstances, PackedPrototype};
use crate::math::Aabb;
use crate::scene::{Instances, Mesh, Prototype};
use crate::{Error, Result};
use glam::{DAffine3, Vec3};

/// What a description says of the instances of a mesh, without hierarchies; `None` without any.
pub(super) fn description(mesh: &Mesh) -> Option<PackedInstances> {
    let instances = &mesh.instances;
    let prototype = |p: &Prototype| PackedPrototype {
        first_triangle: p.triangles.start,
        first_vertex: p.vertices.start,
        hierarchy: None,
    };
    (!instances.is_empty()).then(|| PackedInstances {
        prototypes: instances.prototypes().iter().map(prototype).collect(),
        count: instances.list().len() as u64,
    })
}

/// The rows of all places.
pub(super) fn rows(mesh: &Mesh) -> Vec<u8> {
    let list = mesh.instances.list();
    let mut rows = Vec::with_capacity(list.len() * PackedColumn::Instances.width());
    for instance in list {
        for number in instance.scene_from_prototype.to_cols_array() {
            rows.extend(number.to_le_bytes());
        }
        let Aabb { min, max } = instance.bounds;
        for number in min.to_array().into_iter().chain(max.to_array()) {
            rows.extend(number.to_le_bytes());
        }
        rows.extend(instance.prototype.to_le_bytes());
        rows.extend([0; 4]);
    }
    rows
}

/// The instances of a packed scene, whose rows were checked.
///
/// # Errors
/// More triangles than can be numbered, or some that emit: lights are flat.
pub(super) fn read(packed: &PackedScene) -> Result<Instances> {
    let file = packed.file();
    let meta = file.meta();
    let Some(described) = &meta.parts.instances else {
        return Ok(Instances::default());
    };
    let all = &described.prototypes;
    let first = all.first().map_or(0, |p| p.first_triangle);
    let materials = file.rows(PackedColumn::Materials, 0);
    let mut materials = materials.chunks_exact(4).skip(first as usize);
    let emits = |row: &[u8]| {
        let material = meta
            .materials
            .get(u32::from_le_bytes(part(row, 0)) as usize);
        material.is_some_and(|m| m.emission != [0.0; 3])
    };
    if let Some(at) = materials.position(emits) {
        let at = first as usize + at;
        return Err(Error::input(format!(
            "triangle {at} is of a prototype and emits light, \
             which only triangles in scene space may"
        )));
    }
    let end = [meta.mesh.triangles as u32, meta.mesh.vertices as u32];
    let prototypes = all.iter().enumerate().map(|(i, p)| {
        let next = all.get(i + 1);
        let [triangles, vertices] = next.map_or(end, |n| [n.first_triangle, n.first_vertex]);
        Prototype {
            triangles: p.first_triangle..triangles,
            vertices: p.first_vertex..vertices,
        }
    });
    let rows = file.rows(PackedColumn::Instances, 0);
    let rows = rows.chunks_exact(PackedColumn::Instances.width());
    let places = rows.clone().map(|row| {
        let map: [f64; 12] = std::array::from_fn(|i| f64::from_le_bytes(part(row, 8 * i)));
        let prototype = u32::from_le_bytes(part(row, 120));
        (prototype, DAffine3::from_cols_array(&map))
    });
    let instances = Instances::new(prototypes.collect(), places);
    let mut instances = instances.ok_or_else(|| {
        Error::input(format!(
            "its instances have more than the {} triangles that can be numbered",
            Instances::MAX_TRIANGLES
        ))
    })?;
    instances.set_bounds(rows.map(|row| {
        let end = |first: usize| {
            let of = |i: usize| f32::from_le_bytes(part(row, 96 + 4 * (first + i)));
            Vec3::from([0, 1, 2].map(of))
        };
        Aabb {
            min: end(0),
            max: end(3),
        }
    }));
    Ok(instances)
}

/// Bytes of a row from a place on.
fn part<const N: usize>(row: &[u8], at: usize) -> [u8; N] {
    std::array::from_fn(|i| row[at + i])
}
