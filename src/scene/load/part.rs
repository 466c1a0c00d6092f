//! A mesh as it comes out of a file: f64 positions, its own materials and textures, nothing dropped
//! yet.

use super::super::{Material, Texture};
use crate::run::memory;
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec2, Vec3};

/// Coordinates beyond this are taken for a mistake: their squares would leave the range of f32.
pub(super) const FARTHEST: f64 = 1e15;

/// Albedo of a mesh that does not state any.
pub(super) const DEFAULT_ALBEDO: [f32; 3] = [0.5; 3];

/// What needs the memory of its lists, as an error says it.
pub(super) const MESH: &str = "the mesh";

/// Triangles with attributes per vertex; an attribute that the file does not have is an empty list.
#[derive(Debug, Default)]
pub(super) struct Part {
    pub(super) positions: Vec<DVec3>,
    /// Not yet of unit length.
    pub(super) normals: Vec<Vec3>,
    /// Linear RGB factors.
    pub(super) colors: Vec<[f32; 3]>,
    /// (0,0) top left.
    pub(super) uvs: Vec<Vec2>,
    pub(super) triangles: Vec<[u32; 3]>,
    /// Index into `materials`, per triangle.
    pub(super) material: Vec<u32>,
    pub(super) materials: Vec<Material>,
    /// Textures that `materials` refer to.
    pub(super) textures: Vec<Texture>,
}

impl Part {
    /// An error if a value is not finite or out of its range, or an index refers to nothing.
    pub(super) fn check(&self) -> Result<()> {
        if let Some(i) = self.positions.iter().position(|p| !p.is_finite()) {
            let p = self.positions[i];
            return Err(Error::input(format!(
                "vertex {i}: the position is not finite: {p}"
            )));
        }
        let far = |p: &DVec3| p.abs().max_element() > FARTHEST;
        if let Some(i) = self.positions.iter().position(far) {
            let p = self.positions[i];
            return Err(Error::input(format!(
                "vertex {i}: the position {:?} is farther than {FARTHEST:e} from the origin",
                p.to_array()
            )));
        }
        if let Some(i) = self.normals.iter().position(|n| !n.is_finite()) {
            let n = self.normals[i];
            return Err(Error::input(format!(
                "vertex {i}: the normal is not finite in 32 bits: {n}"
            )));
        }
        if let Some(i) = self.uvs.iter().position(|t| !t.is_finite()) {
            return Err(Error::input(format!(
                "vertex {i}: the texture coordinates are not finite in 32 bits: {}",
                self.uvs[i]
            )));
        }
        let outside = |c: &[f32; 3]| !c.iter().all(|x| (0.0..=1.0).contains(x));
        if let Some(i) = self.colors.iter().position(outside) {
            return Err(Error::input(format!(
                "vertex {i}: the colour {:?} is not in [0,1]",
                self.colors[i]
            )));
        }
        let count = self.positions.len();
        let loose = |t: &[u32; 3]| t.iter().any(|&v| v as usize >= count);
        if let Some(i) = self.triangles.iter().position(loose) {
            return Err(Error::input(format!(
                "triangle {i} refers to the vertices {:?}, but there are {count} (0 to {})",
                self.triangles[i],
                count.saturating_sub(1)
            )));
        }
        self.materials.iter().try_for_each(check_material)
    }

    /// Moves the part. A map that mirrors also turns the triangles round, so that fronts stay
    /// fronts.
    pub(super) fn transform(&mut self, world_from_part: &DAffine3) {
        if *world_from_part == DAffine3::IDENTITY {
            return;
        }
        for p in &mut self.positions {
            *p = world_from_part.transform_point3(*p);
        }
        let normals_from = world_from_part.matrix3.inverse().transpose();
        for n in &mut self.normals {
            // Unit length first: a scale of 1e-30 must not take the normal out of the range of f32.
            *n = (normals_from * n.as_dvec3()).normalize_or_zero().as_vec3();
        }
        if world_from_part.matrix3.determinant() < 0.0 {
            for t in &mut self.triangles {
                t.swap(1, 2);
            }
        }
    }

