//! Faces of a PLY file: triangles, and the materials that they call for.

use super::super::polygon::Cutter;
use super::{ColorEncoding, DEFAULT_ALBEDO, LeftOut, Material, Plan, Role, Row};
use crate::run::Cancel;
use crate::run::memory;
use crate::scene::builder::{MESH, MeshInput, push};
use crate::{Error, Result};
use glam::Vec2;
use std::collections::HashMap;

/// Colour and texture of a face, neither of which it needs to have.
#[derive(Clone, Copy)]
struct Look {
    color: Option<[f32; 3]>,
    texture: Option<u32>,
}

/// What faces of a file come to.
pub(super) struct Faces<'a> {
    palette: Option<&'a [[f32; 3]]>,
    cutter: Cutter,
    /// Whether the vertices come after the faces, which then are kept until they are there.
    before_vertices: bool,
    /// Corners of all faces that are kept.
    kept: Vec<u32>,
    /// Number of corners and material of each face that is kept.
    kept_faces: Vec<(usize, u32)>,
    /// Vertices of the face at hand.
    corners: Vec<u32>,
    /// Vertices that have got texture coordinates by the corner of a face.
    has_uv: Vec<bool>,
    /// Copies of vertices that have others in other faces.
    copies: HashMap<(u32, [u32; 2]), u32>,
    /// Material of each distinct look, in the order of first use.
    by_look: HashMap<([u32; 3], u32), u32>,
    looks: Vec<Look>,
    has_palette_colors: bool,
}

impl<'a> Faces<'a> {
    pub(super) fn new(
        before_vertices: bool,
        palette: Option<&'a [[f32; 3]]>,
        cancel: &Cancel,
    ) -> Self {
        Self {
            palette,
            cutter: Cutter::until(cancel),
            before_vertices,
            kept: Vec::new(),
            kept_faces: Vec::new(),
            corners: Vec::new(),
            has_uv: Vec::new(),
            copies: HashMap::new(),
            by_look: HashMap::new(),
            looks: Vec::new(),
            has_palette_colors: false,
        }
    }

    /// Adds a face to the mesh.
    pub(super) fn add(
        &mut self,
        row: &Row,
        plan: &Plan,
        mesh: &mut MeshInput,
        left_out: &mut LeftOut,
    ) -> Result<()> {
        let material = self.material(row, plan)?;
        if self.before_vertices {
            if plan.has(Role::CornerUvs) {
                let what = "texture coordinates of faces that come before vertices are left out";
                left_out.note(what, "`texcoord`");
            }
            memory::grow(MESH, &mut self.kept, row.polygon.len())?;
            self.kept.extend(&row.polygon);
            return push(&mut self.kept_faces, (row.polygon.len(), material));
        }
        self.corners.clear();
        memory::grow(MESH, &mut self.corners, row.polygon.len())?;
        self.corners.extend(&row.polygon);
        if plan.has(Role::CornerUvs) && row.corner_uvs.len() == 2 * row.polygon.len() {
            self.place_uvs(&row.corner_uvs, mesh)?;
        }
        if self.corners.len() < 3 {
            let what = "faces of less than 3 corners are left out";
            left_out.note(what, format_args!("one of {}", self.corners.len()));
        }
        cut(&mut self.cutter, &self.corners, material, mesh)
    }

