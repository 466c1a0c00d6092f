//! Wavefront OBJ: polygons cut into triangles, vertices split where a corner has another normal or
//! texture coordinate.
//!
//! Read are `v` (with `w`, or with a linear RGB factor on the albedo), `vt`, `vn`, `f`, `usemtl`,
//! `mtllib`; everything else is skipped, smoothing groups included. A corner without a normal takes
//! that of its face.

use super::files::{Files, beside};
use super::mtl;
use super::polygon::Cutter;
use super::texture;
use crate::run::memory;
use crate::scene::Material;
use crate::scene::builder::{DEFAULT_ALBEDO, MESH, MeshInput, extend_attribute, push};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::path::Path;

/// Reads an OBJ file and the material files that it names.
pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<MeshInput> {
    let text = String::from_utf8_lossy(content);
    let mut reader = Reader {
        path,
        files,
        mesh: MeshInput::default(),
        positions: Vec::new(),
        colors: Vec::new(),
        uvs: Vec::new(),
        normals: Vec::new(),
        vertices: HashMap::new(),
        polygon: Vec::new(),
        cutter: Cutter::default(),
        materials: HashMap::new(),
        material: None,
    };
    let mut joined = String::new();
    for (number, line) in text.lines().enumerate() {
        if number & 0x3ff == 0 {
            reader.files.cancel.check()?;
        }
        // A backslash at its end joins a line to the next.
        if let Some(start) = line.trim_end().strip_suffix('\\') {
            joined.push_str(start);
            joined.push(' ');
            continue;
        }
        let whole = if joined.is_empty() {
            reader.statement(line)
        } else {
            joined.push_str(line);
            reader.statement(&std::mem::take(&mut joined))
        };
        whole.map_err(|e| e.at(format!("line {}", number + 1)))?;
    }
    reader.without_uvs();
    Ok(reader.mesh)
}

/// Position, texture coordinate and normal of a corner.
type Corner = [Option<usize>; 3];

struct Reader<'a> {
    path: &'a Path,
    files: &'a mut Files,
    mesh: MeshInput,
    positions: Vec<DVec3>,
    /// As long as `positions`, or empty if no vertex so far has a colour.
    colors: Vec<[f32; 3]>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// Vertex of the mesh for each corner that differs from those before it.
    vertices: HashMap<Corner, u32>,
    /// Vertices of the face that is read.
    polygon: Vec<u32>,
    cutter: Cutter,
    /// Index in the mesh of each material by name.
    materials: HashMap<String, u32>,
    /// That of the following faces.
    material: Option<u32>,
}