    /// Appends another part of the same file.
    ///
    /// # Errors
    /// If there is no memory for both.
    pub(super) fn append(&mut self, other: Part) -> Result<()> {
        let vertex = self.positions.len() as u32;
        let material = self.materials.len() as u32;
        let texture = self.textures.len() as u32;
        let total = self.positions.len() + other.positions.len();
        merge(
            &mut self.normals,
            other.normals,
            vertex as usize,
            total,
            Vec3::ZERO,
        )?;
        merge(
            &mut self.colors,
            other.colors,
            vertex as usize,
            total,
            [1.0; 3],
        )?;
        merge(&mut self.uvs, other.uvs, vertex as usize, total, Vec2::ZERO)?;
        memory::grow(MESH, &mut self.positions, other.positions.len())?;
        self.positions.extend(other.positions);
        memory::grow(MESH, &mut self.triangles, other.triangles.len())?;
        memory::grow(MESH, &mut self.material, other.triangles.len())?;
        let moved = other.triangles.iter().map(|t| t.map(|v| v + vertex));
        self.triangles.extend(moved);
        self.material
            .extend(other.material.iter().map(|m| m + material));
        self.materials
            .extend(other.materials.into_iter().map(|mut m| {
                m.texture = m.texture.map(|t| t + texture);
                m
            }));
        self.textures.extend(other.textures);
        Ok(())
    }
}

/// Appends an optional attribute; a side that lacks what the other has is filled.
///
/// # Errors
/// If there is no memory for both.
pub(super) fn merge<T: Clone>(
    into: &mut Vec<T>,
    from: Vec<T>,
    before: usize,
    total: usize,
    fill: T,
) -> Result<()> {
    if into.is_empty() && from.is_empty() {
        return Ok(());
    }
    memory::grow(MESH, into, total.saturating_sub(into.len()))?;
    into.resize(before, fill.clone());
    into.extend(from);
    into.resize(total, fill);
    Ok(())
}

/// Appends to a list of which the file does not say how long it is.
pub(super) fn push<T>(list: &mut Vec<T>, value: T) -> Result<()> {
    memory::grow(MESH, list, 1)?;
    list.push(value);
    Ok(())
}

fn check_material(material: &Material) -> Result<()> {
    let name = &material.name;
    if !material.albedo.iter().all(|x| (0.0..=1.0).contains(x)) {
        return Err(Error::input(format!(
            "material `{name}`: the albedo {:?} is not in [0,1]",
            material.albedo
        )));
    }
    if !(material.emission.iter()).all(|x| (0.0..=super::BRIGHTEST).contains(x)) {
        return Err(Error::input(format!(
            "material `{name}`: the emission {:?} is not in 0 to {:e}",
            material.emission,
            super::BRIGHTEST
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn triangle() -> Part {
        Part {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
            material: vec![0],
            materials: vec![Material::diffuse("grey", DEFAULT_ALBEDO)],
            ..Part::default()
        }
    }

    #[test]
    fn a_mirror_keeps_fronts_in_front() {
        let mut part = triangle();
        part.transform(&DAffine3::from_scale(DVec3::new(1.0, 1.0, -2.0)));
        let [a, b, c] = part.triangles[0].map(|i| part.positions[i as usize]);
        assert_eq!((b - a).cross(c - a).normalize(), DVec3::NEG_Z);
        assert_eq!(part.normals[0], Vec3::NEG_Z);
    }

    #[test]
    fn parts_with_different_attributes_join() {
        let mut part = triangle();
        let mut other = triangle();
        other.normals.clear();
        other.colors = vec![[0.25; 3]; 3];
        part.append(other).unwrap();
        assert_eq!(part.normals[2..4], [Vec3::Z, Vec3::ZERO]);
        assert_eq!(part.colors[2..4], [[1.0; 3], [0.25; 3]]);
        assert_eq!(part.triangles[1], [3, 4, 5]);
        assert_eq!(part.material, [0, 1]);
        assert!(part.uvs.is_empty());
        part.check().unwrap();
    }

    #[test]
    fn each_damage_has_its_message() {
        let message = |damage: fn(&mut Part)| {
            let mut part = triangle();
            damage(&mut part);
            part.check().unwrap_err().to_string()
        };
        assert!(message(|p| p.positions[1].x = f64::NAN).starts_with("vertex 1: the position"));
        let far = message(|p| p.positions[1].x = 1e300);
        assert!(far.contains("1e300") && far.len() < 120, "{far}");
        assert!(message(|p| p.positions[2].y = -1e16).contains("farther than 1e15"));
        assert!(
            message(|p| p.normals[0].z = f32::INFINITY)
                .contains("the normal is not finite in 32 bits")
        );
        assert!(message(|p| p.uvs = vec![Vec2::NAN; 3]).contains("texture coordinates"));
        assert!(message(|p| p.colors = vec![[1.5; 3]; 3]).contains("not in [0,1]"));
        assert!(message(|p| p.triangles[0][2] = 3).starts_with("triangle 0 refers to"));
        assert!(message(|p| p.materials[0].albedo[0] = 1.01).contains("`grey`: the albedo"));
        for wrong in [
            |p: &mut Part| p.materials[0].emission[0] = -1.0,
            |p: &mut Part| p.materials[0].emission[0] = 1e38,
        ] {
            let message = message(wrong);
            assert!(message.ends_with("is not in 0 to 1e30"), "{message}");
        }
    }
}
