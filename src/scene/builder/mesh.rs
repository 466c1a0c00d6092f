//! Meshes as they are handed to a builder: f64 positions, materials and textures of their own,
//! nothing dropped yet.

use super::copies::Copies;
use super::{MAX_COORDINATE, MAX_EMISSION, is_singular};
use crate::run::memory;
use crate::scene::{Material, Texture};
use crate::{Error, Result};
use glam::{DAffine3, DVec3, Vec2, Vec3};

/// Albedo of a mesh that does not state any.
pub(in crate::scene) const DEFAULT_ALBEDO: [f32; 3] = [0.5; 3];

/// What needs the memory of its lists, as an error says it.
pub(in crate::scene) const MESH: &str = "the mesh";

/// An indexed triangle mesh with materials, in a space of its own until it is placed in the world
/// by [`MeshInput::transform`].
#[derive(Debug, Default)]
pub struct MeshInput {
    pub(in crate::scene) positions: Vec<DVec3>,
    /// Shading normals per vertex, of any length; none, or one for each position. So are the next
    /// three.
    pub(in crate::scene) normals: Vec<Vec3>,
    /// Linear RGB factors on the albedo.
    pub(in crate::scene) colors: Vec<[f32; 3]>,
    /// Texture coordinates, (0,0) top left.
    pub(in crate::scene) uvs: Vec<Vec2>,
    /// Factors on the opacity of masks.
    pub(in crate::scene) opacities: Vec<f32>,
    pub(in crate::scene) triangles: Vec<[u32; 3]>,
    /// Index into `materials`, per triangle.
    pub(in crate::scene) material: Vec<u32>,
    pub(in crate::scene) materials: Vec<Material>,
    /// Textures that `materials` refer to.
    pub(in crate::scene) textures: Vec<Texture>,
    /// Parts that stand at several places, kept once.
    pub(in crate::scene) copies: Vec<Copies>,
}

impl MeshInput {
    /// A mesh of one material with an albedo of one half. `triangles` index `positions`, their
    /// corners counter-clockwise seen from the front; the name is for messages.
    #[must_use]
    pub fn new(
        name: &str,
        positions: impl IntoIterator<Item = impl Into<DVec3>>,
        triangles: Vec<[u32; 3]>,
    ) -> Self {
        Self {
            positions: positions.into_iter().map(Into::into).collect(),
            material: vec![0; triangles.len()],
            materials: vec![Material::diffuse(name, DEFAULT_ALBEDO)],
            triangles,
            ..Self::default()
        }
    }

    /// Whether any of its materials sends light.
    pub(in crate::scene) fn emits(&self) -> bool {
        self.materials.iter().any(Material::emits)
    }

    /// Gives all its materials this albedo, each channel in `[0,1]`.
    #[must_use]
    pub fn albedo(mut self, albedo: [f32; 3]) -> Self {
        self.materials.iter_mut().for_each(|m| m.albedo = albedo);
        self
    }

    /// Lets all its materials emit this radiance, at their front.
    #[must_use]
    pub fn emission(mut self, radiance: [f32; 3]) -> Self {
        self.materials
            .iter_mut()
            .for_each(|m| m.emission = radiance);
        self
    }

    /// Lets all its materials emit at their back, too.
    #[must_use]
    pub fn emitting_both_sides(mut self) -> Self {
        self.materials
            .iter_mut()
            .for_each(|m| m.emits_both_sides = true);
        self
    }

    /// Lets rays of cameras pass it; all other rays meet it.
    #[must_use]
    pub fn unseen(mut self) -> Self {
        self.materials.iter_mut().for_each(|m| m.is_seen = false);
        self
    }

    /// Gives it materials of its own in place of the one: `of_triangle` holds an index into
    /// `materials` for each triangle, and `materials` index `textures`.
    #[must_use]
    pub fn materials(
        mut self,
        materials: Vec<Material>,
        of_triangle: Vec<u32>,
        textures: Vec<Texture>,
    ) -> Self {
        self.materials = materials;
        self.material = of_triangle;
        self.textures = textures;
        self
    }

    /// Sets shading normals, one for each position, of any length; a zero vector means that of the
    /// face.
    #[must_use]
    pub fn normals(mut self, normals: Vec<Vec3>) -> Self {
        self.normals = normals;
        self
    }

    /// Sets factors on the albedo, one for each position, linear Rec.709 in `[0,1]`.
    #[must_use]
    pub fn colors(mut self, colors: Vec<[f32; 3]>) -> Self {
        self.colors = colors;
        self
    }

