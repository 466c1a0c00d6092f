//! Wavefront OBJ: polygons cut into triangles, vertices split where a corner has another normal or
//! texture coordinate.
//!
//! Read are `v` (with `w`, or with a factor on the albedo), `vt`, `vn`, `f`, `usemtl`, `mtllib`, in
//! any letter case; smoothing groups and names are skipped, and what else is drawn is left out with
//! a warning. A corner without a normal takes that of its face.

use super::colors::ColorEncoding;
use super::files::{Files, beside, text_start};
use super::left_out::LeftOut;
use super::mtl::{self, UvMap};
use super::numbers::number;
use super::polygon::Cutter;
use super::texture;
use crate::run::memory;
use crate::scene::Material;
use crate::scene::builder::{DEFAULT_ALBEDO, MESH, MeshInput, extend_attribute, push};
use crate::{Error, Result};
use glam::{DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Words of a `mtllib` that may be one name with spaces in it.
const NAME_WORDS: usize = 8;

/// Reads an OBJ file and the material files that it names; `colors` says how its vertex colours are
/// encoded.
pub(super) fn read(
    content: &[u8],
    path: &Path,
    colors: ColorEncoding,
    files: &mut Files,
) -> Result<MeshInput> {
    read_as(content, path, colors, true, files)
}

/// As [`read`], but what the file says of materials makes no difference.
pub(super) fn geometry(
    content: &[u8],
    path: &Path,
    colors: ColorEncoding,
    files: &mut Files,
) -> Result<MeshInput> {
    read_as(content, path, colors, false, files)
}

fn read_as(
    content: &[u8],
    path: &Path,
    colors: ColorEncoding,
    has_materials: bool,
    files: &mut Files,
) -> Result<MeshInput> {
    let text = String::from_utf8_lossy(text_start(content)?);
    let cutter = Cutter::until(&files.cancel);
    let mut reader = Reader {
        path,
        files,
        has_materials,
        mesh: MeshInput::default(),
        line: 0,
        positions: Vec::new(),
        colors: Vec::new(),
        uvs: Vec::new(),
        normals: Vec::new(),
        vertices: HashMap::new(),
        polygon: Vec::new(),
        cutter,
        materials: HashMap::new(),
        material: None,
        uv_maps: vec![UvMap::IDENTITY],
        uv_map_of_material: Vec::new(),
        left_out: LeftOut::default(),
    };
    let mut joined = String::new();
    for (number, line) in text.lines().enumerate() {
        if number & 0x3ff == 0 {
            reader.files.cancel.check()?;
        }
        reader.line = number + 1;
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
    reader.finish(colors)
}

/// Position, texture coordinate and normal of a corner.
type Corner = [Option<usize>; 3];

struct Reader<'a> {
    path: &'a Path,
    files: &'a mut Files,
    /// Whether materials are read.
    has_materials: bool,
    mesh: MeshInput,
    /// Number of the line that is read.
    line: usize,
    positions: Vec<DVec3>,
    /// As the file has them. As long as `positions`, or empty if no vertex so far has a colour.
    colors: Vec<[f32; 3]>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// Vertex of the mesh for each corner, under each map of texture coordinates, that differs from
    /// those before it.
    vertices: HashMap<(Corner, u32), u32>,
    /// Vertices of the face that is read.
    polygon: Vec<u32>,
    cutter: Cutter,
    /// Index in the mesh of each material by name.
    materials: HashMap<String, u32>,
    /// That of the following faces.
    material: Option<u32>,
    /// Maps of texture coordinates that materials ask for, the identity first.
    uv_maps: Vec<UvMap>,
    uv_map_of_material: Vec<u32>,
    left_out: LeftOut,
}

impl Reader<'_> {
    fn statement(&mut self, line: &str) -> Result<()> {
        let line = line.trim();
        let (word, rest) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        // Long enough for those that are told apart here.
        let mut lower = [0; 8];
        let Some(lower) = lower.get_mut(..word.len()) else {
            return Ok(());
        };
        lower.copy_from_slice(word.as_bytes());
        lower.make_ascii_lowercase();
        match &*lower {
            b"v" => self.position(numbers_of(rest)),
            b"vt" => {
                let numbers = numbers(numbers_of(rest), 1..=4)?;
                let v = numbers.get(1).copied().unwrap_or(0.0);
                // Ours run downwards.
                let mut uv = Vec2::new(numbers[0] as f32, (1.0 - v) as f32);
                if !uv.is_finite() {
                    self.note("texture coordinates that are no numbers are taken as 0");
                    uv = Vec2::ZERO;
                }
                push(&mut self.uvs, uv)
            }
            b"vn" => {
                let numbers = numbers(numbers_of(rest), 3..=3)?;
                let mut normal = DVec3::from_slice(&numbers).as_vec3();
                if !normal.is_finite() {
                    self.note("normals that are no numbers give way to those of faces");
                    normal = Vec3::ZERO;
                }
                push(&mut self.normals, normal)
            }
            b"f" | b"fo" => self.face(numbers_of(rest)),
            b"mtllib" | b"usemtl" if !self.has_materials => Ok(()),
            b"mtllib" => self.libraries(rest.trim()),
            b"usemtl" => {
                self.material = Some(self.named_material(rest.trim()));
                Ok(())
            }
            b"p" | b"l" => {
                self.note("points and lines are left out");
                Ok(())
            }
            b"curv" | b"curv2" | b"surf" => {
                self.note("free-form curves and surfaces are left out");
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Notes what is left out at this line.
    fn note(&mut self, what: &str) {
        self.left_out.note(what, format_args!("line {}", self.line));
    }

    fn position(&mut self, rest: &str) -> Result<()> {
        let numbers = numbers(rest, 3..=7)?;
        let mut position = DVec3::from_slice(&numbers);
        match numbers[3..] {
            [] => {}
            [w] if w != 0.0 => position /= w,
            [_] => return Err(Error::input("a vertex with w = 0 is at infinity")),
            // An alpha may follow.
            [r, g, b] | [r, g, b, _] => {
                let before = self.positions.len();
                let more = before + 1 - self.colors.len();
                memory::grow(MESH, &mut self.colors, more)?;
                self.colors.resize(before, [f32::NAN; 3]);
                self.colors.push([r, g, b].map(|c| c as f32));
            }
            _ => {
                return Err(Error::input(format!(
                    "expected 3, 4, 6 or 7 numbers, found {}",
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
        if rest.split_whitespace().nth(2).is_none() {
            self.note("faces of less than 3 corners are left out");
            return Ok(());
        }
        self.polygon.clear();
        for corner in rest.split_whitespace() {
            let vertex = self.corner(corner, material)?;
            push(&mut self.polygon, vertex)?;
        }
        let mesh = &mut self.mesh;
        let position = |v: u32| mesh.positions.get(v as usize).copied();
        for triangle in self.cutter.cut(&self.polygon, position)? {
            push(&mut mesh.triangles, triangle)?;
            push(&mut mesh.material, material)?;
        }
        Ok(())
    }

    /// The numbers of a corner written as `v`, `v/vt`, `v//vn` or `v/vt/vn`.
    fn corner_numbers(&mut self, text: &str) -> Result<Corner> {
        let lists = [
            ("v", self.positions.len()),
            ("vt", self.uvs.len()),
            ("vn", self.normals.len()),
        ];
        let mut key = [None; 3];
        for (a, number) in text.split('/').enumerate() {
            let wrong = || {
                let found = short(text);
                Error::input(format!(
                    "expected a corner such as 1, 1/2, 1//3 or 1/2/3, found \"{found}\""
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
            key[a] = index.filter(|&i| number != 0 && i < count);
            if key[a].is_none() && a > 0 {
                self.note("references to `vt` and `vn` that are not there are left out");
            } else if key[a].is_none() {
                return Err(Error::input(format!(
                    "the corner {} refers to `{name}` number {number}, \
                     but there are {count} so far",
                    short(text)
                )));
            }
        }
        Ok(key)
    }

    /// The vertex of a corner.
    fn corner(&mut self, text: &str, material: u32) -> Result<u32> {
        let corner = self.corner_numbers(text)?;
        let uv_map = match corner[1] {
            Some(_) => self.uv_map_of_material[material as usize],
            None => 0,
        };
        if let Some(&vertex) = self.vertices.get(&(corner, uv_map)) {
            return Ok(vertex);
        }
        let [Some(position), uv, normal] = corner else {
            return Err(Error::input("a corner without a position"));
        };
        let mesh = &mut self.mesh;
        let vertex = mesh.positions.len();
        push(&mut mesh.positions, self.positions[position])?;
        let color = self.colors.get(position).copied().into_iter().collect();
        let no_color = [f32::NAN; 3];
        extend_attribute(&mut mesh.colors, color, vertex, vertex + 1, no_color)?;
        let map = self.uv_maps[uv_map as usize];
        let uv: Vec<Vec2> = uv.map(|i| mapped(self.uvs[i], map)).into_iter().collect();
        extend_attribute(&mut mesh.uvs, uv, vertex, vertex + 1, Vec2::ZERO)?;
        let normal: Vec<Vec3> = normal.map(|i| self.normals[i]).into_iter().collect();
        extend_attribute(&mut mesh.normals, normal, vertex, vertex + 1, Vec3::ZERO)?;
        let vertex = u32::try_from(vertex)
            .map_err(|_| Error::input("more vertices than can be indexed with 32 bits"))?;
        memory::heard(|| self.vertices.try_reserve(1))
            .map_err(|_| memory::refused::<(Corner, u32)>(MESH, self.vertices.len() + 1))?;
        self.vertices.insert((corner, uv_map), vertex);
        Ok(vertex)
    }

    /// Reads the material files of a `mtllib`: one name with spaces in it, or several names.
    fn libraries(&mut self, names: &str) -> Result<()> {
        match self.find(names) {
            Ok(Some(path)) => return self.library(&path),
            Err(e) => return self.without_library(&e),
            Ok(None) => {}
        }
        let names = names.split_once(" #").map_or(names, |(names, _)| names);
        let words: Vec<&str> = names.split_whitespace().collect();
        let mut at = 0;
        while at < words.len() {
            let lengths = (1..=NAME_WORDS.min(words.len() - at)).rev();
            let found = lengths.filter_map(|n| {
                let found = self.find(&words[at..at + n].join(" "));
                Some((n, found.transpose()?))
            });
            let (n, found) = { found }.next().unwrap_or_else(|| {
                let path = beside(self.path, words[at]);
                let reason = format!("material file {} is not there", path.display());
                (1, Err(Error::input(reason)))
            });
            match found {
                Ok(path) => self.library(&path)?,
                Err(e) => self.without_library(&e)?,
            }
            at += n;
        }
        Ok(())
    }

    fn find(&self, name: &str) -> Result<Option<PathBuf>> {
        self.files.find("material", self.path, name)
    }

    fn without_library(&mut self, reason: &Error) -> Result<()> {
        let path = self.path.display();
        self.files
            .warn(format!("{path}: {reason}; its materials are grey"));
        Ok(())
    }

    fn library(&mut self, path: &Path) -> Result<()> {
        let content = self.files.read("material", path)?;
        let first = self.mesh.textures.len() as u32;
        let library = mtl::read(&content, path, self.files).map_err(|e| e.at(path.display()))?;
        self.mesh.textures.extend(library.textures);
        for (mut material, uv_map) in library.materials.into_iter().zip(library.uv_maps) {
            material.move_textures(first);
            self.add(material, uv_map);
        }
        Ok(())
    }

    fn add(&mut self, material: Material, uv_map: UvMap) -> u32 {
        let known = self.uv_maps.iter().position(|m| *m == uv_map);
        let at = known.unwrap_or_else(|| {
            self.uv_maps.push(uv_map);
            self.uv_maps.len() - 1
        });
        self.uv_map_of_material.push(at as u32);
        let index = self.mesh.materials.len() as u32;
        self.materials.insert(material.name.clone(), index);
        self.mesh.materials.push(material);
        index
    }

    fn named_material(&mut self, name: &str) -> u32 {
        let uncommented = name.split_once(" #").map_or(name, |(name, _)| name.trim());
        for name in [name, uncommented] {
            if let Some(&index) = self.materials.get(name) {
                return index;
            }
        }
        if !name.is_empty() {
            let what = "materials that are in no material file are grey";
            self.left_out.note(what, format_args!("`{name}`"));
        }
        let grey = Material::diffuse(name, DEFAULT_ALBEDO);
        self.add(grey, UvMap::IDENTITY)
    }

    fn finish(mut self, colors: ColorEncoding) -> Result<MeshInput> {
        if !self.mesh.colors.is_empty() {
            colors.decode(&mut self.mesh.colors, &mut self.left_out);
            // A colour of vertices is the albedo of what has no other.
            let unnamed = self.materials.get("").copied();
            if let Some(index) = unnamed {
                self.mesh.materials[index as usize].albedo = [1.0; 3];
            }
        }
        self.cutter.note_crossed(&mut self.left_out);
        self.left_out.tell(self.path, 0, self.files);
        if self.mesh.uvs.is_empty() && !self.mesh.textures.is_empty() {
            texture::replace_by_means(&mut self.mesh);
            self.files.warn(format!(
                "{}: there are no texture coordinates; textures are replaced by their mean colour",
                self.path.display()
            ));
        }
        Ok(self.mesh)
    }
}

/// What of a word a message quotes.
fn short(word: &str) -> String {
    word.chars().take(40).collect()
}

/// Texture coordinates, which run downwards, under a map of those that run upwards.
fn mapped(uv: Vec2, map: UvMap) -> Vec2 {
    match map == UvMap::IDENTITY {
        true => uv,
        false => {
            let up = Vec2::new(uv.x, 1.0 - uv.y) * map.scale + map.offset;
            Vec2::new(up.x, 1.0 - up.y)
        }
    }
}

/// What of a statement is before a comment.
fn numbers_of(rest: &str) -> &str {
    rest.split_once('#').map_or(rest, |(numbers, _)| numbers)
}

fn numbers(text: &str, count: std::ops::RangeInclusive<usize>) -> Result<Vec<f64>> {
    let parsed = text.split_whitespace().map(|word| {
        number(word)
            .ok_or_else(|| Error::input(format!("expected a number, found \"{}\"", short(word))))
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
        load_with_warnings(text).map(|(mesh, _)| mesh)
    }

    fn load_with_warnings(text: &str) -> Result<(MeshInput, Vec<String>)> {
        let mut files = Files::default();
        let (path, colors) = (Path::new("x.obj"), ColorEncoding::Linear);
        let mesh = read(text.as_bytes(), path, colors, &mut files)?;
        mesh.check()?;
        Ok((mesh, files.warnings))
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
    fn odd_elements_are_dropped_and_told() {
        let text = "V 0 0 0 # origin\nv 1 0 0\nv 1 1 0\nvt nan 0\nvn -nan(ind) 0 1.#QNAN\n\
                    F 1/1/1 2/2/1 3/1/7 # a face\nf 1 2\nf 1\nl 1 2\np 1\nusemtl x # y\n\
                    curv 0 1 1 2\n";
        let (mesh, warnings) = load_with_warnings(text).unwrap();
        assert_eq!(mesh.triangles, [[0, 1, 2]]);
        assert_eq!(mesh.normals, [Vec3::ZERO; 3]);
        assert_eq!(mesh.uvs, [Vec2::ZERO; 3]);
        assert_eq!(
            warnings,
            [
                "x.obj: texture coordinates that are no numbers are taken as 0: line 4",
                "x.obj: normals that are no numbers give way to those of faces: line 5",
                "x.obj: references to `vt` and `vn` that are not there are left out: line 6",
                "x.obj: faces of less than 3 corners are left out: line 7, line 8",
                "x.obj: points and lines are left out: line 9, line 10",
                "x.obj: materials that are in no material file are grey: `x # y`",
                "x.obj: free-form curves and surfaces are left out: line 12",
            ]
        );
        assert!(load("v nan 0 0\nf 1 1 1").is_err());
    }

    #[test]
    fn colours_may_have_an_alpha_or_be_bytes_and_are_the_albedo() {
        let (mesh, warnings) =
            load_with_warnings("v 0 0 0 255 0 51 255\nv 1 0 0 0 0 0\nv 0 1 0\nf 1 2 3").unwrap();
        assert_eq!(mesh.colors, [[1.0, 0.0, 0.2], [0.0; 3], [1.0; 3]]);
        assert_eq!(mesh.materials[0].albedo, [1.0; 3]);
        assert_eq!(warnings, ["x.obj: colours are taken as bytes: up to 255"]);
    }

    #[test]
    fn wrong_statements_name_their_line() {
        let message = |text: &str| load(&format!("{SQUARE}{text}")).unwrap_err().to_string();
        assert_eq!(message("v 1 2"), "line 8: expected 3 to 7 numbers, found 2");
        assert_eq!(message("v 1 2 x"), "line 8: expected a number, found \"x\"");
        assert!(message("f 1 2 5").contains("refers to `v` number 5, but there are 4"));
        assert!(message("f 0 1 2").contains("number 0"));
        assert!(message("f 1 2 -5").contains("number -5"));
        assert!(message("f 1 2 3/1/1/1").contains("expected a corner such as"));
        assert!(message("f 1 2 -9223372036854775808").contains("refers to"));
    }
}
