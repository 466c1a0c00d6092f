//! PLY, ASCII and binary.
//!
//! | element | property | meaning |
//! | --- | --- | --- |
//! | `vertex` | `x y z` | position |
//! | | `nx ny nz` | normal |
//! | | `red green blue` (or `r g b`) | factor on the albedo |
//! | | `u v`, `s t`, `texture_u texture_v` | texture coordinates, v upwards |
//! | `face` | `vertex_indices` (or `vertex_index`) | polygon, cut into triangles |
//! | | `texcoord` | texture coordinates of its corners, v upwards |
//! | | `texnumber` | which of the textures of the file |
//! | | `red green blue` | albedo of the face |
//! | | `material_index` | entry of the `palette` that the scene file gives; ignored if it gives none |
//!
//! Textures are those of comments `TextureFile name`, beside the file. Other elements and
//! properties are skipped. Where a file colours anything, the albedo is 1 times that colour.
//!
//! - `header`: what elements there are; here: their content
//! - `faces`: triangles, and the materials that faces call for

mod faces;
pub(crate) mod header;

use super::colors::ColorEncoding;
use super::files::{Files, text_start};
use super::left_out::LeftOut;
use super::numbers::number;
use super::texture::{self, Decoding};
use crate::run::memory;
use crate::scene::Material;
use crate::scene::builder::{DEFAULT_ALBEDO, MESH, MeshInput, push};
use crate::{Error, Result};
use faces::Faces;
use glam::{DVec3, Vec2, Vec3};
use header::{Element, Encoding, Header, Scalar};
use std::path::Path;

/// What the scene file says of the colours of a PLY file.
pub(super) struct Coloring<'a> {
    /// Albedo of each `material_index`, linear.
    pub(super) palette: Option<&'a [[f32; 3]]>,
    /// How colours in the file are encoded.
    pub(super) encoding: ColorEncoding,
}

/// Reads a PLY file and the textures that it names.
pub(super) fn read(
    content: &[u8],
    path: &Path,
    coloring: &Coloring<'_>,
    files: &mut Files,
) -> Result<MeshInput> {
    let content = text_start(content)?;
    let header = Header::parse(content)?;
    let has = |name: &str| header.elements.iter().any(|e| e.name == name);
    if !has("vertex") || !has("face") {
        return Err(Error::input(
            "expected the elements `vertex` and `face`, found a file without one of them",
        ));
    }
    let mut payload = Payload {
        rest: &content[header.length..],
        encoding: header.encoding,
    };
    let mut mesh = MeshInput::default();
    let first = header
        .elements
        .iter()
        .find(|e| ["vertex", "face"].contains(&e.name.as_str()));
    let mut faces = Faces::new(
        first.is_some_and(|e| e.name == "face"),
        coloring.palette,
        &files.cancel,
    );
    let mut left_out = LeftOut::default();
    for element in &header.elements {
        let plan = Plan::of(element, coloring.palette.is_some());
        payload.check_count(element)?;
        match element.name.as_str() {
            "vertex" => mesh.positions = memory::room(MESH, element.count)?,
            "face" => {
                mesh.triangles = memory::room(MESH, element.count)?;
                mesh.material = memory::room(MESH, element.count)?;
            }
            _ => {}
        }
        let mut row = Row::default();
        for i in 0..element.count {
            files.cancel.check()?;
            let read = payload.row(&plan, &mut row);
            read.map_err(|e| e.at(format!("{} {i} of {}", element.name, element.count)))?;
            match element.name.as_str() {
                "vertex" => row.add_vertex(i, &plan, &mut mesh, &mut left_out)?,
                "face" => {
                    let added = faces.add(&row, &plan, &mut mesh, &mut left_out);
                    added.map_err(|e| e.at(format!("face {i}")))?;
                }
                _ => {}
            }
        }
    }
    faces.finish(&mut mesh, &mut left_out)?;
    coloring.encoding.decode(&mut mesh.colors, &mut left_out);
    let textures = textures(&header, path, &mut mesh, &mut left_out, files)?;
    faces.make_materials(&mut mesh, coloring.encoding, &textures, &mut left_out);
    left_out.tell(path, 0, files);
    Ok(mesh)
}

