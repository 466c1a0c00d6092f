//! Where a disk must end: the borders and creases of the mesh around it.
//!
//! A plain disk sticks out over a convex edge and hides the neighbouring facet from light; on
//! Sponza that alone makes indirect light a fifth too dark. So each disk is cut by the creases
//! within its radius, found by walking from triangle to triangle over smooth edges.

use crate::math::sampling::{self, tangents};
use crate::run::Cancel;
use crate::scene::{Instance, Mesh};
use crate::trace::unit_normal;
use crate::{Error, Result};
use glam::Vec3;
use lvox_formats::record::{ClipEdge, Clips};
use rayon::prelude::*;
use std::f32::consts::TAU;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

/// Across this edge there is no surface to go on to, or one at an angle.
const CREASE: u32 = u32::MAX;
/// Behind this edge of a chain there is no other.
const END: u32 = u32::MAX;
/// Edges or vertices between two looks at whether to stop.
const PIECE: u32 = 1 << 16;

/// For each triangle, what lies across its three edges. Instances of a mesh have the creases that
/// it has in its own space.
#[derive(Debug)]
pub struct Creases<'a> {
    mesh: &'a Mesh,
    /// By number of the edge, three for each triangle that is stored: a triangle, or [`CREASE`].
    across: Vec<u32>,
}

impl<'a> Creases<'a> {
    /// Finds the edges at which two facets meet at more than `crease_deg`, and those with one
    /// facet, or more than two.
    ///
    /// # Errors
    /// If cancelled.
    pub fn new(mesh: &'a Mesh, crease_deg: f32, cancel: &Cancel) -> Result<Self> {
        let cos_crease = libm::cosf(crease_deg.to_radians());
        const { assert!(3 * Mesh::MAX_TRIANGLES < END as usize) };
        let mut welded = weld(&mesh.positions[..mesh.flat_vertices()], cancel)?;
        for prototype in mesh.instances.prototypes() {
            // What lies in another space is never at the same place.
            let first = prototype.vertices.start;
            let vertices = first as usize..prototype.vertices.end as usize;
            let own = weld(&mesh.positions[vertices], cancel)?;
            welded.extend(own.into_iter().map(|v| v + first));
        }
        let ends = |edge: u32| {
            let triangle = mesh.triangles[edge as usize / 3];
            let [a, b] = [edge % 3, (edge + 1) % 3].map(|k| welded[triangle[k as usize] as usize]);
            (a.min(b), a.max(b))
        };
        // Edges hang in a chain at the lower of their ends. A chain has few, and once it is in
        // hand what lies across takes the place of its links: no list but this one is ever made.
        let mut first = vec![END; mesh.positions.len()];
        let mut across = Vec::with_capacity(3 * mesh.triangles.len());
        for edge in 0..3 * mesh.triangles.len() as u32 {
            if edge % PIECE == 0 {
                cancel.check()?;
            }
            let first = &mut first[ends(edge).0 as usize];
            across.push(AtomicU32::new(std::mem::replace(first, edge)));
        }
        let is_smooth = |a: u32, b: u32| {
            let [n, m] = [a, b].map(|edge| unit_normal(mesh.own_corners(edge as usize / 3)));
            // Neighbours may wind differently: a flat pair is flat either way.
            n.dot(m).abs() >= cos_crease
        };
        first.par_chunks(PIECE as usize).try_for_each(|piece| {
            cancel.check()?;
            let mut chain = Vec::new();
            for &first in piece {
                let mut next = first;
                while next != END {
                    chain.push((ends(next).1, next));
                    next = across[next as usize].swap(CREASE, Relaxed);
                }
                chain.sort_unstable();
                for same in chain.chunk_by(|a, b| a.0 == b.0) {
                    if let &[(_, a), (_, b)] = same
                        && is_smooth(a, b)
                    {
                        across[a as usize].store(b / 3, Relaxed);
                        across[b as usize].store(a / 3, Relaxed);
                    }
                }
                chain.clear();
            }
            Ok::<_, Error>(())
        })?;
        let across = across.into_iter().map(AtomicU32::into_inner).collect();
        Ok(Self { mesh, across })
    }

