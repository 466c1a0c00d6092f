//! PLY, ASCII and binary.
//!
//! | element | property | meaning |
//! | --- | --- | --- |
//! | `vertex` | `x y z` | position |
//! | | `nx ny nz` | normal |
//! | | `red green blue` (or `r g b`) | factor on the albedo |
//! | | `u v`, `s t`, `texture_u texture_v` | texture coordinates, v upwards |
//! | `face` | `vertex_indices` (or `vertex_index`) | polygon, cut into triangles |
//! | | `red green blue` | albedo of the face |
//! | | `material_index` | entry of the `palette` that the scene file gives; ignored if it gives none |
//!
//! Colours in integers are sRGB encoded (255, or 65535 for 16 bits, is 1); colours in floats are
//! linear. Other elements and properties are skipped. Where a file colours anything, the albedo is
//! 1 times that colour.

use super::polygon::Cutter;
use super::texture::linear_from_srgb;
use crate::run::{Cancel, memory};
use crate::scene::Material;
use crate::scene::builder::{DEFAULT_ALBEDO, MESH, MeshInput, push};
use crate::{Error, Result};
use glam::{DVec3, Vec2};
use ply_rs_bw::parser::{Parser, Reader};
use ply_rs_bw::ply::{DefaultElement, ElementDef, Encoding, PropertyType, ScalarType};
use std::collections::HashMap;

/// Reads a PLY file. `palette` holds the albedo of each `material_index`, if the scene file gives
/// one.
pub(super) fn read(
    content: &[u8],
    palette: Option<&[[f32; 3]]>,
    cancel: &Cancel,
) -> Result<MeshInput> {
    let mut reader = Reader::new(content);
    let header = Parser::<DefaultElement>::new()
        .read_header(&mut reader)
        .map_err(|e| Error::input(format!("not a PLY header: {e}")))?;
    let mut payload = Payload {
        rest: reader.into_inner(),
        encoding: header.encoding,
    };
    let mut mesh = MeshInput::default();
    let mut names = header.elements.keys();
    let first = names.find(|n| ["vertex", "face"].contains(&n.as_str()));
    let mut faces = Faces::new(first.is_some_and(|n| n == "face"));
    for (name, element) in &header.elements {
        let mut plan = Vec::new();
        for (property, definition) in &element.properties {
            let role = match name.as_str() {
                "vertex" => vertex_role(property),
                "face" => face_role(property, palette.is_some()),
                _ => Role::Skip,
            };
            plan.push((role, definition.data_type.clone()));
        }
        payload.check_count(element)?;
        match name.as_str() {
            "vertex" => mesh.positions = memory::room(MESH, element.count)?,
            "face" => {
                mesh.triangles = memory::room(MESH, element.count)?;
                mesh.material = memory::room(MESH, element.count)?;
            }
            _ => {}
        }
        for i in 0..element.count {
            cancel.check()?;
            let row = payload.row(&plan, &mut faces.polygon);
            let row = row.map_err(|e| e.at(format!("{name} {i} of {}", element.count)))?;
            match name.as_str() {
                "vertex" => row.into_vertex(&mut mesh, &plan)?,
                "face" => {
                    let added = faces.add(&row, &plan, palette, &mut mesh);
                    added.map_err(|e| e.at(format!("face {i}")))?;
                }
                _ => {}
            }
        }
    }
    if !header.elements.contains_key("vertex") || !header.elements.contains_key("face") {
        return Err(Error::input(
            "expected the elements `vertex` and `face`, found a file without one of them",
        ));
    }
    faces.cut_kept(&mut mesh)?;
    let colored = !mesh.colors.is_empty();
    faces.name_materials(&mut mesh, colored);
    Ok(mesh)
}

/// What a property of an element means.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Position(usize),
    Normal(usize),
    Color(usize),
    Uv(usize),
    Polygon,
    Material,
    Skip,
}

fn vertex_role(property: &str) -> Role {
    match property {
        "x" => Role::Position(0),
        "y" => Role::Position(1),
        "z" => Role::Position(2),
        "nx" => Role::Normal(0),
        "ny" => Role::Normal(1),
        "nz" => Role::Normal(2),
        "u" | "s" | "texture_u" => Role::Uv(0),
        "v" | "t" | "texture_v" => Role::Uv(1),
        _ => color_role(property),
    }
}

fn face_role(property: &str, has_palette: bool) -> Role {
    match property {
        "vertex_indices" | "vertex_index" => Role::Polygon,
        "material_index" if has_palette => Role::Material,
        _ => color_role(property),
    }
}

fn color_role(property: &str) -> Role {
    match property {
        "red" | "r" | "diffuse_red" => Role::Color(0),
        "green" | "g" | "diffuse_green" => Role::Color(1),
        "blue" | "b" | "diffuse_blue" => Role::Color(2),
        _ => Role::Skip,
    }
}