impl Reader<'_> {
    fn statement(&mut self, line: &str) -> Result<()> {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        match word {
            "v" => self.position(rest),
            "vt" => {
                let numbers = numbers(rest, 1..=3)?;
                let v = numbers.get(1).copied().unwrap_or(0.0);
                // Ours run downwards.
                let uv = Vec2::new(numbers[0] as f32, (1.0 - v) as f32);
                push(&mut self.uvs, uv)
            }
            "vn" => {
                let numbers = numbers(rest, 3..=3)?;
                let normal = DVec3::from_slice(&numbers);
                push(&mut self.normals, normal.as_vec3())
            }
            "f" => self.face(rest),
            "mtllib" => self.library(rest.trim()),
            "usemtl" => {
                self.material = Some(self.named_material(rest.trim()));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn position(&mut self, rest: &str) -> Result<()> {
        let numbers = numbers(rest, 3..=6)?;
        let mut position = DVec3::from_slice(&numbers);
        match numbers[3..] {
            [] => {}
            [w] if w != 0.0 => position /= w,
            [_] => return Err(Error::input("a vertex with w = 0 is at infinity")),
            [r, g, b] => {
                let before = self.positions.len();
                let more = before + 1 - self.colors.len();
                memory::grow(MESH, &mut self.colors, more)?;
                self.colors.resize(before, [1.0; 3]);
                self.colors.push([r, g, b].map(|c| c as f32));
            }
            _ => {
                return Err(Error::input(format!(
                    "expected 3, 4 or 6 numbers, found {}",
                    numbers.len()
                )));
            }
        }
        push(&mut self.positions, position)
    }

    fn face(&mut self, rest: &str) -> Result<()> {
        let material = match self.material {
            Some(material) => material,
            None => self.named_material(""),
        };
        self.polygon.clear();
        for corner in rest.split_whitespace() {
            let vertex = self.corner(corner)?;
            push(&mut self.polygon, vertex)?;
        }
        if self.polygon.len() < 3 {
            return Err(Error::input(format!(
                "expected a face of 3 corners or more, found {}",
                self.polygon.len()
            )));
        }
        let mesh = &mut self.mesh;
        let position = |v: u32| mesh.positions.get(v as usize).copied();
        for triangle in self.cutter.cut(&self.polygon, position)? {
            push(&mut mesh.triangles, triangle)?;
            push(&mut mesh.material, material)?;
        }
        Ok(())
    }

    /// The vertex of a corner written as `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner(&mut self, text: &str) -> Result<u32> {
        let lists = [
            ("v", self.positions.len()),
            ("vt", self.uvs.len()),
            ("vn", self.normals.len()),
        ];
        let mut key = [None; 3];
        for (a, number) in text.split('/').enumerate() {
            let wrong = || {
                Error::input(format!(
                    "expected a corner such as 1, 1/2, 1//3 or 1/2/3, found \"{text}\""
                ))
            };
            let (name, count) = *lists.get(a).ok_or_else(wrong)?;
            if number.is_empty() && a > 0 {
                continue;
            }
            let number: i64 = number.parse().map_err(|_| wrong())?;
            // Counted from 1, or backwards from the last with -1.
            let index = match number {
                1.. => usize::try_from(number - 1).ok(),
                _ => usize::try_from(number.saturating_add(count as i64)).ok(),
            };
            key[a] = Some(
                index
                    .filter(|&i| number != 0 && i < count)
                    .ok_or_else(|| {
                        Error::input(format!(
                            "the corner {text} refers to `{name}` number {number}, but there are {count} so far"
                        ))
                    })?,
            );
        }
        if let Some(&vertex) = self.vertices.get(&key) {
            return Ok(vertex);
        }
        let [Some(position), uv, normal] = key else {
            return Err(Error::input("a corner without a position"));
        };
        let mesh = &mut self.mesh;
        let vertex = mesh.positions.len();
        push(&mut mesh.positions, self.positions[position])?;
        let color = self.colors.get(position).copied().into_iter().collect();
        extend_attribute(&mut mesh.colors, color, vertex, vertex + 1, [1.0; 3])?;
        let uv: Vec<Vec2> = uv.map(|i| self.uvs[i]).into_iter().collect();
        extend_attribute(&mut mesh.uvs, uv, vertex, vertex + 1, Vec2::ZERO)?;
        let normal: Vec<Vec3> = normal.map(|i| self.normals[i]).into_iter().collect();
        extend_attribute(&mut mesh.normals, normal, vertex, vertex + 1, Vec3::ZERO)?;
        let vertex = u32::try_from(vertex)
            .map_err(|_| Error::input("more vertices than can be indexed with 32 bits"))?;
        self.vertices
            .try_reserve(1)
            .map_err(|_| memory::refused::<(Corner, u32)>(MESH, self.vertices.len() + 1))?;
        self.vertices.insert(key, vertex);
        Ok(vertex)
    }

    fn library(&mut self, names: &str) -> Result<()> {
        // One name with spaces in it, or several names.
        let whole = beside(self.path, names);
        let split: Vec<&str> = names.split_whitespace().collect();
        let names = match whole.exists() {
            true => vec![names],
            false => split,
        };
        for name in names {
            let path = beside(self.path, name);
            if !path.exists() {
                self.files.warn(format!(
                    "{}: material file {} is not there; its materials are grey",
                    self.path.display(),
                    path.display()
                ));
                continue;
            }
            let content = self.files.read("material", &path)?;
            let first = self.mesh.textures.len() as u32;
            let (materials, textures) =
                mtl::read(&content, &path, self.files).map_err(|e| e.at(path.display()))?;
            self.mesh.textures.extend(textures);
            for mut material in materials {
                material.texture = material.texture.map(|t| t + first);
                self.add(material);
            }
        }
        Ok(())
    }

    /// Where nothing says which part of a texture is meant, its mean colour stands for it.
    fn without_uvs(&mut self) {
        if !self.mesh.uvs.is_empty() || self.mesh.textures.is_empty() {
            return;
        }
        for material in &mut self.mesh.materials {
            if let Some(index) = material.texture.take() {
                let mean = texture::mean(&self.mesh.textures[index as usize]);
                material.albedo = std::array::from_fn(|i| material.albedo[i] * mean[i]);
            }
        }
        self.mesh.textures.clear();
        self.files.warn(format!(
            "{}: there are no texture coordinates; textures are replaced by their mean colour",
            self.path.display()
        ));
    }

    fn add(&mut self, material: Material) -> u32 {
        let index = self.mesh.materials.len() as u32;
        self.materials.insert(material.name.clone(), index);
        self.mesh.materials.push(material);
        index
    }

    fn named_material(&mut self, name: &str) -> u32 {
        if let Some(&index) = self.materials.get(name) {
            return index;
        }
        if !name.is_empty() {
            self.files.warn(format!(
                "{}: the material `{name}` is in no material file; it is grey",
                self.path.display()
            ));
        }
        self.add(Material::diffuse(name, DEFAULT_ALBEDO))
    }
}

fn numbers(text: &str, count: std::ops::RangeInclusive<usize>) -> Result<Vec<f64>> {
    let parsed = text.split_whitespace().map(|word| {
        word.parse::<f64>()
            .map_err(|_| Error::input(format!("expected a number, found \"{word}\"")))
    });
    let numbers = parsed.collect::<Result<Vec<_>>>()?;
    if !count.contains(&numbers.len()) {
        let (low, high) = (count.start(), count.end());
        let range = if low == high {
            low.to_string()
        } else {
            format!("{low} to {high}")
        };
        return Err(Error::input(format!(
            "expected {range} numbers, found {}",
            numbers.len()
        )));
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<MeshInput> {
        read(text.as_bytes(), Path::new("x.obj"), &mut Files::default())
    }

    const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\nvn 0 0 2\n";

    #[test]
    fn a_quad_is_a_fan_and_negative_indices_count_backwards() {
        for face in ["f 1 2 3 4", "f -4 -3 -2 -1", "f 1 2 \\\n 3 4"] {
            let mesh = load(&format!("{SQUARE}{face}\n")).unwrap();
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]], "{face}");
            assert_eq!(mesh.positions[2], DVec3::new(1.0, 1.0, 0.0));
            assert!(mesh.normals.is_empty() && mesh.uvs.is_empty());
            assert_eq!(mesh.material, [0, 0]);
            mesh.check().unwrap();
        }
    }

    #[test]
    fn corners_split_vertices_and_mixed_normals_stay_aligned() {
        let mesh = load(&format!("{SQUARE}f 1 2 3\nf 1//1 3//1 4/2/1\n")).unwrap();
        assert_eq!(mesh.positions.len(), 6);
        assert_eq!(mesh.normals.len(), 6);
        assert_eq!(mesh.normals[2], Vec3::ZERO);
        assert_eq!(mesh.normals[3], Vec3::new(0.0, 0.0, 2.0));
        assert_eq!(mesh.uvs[5], Vec2::new(1.0, 0.75));
        mesh.check().unwrap();
    }

    #[test]
    fn vertex_colours_are_read_where_given() {
        let mesh = load("v 0 0 0\nv 1 0 0 0.25 0.5 1\nv 0 1 0 2\nf 1 2 3").unwrap();
        assert_eq!(mesh.colors, [[1.0; 3], [0.25, 0.5, 1.0], [1.0; 3]]);
        assert_eq!(mesh.positions[2].y, 0.5);
    }

    #[test]
    fn wrong_statements_name_their_line() {
        let message = |text: &str| load(&format!("{SQUARE}{text}")).unwrap_err().to_string();
        assert_eq!(message("v 1 2"), "line 8: expected 3 to 6 numbers, found 2");
        assert_eq!(message("v 1 2 x"), "line 8: expected a number, found \"x\"");
        assert!(message("f 1 2").contains("line 8: expected a face of 3"));
        assert!(message("f 1 2 5").contains("refers to `v` number 5, but there are 4"));
        assert!(message("f 0 1 2").contains("number 0"));
        assert!(message("f 1 2 -5").contains("number -5"));
        assert!(message("f 1/3 2 4").contains("`vt` number 3, but there are 2"));
        assert!(message("f 1 2 3/1/1/1").contains("expected a corner such as"));
        assert!(message("f 1 2 -9223372036854775808").contains("refers to"));
    }
}