/// Reads the textures that the file names, if it has coordinates for them; the index in the mesh of
/// each.
fn textures(
    header: &Header,
    path: &Path,
    mesh: &mut MeshInput,
    left_out: &mut LeftOut,
    files: &mut Files,
) -> Result<Vec<Option<u32>>> {
    let mut indices = Vec::new();
    for name in &header.textures {
        if mesh.uvs.is_empty() {
            let what = "textures without texture coordinates are left out";
            left_out.note(what, format_args!("`{name}`"));
            continue;
        }
        let image = texture::load(path, name, Decoding::default(), left_out, files)?;
        indices.push(image.map(|image| {
            mesh.textures.push(image);
            mesh.textures.len() as u32 - 1
        }));
    }
    if !mesh.textures.is_empty() && !mesh.colors.is_empty() {
        left_out.note(
            "colours of vertices give way to textures",
            format_args!("`{}`", header.textures[0]),
        );
        mesh.colors.clear();
    }
    Ok(indices)
}

/// What a property of an element means.
#[derive(Clone, Copy, PartialEq)]
enum Role {
    Position(usize),
    Normal(usize),
    Color(usize),
    Uv(usize),
    Polygon,
    CornerUvs,
    Texture,
    Material,
    Skip,
}

/// What to do with each property of an element.
struct Plan {
    /// Role, type of the length for a list, and type of the numbers.
    properties: Vec<(Role, Option<Scalar>, Scalar)>,
}

impl Plan {
    fn of(element: &Element, has_palette: bool) -> Self {
        let properties = element.properties.iter().map(|p| {
            let role = match element.name.as_str() {
                "vertex" => vertex_role(&p.name),
                "face" => face_role(&p.name, has_palette),
                _ => Role::Skip,
            };
            // A list where a number is meant, or the other way round, says nothing.
            let is_list = matches!(role, Role::Polygon | Role::CornerUvs);
            let role = if is_list == p.length.is_some() {
                role
            } else {
                Role::Skip
            };
            (role, p.length, p.scalar)
        });
        Self {
            properties: properties.collect(),
        }
    }

    fn has(&self, role: Role) -> bool {
        self.properties.iter().any(|(r, ..)| *r == role)
    }
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
        "texcoord" => Role::CornerUvs,
        "texnumber" => Role::Texture,
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

/// The values of one vertex or face.
#[derive(Default)]
struct Row {
    position: [f64; 3],
    normal: [f64; 3],
    /// Encoded; integers as parts of the largest of their type.
    color: [f32; 3],
    uv: [f64; 2],
    material: f64,
    texture: f64,
    polygon: Vec<u32>,
    corner_uvs: Vec<f32>,
}

impl Row {
    fn set(&mut self, role: Role, value: f64, scalar: Scalar) {
        match role {
            Role::Position(i) => self.position[i] = value,
            Role::Normal(i) => self.normal[i] = value,
            Role::Uv(i) => self.uv[i] = value,
            Role::Color(i) => {
                self.color[i] = match scalar {
                    Scalar::F32 | Scalar::F64 => value as f32,
                    Scalar::U16 => value as f32 / 65535.0,
                    _ => value as f32 / 255.0,
                };
            }
            Role::Material => self.material = value,
            Role::Texture => self.texture = value,
            Role::Polygon | Role::CornerUvs | Role::Skip => {}
        }
    }