    /// Sets texture coordinates, one for each position; (0,0) is the top left of a texture.
    #[must_use]
    pub fn uvs(mut self, uvs: Vec<Vec2>) -> Self {
        self.uvs = uvs;
        self
    }

    /// Sets factors on the opacity of masks, one for each position, in `[0,1]`.
    #[must_use]
    pub fn opacities(mut self, opacities: Vec<f32>) -> Self {
        self.opacities = opacities;
        self
    }

    /// Places the mesh by an invertible map to the world, after the maps before it.
    #[must_use]
    pub fn transform(mut self, world_from_mesh: &DAffine3) -> Self {
        self.place(world_from_mesh);
        self
    }

    /// Refuses values that are not finite or out of their range, and triangles of vertices that
    /// are not there.
    pub(in crate::scene) fn check(&self) -> Result<()> {
        if let Some(i) = self.positions.iter().position(|p| !p.is_finite()) {
            let p = self.positions[i];
            return Err(Error::input(format!(
                "vertex {i}: the position is not finite: {p}"
            )));
        }
        let far = |p: &DVec3| p.abs().max_element() > MAX_COORDINATE;
        if let Some(i) = self.positions.iter().position(far) {
            let p = self.positions[i];
            return Err(Error::input(format!(
                "vertex {i}: the position {:?} is farther than {MAX_COORDINATE:e} from the origin",
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
        let outside = |o: &f32| !(0.0..=1.0).contains(o);
        if let Some(i) = self.opacities.iter().position(outside) {
            return Err(Error::input(format!(
                "vertex {i}: the opacity {} is not in [0,1]",
                self.opacities[i]
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
        (self.copies.iter()).try_for_each(|copies| {
            copies.mesh.check()?;
            self.check_copies(copies)
        })?;
        self.materials.iter().try_for_each(check_material)
    }

    /// Refuses places to which a part is taken out of range.
    fn check_copies(&self, copies: &Copies) -> Result<()> {
        if let Some(i) = copies.world_from_mesh.iter().position(is_singular) {
            return Err(Error::input(format!(
                "the map of instance {i} is singular or not finite: it flattens space"
            )));
        }
        let largest = copies.farthest();
        if copies.triangles() == 0 || largest <= MAX_COORDINATE {
            return Ok(());
        }
        Err(Error::input(format!(
            "an instance reaches {largest:e} from the origin, farther than {MAX_COORDINATE:e}"
        )))
    }

    /// Refuses lists that do not fit each other; readers of files make none.
    pub(super) fn check_lists(&self) -> Result<()> {
        self.check_lists_of(self.materials.len())?;
        (self.copies.iter()).try_for_each(|c| c.mesh.check_lists_of(self.materials.len()))?;
        for material in &self.materials {
            for index in material.textures() {
                let texture = self.textures.get(index as usize).ok_or_else(|| {
                    Error::input(format!(
                        "material `{}` refers to texture {index}, but there are {}",
                        material.name,
                        self.textures.len()
                    ))
                })?;
                texture.check()?;
            }
        }
        Ok(())
    }

    /// Refuses lists of vertices and triangles that do not fit each other and so many materials.
    fn check_lists_of(&self, materials: usize) -> Result<()> {
        let attributes = [
            ("normals", self.normals.len()),
            ("colours", self.colors.len()),
            ("texture coordinates", self.uvs.len()),
            ("opacities", self.opacities.len()),
        ];
        let count = self.positions.len();
        if let Some((what, n)) = attributes.iter().find(|(_, n)| ![0, count].contains(n)) {
            return Err(Error::input(format!(
                "expected {count} {what}, one for each position, found {n}"
            )));
        }
        if self.material.len() != self.triangles.len() {
            return Err(Error::input(format!(
                "expected a material for each of {} triangles, found {}",
                self.triangles.len(),
                self.material.len()
            )));
        }
        if let Some(&m) = self.material.iter().find(|m| **m as usize >= materials) {
            return Err(Error::input(format!(
                "a triangle refers to material {m}, but there are {materials}"
            )));
        }
        Ok(())
    }

    /// Moves the mesh. A map that mirrors also turns the triangles round, so that fronts stay
    /// fronts.
    pub(in crate::scene) fn place(&mut self, world_from_mesh: &DAffine3) {
        if *world_from_mesh == DAffine3::IDENTITY {
            return;
        }
        for place in self.copies.iter_mut().flat_map(|c| &mut c.world_from_mesh) {
            *place = *world_from_mesh * *place;
        }
        for p in &mut self.positions {
            *p = world_from_mesh.transform_point3(*p);
        }
        let normals_from = world_from_mesh.matrix3.inverse().transpose();
        for n in &mut self.normals {
            // Unit length first: a scale of 1e-30 must not take the normal out of the range of f32.
            *n = (normals_from * n.as_dvec3()).normalize_or_zero().as_vec3();
        }
        if world_from_mesh.matrix3.determinant() < 0.0 {
            for t in &mut self.triangles {
                t.swap(1, 2);
            }
        }
    }

    /// Appends another mesh of the same file.
    ///
    /// # Errors
    /// If there is no memory for both.
    pub(in crate::scene) fn append(&mut self, other: MeshInput) -> Result<()> {
        let vertex = self.positions.len() as u32;
        let material = self.materials.len() as u32;
        let texture = self.textures.len() as u32;
        let total = self.positions.len() + other.positions.len();
        extend_attribute(
            &mut self.normals,
            other.normals,
            vertex as usize,
            total,
            Vec3::ZERO,
        )?;
        extend_attribute(
            &mut self.colors,
            other.colors,
            vertex as usize,
            total,
            [1.0; 3],
        )?;
        extend_attribute(&mut self.uvs, other.uvs, vertex as usize, total, Vec2::ZERO)?;
        extend_attribute(
            &mut self.opacities,
            other.opacities,
            vertex as usize,
            total,
            1.0,
        )?;
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
                m.move_textures(texture);
                m
            }));
        self.textures.extend(other.textures);
        self.copies.extend(other.copies.into_iter().map(|mut c| {
            c.mesh.material.iter_mut().for_each(|m| *m += material);
            c
        }));
        Ok(())
    }
}

/// Appends an optional attribute; a side that lacks what the other has is filled.
///
/// # Errors
/// If there is no memory for both.
pub(in crate::scene) fn extend_attribute<T: Clone>(
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
pub(in crate::scene) fn push<T>(list: &mut Vec<T>, value: T) -> Result<()> {
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
    if !(material.emission.iter()).all(|x| (0.0..=MAX_EMISSION).contains(x)) {
        return Err(Error::input(format!(
            "material `{name}`: the emission {:?} is not in 0 to {:e}",
            material.emission, MAX_EMISSION
        )));
    }
    if let Some(mask) = &material.mask {
        let cutoff = mask.cutoff.unwrap_or(0.0);
        if ![mask.opacity, cutoff]
            .iter()
            .all(|x| (0.0..=1.0).contains(x))
        {
            return Err(Error::input(format!(
                "material `{name}`: the opacity {} or the cut-off {cutoff} is not in [0,1]",
                mask.opacity
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    pub(in crate::scene) fn triangle() -> MeshInput {
        MeshInput {
            positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y],
            normals: vec![Vec3::Z; 3],
            triangles: vec![[0, 1, 2]],
            material: vec![0],
            materials: vec![Material::diffuse("grey", DEFAULT_ALBEDO)],
            ..MeshInput::default()
        }
    }

    #[test]
    fn a_mirror_keeps_fronts_in_front() {
        let mut part = triangle();
        part.place(&DAffine3::from_scale(DVec3::new(1.0, 1.0, -2.0)));
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
        let message = |damage: fn(&mut MeshInput)| {
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
        assert!(message(|p| p.opacities = vec![-0.5; 3]).contains("the opacity -0.5 is not"));
        let masked = |p: &mut MeshInput| {
            p.materials[0].mask = Some(Mask {
                opacity: 1.0,
                texture: None,
                cutoff: Some(1.5),
            });
        };
        assert!(message(masked).contains("the cut-off 1.5 is not in [0,1]"));
        assert!(message(|p| p.triangles[0][2] = 3).starts_with("triangle 0 refers to"));
        assert!(message(|p| p.materials[0].albedo[0] = 1.01).contains("`grey`: the albedo"));
        for wrong in [
            |p: &mut MeshInput| p.materials[0].emission[0] = -1.0,
            |p: &mut MeshInput| p.materials[0].emission[0] = 1e38,
        ] {
            let message = message(wrong);
            assert!(message.ends_with("is not in 0 to 1e30"), "{message}");
        }
    }
}
