//! Meshes that a packed scene stores once and places many times.

use super::super::column::{MAX_COORDINATE, PackedColumn};
use super::rules::check;
use super::surface::{PackedHierarchy, PackedMesh};
use crate::{FormatError, Result};
use std::ops::Range;

/// Triangles that are stored once, and the places of each mesh of these.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedInstances {
    /// What is placed, in the order in which it is stored: behind all that lies in scene space. At
    /// least one.
    pub prototypes: Vec<PackedPrototype>,
    /// Number of places, at least one.
    pub count: u64,
}

/// A mesh in a space of its own.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedPrototype {
    /// Its first triangle; it ends where the next begins.
    pub first_triangle: u32,
    /// Its first vertex.
    pub first_vertex: u32,
    /// The hierarchy over its triangles; `None` if no ray can meet any.
    pub hierarchy: Option<PackedHierarchy>,
}

impl PackedInstances {
    /// The triangles of a prototype.
    pub(crate) fn triangles(&self, prototype: usize, mesh: &PackedMesh) -> Range<u64> {
        let first = |p: usize| self.prototypes.get(p).map(|p| p.first_triangle.into());
        let end = first(prototype + 1).unwrap_or(mesh.triangles);
        first(prototype).unwrap_or(end)..end
    }

    pub(super) fn validate(&self, mesh: &PackedMesh) -> Result<()> {
        let what = || "instances".to_owned();
        let last = |of: fn(&PackedPrototype) -> u32| self.prototypes.last().map(of);
        let rise = |of: fn(&PackedPrototype) -> u32, most: u64| {
            self.prototypes.is_sorted_by_key(of) && last(of).is_some_and(|n| u64::from(n) <= most)
        };
        let is_right = self.count > 0
            && rise(|p| p.first_triangle, mesh.triangles)
            && rise(|p| p.first_vertex, mesh.vertices);
        let expected = "prototypes whose triangles and vertices follow each other, and a place";
        check(is_right, &what, expected, self.prototypes.len())?;
        let mut hierarchies = self.prototypes.iter().filter_map(|p| p.hierarchy.as_ref());
        hierarchies.try_for_each(|h| h.validate(mesh))
    }
}

/// Bytes of the map in a row: twelve f64.
const MAP: usize = 96;
/// And behind it of the box: six f32.
const BOX: usize = 24;

/// Checks rows of places: maps that can be inverted, boxes, and numbers of prototypes.
pub fn check_instances(first: u64, piece: &[u8], instances: &PackedInstances) -> Result<()> {
    let prototypes = instances.prototypes.len();
    let width = PackedColumn::Instances.width();
    for (row, at) in piece.chunks_exact(width).zip(first..) {
        let (map, rest) = row.split_at(MAP);
        let (ends, numbers) = rest.split_at(BOX);
        let map: Vec<f64> = (map.as_chunks().0.iter())
            .map(|b| f64::from_le_bytes(*b))
            .collect();
        let ends: Vec<f32> = (ends.as_chunks().0.iter())
            .map(|b| f32::from_le_bytes(*b))
            .collect();
        let numbers: Vec<u32> = (numbers.as_chunks().0.iter())
            .map(|b| u32::from_le_bytes(*b))
            .collect();
        let is_box = (0..3).all(|a| ends[a] <= ends[3 + a])
            && ends.iter().all(|v| v.abs() <= MAX_COORDINATE);
        let is_right = can_be_inverted(&map)
            && is_box
            && (numbers[0] as usize) < prototypes
            && numbers[1] == 0;
        if !is_right {
            return Err(FormatError::invalid(
                format!("row {at} of the {}", PackedColumn::Instances.name()),
                format!("an invertible map, a finite box, a prototype below {prototypes} and 0"),
                "others",
            ));
        }
    }
    Ok(())
}

/// Whether columns of a matrix and a place are finite, and the matrix has an inverse.
fn can_be_inverted(map: &[f64]) -> bool {
    let [x, y, z] = [0, 3, 6].map(|i| [map[i], map[i + 1], map[i + 2]]);
    let volume = super::rules::dot(x, super::rules::cross(y, z));
    let lengths: f64 = [x, y, z]
        .map(|c| super::rules::dot(c, c).sqrt())
        .iter()
        .product();
    // As scenes are held to, with room for rounding.
    map.iter().all(|v| v.is_finite())
        && (1.0 / volume).is_finite()
        && volume.abs() >= 1e-13 * lengths
}