    /// The nearest creases that cut a disk around a point of a triangle.
    #[must_use]
    pub fn clips(&self, triangle: u32, point: Vec3, normal: Vec3, radius: f32) -> Clips {
        const MAX_TRIANGLES: usize = 32;
        let (stored, instance) = self.mesh.place(triangle as usize);
        // Of an instance all triangles have their numbers by the same step.
        let step = triangle.wrapping_sub(stored as u32);
        let is_mirrored = instance.is_some_and(Instance::is_mirrored);
        let (tangent, bitangent) = tangents(normal);
        let mut visited = [triangle; MAX_TRIANGLES];
        let (mut visited_count, mut next) = (1, 0);
        let mut clips = Clips::default();
        while next < visited_count {
            let t = visited[next];
            next += 1;
            let stored = t.wrapping_sub(step) as usize;
            let corners = self.mesh.corners(t as usize).map(|c| {
                let d = c - point;
                [d.dot(tangent), d.dot(bitangent)]
            });
            for e in 0..3 {
                let (a, b) = (corners[e], corners[(e + 1) % 3]);
                if distance2_to_segment(a, b) >= radius * radius {
                    continue;
                }
                // A mirrored instance has the corners of triangles the other way round.
                let edge = if is_mirrored { 2 - e } else { e };
                let other = self.across[3 * stored + edge];
                if other != CREASE {
                    let other = other.wrapping_add(step);
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
    // Adding 0.0 makes -0.0 and 0.0 one.
    let place = |i: u32| {
        (positions[i as usize] + Vec3::ZERO)
            .to_array()
            .map(f32::to_bits)
    };
    let hashed = |i: u32| {
        let place = place(i).map(u64::from);
        sampling::hash(&place) >> 32 << 32 | u64::from(i)
    };
    cancel.check()?;
    let mut order: Vec<u64> = (0..positions.len() as u32)
        .into_par_iter()
        .map(hashed)
        .collect();
    cancel.check()?;
    order.par_sort_unstable();
    cancel.check()?;
    let mut welded: Vec<u32> = (0..positions.len() as u32).collect();
    for same_hash in order.chunk_by_mut(|a, b| a >> 32 == b >> 32) {
        if same_hash.len() == 1 {
            continue;
        }
        same_hash.sort_unstable_by_key(|&key| (place(key as u32), key as u32));
        for same in same_hash.chunk_by(|&a, &b| place(a as u32) == place(b as u32)) {
            for &key in same {
                welded[key as u32 as usize] = same[0] as u32;
            }
        }
    }
    Ok(welded)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{MeshInput, SceneBuilder};
    use crate::trace::Surface;
    use glam::{DAffine3, DVec3};
    use std::collections::BTreeMap;

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
            ]
            .into(),
            triangles: vec![[0, 1, 2], [0, 2, 3], [1, 2, 5], [1, 5, 4]].into(),
            material: vec![0; 4].into(),
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

    /// What lies across each edge, by a table of all edges.
    fn plain(mesh: &Mesh, cos_crease: f32) -> Vec<u32> {
        let place = |v: u32| {
            (mesh.positions[v as usize] + Vec3::ZERO)
                .to_array()
                .map(f32::to_bits)
        };
        let edges = || {
            let triangles = mesh.triangles.iter().enumerate();
            triangles.flat_map(|(t, v)| (0..3).map(move |e| (t as u32, [v[e], v[(e + 1) % 3]])))
        };
        let key = |ends: [u32; 2]| {
            let mut key = ends.map(place);
            key.sort_unstable();
            key
        };
        let mut triangles = BTreeMap::<_, Vec<u32>>::new();
        for (t, ends) in edges() {
            triangles.entry(key(ends)).or_default().push(t);
        }
        let across = |(t, ends): (u32, [u32; 2])| {
            let &[a, b] = triangles[&key(ends)].as_slice() else {
                return CREASE;
            };
            let [n, m] = [a, b].map(|t| unit_normal(mesh.corners(t as usize)));
            let is_smooth = n.dot(m).abs() >= cos_crease;
            if is_smooth { a ^ b ^ t } else { CREASE }
        };
        edges().map(across).collect()
    }

    #[test]
    fn chains_find_what_a_table_of_all_edges_finds() {
        // Vertices that are few and often at one place: edges of one to many facets, facets
        // without area, and facets that have an edge twice.
        let mut seed = 1_u64;
        let mut random = |below: u64| {
            seed = sampling::hash(&[seed]);
            seed % below
        };
        for _ in 0..50 {
            let vertices = 4 + random(60);
            let lattice = 2 + random(3);
            let mut coordinate = || random(lattice) as f32 * [-1.0, 1.0][random(2) as usize];
            let position = |_| Vec3::new(coordinate(), coordinate(), 0.1 * coordinate());
            let positions: Vec<Vec3> = (0..vertices).map(position).collect();
            let triangle = |_| std::array::from_fn(|_| random(vertices) as u32);
            let triangles: Vec<[u32; 3]> = (0..2 * vertices).map(triangle).collect();
            let mesh = Mesh {
                material: vec![0; triangles.len()].into(),
                positions: positions.into(),
                triangles: triangles.into(),
                ..Mesh::default()
            };
            let creases = Creases::new(&mesh, 20.0, &Cancel::default()).unwrap();
            assert_eq!(
                creases.across,
                plain(&mesh, libm::cosf(20_f32.to_radians()))
            );
        }
    }

    /// Turned, twice as large and mirrored.
    #[test]
    fn instances_have_the_creases_that_they_have_flat() {
        let mesh = floor_and_wall();
        let positions = || mesh.positions.iter().map(|p| p.as_dvec3());
        let input = || MeshInput::new("corner", positions(), mesh.triangles.to_vec());
        let turned = DAffine3::from_rotation_y(0.7) * DAffine3::from_translation(DVec3::X * 5.0);
        let places = [1.0, -1.0].map(|side| {
            let size = DVec3::new(2.0 * side, 2.0, 2.0);
            // Apart: flat ones that touch would go on into each other.
            let apart = DAffine3::from_translation(DVec3::X * 3.0 * side);
            turned * apart * DAffine3::from_scale(size)
        });
        let builder = SceneBuilder::new("corners");
        let flat = places
            .iter()
            .fold(SceneBuilder::new("corners"), |builder, place| {
                builder.mesh(input().transform(place))
            });
        let scenes = [builder.instances(input(), places), flat].map(|b| b.build().unwrap());
        assert_eq!(scenes[0].mesh.triangles.len(), 4);
        let creases = scenes
            .each_ref()
            .map(|scene| Creases::new(&scene.mesh, 20.0, &Cancel::default()).unwrap());
        for triangle in 0..8 {
            for i in 0..20 {
                let w = sampling::triangle(sampling::r2(i, [0.5; 2]));
                let clips = [0, 1].map(|k| {
                    let surface = Surface::new(&scenes[k], triangle, [w[1], w[2]]);
                    let (point, normal) = (surface.position, surface.face_normal);
                    creases[k].clips(triangle, point, normal, 0.9)
                });
                let [a, b] = clips.map(|c| {
                    let edges = c.edges[..c.count as usize].iter();
                    let edges = edges.map(|e| (normal_of(e.angle), e.offset));
                    edges.collect::<Vec<([f32; 2], f32)>>()
                });
                assert_eq!(a.len(), b.len(), "triangle {triangle}");
                for (n, offset) in &a {
                    let is_same = |(m, other): &([f32; 2], f32)| {
                        (n[0] - m[0]).abs() + (n[1] - m[1]).abs() + (offset - other).abs() < 1e-2
                    };
                    assert!(b.iter().any(is_same), "triangle {triangle}: {a:?} {b:?}");
                }
            }
        }
    }

    fn normal_of(angle: f32) -> [f32; 2] {
        let (sin, cos) = angle.sin_cos();
        [cos, sin]
    }
}
