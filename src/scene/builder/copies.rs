//! Meshes that stand at many places: kept once, or laid flat.

use super::MeshInput;
use crate::Result;
use glam::{DAffine3, DVec3};
use rayon::prelude::*;

/// A part of a mesh that stands at several places. Its triangles refer to the materials of the
/// whole; it has none of its own.
#[derive(Debug, Default)]
pub(in crate::scene) struct Copies {
    pub mesh: MeshInput,
    pub world_from_mesh: Vec<DAffine3>,
}

impl Copies {
    /// Triangles at all places.
    pub fn triangles(&self) -> usize {
        (self.mesh.triangles.len()).saturating_mul(self.world_from_mesh.len())
    }

    /// The box around all that its triangles use, at all places.
    pub fn bounds(&self) -> [DVec3; 2] {
        let mut is_used = vec![false; self.mesh.positions.len()];
        for v in self.mesh.triangles.iter().flatten() {
            is_used[*v as usize] = true;
        }
        let used = self.mesh.positions.iter().zip(&is_used);
        let used: Vec<DVec3> = used.filter(|(_, used)| **used).map(|(p, _)| *p).collect();
        let empty = || [DVec3::INFINITY, DVec3::NEG_INFINITY];
        let joined = |[a, b]: [DVec3; 2], [c, d]: [DVec3; 2]| [a.min(c), b.max(d)];
        let at = |map: &DAffine3| {
            let points = used.iter().map(|p| map.transform_point3(*p));
            points.fold(empty(), |all, p| joined(all, [p, p]))
        };
        let places = self.world_from_mesh.par_iter();
        places.map(at).reduce(empty, joined)
    }

    /// The largest coordinate that a point of the box around its vertices has at a place.
    pub fn farthest(&self) -> f64 {
        let positions = self.mesh.positions.iter();
        let most = positions.fold(DVec3::ZERO, |most, p| most.max(p.abs()));
        let at = |map: &DAffine3| {
            let rows = map.matrix3.transpose();
            let rows = [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.abs().dot(most));
            (DVec3::from(rows) + map.translation.abs()).max_element()
        };
        self.world_from_mesh.iter().map(at).fold(0.0, f64::max)
    }

    /// The mesh as it stands at each place.
    fn into_flat(self) -> impl Iterator<Item = MeshInput> {
        let Self {
            mesh,
            world_from_mesh,
        } = self;
        world_from_mesh.into_iter().map(move |map| {
            let mut copy = MeshInput {
                positions: mesh.positions.clone(),
                normals: mesh.normals.clone(),
                colors: mesh.colors.clone(),
                uvs: mesh.uvs.clone(),
                opacities: mesh.opacities.clone(),
                triangles: mesh.triangles.clone(),
                material: mesh.material.clone(),
                ..MeshInput::default()
            };
            copy.place(&map);
            copy
        })
    }
}

impl MeshInput {
    /// A part that stands at the places of these maps, of a mesh whose materials it has.
    pub(in crate::scene) fn copied(self, world_from_mesh: Vec<DAffine3>) -> Self {
        let part = Self {
            positions: self.positions,
            normals: self.normals,
            colors: self.colors,
            uvs: self.uvs,
            opacities: self.opacities,
            triangles: self.triangles,
            material: self.material,
            ..Self::default()
        };
        let mut copies = self.copies;
        for copies in &mut copies {
            let places = world_from_mesh.iter();
            let inner = &copies.world_from_mesh;
            let places = places.flat_map(|map| inner.iter().map(move |own| *map * *own));
            copies.world_from_mesh = places.collect();
        }
        copies.push(Copies {
            mesh: part,
            world_from_mesh,
        });
        Self {
            materials: self.materials,
            textures: self.textures,
            copies,
            ..Self::default()
        }
    }

    /// Its vertices and triangles, without those of parts.
    pub(super) fn counts(&self) -> [usize; 2] {
        [self.positions.len(), self.triangles.len()]
    }

    /// Whether there is no triangle at any place.
    pub(in crate::scene) fn is_empty(&self) -> bool {
        self.triangles.is_empty() && self.copies.iter().all(|c| c.triangles() == 0)
    }

    /// Lays parts flat that stand at several places, as if each place had a mesh of its own.
    ///
    /// # Errors
    /// If there is no memory for all.
    pub(in crate::scene) fn lay_flat(&mut self) -> Result<()> {
        self.lay_flat_where(|_, _| true)
    }

    /// Lays parts flat that send light, and those that stand nowhere or at one place.
    ///
    /// # Errors
    /// If there is no memory for all.
    pub(super) fn lay_emitters_flat(&mut self) -> Result<()> {
        self.lay_flat_where(|copies, materials| {
            let mut used = copies.mesh.material.iter();
            copies.world_from_mesh.len() < 2 || used.any(|m| materials[*m as usize].emits())
        })
    }

    fn lay_flat_where(
        &mut self,
        is_flat: impl Fn(&Copies, &[crate::scene::Material]) -> bool,
    ) -> Result<()> {
        for copies in std::mem::take(&mut self.copies) {
            if !is_flat(&copies, &self.materials) {
                self.copies.push(copies);
                continue;
            }
            for mut copy in copies.into_flat() {
                // Materials are appended behind those there are, and these are already theirs.
                let material = std::mem::take(&mut copy.material);
                self.append(copy)?;
                self.material.extend(material);
            }
        }
        Ok(())
    }
}
