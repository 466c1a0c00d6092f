//! Where a disk must end: the borders and creases of the mesh around it.
//!
//! A plain disk sticks out over a convex edge and hides the neighbouring facet from light; on
//! Sponza that alone makes indirect light a fifth too dark. So each disk is cut by the creases
//! within its radius, found by walking from triangle to triangle over smooth edges.

use crate::Result;
use crate::math::sampling::tangents;
use crate::run::Cancel;
use crate::scene::Mesh;
use crate::trace::unit_normal;
use glam::Vec3;
use lvox_formats::record::{ClipEdge, Clips};
use std::collections::HashMap;
use std::f32::consts::TAU;

/// Across this edge there is no surface to go on to, or one at an angle.
const CREASE: u32 = u32::MAX;

/// For each triangle, what lies across its three edges.
#[derive(Debug)]
pub struct Creases<'a> {
    mesh: &'a Mesh,
    across: Vec<[u32; 3]>,
}

impl<'a> Creases<'a> {
    /// Finds the edges at which two facets meet at more than `crease_deg`, and those with one
    /// facet, or more than two.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new(mesh: &'a Mesh, crease_deg: f32, cancel: &Cancel) -> Result<Self> {
        let cos_crease = libm::cosf(crease_deg.to_radians());
        let welded = weld(&mesh.positions, cancel)?;
        let mut edges: HashMap<(u32, u32), (u32, u32, u8)> =
            HashMap::with_capacity(mesh.triangles.len() * 2);
        let key = |t: usize, e: usize| {
            let [a, b] = [e, (e + 1) % 3].map(|k| welded[mesh.triangles[t][k] as usize]);
            (a.min(b), a.max(b))
        };
        for t in 0..mesh.triangles.len() {
            cancel.check()?;
            for e in 0..3 {
                let entry = edges.entry(key(t, e)).or_insert((t as u32, CREASE, 0));
                entry.2 = entry.2.saturating_add(1);
                if entry.2 == 2 {
                    entry.1 = t as u32;
                }
            }
        }
        let mut across = Vec::with_capacity(mesh.triangles.len());
        for t in 0..mesh.triangles.len() {
            cancel.check()?;
            across.push(std::array::from_fn(|e| match edges.get(&key(t, e)) {
                Some(&(a, b, 2)) => {
                    let other = if a == t as u32 { b } else { a };
                    let [n, m] = [t, other as usize].map(|t| unit_normal(mesh.corners(t)));
                    // Neighbours may wind differently: a flat pair is flat either way.
                    if n.dot(m).abs() >= cos_crease {
                        other
                    } else {
                        CREASE
                    }
                }
                _ => CREASE,
            }));
        }
        Ok(Self { mesh, across })
    }

    /// The nearest creases that cut a disk around a point of a triangle.
    #[must_use]
    pub fn clips(&self, triangle: u32, point: Vec3, normal: Vec3, radius: f32) -> Clips {
        const MAX_TRIANGLES: usize = 32;
        let (tangent, bitangent) = tangents(normal);
        let mut visited = [triangle; MAX_TRIANGLES];
        let (mut visited_count, mut next) = (1, 0);
        let mut clips = Clips::default();
        while next < visited_count {
            let t = visited[next] as usize;
            next += 1;
            let corners = self.mesh.corners(t).map(|c| {
                let d = c - point;
                [d.dot(tangent), d.dot(bitangent)]
            });
            for e in 0..3 {
                let (a, b) = (corners[e], corners[(e + 1) % 3]);
                if distance2_to_segment(a, b) >= radius * radius {
                    continue;
                }
                let other = self.across[t][e];
                if other != CREASE {
                    if visited_count < MAX_TRIANGLES && !visited[..visited_count].contains(&other) {
                        visited[visited_count] = other;
                        visited_count += 1;
                    }
                } else {
                    add_clip(&mut clips, line(a, b, corners[(e + 2) % 3]), radius);
                }
            }
        }
        clips
    }
}

/// Outward normal and distance from the origin of the line through a and b; `inside` is on its
/// inner side.
fn line(a: [f32; 2], b: [f32; 2], inside: [f32; 2]) -> ([f32; 2], f32) {
    let (x, y) = (b[1] - a[1], a[0] - b[0]);
    let length = (x * x + y * y).sqrt().max(f32::MIN_POSITIVE);
    let mut n = [x / length, y / length];
    if n[0] * (inside[0] - a[0]) + n[1] * (inside[1] - a[1]) > 0.0 {
        n = [-n[0], -n[1]];
    }
    (n, n[0] * a[0] + n[1] * a[1])
}

