//! Clip planes of cameras, of which lvox has none: told where they would cut what is seen.

use super::Reader;
use crate::scene::builder::MeshInput;
use glam::{DAffine3, DVec3};

/// What a camera sees, and between which planes Mitsuba shows it.
pub(super) struct ClipPlanes {
    /// To a space in which it looks along -z.
    pub(super) camera_from_world: DAffine3,
    /// Half the width and the height of what it sees, over its depth.
    pub(super) tan: [f64; 2],
    pub(super) near: f64,
    pub(super) far: f64,
    /// Where it stands in the file.
    pub(super) line: String,
}

impl ClipPlanes {
    /// Planes that nobody chose.
    pub(super) const NEAR: f64 = 1e-2;
    pub(super) const FAR: f64 = f64::INFINITY;

    fn cut(&self, mesh: &MeshInput) -> bool {
        mesh.triangles.iter().any(|triangle| {
            let corners = triangle.map(|v| mesh.positions[v as usize]);
            self.cut_triangle(corners.map(|p| self.camera_from_world.transform_point3(p)))
        })
    }

    /// Whether a part of a triangle is in the picture, but not between the planes.
    fn cut_triangle(&self, corners: [DVec3; 3]) -> bool {
        let depths = corners.map(|p| -p.z);
        let nearest = depths.into_iter().fold(f64::INFINITY, f64::min);
        let farthest = depths.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let is_near = nearest < self.near && farthest > 0.0;
        is_near && self.sees(&corners, [0.0, self.near])
            || farthest > self.far && self.sees(&corners, [self.far, f64::INFINITY])
    }

    /// Whether a part of a polygon is in the picture and between two depths.
    fn sees(&self, corners: &[DVec3; 3], [low, high]: [f64; 2]) -> bool {
        let [across, up] = self.tan;
        let inside: [&dyn Fn(DVec3) -> f64; 6] = [
            &|p| -p.z - low,
            // An infinite difference has no ratio to another.
            &|p| if high.is_finite() { high + p.z } else { 1.0 },
            &|p| -p.z * across - p.x,
            &|p| -p.z * across + p.x,
            &|p| -p.z * up - p.y,
            &|p| -p.z * up + p.y,
        ];
        let mut polygon = corners.to_vec();
        for inside in inside {
            polygon = clipped(&polygon, inside);
        }
        !polygon.is_empty()
    }
}

/// The part of a convex polygon where a linear function is above 0.
fn clipped(polygon: &[DVec3], inside: impl Fn(DVec3) -> f64) -> Vec<DVec3> {
    let mut part = Vec::with_capacity(polygon.len() + 1);
    for (i, &p) in polygon.iter().enumerate() {
        let q = polygon[(i + 1) % polygon.len()];
        let [at_p, at_q] = [inside(p), inside(q)];
        if at_p > 0.0 {
            part.push(p);
        }
        if (at_p > 0.0) != (at_q > 0.0) {
            part.push(p.lerp(q, at_p / (at_p - at_q)));
        }
    }
    part
}

impl Reader<'_> {
    /// Tells cameras whose planes would cut a surface.
    pub(super) fn tell_clipped(&mut self) {
        for planes in std::mem::take(&mut self.clip_planes) {
            if self.builder.meshes.iter().any(|mesh| planes.cut(mesh)) {
                let what = "`near_clip` and `far_clip` are left out where they would cut surfaces";
                self.left_out.note(what, planes.line);
            }
        }
    }
}