    fn add_vertex(
        &self,
        index: usize,
        plan: &Plan,
        mesh: &mut MeshInput,
        left_out: &mut LeftOut,
    ) -> Result<()> {
        push(&mut mesh.positions, DVec3::from(self.position))?;
        if plan.has(Role::Normal(0)) {
            let mut normal = DVec3::from(self.normal).as_vec3();
            if !normal.is_finite() {
                let what = "normals that are no numbers give way to those of faces";
                left_out.note(what, format_args!("vertex {index}"));
                normal = Vec3::ZERO;
            }
            push(&mut mesh.normals, normal)?;
        }
        if plan.has(Role::Color(0)) {
            push(&mut mesh.colors, self.color)?;
        }
        if plan.has(Role::Uv(0)) {
            let [u, v] = self.uv.map(|x| x as f32);
            let mut uv = Vec2::new(u, 1.0 - v);
            if !uv.is_finite() {
                let what = "texture coordinates that are no numbers are taken as 0";
                left_out.note(what, format_args!("vertex {index}"));
                uv = Vec2::ZERO;
            }
            push(&mut mesh.uvs, uv)?;
        }
        Ok(())
    }
}

/// What is left of the file after the header.
struct Payload<'a> {
    rest: &'a [u8],
    encoding: Encoding,
}

impl Payload<'_> {
    /// Refuses a count that the rest of the file cannot hold, before anything is read or allocated.
    fn check_count(&self, element: &Element) -> Result<()> {
        let ascii = self.encoding == Encoding::Ascii;
        let size = |p: &header::Property| match ascii {
            true => 1,
            false => p.length.unwrap_or(p.scalar).size(),
        };
        let least: usize = element.properties.iter().map(size).sum();
        let most = match least {
            0 => 0,
            _ => self.rest.len().div_ceil(least),
        };
        if element.count > most {
            return Err(Error::input(format!(
                "the header promises {} elements `{}`, \
                 the rest of the file has room for {most} at most",
                element.count, element.name
            )));
        }
        Ok(())
    }

    fn row(&mut self, plan: &Plan, row: &mut Row) -> Result<()> {
        row.polygon.clear();
        row.corner_uvs.clear();
        for &(role, length, scalar) in &plan.properties {
            let Some(length) = length else {
                let value = self.scalar(scalar)?;
                row.set(role, value, scalar);
                continue;
            };
            let count = self.scalar(length)?;
            if !(count >= 0.0 && count.fract() == 0.0) {
                return Err(Error::input(format!("{count} is not a length of a list")));
            }
            for _ in 0..count as u64 {
                let value = self.scalar(scalar)?;
                match role {
                    Role::Polygon => push(&mut row.polygon, vertex_index(value)?)?,
                    Role::CornerUvs => push(&mut row.corner_uvs, value as f32)?,
                    _ => {}
                }
            }
        }
        Ok(())
    }

    fn scalar(&mut self, scalar: Scalar) -> Result<f64> {
        let little = match self.encoding {
            Encoding::Ascii => return self.word(),
            Encoding::LittleEndian => true,
            Encoding::BigEndian => false,
        };
        Ok(match scalar {
            Scalar::I8 => i8::from_le_bytes(self.bytes()?).into(),
            Scalar::U8 => u8::from_le_bytes(self.bytes()?).into(),
            Scalar::I16 => i16::from_le_bytes(self.ordered(little)?).into(),
            Scalar::U16 => u16::from_le_bytes(self.ordered(little)?).into(),
            Scalar::I32 => i32::from_le_bytes(self.ordered(little)?).into(),
            Scalar::U32 => u32::from_le_bytes(self.ordered(little)?).into(),
            Scalar::F32 => f32::from_le_bytes(self.ordered(little)?).into(),
            Scalar::F64 => f64::from_le_bytes(self.ordered(little)?),
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
        text.and_then(number).ok_or_else(|| {
            let found = String::from_utf8_lossy(&word[..word.len().min(40)]);
            Error::input(format!(
                "expected a number, found \"{}\"",
                found.escape_debug()
            ))
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
