//! STL, ASCII and binary: triangles alone, whose corners are joined where they are in one place.
//! What is said of normals and colours is left out: triangles face as their corners wind.

use super::files::{Files, text_start};
use super::numbers::number;
use crate::run::memory;
use crate::scene::builder::{MESH, MeshInput};
use crate::{Error, Result};
use glam::DVec3;
use std::collections::HashMap;
use std::path::Path;

/// Bytes before the triangles of a binary file, and of each of them.
const HEADER: usize = 84;
const TRIANGLE: usize = 50;

/// Reads an STL file.
pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<MeshInput> {
    let mut corners = Corners::default();
    match count_of_binary(content) {
        Some(count) => {
            corners.triangles = memory::room(MESH, count)?;
            for triangle in content[HEADER..].chunks_exact(TRIANGLE).take(count) {
                files.cancel.check()?;
                // Behind the normal.
                let (values, _) = triangle[12..48].as_chunks::<4>();
                let value = |i: usize| f64::from(f32::from_le_bytes(values[i]));
                corners.add([0, 3, 6].map(|i| DVec3::new(value(i), value(i + 1), value(i + 2))));
            }
        }
        None => read_text(content, &mut corners, files)?,
    }
    if corners.not_finite > 0 {
        files.warn(format!(
            "{}: {} triangles with a corner that is no number are left out",
            path.display(),
            corners.not_finite
        ));
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(MeshInput::new(&name, corners.positions, corners.triangles))
}

/// The number of triangles of a binary file; `None` if it is text. Binary ones may begin as text
/// does.
fn count_of_binary(content: &[u8]) -> Option<usize> {
    let count = content.get(HEADER - 4..HEADER)?;
    let count = u32::from_le_bytes(count.try_into().ok()?) as usize;
    let held = (content.len() - HEADER) / TRIANGLE;
    let is_text = content.trim_ascii_start().starts_with(b"solid") && held != count;
    (held >= count && !is_text).then_some(count)
}

/// Triangles, and the places of their corners.
#[derive(Default)]
struct Corners {
    positions: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    known: HashMap<[u64; 3], u32>,
    not_finite: u64,
}

impl Corners {
    fn add(&mut self, corners: [DVec3; 3]) {
        if !corners.iter().all(|c| c.is_finite()) {
            self.not_finite += 1;
            return;
        }
        let triangle = corners.map(|corner| {
            // Of 0 there are two.
            let key = (corner + DVec3::ZERO).to_array().map(f64::to_bits);
            *self.known.entry(key).or_insert_with(|| {
                self.positions.push(corner);
                (self.positions.len() - 1) as u32
            })
        });
        self.triangles.push(triangle);
    }
}

/// Reads the lines `vertex x y z`, three for each triangle.
fn read_text(content: &[u8], corners: &mut Corners, files: &Files) -> Result<()> {
    let text = text_start(content).ok();
    let text = text.and_then(|text| std::str::from_utf8(text).ok());
    let text = text.filter(|text| text.trim_start().starts_with("solid"));
    let text = text.ok_or_else(|| {
        Error::input(format!(
            "expected an STL file: text that begins with `solid`, or a header of {HEADER} bytes \
             and {TRIANGLE} for each of the triangles that it counts; \
             found {} bytes of something else",
            content.len()
        ))
    })?;
    let mut open: Vec<DVec3> = Vec::with_capacity(3);
    for (i, line) in text.lines().enumerate() {
        files.cancel.check()?;
        let mut words = line.split_ascii_whitespace();
        let at =
            |what: &str| Error::input(format!("line {}: {what}, found `{}`", i + 1, line.trim()));
        match words.next() {
            Some("vertex") => {
                let values: Option<Vec<f64>> = words.map(number).collect();
                let Some([x, y, z]) = values.as_deref() else {
                    return Err(at("expected `vertex` and three numbers"));
                };
                open.push(DVec3::new(*x, *y, *z));
                if let [a, b, c] = open[..] {
                    corners.add([a, b, c]);
                    open.clear();
                }
            }
            Some("endfacet") if !open.is_empty() => {
                return Err(at("expected three corners before the end of a facet"));
            }
            _ => {}
        }
    }
    match open.is_empty() {
        true => Ok(()),
        false => Err(Error::input("the file ends within a facet: it is cut")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "solid two\n facet normal 0 0 1\n  outer loop\n   vertex 0 0 0\n   \
        vertex 1 0 0\n   vertex 1 1 0\n  endloop\n endfacet\n facet normal 0 0 1\n  outer loop\n   \
        vertex -0 0 0\n   vertex 1 1 0\n   vertex 0 1e0 0\n  endloop\n endfacet\nendsolid two\n";

    fn binary(name: &[u8], triangles: &[[[f32; 3]; 3]]) -> Vec<u8> {
        let mut bytes = name.to_vec();
        bytes.resize(HEADER - 4, b' ');
        bytes.extend((triangles.len() as u32).to_le_bytes());
        for triangle in triangles {
            bytes.extend([0; 12]);
            bytes.extend(triangle.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
            bytes.extend([0; 2]);
        }
        bytes
    }

    fn load(content: &[u8]) -> Result<(MeshInput, Vec<String>)> {
        let mut files = Files::default();
        let mesh = read(content, Path::new("x.stl"), &mut files)?;
        Ok((mesh, files.warnings))
    }

    const SQUARE: [[[f32; 3]; 3]; 2] = [
        [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
        [[-0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
    ];

    #[test]
    fn text_and_binary_files_are_the_same_mesh() {
        for content in [
            TEXT.as_bytes().to_vec(),
            TEXT.replace('\n', "\r\n").into_bytes(),
            binary(b"made by a scanner", &SQUARE),
            // Many programs write this before binary triangles.
            binary(b"solid made by a scanner", &SQUARE),
        ] {
            let (mesh, warnings) = load(&content).unwrap();
            assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
            assert_eq!(mesh.positions.len(), 4);
            assert_eq!(mesh.positions[3], DVec3::new(0.0, 1.0, 0.0));
            assert!(warnings.is_empty());
        }
    }

    #[test]
    fn what_is_wrong_is_told() {
        let said = |content: &[u8]| load(content).unwrap_err().to_string();
        assert!(said(b"").contains("expected an STL file"));
        let whole = binary(b"x", &SQUARE);
        assert!(said(&whole[..whole.len() - 1]).contains("expected an STL file"));
        let cut = &TEXT[..TEXT.find("vertex 1 1").unwrap()];
        assert!(said(cut.as_bytes()).contains("it is cut"));
        let short = TEXT.replacen("vertex 1 0 0", "vertex 1 0", 1);
        assert!(said(short.as_bytes()).contains("line 5: expected `vertex` and three numbers"));
        let few = TEXT.replacen("vertex 1 0 0", "", 1);
        assert!(said(few.as_bytes()).contains("line 8: expected three corners"));
        let mut broken = SQUARE;
        broken[1][2][0] = f32::NAN;
        let (mesh, warnings) = load(&binary(b"x", &broken)).unwrap();
        assert_eq!(mesh.triangles.len(), 1);
        assert!(warnings[0].contains("1 triangles with a corner"));
    }
}