    /// Gives the corners of the face at hand their texture coordinates; a vertex that has others
    /// already is copied.
    fn place_uvs(&mut self, uvs: &[f32], mesh: &mut MeshInput) -> Result<()> {
        let count = mesh.positions.len();
        if self.has_uv.is_empty() {
            // Those of corners replace any of vertices.
            mesh.uvs = memory::filled(MESH, Vec2::ZERO, count)?;
            self.has_uv = memory::filled(MESH, false, count)?;
        }
        for (corner, uv) in self.corners.iter_mut().zip(uvs.chunks_exact(2)) {
            let vertex = *corner as usize;
            let uv = Vec2::new(uv[0], 1.0 - uv[1]);
            // What a check finds later on.
            if vertex >= self.has_uv.len() {
                continue;
            }
            let uv = if uv.is_finite() { uv } else { Vec2::ZERO };
            if !self.has_uv[vertex] {
                self.has_uv[vertex] = true;
                mesh.uvs[vertex] = uv;
            }
            if mesh.uvs[vertex] == uv {
                continue;
            }
            let key = (*corner, uv.to_array().map(f32::to_bits));
            *corner = match self.copies.get(&key) {
                Some(&copy) => copy,
                None => {
                    let copy = mesh.positions.len() as u32;
                    let position = mesh.positions[vertex];
                    push(&mut mesh.positions, position)?;
                    push(&mut mesh.uvs, uv)?;
                    if let Some(&normal) = mesh.normals.get(vertex) {
                        push(&mut mesh.normals, normal)?;
                    }
                    if let Some(&color) = mesh.colors.get(vertex) {
                        push(&mut mesh.colors, color)?;
                    }
                    self.copies.insert(key, copy);
                    copy
                }
            };
        }
        Ok(())
    }

    /// The material of a face.
    fn material(&mut self, row: &Row, plan: &Plan) -> Result<u32> {
        let color = match self.palette {
            Some(palette) if plan.has(Role::Material) => {
                self.has_palette_colors = true;
                let entry = palette.get(row.material as usize);
                Some(*entry.filter(|_| row.material >= 0.0).ok_or_else(|| {
                    Error::input(format!(
                        "material_index {} is beyond the palette of {} colours",
                        row.material,
                        palette.len()
                    ))
                })?)
            }
            _ => plan.has(Role::Color(0)).then_some(row.color),
        };
        // Without a number the first texture is meant; -1 stands for none.
        let texture = match plan.has(Role::Texture) {
            true => (row.texture >= 0.0).then_some(row.texture as u32),
            false => Some(0),
        };
        let key = (
            color.map_or([u32::MAX; 3], |c| c.map(f32::to_bits)),
            texture.unwrap_or(u32::MAX),
        );
        Ok(*self.by_look.entry(key).or_insert_with(|| {
            self.looks.push(Look { color, texture });
            self.looks.len() as u32 - 1
        }))
    }

    /// Cuts the faces that had to wait for vertices, and notes what is odd of all.
    pub(super) fn finish(&mut self, mesh: &mut MeshInput, left_out: &mut LeftOut) -> Result<()> {
        let mut rest = &self.kept[..];
        for &(count, material) in &self.kept_faces {
            let (polygon, others) = rest.split_at(count);
            cut(&mut self.cutter, polygon, material, mesh)?;
            rest = others;
        }
        self.cutter.note_crossed(left_out);
        Ok(())
    }

    /// Makes the materials; `textures` holds the index in the mesh of each texture of the file that
    /// could be read.
    pub(super) fn make_materials(
        self,
        mesh: &mut MeshInput,
        encoding: ColorEncoding,
        textures: &[Option<u32>],
        left_out: &mut LeftOut,
    ) {
        let mut colors: Vec<[f32; 3]> = self.looks.iter().filter_map(|l| l.color).collect();
        if !self.has_palette_colors {
            encoding.decode(&mut colors, left_out);
        }
        let mut colors = colors.into_iter();
        let only_one = self.looks.len() == 1;
        let colored = !mesh.colors.is_empty();
        for (i, look) in self.looks.into_iter().enumerate() {
            let name = match only_one {
                true => "ply".into(),
                false => format!("ply {i}"),
            };
            let texture = look.texture.and_then(|t| *textures.get(t as usize)?);
            let default = match colored || texture.is_some() {
                true => [1.0; 3],
                false => DEFAULT_ALBEDO,
            };
            let color = look.color.and_then(|_| colors.next());
            let mut material = Material::diffuse(&name, color.unwrap_or(default));
            material.texture = texture;
            mesh.materials.push(material);
        }
    }
}

fn cut(cutter: &mut Cutter, polygon: &[u32], material: u32, mesh: &mut MeshInput) -> Result<()> {
    let position = |v: u32| mesh.positions.get(v as usize).copied();
    for triangle in cutter.cut(polygon, position)? {
        push(&mut mesh.triangles, triangle)?;
        push(&mut mesh.material, material)?;
    }
    Ok(())
}