/// The values of one vertex or face; its polygon is kept apart.
#[derive(Default)]
struct Row {
    position: [f64; 3],
    normal: [f64; 3],
    color: [f32; 3],
    uv: [f64; 2],
    material: f64,
}

impl Row {
    fn set(&mut self, role: Role, value: f64, scalar: &ScalarType) {
        match role {
            Role::Position(i) => self.position[i] = value,
            Role::Normal(i) => self.normal[i] = value,
            Role::Uv(i) => self.uv[i] = value,
            Role::Color(i) => self.color[i] = linear_color(value, scalar),
            Role::Material => self.material = value,
            Role::Polygon | Role::Skip => {}
        }
    }

    fn into_vertex(self, mesh: &mut MeshInput, plan: &[(Role, PropertyType)]) -> Result<()> {
        let has = |role: Role| plan.iter().any(|(r, _)| *r == role);
        push(&mut mesh.positions, DVec3::from(self.position))?;
        if has(Role::Normal(0)) {
            push(&mut mesh.normals, DVec3::from(self.normal).as_vec3())?;
        }
        if has(Role::Color(0)) {
            push(&mut mesh.colors, self.color)?;
        }
        if has(Role::Uv(0)) {
            let [u, v] = self.uv.map(|x| x as f32);
            push(&mut mesh.uvs, Vec2::new(u, 1.0 - v))?;
        }
        Ok(())
    }
}

fn linear_color(value: f64, scalar: &ScalarType) -> f32 {
    match scalar {
        ScalarType::Float | ScalarType::Double => value as f32,
        ScalarType::UShort => linear_from_srgb(value as f32 / 65535.0),
        _ => linear_from_srgb(value as f32 / 255.0),
    }
}

/// Triangles and the materials that their faces call for.
struct Faces {
    polygon: Vec<u32>,
    cutter: Cutter,
    /// Whether the vertices come after the faces, which then are kept until they are there.
    before_vertices: bool,
    /// Corners of all faces that are kept.
    kept: Vec<u32>,
    /// Number of corners and material of each face that is kept.
    kept_faces: Vec<(usize, u32)>,
    /// Material of each distinct colour or palette entry, in the order of first use.
    by_color: HashMap<[u32; 3], u32>,
    colors: Vec<Option<[f32; 3]>>,
}

impl Faces {
    fn new(before_vertices: bool) -> Self {
        Self {
            polygon: Vec::new(),
            cutter: Cutter::default(),
            before_vertices,
            kept: Vec::new(),
            kept_faces: Vec::new(),
            by_color: HashMap::new(),
            colors: Vec::new(),
        }
    }

    fn add(
        &mut self,
        row: &Row,
        plan: &[(Role, PropertyType)],
        palette: Option<&[[f32; 3]]>,
        mesh: &mut MeshInput,
    ) -> Result<()> {
        let has = |role: Role| plan.iter().any(|(r, _)| *r == role);
        let color = match palette {
            Some(palette) if has(Role::Material) => {
                let entry = palette.get(row.material as usize);
                Some(*entry.filter(|_| row.material >= 0.0).ok_or_else(|| {
                    Error::input(format!(
                        "material_index {} is beyond the palette of {} colours",
                        row.material,
                        palette.len()
                    ))
                })?)
            }
            _ => has(Role::Color(0)).then_some(row.color),
        };
        let key = color.map_or([u32::MAX; 3], |c| c.map(f32::to_bits));
        let material = *self.by_color.entry(key).or_insert_with(|| {
            self.colors.push(color);
            self.colors.len() as u32 - 1
        });
        if self.before_vertices {
            memory::grow(MESH, &mut self.kept, self.polygon.len())?;
            self.kept.extend(&self.polygon);
            return push(&mut self.kept_faces, (self.polygon.len(), material));
        }
        cut(&mut self.cutter, &self.polygon, material, mesh)
    }

    /// Cuts the faces that had to wait for vertices.
    fn cut_kept(&mut self, mesh: &mut MeshInput) -> Result<()> {
        let mut rest = &self.kept[..];
        for &(count, material) in &self.kept_faces {
            let (polygon, others) = rest.split_at(count);
            cut(&mut self.cutter, polygon, material, mesh)?;
            rest = others;
        }
        Ok(())
    }