/// Keeps the three nearest lines.
fn add_clip(clips: &mut Clips, (n, distance): ([f32; 2], f32), radius: f32) {
    // A crease that the projection turned over lies on the far side of a curved facet: it does not
    // cut here.
    if distance < -1e-3 * radius {
        return;
    }
    let turns = libm::atan2f(n[1], n[0]) / TAU;
    let edge = ClipEdge {
        angle: TAU * (turns - turns.floor()),
        offset: (distance / radius).clamp(0.0, 1.0),
    };
    let count = clips.count as usize;
    let same =
        |c: &ClipEdge| (c.angle - edge.angle).abs() < 1e-3 && (c.offset - edge.offset).abs() < 1e-3;
    if clips.edges[..count].iter().any(same) {
        return;
    }
    if count < clips.edges.len() {
        clips.edges[count] = edge;
        clips.count += 1;
    } else if let Some(farthest) = clips
        .edges
        .iter_mut()
        .max_by(|a, b| a.offset.total_cmp(&b.offset))
        && edge.offset < farthest.offset
    {
        *farthest = edge;
    }
}

fn distance2_to_segment(a: [f32; 2], b: [f32; 2]) -> f32 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let length2 = dx * dx + dy * dy;
    let t = if length2 > 0.0 {
        (-(a[0] * dx + a[1] * dy) / length2).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let (x, y) = (a[0] + t * dx, a[1] + t * dy);
    x * x + y * y
}

/// For each vertex the first one at the same place, so that split vertices share edges.
fn weld(positions: &[Vec3], cancel: &Cancel) -> Result<Vec<u32>> {
    let mut first = HashMap::with_capacity(positions.len());
    let mut welded = Vec::with_capacity(positions.len());
    for (i, p) in positions.iter().enumerate() {
        cancel.check()?;
        // Adding 0.0 makes -0.0 and 0.0 one.
        let key = (*p + Vec3::ZERO).to_array().map(f32::to_bits);
        welded.push(*first.entry(key).or_insert(i as u32));
    }
    Ok(welded)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A unit square of two triangles in z = 0, and a wall standing on its edge x = 1.
    fn floor_and_wall() -> Mesh {
        let p = |x: f32, y: f32, z: f32| Vec3::new(x, y, z);
        Mesh {
            positions: vec![
                p(0., 0., 0.),
                p(1., 0., 0.),
                p(1., 1., 0.),
                p(0., 1., 0.),
                p(1., 0., 1.),
                p(1., 1., 1.),
            ],
            triangles: vec![[0, 1, 2], [0, 2, 3], [1, 2, 5], [1, 5, 4]],
            material: vec![0; 4],
            ..Mesh::default()
        }
    }

    #[test]
    fn finding_them_stops_on_request() {
        let cancel = Cancel::default();
        cancel.request();
        let error = Creases::new(&floor_and_wall(), 20.0, &cancel).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Cancelled);
    }

    #[test]
    fn a_disk_ends_at_borders_and_creases_but_not_at_the_diagonal() {
        let mesh = floor_and_wall();
        let creases = Creases::new(&mesh, 20.0, &Cancel::default()).unwrap();
        let middle = creases.clips(0, Vec3::new(0.5, 0.5, 0.0), Vec3::Z, 0.4);
        assert_eq!(middle.count, 0);
        // From the first triangle across the diagonal to the border y = 1 of the second, and the
        // crease at x = 1.
        let corner = creases.clips(0, Vec3::new(0.9, 0.8, 0.0), Vec3::Z, 0.25);
        assert_eq!(corner.count, 2);
        let (t, b) = tangents(Vec3::Z);
        let mut lines: Vec<_> = corner.edges[..2]
            .iter()
            .map(|c| (t * c.angle.cos() + b * c.angle.sin(), c.offset * 0.25))
            .collect();
        lines.sort_by(|a, b| a.1.total_cmp(&b.1));
        assert!((lines[0].0 - Vec3::X).length() < 1e-5 && (lines[0].1 - 0.1).abs() < 1e-5);
        assert!((lines[1].0 - Vec3::Y).length() < 1e-5 && (lines[1].1 - 0.2).abs() < 1e-5);
    }
}