    fn name_materials(self, mesh: &mut MeshInput, vertices_colored: bool) {
        let default = match vertices_colored {
            true => [1.0; 3],
            false => DEFAULT_ALBEDO,
        };
        let only_one = self.colors.len() == 1;
        let named = self.colors.into_iter().enumerate().map(|(i, color)| {
            let name = if only_one {
                "ply".into()
            } else {
                format!("ply {i}")
            };
            Material::diffuse(&name, color.unwrap_or(default))
        });
        mesh.materials = named.collect();
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

/// What is left of the file after the header.
struct Payload<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Payload<'_> {
    /// Refuses a count that the rest of the file cannot hold, before anything is read or allocated.
    fn check_count(&self, element: &ElementDef) -> Result<()> {
        let ascii = self.encoding == Encoding::Ascii;
        let least: usize = element
            .properties
            .values()
            .map(|p| match &p.data_type {
                _ if ascii => 1,
                PropertyType::Scalar(s) | PropertyType::List(s, _) => size(s),
            })
            .sum();
        let most = match least {
            0 => 0,
            _ => self.rest.len().div_ceil(least),
        };
        if element.count > most {
            return Err(Error::input(format!(
                "the header promises {} elements `{}`, the rest of the file has room for {most} at most",
                element.count, element.name
            )));
        }
        Ok(())
    }

    fn row(&mut self, plan: &[(Role, PropertyType)], polygon: &mut Vec<u32>) -> Result<Row> {
        let mut row = Row::default();
        for (role, data_type) in plan {
            match data_type {
                PropertyType::Scalar(scalar) => {
                    let value = self.scalar(scalar)?;
                    row.set(*role, value, scalar);
                }
                PropertyType::List(count, scalar) => {
                    let count = self.scalar(count)?;
                    if *role == Role::Polygon {
                        polygon.clear();
                    }
                    if !(count >= 0.0 && count.fract() == 0.0) {
                        return Err(Error::input(format!("{count} is not a length of a list")));
                    }
                    for _ in 0..count as u64 {
                        let value = self.scalar(scalar)?;
                        if *role == Role::Polygon {
                            push(polygon, vertex_index(value)?)?;
                        }
                    }
                }
            }
        }
        Ok(row)
    }

    fn scalar(&mut self, scalar: &ScalarType) -> Result<f64> {
        if self.encoding == Encoding::Ascii {
            return self.word();
        }
        let little = self.encoding == Encoding::BinaryLittleEndian;
        Ok(match scalar {
            ScalarType::Char => i8::from_le_bytes(self.bytes()?).into(),
            ScalarType::UChar => u8::from_le_bytes(self.bytes()?).into(),
            ScalarType::Short => i16::from_le_bytes(self.ordered(little)?).into(),
            ScalarType::UShort => u16::from_le_bytes(self.ordered(little)?).into(),
            ScalarType::Int => i32::from_le_bytes(self.ordered(little)?).into(),
            ScalarType::UInt => u32::from_le_bytes(self.ordered(little)?).into(),
            ScalarType::Float => f32::from_le_bytes(self.ordered(little)?).into(),
            ScalarType::Double => f64::from_le_bytes(self.ordered(little)?),
        })
    }

    fn ordered<const N: usize>(&mut self, little: bool) -> Result<[u8; N]> {
        let mut bytes = self.bytes()?;
        if !little {
            bytes.reverse();
        }
        Ok(bytes)
    }

    fn bytes<const N: usize>(&mut self) -> Result<[u8; N]> {
        let (bytes, rest) = self.rest.split_first_chunk().ok_or_else(end_of_file)?;
        self.rest = rest;
        Ok(*bytes)
    }

    fn word(&mut self) -> Result<f64> {
        let start = self.rest.trim_ascii_start();
        let space = start.iter().position(u8::is_ascii_whitespace);
        let (word, rest) = start.split_at(space.unwrap_or(start.len()));
        self.rest = rest;
        if word.is_empty() {
            return Err(end_of_file());
        }
        let text = std::str::from_utf8(word).ok();
        text.and_then(|t| t.parse().ok()).ok_or_else(|| {
            let found = String::from_utf8_lossy(&word[..word.len().min(40)]);
            Error::input(format!("expected a number, found \"{found}\""))
        })
    }
}

fn vertex_index(value: f64) -> Result<u32> {
    // -1 becomes 4294967295 in some writers; both are beyond any mesh.
    if value >= 0.0 && value < f64::from(u32::MAX) && value.fract() == 0.0 {
        Ok(value as u32)
    } else {
        Err(Error::input(format!("{value} is not a vertex index")))
    }
}

fn end_of_file() -> Error {
    Error::input("the file ends too early; it is truncated or its header is wrong")
}

fn size(scalar: &ScalarType) -> usize {
    match scalar {
        ScalarType::Char | ScalarType::UChar => 1,
        ScalarType::Short | ScalarType::UShort => 2,
        ScalarType::Int | ScalarType::UInt | ScalarType::Float => 4,
        ScalarType::Double => 8,
    }
}
